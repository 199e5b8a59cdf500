"""Airframes: the physical constants of one kind of drone."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bulletuav.errors import as_int, as_sequence, finite, shown
from bulletuav.geometry.convex import bounding_radius, inscribed_radius
from bulletuav.geometry.obstacle import DEFAULT_FRICTION
from bulletuav.geometry.shapes import Shape

MIN_ROTORS, MAX_ROTORS = 4, 8
"""Minimum and maximum number of rotors of an airframe."""
_POSITIVE = (
    "mass",
    "inertia",
    "thrust_coefficient",
    "torque_ratio",
    "max_rotor_speed",
    "propeller_radius",
    "ground_effect_reach",
    "wake_radius",
    "efficiency",
    "max_speed",
)
"""Constants that must be greater than 0."""
_NOT_NEGATIVE = (
    "lag_up",
    "lag_down",
    "drag_xy",
    "drag_z",
    "rotor_inertia",
    "damping",
    "body_drag",
    "ground_effect_gain",
    "wake_share",
    "wake_spread",
    "electronics",
    "friction",
    "restitution",
)
"""Constants that must be at least 0."""
_WITHOUT = {"ground_effect_reach": "ground_effect_gain", "wake_radius": "wake_share"}
"""Constants that cannot be 0, and the constant that switches their effect off at 0."""
STANDARD_GRAVITY = 9.80665
"""Standard gravity, m/s^2 (CODATA)."""
DENSITY = 1.225
"""Air density of the standard atmosphere at sea level, kg/m^3."""


def hover_speed(weight: float, num_rotors: int, thrust_coefficient: float) -> float:
    """Compute the rotor speed w at which the thrust n k_f w^2 equals a weight (N), rad/s.

    It is 0 without rotors.
    """
    return math.sqrt(weight / (num_rotors * thrust_coefficient)) if num_rotors else 0.0


def arm_length(rotors: tuple[tuple[float, float, int], ...]) -> float:
    """Compute the distance of the outermost rotor from the centre of mass, m; 0 without rotors."""
    return max((math.sqrt(x * x + y * y) for x, y, _ in rotors), default=0.0)


@dataclass(frozen=True)
class Pwm:
    """Motor command of the Crazyflie: rpm = slope pwm + intercept.

    Attributes:
        slope: Rotor speed per unit of the command, rpm.
        intercept: Rotor speed at a command of 0, rpm.
        minimum: Minimum command.
        maximum: Maximum command.
    """

    slope: float
    intercept: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class Pack:
    """Battery pack of lithium-polymer cells in series.

    Attributes:
        cells: Number of cells.
        capacity: Energy of the full battery, W h.
        resistance: Internal resistance, ohm.
        voltage: Nominal voltage, at which the motors reach the commanded speed, V.
    """

    cells: int
    capacity: float
    resistance: float
    voltage: float


@dataclass(frozen=True)
class Airframe:
    """Constants of one kind of drone, SI units, body axes FLU, rotor thrust along +z.

    Attributes:
        name: Name of the robot in the URDF.
        urdf: Path of the file.
        mass: Mass, kg.
        inertia: Principal moments of inertia about x, y, z, kg m^2.
        rotors: Position x, y (m) and direction of rotation of each rotor. The direction is +1 if
            the reaction torque on the body is +z (the rotor spins clockwise seen from above), else
            -1.
        thrust_coefficient: Thrust divided by the square of the rotor speed, N s^2.
        torque_ratio: Reaction torque divided by thrust, m.
        max_rotor_speed: Maximum rotor speed, rad/s.
        lag_up: Time constant of a rotor that speeds up, s; 0 for no lag.
        lag_down: Time constant of a rotor that slows down, s; 0 for no lag.
        drag_xy: Drag of a rotor across its axis, N / (m/s rad/s).
        drag_z: Drag of a rotor along its axis, per m/s and rad/s, N.
        drag_height: Height above the centre of mass at which the rotors' drag acts, m.
        propeller_radius: Radius of the propellers, m.
        rotor_inertia: Moment of inertia of a propeller and its motor's rotor, kg m^2; 0 to neglect
            it.
        damping: Decay rates of the angular velocities about x, y, z in hover, 1/s.
        body_drag: Drag areas of the body in the rotor plane and across it, m^2.
        ground_effect_gain: Thrust that a surface right below adds, as a fraction of a rotor's
            thrust.
        ground_effect_reach: Height above which there is no ground effect, m.
        wake_share: Force of the wake on a drone right below, as a fraction of the thrust.
        wake_spread: Growth of the wake's width per distance below.
        wake_radius: Width of the wake at the rotors, m.
        efficiency: Power at the rotors' shafts divided by electrical power.
        electronics: Electrical power of everything except the motors, W.
        pack: The battery, if known.
        max_speed: Maximum commanded speed, m/s.
        shape: Collision shape, relative to the centre of mass.
        pwm: Motor command for the Crazyflie's own PID, if known.
        friction: Coefficient of friction of the surface, from 0 to 10.
        restitution: Coefficient of restitution, from 0 to 1.
    """

    name: str
    urdf: Path
    mass: float
    inertia: tuple[float, float, float]
    rotors: tuple[tuple[float, float, int], ...]
    thrust_coefficient: float
    torque_ratio: float
    max_rotor_speed: float
    lag_up: float
    lag_down: float
    drag_xy: float
    drag_z: float
    drag_height: float
    propeller_radius: float
    rotor_inertia: float
    damping: tuple[float, float, float]
    body_drag: tuple[float, float]
    ground_effect_gain: float
    ground_effect_reach: float
    wake_share: float
    wake_spread: float
    wake_radius: float
    efficiency: float
    electronics: float
    max_speed: float
    shape: Shape
    pack: Pack | None = None
    pwm: Pwm | None = None
    friction: float = DEFAULT_FRICTION
    restitution: float = 0.0

    def require_physical(self) -> None:
        """Raise ValueError for constants outside the domain of the dynamics.

        The reader of URDF files checks its values. This check is for airframes that are made in
        Python, such as by `dataclasses.replace`.

        Raises:
            ValueError: If a constant is not finite, or is 0 or negative where it must not be.
        """
        of = f"of airframe {self.name!r}"
        for name in (*_POSITIVE, *_NOT_NEGATIVE, "drag_height"):
            values = getattr(self, name)
            for value in values if isinstance(values, tuple) else (values,):
                least = None if name == "drag_height" else 0.0
                if finite(f"{name} {of}", value, least) == 0.0 and name in _POSITIVE:
                    other = _WITHOUT.get(name)
                    remedy = f"; for none, set {other} to 0" if other else ""
                    raise ValueError(f"{name} {of} is 0: a number above 0 is needed{remedy}")
        if not self.is_load:
            as_int(f"number of rotors {of}", len(self.rotors), MIN_ROTORS, MAX_ROTORS)
        for rotor in self.rotors:
            x, y, turn = as_sequence(f"a rotor {of}", rotor, 3)
            finite(f"x of a rotor {of}", x)
            finite(f"y of a rotor {of}", y)
            if turn not in (-1, 1):
                raise ValueError(f"turn of a rotor {of} is {shown(turn)}: 1 or -1 is needed")

    @property
    def is_load(self) -> bool:
        """Whether it has no rotors, as what drones carry on cables; see `vehicle.load.Load`."""
        return False

    @property
    def collision_radius(self) -> float:
        """Radius of the collision shape's bounding sphere about the centre of mass, m."""
        return bounding_radius(self.shape)

    @cached_property
    def thinnest(self) -> float:
        """Minimum extent of the collision shape, m: the diameter of a ball inside it.

        The ball in a hull is centred at the mean of the vertices, so its diameter may be less than
        the minimum extent.
        """
        return 2 * inscribed_radius(self.shape)

    @property
    def standing_height(self) -> float:
        """Height of the centre of mass above level ground on which the drone stands, m."""
        corners = self.shape.corners
        return -min(z for _, _, z in corners) if corners else self.shape.half[2]

    @property
    def arm(self) -> float:
        """Distance of the outermost rotor from the centre of mass, m."""
        return arm_length(self.rotors)

    @property
    def max_thrust(self) -> float:
        """Thrust of all rotors at maximum speed, N."""
        speed = self.max_rotor_speed
        return len(self.rotors) * self.thrust_coefficient * (speed * speed)

    def hover_speed(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Return the rotor speed at which thrust equals weight, rad/s.

        Args:
            gravity: Gravity, m/s^2.
        """
        return hover_speed(self.mass * gravity, len(self.rotors), self.thrust_coefficient)

    def allocation(self) -> np.ndarray:
        """Return the allocation matrix from the thrust of each rotor to the wrench on the body.

        Returns:
            (4, R): collective thrust (N) and body torques about x, y, z (N m), per N of thrust.
        """
        return np.array([(1, y, -x, turn * self.torque_ratio) for x, y, turn in self.rotors]).T
