"""Airframes: the constants of one kind of drone."""

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
"""Fewest and most rotors of an airframe."""
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
"""Constants that must be above 0."""
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
"""Constants at 0 with which an effect is left out whose size cannot be 0."""
STANDARD_GRAVITY = 9.80665
"""Gravity at the Earth's surface, m/s^2 (CODATA)."""
DENSITY = 1.225
"""Density of the air, kg/m^3: standard atmosphere at sea level."""


def hover_speed(weight: float, num_rotors: int, thrust_coefficient: float) -> float:
    """Compute the rotor speed at which thrust k_f w^2 of all rotors equals a weight (N), rad/s."""
    return math.sqrt(weight / (num_rotors * thrust_coefficient))


def arm_length(rotors: tuple[tuple[float, float, int], ...]) -> float:
    """Compute the distance of the outermost rotor from the centre of mass, m."""
    return max(math.sqrt(x * x + y * y) for x, y, _ in rotors)


@dataclass(frozen=True)
class Pwm:
    """The Crazyflie's motor command: rpm = slope pwm + intercept.

    Attributes:
        slope: Rotor speed for each unit of the command, rpm.
        intercept: Rotor speed at a command of 0, rpm.
        minimum: Least command.
        maximum: Greatest command.
    """

    slope: float
    intercept: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class Pack:
    """A battery of lithium-polymer cells in series.

    Attributes:
        cells: Number of cells.
        capacity: Energy of a full battery, W h.
        resistance: Inner resistance, ohm.
        voltage: Voltage at which the motors reach the speed that is commanded, V.
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
        urdf: The file.
        mass: Mass, kg.
        inertia: Principal moments of inertia about x, y, z, kg m^2.
        rotors: Place x, y (m) and turn of each rotor. The turn is +1 where the reaction torque on
            the body is +z, so the rotor spins clockwise seen from above, else -1.
        thrust_coefficient: Thrust over the square of the rotor speed, N s^2.
        torque_ratio: Reaction torque over thrust, m.
        max_rotor_speed: Greatest rotor speed, rad/s.
        lag_up: Time constant of a rotor that speeds up, s; 0 for none.
        lag_down: Time constant of a rotor that slows down, s; 0 for none.
        drag_xy: Drag of a rotor across its axis, for each m/s and rad/s, N.
        drag_z: Drag of a rotor along its axis, for each m/s and rad/s, N.
        drag_height: Height above the centre of mass at which the rotors' drag acts, m.
        propeller_radius: Radius of the propellers, m.
        rotor_inertia: Moment of inertia of a propeller with its motor's rotor, kg m^2; 0 for none.
        damping: How fast rates about x, y, z decay by themselves in hover, 1/s.
        body_drag: Drag areas of the body in the rotor plane and across it, m^2.
        ground_effect_gain: Share of a rotor's thrust that a surface right below adds.
        ground_effect_reach: Height above which there is no ground effect, m.
        wake_share: Share of the drone's thrust that its wake puts on a drone right below.
        wake_spread: Growth of the wake's width with the distance below.
        wake_radius: Width of the wake at its start, m.
        efficiency: Power at the rotors' shafts over electrical power.
        electronics: Electrical power of all but the motors, W.
        pack: The battery, where known.
        max_speed: Greatest speed that the drone may be asked for, m/s.
        shape: Collision shape, about the centre of mass.
        pwm: Motor command for the Crazyflie's own PID, where known.
        friction: Coefficient of friction of its surface, from 0 to 10.
        restitution: Share of the speed that an impact gives back, from 0 to 1.
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
        """Refuse constants that the laws cannot compute with.

        URDF files are refused as they are read. This is for airframes that are made in Python, such
        as by `dataclasses.replace`.

        Raises:
            ValueError: A constant is no finite number, or 0 or negative where it must not be.
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
        as_int(f"number of rotors {of}", len(self.rotors), MIN_ROTORS, MAX_ROTORS)
        for rotor in self.rotors:
            x, y, turn = as_sequence(f"a rotor {of}", rotor, 3)
            finite(f"x of a rotor {of}", x)
            finite(f"y of a rotor {of}", y)
            if turn not in (-1, 1):
                raise ValueError(f"turn of a rotor {of} is {shown(turn)}: 1 or -1 is needed")

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere about the centre of mass that holds the collision shape, m."""
        return bounding_radius(self.shape)

    @cached_property
    def thinnest(self) -> float:
        """Least extent of the collision shape, m: the diameter of a ball within it.

        A hull's ball is about the mean of its corners, and may be less than its least extent.
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
        """Thrust of all rotors at full speed, N."""
        return len(self.rotors) * self.thrust_coefficient * self.max_rotor_speed**2

    def hover_speed(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Return the rotor speed at which thrust equals weight, rad/s.

        Args:
            gravity: Gravity, m/s^2.
        """
        return hover_speed(self.mass * gravity, len(self.rotors), self.thrust_coefficient)

    def allocation(self) -> np.ndarray:
        """Return what a newton of each rotor's thrust does to the body.

        Returns:
            (4, R): collective thrust (N) and body torques about x, y, z (N m).
        """
        return np.array([(1, y, -x, turn * self.torque_ratio) for x, y, turn in self.rotors]).T
