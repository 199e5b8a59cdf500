"""Constants of drones in the URDFs of other simulators, in our units and with their origin.

Three forms are read: `<properties>` of gym-pybullet-drones, the YAML file that PyFlyt keeps next to
a URDF, and the motor plugins of RotorS. The laws behind the constants are those of the simulators'
source code: BaseAviary.py of gym-pybullet-drones, motors.py and boring_bodies.py of PyFlyt, and
gazebo_motor_model.cpp of RotorS.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any, NamedTuple

from bulletuav.errors import finite, shown
from bulletuav.parsing import read_yaml
from bulletuav.vehicle.urdf import MAX_MAGNITUDE, UrdfFile

RPM = 2 * math.pi / 60
"""One revolution per minute, rad/s."""
GYM_GRAVITY = 9.8
"""Gravity of gym-pybullet-drones, m/s^2: its maximum rotor speed follows from a ratio to weight."""
PROPERTIES = "<properties>"
NOT_USED = {
    "gnd_eff_coeff": "thrust rises by gnd_eff_coeff (R / 4 h)^2 there, by k (1 - h / H)^3 here",
    "dw_coeff_1": "downwash falls as 1 / distance^2 there, and is a spreading jet here",
    "dw_coeff_2": "a part of the downwash's law, see dw_coeff_1",
    "dw_coeff_3": "a part of the downwash's law, see dw_coeff_1",
}
"""Reason why a property of gym-pybullet-drones has no counterpart."""
USED = (
    "arm", "layout", "kf", "km", "thrust2weight", "max_speed_kmh", "prop_radius", "drag_coeff_xy",
    "drag_coeff_z",
)  # fmt: skip
"""Other properties."""
PLUGIN_TAGS = {
    "motorConstant": ("thrust_coefficient", "value"),
    "momentConstant": ("torque_ratio", "value"),
    "maxRotVelocity": ("max_rotor_speed", "value"),
    "timeConstantUp": ("motor_lag", "up"),
    "timeConstantDown": ("motor_lag", "down"),
    "rotorDragCoefficient": ("rotor_drag", "xy"),
}
"""Tag and attribute of the same law, by the tag of a motor plugin of RotorS."""
PLUGIN_NAMES = {
    "robotNamespace", "jointName", "linkName", "turningDirection", "commandSubTopic", "motorNumber",
    "motorSpeedPubTopic", "rotorVelocitySlowdownSim",
}  # fmt: skip
"""Tags of a motor plugin that are no constants of the drone, or are read elsewhere."""


class Entry(NamedTuple):
    """One line of the report of a conversion.

    Attributes:
        kind: "taken", "derived", "default" or "not used".
        what: Tag of the airframe; for "not used" the name in the file.
        value: The value, with its unit.
        origin: Where the value comes from, by which formula, or why it is not used.
    """

    kind: str
    what: str
    value: str
    origin: str


class Motor(NamedTuple):
    """A motor plugin of RotorS.

    Attributes:
        link: Name of the rotor's link.
        spin: "cw" or "ccw", seen from above.
        slowdown: Factor by which the joint turns slower than the rotor.
    """

    link: str
    spin: str
    slowdown: float


class Constants(NamedTuple):
    """Constants that a file has in the form of another simulator.

    Attributes:
        values: Value by tag and attribute of `<airframe>`.
        entries: Lines of the report.
        motors: Motors of RotorS in their order; empty for other files.
    """

    values: dict[tuple[str, str], float]
    entries: list[Entry]
    motors: list[Motor]

    def add(self, kind: str, tag: str, attribute: str, value: float, origin: str) -> None:
        """Add a value, and its line of the report.

        Raises:
            ValueError: If the file has the value in two forms that differ.
        """
        name = tag if attribute == "value" else f"{tag} {attribute}"
        if (old := self.values.setdefault((tag, attribute), value)) != value:
            raise ValueError(
                f"{name} is {old:g} and, from {origin}, {value:g}: delete one from a copy of the "
                f"file"
            )
        self.entries.append(Entry(kind, name, f"{value:.6g}", origin))

    def skip(self, what: str, value: object, reason: str) -> None:
        """Add a line of the report for a value that is not used."""
        self.entries.append(Entry("not used", what, str(value)[:60], reason))


def read_constants(urdf: UrdfFile, mass: float, num_rotors: int) -> Constants:
    """Read the constants of all three forms.

    Args:
        urdf: The file.
        mass: Mass of the drone, kg.
        num_rotors: Number of rotors.

    Returns:
        The constants.

    Raises:
        ValueError: If a number is invalid, or two forms contradict each other.
    """
    constants = Constants({}, [], [])
    try:
        for element in urdf.root.findall("properties"):
            _read_properties(urdf, element, mass, num_rotors, constants)
        _read_pyflyt(urdf, constants)
        _read_plugins(urdf, constants)
    except ValueError as error:
        prefix = "" if str(urdf.path.with_suffix("")) in str(error) else f"{urdf.path}: "
        raise ValueError(f"{prefix}{error}") from None
    return constants


def _read_properties(
    urdf: UrdfFile,
    element: ElementTree.Element,
    mass: float,
    num_rotors: int,
    constants: Constants,
) -> None:
    """Read `<properties>` of gym-pybullet-drones, in which rotor speeds are in rpm."""
    found = {
        key: urdf.number(element, key, low=0, strict=False)
        for key in USED
        if key in element.attrib and key != "layout"
    }
    k_f = found.get("kf", 0.0)
    if "kf" in found:
        if k_f == 0:
            raise urdf.make_error("properties kf", "0", "it must be above 0")
        formula = f"{PROPERTIES} kf {k_f:g} N/rpm^2: kf (60 / 2 pi)^2, N s^2"
        constants.add("derived", "thrust_coefficient", "value", k_f / RPM**2, formula)
    for key, tag in (("km", "torque_ratio"), ("thrust2weight", "max_rotor_speed")):
        if key in found and k_f == 0:
            raise urdf.make_error("properties kf", "missing", f"{key} needs it, in N/rpm^2")
        if key in found and tag == "torque_ratio":
            formula = f"{PROPERTIES} km {found[key]:g} N m/rpm^2: km / kf, m"
            constants.add("derived", tag, "value", found[key] / k_f, formula)
        elif key in found:
            speed = math.sqrt(found[key] * GYM_GRAVITY * mass / (num_rotors * k_f))
            formula = (
                f"{PROPERTIES} thrust2weight {found[key]:g}: sqrt(thrust2weight {GYM_GRAVITY} "
                f"mass / ({num_rotors} kf)) = {speed:.6g} rpm, in rad/s"
            )
            constants.add("derived", tag, "value", speed * RPM, formula)
    if "max_speed_kmh" in found:
        formula = f"{PROPERTIES} max_speed_kmh {found['max_speed_kmh']:g}: / 3.6, m/s"
        constants.add("derived", "max_speed", "value", found["max_speed_kmh"] / 3.6, formula)
    if "prop_radius" in found:
        origin = f"{PROPERTIES} prop_radius, m"
        constants.add("taken", "propeller_radius", "value", found["prop_radius"], origin)
    for attribute in ("xy", "z"):
        if (key := f"drag_coeff_{attribute}") in found:
            origin = f"{PROPERTIES} {key}, N/(m/s rad/s): drag = coefficient v sum of rotor speeds"
            constants.add("taken", "rotor_drag", attribute, found[key], origin)
    for key, value in element.attrib.items():
        if key not in USED:
            reason = NOT_USED.get(key, "no property that is known")
            constants.skip(f"properties {key}", value, reason)


def _read_pyflyt(urdf: UrdfFile, constants: Constants) -> None:
    """Read the YAML file of PyFlyt next to the URDF, in which rotor speeds are in rpm."""
    path = urdf.path.with_suffix(".yaml")
    if not path.is_file():
        return
    table = read_yaml(path)
    motor = table.get("motor_params") if isinstance(table, dict) else None
    if not isinstance(motor, dict):
        constants.skip(path.name, "", "it has no motor_params, as files of PyFlyt do")
        return
    drag = table.get("drag_params", {})
    drag = drag if isinstance(drag, dict) else {}
    rest = {f"motor_params {key}": value for key, value in motor.items()}
    rest |= {f"drag_params {key}": value for key, value in drag.items()}
    rest |= {key: "" for key in table if key not in ("motor_params", "drag_params")}

    def take(group: str, key: str, positive: bool = True) -> float | None:
        value = rest.pop(f"{group} {key}", None)
        if value is None:
            return None
        number: float = finite(f"{path}: {key}", value, 0, MAX_MAGNITUDE)
        if number == 0 and positive:
            raise ValueError(f"{path}: {key} is 0: a number above 0 is needed")
        return number

    k_f, k_m = take("motor_params", "thrust_coef"), take("motor_params", "torque_coef")
    total, tau = take("motor_params", "total_thrust"), take("motor_params", "tau", positive=False)
    if k_f is None:
        raise ValueError(f"{path}: motor_params thrust_coef is missing: N/rpm^2 are needed")
    formula = f"{path.name} thrust_coef {k_f:g} N/rpm^2: (60 / 2 pi)^2 thrust_coef, N s^2"
    constants.add("derived", "thrust_coefficient", "value", k_f / RPM**2, formula)
    if k_m is not None:
        formula = f"{path.name} torque_coef {k_m:g} N m/rpm^2: torque_coef / thrust_coef, m"
        constants.add("derived", "torque_ratio", "value", k_m / k_f, formula)
    if total is not None:
        speed = math.sqrt(total / (4 * k_f))
        formula = (
            f"{path.name} total_thrust {total:g} N: sqrt(total_thrust / (4 thrust_coef)) = "
            f"{speed:.6g} rpm, in rad/s"
        )
        constants.add("derived", "max_rotor_speed", "value", speed * RPM, formula)
    if tau is not None:
        for attribute in ("up", "down"):
            constants.add("taken", "motor_lag", attribute, tau, f"{path.name} tau, s")
    shape, area = take("drag_params", "drag_coef_xyz"), take("drag_params", "drag_area_xyz")
    if shape is not None and area is not None:
        formula = f"{path.name}: drag_coef_xyz drag_area_xyz, m^2 (squares of each component there)"
        for attribute in ("xy", "z"):
            constants.add("derived", "body_drag", attribute, shape * area, formula)
        # Its bodies have no other drag
        for attribute in ("xy", "z"):
            origin = f"{path.name}: rotors have no drag in PyFlyt"
            constants.add("derived", "rotor_drag", attribute, 0.0, origin)
    for name, value in rest.items():
        constants.skip(f"{path.name} {name}", value, "it has no counterpart here")


def _read_plugins(urdf: UrdfFile, constants: Constants) -> None:
    """Read the motor plugins of RotorS, in which rotor speeds are in rad/s."""
    links = {}
    for joint in urdf.root.findall("joint"):
        child = joint.find("child")
        links[joint.get("name")] = "" if child is None else child.get("link", "")
    plugins = []
    for plugin in urdf.root.iterfind("gazebo/plugin"):
        if plugin.find("motorConstant") is None:
            name = plugin.get("name", "unnamed")
            constants.skip(f"plugin {name}", plugin.get("filename", ""), "it is no motor")
            continue
        plugins.append({one.tag: (one.text or "").strip() for one in plugin})
    numbered: dict[int, Motor] = {}
    for k, texts in enumerate(plugins):
        name = texts.get("linkName") or links.get(texts.get("jointName")) or "missing"
        spin = texts.get("turningDirection", "missing")
        if spin not in ("cw", "ccw"):
            raise urdf.make_error("turningDirection", spin, "cw or ccw is needed")
        for other in sorted(PLUGIN_TAGS.keys() | texts.keys()):
            if other in PLUGIN_NAMES or texts.get(other) == plugins[0].get(other):
                continue
            values = f"{plugins[0].get(other)} and {texts.get(other)}"
            raise urdf.make_error(other, values, "all motors of an airframe are equal")
        slowdown = _text_number(urdf, texts, "rotorVelocitySlowdownSim", "10")
        if slowdown <= 0:
            raise urdf.make_error("rotorVelocitySlowdownSim", slowdown, "it must be above 0")
        number = int(_text_number(urdf, texts, "motorNumber", str(k)))
        if number in numbered:
            raise urdf.make_error("motorNumber", number, "each motor needs a number of its own")
        numbered[number] = Motor(name, spin, slowdown)
    constants.motors.extend(numbered[number] for number in sorted(numbered))
    if not plugins:
        return
    for tag, text in plugins[0].items():
        if tag in PLUGIN_TAGS:
            value = _text_number(urdf, plugins[0], tag, text)
            constants.add("taken", *PLUGIN_TAGS[tag], value, f"motor plugin {tag}")
        elif tag not in PLUGIN_NAMES:
            constants.skip(f"motor plugin {tag}", text, "it has no counterpart here")
    if "rotorDragCoefficient" in plugins[0]:
        origin = "rotors of RotorS have no drag along their axis"
        constants.add("derived", "rotor_drag", "z", 0.0, origin)


def _text_number(urdf: UrdfFile, texts: dict[str, str], tag: str, default: str) -> float:
    """Read a number of at least 0 from the text of a plugin's tag."""
    element = ElementTree.Element(tag, value=texts.get(tag, default))
    return urdf.number(element, "value", low=0, strict=False)


def list_other_tags(urdf: UrdfFile) -> Iterator[Entry]:
    """Yield a line of the report for each kind of element that no reader uses."""
    known = {"link", "joint", "material", "properties", "gazebo"}
    counts: dict[str, int] = {}
    for element in urdf.root:
        if isinstance(element.tag, str) and element.tag not in known:
            counts[element.tag] = counts.get(element.tag, 0) + 1
    for tag, count in counts.items():
        yield Entry("not used", f"<{tag}>", f"{count} times", "it has no counterpart here")


def require_expanded(urdf: UrdfFile) -> None:
    """Raise ValueError for a xacro file, whose macros are to be expanded before."""
    texts: Iterator[Any] = (element.tag for element in urdf.root.iter())
    if any(isinstance(tag, str) and "xacro" in tag for tag in texts):
        remedy = "expand it with `xacro FILE > NAME.urdf` of ROS, and convert NAME.urdf"
        raise ValueError(f"{urdf.path} has macros ({shown('xacro')}): {remedy}")
