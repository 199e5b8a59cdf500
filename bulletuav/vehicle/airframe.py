"""Airframes: one-link URDF files, read into frozen constants.

A drone of your own is a URDF and nothing else. Beside the standard `<link>` (inertial, one convex
collision shape, any number of visuals) it holds `<airframe>` with the tags of `Airframe`, and one
`<rotor x y spin>` for each rotor; see assets/urdf.

Airframes have names: those of the files in assets/urdf, and those that are registered as kind
"airframe" (see `bulletuav.registry`), as an `Airframe` or as the path of a URDF.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bulletuav.errors import require_file, shown, unknown
from bulletuav.functions import hypot
from bulletuav.geometry.convex import inscribed_radius, reach
from bulletuav.geometry.obstacle import FRICTION, MOST_FRICTION
from bulletuav.geometry.shapes import Shape
from bulletuav.registry import find, register
from bulletuav.vehicle.urdf import LARGEST, WIDEST, UrdfFile

_PACKAGE = Path(__file__).parents[1]
URDF_FOLDER = next(
    folder / "assets" / "urdf"
    for folder in (_PACKAGE, _PACKAGE.parent)
    if (folder / "assets").is_dir()
)
"""Folder of the airframes that come with the package.

In the package of a wheel; beside it in a checkout.
"""

MAX_ROTORS = 8
"""Most rotors of an airframe."""
TAGS = (
    "thrust_coefficient",
    "torque_ratio",
    "max_rotor_speed",
    "motor_lag",
    "rotor_drag",
    "propeller_radius",
    "ground_effect",
    "max_speed",
    "rotor",
    "pwm",
    "contact",
)
"""Tags within `<airframe>`."""
HEAVIEST = 1e5
"""Greatest mass, kg."""
FASTEST = 1000.0
"""Greatest speed of a drone, m/s."""
FASTEST_ROTOR = 1e5
"""Greatest speed of a rotor, rad/s."""
SLOWEST_LAG = 100.0
"""Greatest time constant of a motor, s."""
MOST_DRAG = 1.0
"""Greatest drag of a rotor, N for each m/s and rad/s."""
STRONGEST = 1000.0
"""Greatest thrust of a drone, in its weights."""

STANDARD_GRAVITY = 9.80665
"""Gravity at the Earth's surface, m/s^2 (CODATA)."""
EFFECTS = ("lag", "drag", "ground_effect", "downwash")
"""Effects of rotors that can be switched off."""
DOWNWASH_GAIN = 2267.18
"""Gain of the downwash, N: fit for the Crazyflie (gym-pybullet-drones, J. Panerati et al. 2021)."""


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
        propeller_radius: Radius of the propellers, m.
        ground_effect_gain: Factor of the ground effect; 1 is the formula of Cheeseman and Bennett.
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
    propeller_radius: float
    ground_effect_gain: float
    max_speed: float
    shape: Shape
    pwm: Pwm | None = None
    friction: float = FRICTION
    restitution: float = 0.0

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere about the centre of mass that holds the collision shape, m."""
        return reach(self.shape)

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
        return max(hypot(x, y) for x, y, _ in self.rotors)

    @property
    def max_thrust(self) -> float:
        """Thrust of all rotors at full speed, N."""
        return len(self.rotors) * self.thrust_coefficient * self.max_rotor_speed**2

    def hover_speed(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Return the rotor speed at which thrust equals weight, rad/s.

        Args:
            gravity: Gravity, m/s^2.
        """
        return math.sqrt(self.mass * gravity / (len(self.rotors) * self.thrust_coefficient))

    def allocation(self) -> np.ndarray:
        """Return what a newton of each rotor's thrust does to the body.

        Returns:
            (4, R): collective thrust (N) and body torques about x, y, z (N m).
        """
        return np.array([(1, y, -x, turn * self.torque_ratio) for x, y, turn in self.rotors]).T


def available_airframes() -> list[str]:
    """List the names of the airframes that come with the package."""
    return sorted(path.stem for path in URDF_FOLDER.glob("*.urdf"))


def load_airframe(source: str | Path | Airframe) -> Airframe:
    """Load an airframe.

    Args:
        source: A name (of `available_airframes` or registered), `module:Name` of an `Airframe` or
            of a path, the path of a URDF, which ends in ".urdf", or the airframe itself.

    Returns:
        The airframe.

    Raises:
        ValueError: The name is unknown, or a value is missing or not physical; file, tag and value
            are named.
        FileNotFoundError: There is no such file.
    """
    if isinstance(source, Airframe):
        return source
    if not isinstance(source, str | Path):
        raise ValueError(
            f"airframe is {shown(source)}: a name, the path of a URDF, or an Airframe is needed"
        )
    if isinstance(source, str) and not source.endswith(".urdf"):
        found = _find_by_name(source)
        if isinstance(found, Airframe):
            return found
        source = found
    path = require_file(
        "airframe", source, f"pass the path of a URDF or one of {available_airframes()}"
    )
    return _read_airframe(path.resolve())


def _find_by_name(name: str) -> str | Path | Airframe:
    """Find what a name stands for: a file of the package comes before what is registered."""
    if name in available_airframes():
        return URDF_FOLDER / f"{name}.urdf"
    found: str | Path | Airframe = find("airframe", name, _is_airframe_or_path)
    if not _is_airframe_or_path(found):
        raise ValueError(
            f"airframe {name} is {shown(found)}: the path of a URDF, or an Airframe is needed"
        )
    return found


def _is_airframe_or_path(ingredient: object) -> bool:
    """Tell whether an object of the registry can be an airframe."""
    return isinstance(ingredient, str | Path | Airframe)


def _read_airframe(path: Path) -> Airframe:
    """Read an airframe from a URDF file."""
    urdf = UrdfFile(path)
    urdf.require_one_link()
    _refuse_unknown_tags(urdf)
    shape = urdf.collision_shape()
    for element in (urdf.root, urdf.element("link")):
        if not element.get("name"):
            raise urdf.refusal(f"{element.tag} name", "missing", "the engine needs it")
    # Each number is read within the bounds that the dynamics can compute with.
    airframe = Airframe(
        name=urdf.root.get("name", ""),
        urdf=urdf.path,
        mass=urdf.number(urdf.element("link/inertial/mass"), "value", low=0, most=HEAVIEST),
        inertia=urdf.inertia(),
        rotors=_rotors(urdf),
        thrust_coefficient=_positive(urdf, "thrust_coefficient", LARGEST),
        torque_ratio=_positive(urdf, "torque_ratio", WIDEST),
        max_rotor_speed=_positive(urdf, "max_rotor_speed", FASTEST_ROTOR),
        lag_up=_not_negative(urdf, "motor_lag", "up", SLOWEST_LAG),
        lag_down=_not_negative(urdf, "motor_lag", "down", SLOWEST_LAG),
        drag_xy=_not_negative(urdf, "rotor_drag", "xy", MOST_DRAG),
        drag_z=_not_negative(urdf, "rotor_drag", "z", MOST_DRAG),
        propeller_radius=_positive(urdf, "propeller_radius", WIDEST),
        ground_effect_gain=_not_negative(urdf, "ground_effect", "gain", LARGEST),
        max_speed=_positive(urdf, "max_speed", FASTEST),
        shape=shape,
        pwm=_pwm(urdf),
        friction=_contact(urdf, "friction", FRICTION, MOST_FRICTION),
        restitution=_contact(urdf, "restitution", 0.0, 1.0),
    )
    _require_flyable(urdf, airframe)
    return airframe


def _refuse_unknown_tags(urdf: UrdfFile) -> None:
    """Refuse tags within `<airframe>` that nobody would read, such as misspelt ones."""
    for element in urdf.element("airframe"):
        if isinstance(element.tag, str) and element.tag not in TAGS:
            reason = str(unknown("tag", element.tag, TAGS))
            raise urdf.refusal(f"airframe/{element.tag}", "unknown", reason)


def _positive(urdf: UrdfFile, tag: str, most: float) -> float:
    """Read the value of a tag within `<airframe>` that must be above 0."""
    return urdf.number(urdf.element(f"airframe/{tag}"), "value", low=0, most=most)


def _not_negative(urdf: UrdfFile, tag: str, attribute: str, most: float) -> float:
    """Read an attribute of a tag within `<airframe>` that must be at least 0."""
    element = urdf.element(f"airframe/{tag}")
    return urdf.number(element, attribute, low=0, strict=False, most=most)


def _rotors(urdf: UrdfFile) -> tuple[tuple[float, float, int], ...]:
    """Read the place (m) and the turn of each rotor."""
    elements = urdf.root.findall("airframe/rotor")
    if not 4 <= len(elements) <= MAX_ROTORS:
        reason = f"between 4 and {MAX_ROTORS} rotors are supported"
        raise urdf.refusal("rotor", f"there {len(elements)} times", reason)
    turns = {"cw": 1, "ccw": -1}
    for element in elements:
        if element.get("spin") not in turns:
            spin = element.get("spin", "missing")
            raise urdf.refusal("rotor spin", spin, "it must be cw or ccw, seen from above")
    return tuple(
        (
            urdf.number(element, "x", most=WIDEST),
            urdf.number(element, "y", most=WIDEST),
            turns[element.get("spin", "")],
        )
        for element in elements
    )


def _pwm(urdf: UrdfFile) -> Pwm | None:
    """Read the motor command, where the file has it."""
    element = urdf.root.find("airframe/pwm")
    if element is None:
        return None
    minimum = urdf.number(element, "min", low=0, strict=False)
    return Pwm(
        slope=urdf.number(element, "slope", low=0),
        intercept=urdf.number(element, "intercept"),
        minimum=minimum,
        maximum=urdf.number(element, "max", low=minimum),
    )


def _contact(urdf: UrdfFile, attribute: str, default: float, most: float) -> float:
    """Read a number of the tag `<contact>` within `<airframe>`, where it is there."""
    element = urdf.root.find("airframe/contact")
    if element is None or attribute not in element.attrib:
        return default
    value = urdf.number(element, attribute, low=0, strict=False)
    if value > most:
        raise urdf.refusal(f"contact {attribute}", value, f"at most {most:g} is possible")
    return value


def _require_flyable(urdf: UrdfFile, airframe: Airframe) -> None:
    """Refuse airframes that are too heavy to hover, far too strong, or cannot turn."""
    weight = airframe.mass * STANDARD_GRAVITY
    if airframe.max_thrust <= weight:
        thrust = f"{airframe.max_rotor_speed:g} (thrust {airframe.max_thrust:.4g} N)"
        reason = f"the drone weighs {weight:.4g} N and cannot hover"
        raise urdf.refusal("max_rotor_speed", thrust, reason)
    if airframe.max_thrust > STRONGEST * airframe.mass * STANDARD_GRAVITY:
        thrust = f"{airframe.thrust_coefficient:g} (thrust {airframe.max_thrust:.4g} N)"
        reason = f"at most {STRONGEST:g} times the weight of {airframe.mass:g} kg can be flown with"
        raise urdf.refusal("thrust_coefficient", thrust, reason)
    if np.linalg.matrix_rank(airframe.allocation()) < 4:
        reason = "these rotors cannot turn the body about all three axes"
        raise urdf.refusal("rotor", airframe.rotors, reason)


# Tell the registry where the package's own airframes are; each file is read when it is asked for.
for _path in URDF_FOLDER.glob("*.urdf"):
    if _path.stem.isidentifier():
        register("airframe", _path.stem)(_path)
