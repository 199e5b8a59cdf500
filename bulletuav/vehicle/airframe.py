"""Airframes: one-link URDF files read by tag name into frozen constants and into rows for the compiled loops.

A drone of your own is a URDF and nothing else. Beside the standard `<link>` (inertial, one convex collision shape, any
number of visuals) it holds `<airframe>` with the tags of `Airframe`, one `<rotor x y spin>` a rotor; see assets/urdf.
"""

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bulletuav.errors import require_file, shown, unknown
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE, Shape

_PACKAGE = Path(__file__).parents[1]
URDF_FOLDER = next(
    folder / "assets" / "urdf"
    for folder in (_PACKAGE, _PACKAGE.parent)
    if (folder / "assets").is_dir()
)
"""In the package of a wheel; beside it in a checkout"""
MAX_ROTORS = 8
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
)
SMALLEST, LARGEST = 1e-20, 1e9
"""Of numbers of an airframe but 0: squares of these, and products of a few, are numbers, too"""
WIDEST, THINNEST = 100.0, 1e-4
"""Lengths of a drone, m: the engine's margins are as large as thinner ones"""
HEAVIEST, FASTEST, FASTEST_ROTOR = 1e5, 1000.0, 1e5
"""kg, m/s, rad/s"""
SLOWEST_LAG, MOST_DRAG = 100.0, 1.0
"""s; N for each m/s and rad/s of a rotor"""
STRONGEST = 1000.0  # times its weight, that a drone's thrust can be
LONGEST = 200  # letters of a value in a message
STANDARD_GRAVITY = 9.80665  # m/s^2, CODATA
EFFECTS = ("lag", "drag", "ground_effect", "downwash")
DOWNWASH_GAIN = 2267.18  # N, fit for the Crazyflie (gym-pybullet-drones, J. Panerati et al. 2021)


@dataclass(frozen=True)
class Pwm:
    """The Crazyflie's motor command: rpm = slope pwm + intercept, pwm within [minimum, maximum]."""

    slope: float
    intercept: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class Airframe:
    """Constants of one kind of drone, SI units, body FLU, rotor thrust along +z.

    rotors: (x, y, turn) each, m; turn is +1 where the reaction torque on the body is +z (the rotor spins clockwise
    seen from above), else -1. `shape` is the collision shape, about the centre of mass.
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

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere about the centre of mass that holds the collision shape, m."""
        across, _, rise = self.shape.half
        return {SPHERE: across, CYLINDER: math.hypot(across, rise)}.get(
            self.shape.kind, math.hypot(*self.shape.half)
        )

    @property
    def thinnest(self) -> float:
        """Least extent of the collision shape, m."""
        return 2 * min(self.shape.half)

    @property
    def arm(self) -> float:
        """Distance of the outermost rotor from the centre of mass, m."""
        return max(math.hypot(x, y) for x, y, _ in self.rotors)

    @property
    def max_thrust(self) -> float:
        """Thrust of all rotors at full speed, N."""
        return len(self.rotors) * self.thrust_coefficient * self.max_rotor_speed**2

    def hover_speed(self, gravity: float = STANDARD_GRAVITY) -> float:
        """Rotor speed at which thrust equals weight, rad/s."""
        return math.sqrt(self.mass * gravity / (len(self.rotors) * self.thrust_coefficient))

    def allocation(self) -> np.ndarray:
        """(4, R): collective thrust (N) and body torques (N m) per newton of each rotor's thrust."""
        return np.array([(1, y, -x, turn * self.torque_ratio) for x, y, turn in self.rotors]).T


def available_airframes() -> list[str]:
    """Names of the airframes that come with the package."""
    return sorted(path.stem for path in URDF_FOLDER.glob("*.urdf"))


def load_airframe(source: "str | Path | Airframe") -> Airframe:
    """An airframe by name, by the path of a URDF file, or as it is.

    Raises ValueError for an unknown name or a value that is missing or not physical (file, tag and value are named),
    FileNotFoundError for a path that is not there.
    """
    if isinstance(source, Airframe):
        return source
    if not isinstance(source, str | Path):
        raise ValueError(
            f"airframe is {shown(source)}: a name, the path of a URDF, or an Airframe is needed"
        )
    if isinstance(source, str) and not source.endswith(".urdf"):
        if source not in available_airframes():
            raise unknown("airframe", source, available_airframes())
        source = URDF_FOLDER / f"{source}.urdf"
    path = require_file(
        "airframe", source, f"pass the path of a URDF or one of {available_airframes()}"
    ).resolve()
    return _Reader(path).airframe()


class _Reader:
    """Reads one URDF; every refusal names the file, the tag and the value."""

    def __init__(self, path: Path):
        self.path = path
        try:
            self.root = ElementTree.parse(path).getroot()
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise ValueError(f"{path}: not a readable XML file: {error}") from None

    def refuse(self, tag: str, value: object, reason: str) -> ValueError:
        text = value if isinstance(value, str) and len(value) < LONGEST else shown(value)
        return ValueError(f"{self.path}: <{tag}> is {text}: {reason}")

    def element(self, tag: str, parent: ElementTree.Element | None = None) -> ElementTree.Element:
        found = (self.root if parent is None else parent).find(tag)
        if found is None:
            raise self.refuse(
                tag, "missing", "every airframe needs it; assets/urdf/cf2x.urdf shows the form"
            )
        return found

    def number(
        self,
        element: ElementTree.Element,
        attribute: str,
        low: float = -math.inf,
        strict: bool = True,
        most: float = LARGEST,
    ) -> float:
        """The attribute as a finite number above `low` (or at it, unless `strict`) and at most `most`."""
        text = element.get(attribute)
        label = f"{element.tag} {attribute}"
        try:
            value = float(
                "missing" if text is None or "_" in text else text
            )  # the engine knows no 1_000
        except ValueError:
            raise self.refuse(
                label, text if text is not None else "missing", "a number is needed"
            ) from None
        if not math.isfinite(value) or value < low or (strict and value == low):
            raise self.refuse(
                label, text, f"it must be finite and {'above' if strict else 'at least'} {low:g}"
            )
        if value != 0 and not SMALLEST <= abs(value) <= most:
            raise self.refuse(label, text, f"sizes from {SMALLEST:g} to {most:g} can be flown with")
        return value

    def positive(self, tag: str, most: float = LARGEST) -> float:
        return self.number(self.element(f"airframe/{tag}"), "value", low=0, most=most)

    def not_negative(self, tag: str, attribute: str, most: float) -> float:
        return self.number(
            self.element(f"airframe/{tag}"), attribute, low=0, strict=False, most=most
        )

    def airframe(self) -> Airframe:
        links = self.root.findall("link")
        if len(links) != 1 or self.root.find("joint") is not None:
            raise self.refuse(
                "link",
                f"{len(links)} links",
                "exactly one link and no joint (propellers are visuals)",
            )
        for element in self.element("airframe"):
            if isinstance(element.tag, str) and element.tag not in TAGS:
                raise self.refuse(
                    f"airframe/{element.tag}", "unknown", str(unknown("tag", element.tag, TAGS))
                )
        shape = self._collision_shape()
        for element in (self.root, links[0]):
            if not element.get("name"):
                raise self.refuse(f"{element.tag} name", "missing", "the engine needs it")
        airframe = Airframe(
            name=self.root.get("name", ""),
            urdf=self.path,
            mass=self.number(self.element("link/inertial/mass"), "value", low=0, most=HEAVIEST),
            inertia=self._inertia(),
            rotors=self._rotors(),
            thrust_coefficient=self.positive("thrust_coefficient"),
            torque_ratio=self.positive("torque_ratio", WIDEST),
            max_rotor_speed=self.positive("max_rotor_speed", FASTEST_ROTOR),
            lag_up=self.not_negative("motor_lag", "up", SLOWEST_LAG),
            lag_down=self.not_negative("motor_lag", "down", SLOWEST_LAG),
            drag_xy=self.not_negative("rotor_drag", "xy", MOST_DRAG),
            drag_z=self.not_negative("rotor_drag", "z", MOST_DRAG),
            propeller_radius=self.positive("propeller_radius", WIDEST),
            ground_effect_gain=self.not_negative("ground_effect", "gain", LARGEST),
            max_speed=self.positive("max_speed", FASTEST),
            shape=shape,
            pwm=self._pwm(),
        )
        if airframe.max_thrust <= airframe.mass * STANDARD_GRAVITY:
            thrust = f"{airframe.max_rotor_speed:g} (thrust {airframe.max_thrust:.4g} N)"
            weight = airframe.mass * STANDARD_GRAVITY
            raise self.refuse(
                "max_rotor_speed", thrust, f"the drone weighs {weight:.4g} N and cannot hover"
            )
        if airframe.max_thrust > STRONGEST * airframe.mass * STANDARD_GRAVITY:
            thrust = f"{airframe.thrust_coefficient:g} (thrust {airframe.max_thrust:.4g} N)"
            raise self.refuse(
                "thrust_coefficient",
                thrust,
                f"at most {STRONGEST:g} times the weight of {airframe.mass:g} kg can be flown with",
            )
        if np.linalg.matrix_rank(airframe.allocation()) < 4:
            raise self.refuse(
                "rotor", airframe.rotors, "these rotors cannot turn the body about all three axes"
            )
        return airframe

    def _require_centred(self, parent: ElementTree.Element, reason: str) -> None:
        """Refuse an `<origin>` that is not all zeros."""
        origin = parent.find("origin")
        for key in ("xyz", "rpy"):
            text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
            if [part.strip("+-0.e") for part in text.split()] != ["", "", ""]:
                raise self.refuse(f"{parent.tag} origin {key}", text, reason)

    def _inertia(self) -> tuple[float, float, float]:
        inertial = self.element("link/inertial")
        self._require_centred(
            inertial, "the link frame must be the principal frame at the centre of mass"
        )
        element = self.element("inertia", inertial)
        for key in ("ixy", "ixz", "iyz"):
            if key in element.attrib and self.number(element, key) != 0:
                raise self.refuse(
                    f"inertia {key}",
                    element.get(key),
                    "use principal axes: off-diagonal terms must be 0",
                )
        ixx, iyy, izz = (self.number(element, key, low=0) for key in ("ixx", "iyy", "izz"))
        if 2 * max(ixx, iyy, izz) > (ixx + iyy + izz) * (1 + 1e-9):
            text = f"({ixx:g}, {iyy:g}, {izz:g})"
            raise self.refuse(
                "inertia", text, "no body has it: each moment is at most the sum of the other two"
            )
        return ixx, iyy, izz

    def _rotors(self) -> tuple[tuple[float, float, int], ...]:
        elements = self.root.findall("airframe/rotor")
        if not 4 <= len(elements) <= MAX_ROTORS:
            raise self.refuse(
                "rotor",
                f"there {len(elements)} times",
                f"between 4 and {MAX_ROTORS} rotors are supported",
            )
        turns = {"cw": 1, "ccw": -1}
        for element in elements:
            if element.get("spin") not in turns:
                raise self.refuse(
                    "rotor spin",
                    element.get("spin", "missing"),
                    "it must be cw or ccw, seen from above",
                )
        return tuple(
            (
                self.number(e, "x", most=WIDEST),
                self.number(e, "y", most=WIDEST),
                turns[e.get("spin", "")],
            )
            for e in elements
        )

    def _collision_shape(self) -> Shape:
        shapes = self.root.findall("link/collision")
        if len(shapes) != 1:
            raise self.refuse(
                "collision",
                f"there {len(shapes)} times",
                "exactly one convex shape keeps contacts reproducible",
            )
        self._require_centred(shapes[0], "the collision shape must be centred and not turned")
        geometry = self.element("geometry", shapes[0])
        kinds = [shape.tag for shape in geometry]
        if kinds not in (["cylinder"], ["box"], ["sphere"]):
            raise self.refuse("collision geometry", kinds, "it must be one cylinder, box or sphere")
        shape = geometry[0]
        if shape.tag == "sphere":
            return Shape(SPHERE, (self._side(shape, "radius"),) * 3)
        if shape.tag == "cylinder":
            radius, length = self._side(shape, "radius"), self._side(shape, "length")
            return Shape(CYLINDER, (radius, radius, length / 2))
        try:
            size = [float(part) for part in shape.get("size", "").split()]
        except ValueError:
            size = []
        if len(size) == 3 and all(THINNEST <= side <= WIDEST for side in size):
            return Shape(BOX, (size[0] / 2, size[1] / 2, size[2] / 2))
        raise self.refuse(
            "box size",
            shape.get("size", "missing"),
            f"three positive numbers from {THINNEST:g} to {WIDEST:g} are needed",
        )

    def _side(self, shape: ElementTree.Element, attribute: str) -> float:
        """A length of the collision shape, m."""
        side = self.number(shape, attribute, low=0, most=WIDEST)
        if side < THINNEST:
            raise self.refuse(
                f"{shape.tag} {attribute}",
                shape.get(attribute),
                f"at least {THINNEST:g} m is needed",
            )
        return side

    def _pwm(self) -> Pwm | None:
        element = self.root.find("airframe/pwm")
        if element is None:
            return None
        minimum = self.number(element, "min", low=0, strict=False)
        return Pwm(
            slope=self.number(element, "slope", low=0),
            intercept=self.number(element, "intercept"),
            minimum=minimum,
            maximum=self.number(element, "max", low=minimum),
        )
