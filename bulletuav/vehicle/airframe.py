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
"""Minimum and maximum number of rotors of an airframe; one is enough for an airframe with wings."""
MAX_WINGS = 8
"""Maximum number of wings of an airframe, each with at most one control surface."""
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
MAX_WING_LENGTH = 100.0
"""Maximum span or chord of a wing, m."""
WING_BOUNDS: dict[str, tuple[float, float]] = {
    "span": (0.0, MAX_WING_LENGTH),
    "chord": (0.0, MAX_WING_LENGTH),
    "dihedral": (-math.pi, math.pi),
    "incidence": (-math.pi / 2, math.pi / 2),
    "aspect_ratio": (0.0, 1000.0),
    "lift_slope": (0.0, 10.0),
    "zero_lift": (-0.5, 0.5),
    "stall": (0.0, 0.5),
    "drag": (0.0, 2.0),
    "moment": (-1.0, 1.0),
    "efficiency": (0.0, 1.0),
    "downwash": (0.0, 1.0),
    "slipstream": (0.0, 1.0),
}
"""Lowest and highest value of each constant of a wing."""
SURFACE_BOUNDS: dict[str, tuple[float, float]] = {
    "chord_fraction": (0.0, 1.0),
    "low": (-math.pi / 2, 0.0),
    "high": (0.0, math.pi / 2),
    "rate": (0.0, 1000.0),
}
"""Lowest and highest value of each constant of a control surface; 0 is its neutral deflection."""
ABOVE_ZERO = frozenset(
    (
        "span",
        "chord",
        "aspect_ratio",
        "lift_slope",
        "stall",
        "efficiency",
        "chord_fraction",
        "rate",
    )
)
"""Constants of wings and control surfaces that cannot be 0."""
_WITHOUT_WINGS = ("damping", "drag_height", "ground_effect_gain", "wake_share")
"""Constants that must be 0 for an airframe with wings.

Its rotation is damped by its panels and its rotors' drag. The drag of each rotor acts at the rotor.
Ground effect and wakes are models of rotors along +z.
"""
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


def _require_bounds(owner: object, bounds: dict[str, tuple[float, float]], of: str) -> None:
    """Raise ValueError for an attribute out of its bounds.

    Args:
        owner: The wing or control surface.
        bounds: Lowest and highest value of each attribute.
        of: What the attributes belong to, for the message.
    """
    for name, (low, most) in bounds.items():
        value = finite(f"{name} {of}", getattr(owner, name), low, most)
        if value == 0.0 and name in ABOVE_ZERO:
            raise ValueError(f"{name} {of} is 0: a number above 0 is needed")


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
class ControlSurface:
    """Control surface at the trailing edge of a wing, along its whole span.

    A positive deflection moves the trailing edge down.

    Attributes:
        name: Name, such as "elevator".
        chord_fraction: Chord of the surface divided by that of the wing, from 0 to 1.
        low: Lowest deflection, rad.
        high: Highest deflection, rad.
        rate: Rate of the servo, rad/s.
    """

    name: str
    chord_fraction: float
    low: float
    high: float
    rate: float

    def require_physical(self, of: str) -> None:
        """Raise ValueError for a constant outside the domain of the dynamics.

        Args:
            of: Name of the airframe in messages.
        """
        _require_bounds(self, SURFACE_BOUNDS, f"of control surface {self.name!r} {of}")


@dataclass(frozen=True)
class Wing:
    """A rectangular wing or a part of one, such as the left half or a fin.

    Attributes:
        name: Name, such as "left wing".
        position: Middle of its quarter-chord line relative to the centre of mass, body axes, m.
        span: Length along its span, m.
        chord: Length along the flow, m.
        dihedral: Rotation about the x axis, rad: 0 for a level wing, pi / 2 for a fin.
        incidence: Angle of the chord to the x axis, leading edge up, rad.
        aspect_ratio: Aspect ratio of the whole wing that it is a part of.
        lift_slope: Lift coefficient per angle of attack below the stall, 1/rad.
        zero_lift: Angle of attack without lift, rad; negative for a cambered wing.
        stall: Angle from the zero-lift angle at which the stall begins, rad.
        drag: Drag coefficient without lift.
        moment: Pitching moment coefficient about the quarter chord, positive nose up.
        efficiency: Oswald's efficiency, for the induced drag.
        downwash: Change of the downwash angle of a wing ahead per angle of attack.
        slipstream: Fraction of the area in the slipstream of the forward rotors.
        surface: Its control surface, if any.
    """

    name: str
    position: tuple[float, float, float]
    span: float
    chord: float
    dihedral: float
    incidence: float
    aspect_ratio: float
    lift_slope: float
    zero_lift: float
    stall: float
    drag: float
    moment: float
    efficiency: float
    downwash: float
    slipstream: float
    surface: ControlSurface | None = None

    def require_physical(self, of: str) -> None:
        """Raise ValueError for a constant outside the domain of the dynamics.

        Args:
            of: Name of the airframe in messages.
        """
        of_wing = f"of wing {self.name!r} {of}"
        for value in as_sequence(f"position {of_wing}", self.position, 3):
            finite(f"position {of_wing}", value)
        _require_bounds(self, WING_BOUNDS, of_wing)
        if self.surface is not None:
            self.surface.require_physical(of)


@dataclass(frozen=True)
class Airframe:
    """Constants of one kind of drone, SI units, body axes FLU, rotor thrust along +z or +x.

    Attributes:
        name: Name of the robot in the URDF.
        urdf: Path of the file.
        mass: Mass, kg.
        inertia: Principal moments of inertia about x, y, z, kg m^2.
        rotors: Position x, y (m) and direction of rotation of each rotor. The direction is +1 if
            the reaction torque on the body is along the thrust (the rotor spins clockwise seen from
            the side that its thrust points to: from above, or from ahead if it is one of
            `forward_rotors`), else -1.
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
        wings: Wings, fins and tails; none for a multirotor.
        forward_rotors: Indices of the rotors whose thrust is along +x instead of +z.
        rotor_heights: Position z of each rotor of an airframe with wings, m.
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
    wings: tuple[Wing, ...] = ()
    forward_rotors: tuple[int, ...] = ()
    rotor_heights: tuple[float, ...] = ()

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
            fewest = 1 if self.wings else MIN_ROTORS
            as_int(f"number of rotors {of}", len(self.rotors), fewest, MAX_ROTORS)
        for rotor in self.rotors:
            x, y, turn = as_sequence(f"a rotor {of}", rotor, 3)
            finite(f"x of a rotor {of}", x)
            finite(f"y of a rotor {of}", y)
            if turn not in (-1, 1):
                raise ValueError(f"turn of a rotor {of} is {shown(turn)}: 1 or -1 is needed")
        self._require_wings(of)

    def _require_wings(self, of: str) -> None:
        """Raise ValueError for wings, or rotors next to them, outside the domain of the dynamics.

        Args:
            of: Name of the airframe in messages.
        """
        if not self.wings:
            if self.forward_rotors or self.rotor_heights:
                raise ValueError(
                    f"forward_rotors or rotor_heights {of} are set, and it has no wings: leave "
                    f"them empty"
                )
            return
        as_int(f"number of wings {of}", len(self.wings), 1, MAX_WINGS)
        for wing in self.wings:
            wing.require_physical(of)
        for kind, names in (
            ("wings", [wing.name for wing in self.wings]),
            ("control surfaces", [surface.name for surface in self.surfaces]),
        ):
            if len(set(names)) < len(names):
                raise ValueError(f"names of {kind} {of} are {names}: each must be different")
        count = len(self.rotors)
        for index in self.forward_rotors:
            as_int(f"an index of forward_rotors {of}", index, 0, count - 1)
        for z in as_sequence(f"rotor_heights {of}", self.rotor_heights, count):
            finite(f"z of a rotor {of}", z)
        for name in _WITHOUT_WINGS:
            values = getattr(self, name)
            if any(values if isinstance(values, tuple) else (values,)):
                raise ValueError(
                    f"{name} {of} is {shown(values)}: it has no effect next to wings, set it to 0"
                )

    @property
    def is_load(self) -> bool:
        """Whether it has no rotors, as what drones carry on cables; see `vehicle.load.Load`."""
        return False

    @property
    def needs_airspeed(self) -> bool:
        """Whether it flies by its wings only, as its rotors cannot lift it."""
        return bool(self.wings) and not self.can_hover

    @property
    def lift_rotors(self) -> tuple[tuple[float, float, int], ...]:
        """Rotors whose thrust is along +z, in the form of `rotors`."""
        return tuple(one for k, one in enumerate(self.rotors) if k not in self.forward_rotors)

    @property
    def can_hover(self) -> bool:
        """Whether four rotors or more along +z lift its weight.

        Aircraft with wings that cannot hover fly above `Envelope.min_speed`.
        """
        weight = self.mass * STANDARD_GRAVITY
        return len(self.lift_rotors) >= MIN_ROTORS and self.max_thrust > weight

    @property
    def surfaces(self) -> tuple[ControlSurface, ...]:
        """Control surfaces, in the order of the wings."""
        return tuple(wing.surface for wing in self.wings if wing.surface is not None)

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
        """Thrust of all rotors along +z at maximum speed, N."""
        speed = self.max_rotor_speed
        return len(self.lift_rotors) * self.thrust_coefficient * (speed * speed)

    def hover_speed(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Return the rotor speed at which thrust along +z equals weight, rad/s; 0 without any.

        Args:
            gravity: Gravity, m/s^2.
        """
        return hover_speed(self.mass * gravity, len(self.lift_rotors), self.thrust_coefficient)

    def allocation(self) -> np.ndarray:
        """Return the allocation matrix from the thrust of each rotor to the wrench on the body.

        Returns:
            (4, R): collective thrust (N) and body torques about x, y, z (N m), per N of thrust.
            Columns of forward rotors are 0, as these are not used in hover.
        """
        matrix = np.array([(1, y, -x, turn * self.torque_ratio) for x, y, turn in self.rotors]).T
        matrix[:, list(self.forward_rotors)] = 0
        return matrix
