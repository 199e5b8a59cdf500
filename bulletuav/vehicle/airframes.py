"""Airframes by name and from one-link URDF files, read into frozen constants.

A new drone is one URDF file. Besides the standard `<link>` (inertial, one convex collision shape,
any number of visuals) it contains `<airframe>` with the tags of `Airframe`, and one `<rotor x y
spin>` for each rotor; see assets/urdf. Tags that a file leaves out get the values that
`bulletuav.vehicle.scaling` computes from size and disc loading.

An aircraft with wings has one `<wing name x y z span chord ...>` for each `Wing`, and within it
`<surface name chord low high rate>` if it has a control surface. Its rotors have `z` as well, and
`axis="x"` if they push forward.

Names are those of the files in assets/urdf, and those that are registered as kind "airframe" (see
`bulletuav.registry`), as an `Airframe` or as the path of a URDF.
"""

import functools
import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from bulletuav.errors import printable_text, require_file, shown, unknown
from bulletuav.geometry.obstacle import DEFAULT_FRICTION, MAX_FRICTION
from bulletuav.registry import find, register
from bulletuav.vehicle.airframe import (
    ABOVE_ZERO,
    MAX_ROTORS,
    MAX_WINGS,
    MIN_ROTORS,
    STANDARD_GRAVITY,
    SURFACE_BOUNDS,
    WING_BOUNDS,
    Airframe,
    ControlSurface,
    Pack,
    Pwm,
    Wing,
    hover_speed,
)
from bulletuav.vehicle.envelope import find_envelope
from bulletuav.vehicle.scaling import scaled_constants, without_rotor_effects
from bulletuav.vehicle.urdf import MAX_LENGTH, MAX_MAGNITUDE, UrdfFile

_PACKAGE = Path(__file__).parents[1]
URDF_FOLDER = next(
    folder / "assets" / "urdf"
    for folder in (_PACKAGE, _PACKAGE.parent)
    if (folder / "assets").is_dir()
)
"""Folder of the airframes that come with the package.

It is inside the package in a wheel, and next to it in a checkout.
"""

TAGS = (
    "thrust_coefficient",
    "torque_ratio",
    "max_rotor_speed",
    "motor_lag",
    "rotor_drag",
    "propeller_radius",
    "rotor_inertia",
    "rate_damping",
    "body_drag",
    "ground_effect",
    "wake",
    "power",
    "battery",
    "max_speed",
    "rotor",
    "pwm",
    "contact",
    "wing",
)
"""Tags within `<airframe>`."""
TAGS_WITHOUT_WINGS = ("rate_damping", "ground_effect", "wake")
"""Tags that have no effect on an airframe with wings, see `scaling.without_rotor_effects`."""
_NO_EFFECT = "it has no effect on an airframe with wings: remove it"
"""Reason and remedy of errors."""
ROTOR_ATTRIBUTES = ("x", "y", "z", "spin", "axis")
"""Attributes of `<rotor>` next to wings."""
WING_ATTRIBUTES = ("name", "x", "y", "z", *WING_BOUNDS)
"""Attributes of `<wing>`."""
SURFACE_ATTRIBUTES = ("name", "chord", "low", "high", "rate")
"""Attributes of `<surface>`."""
MAX_MASS = 1e5
"""Maximum mass, kg."""
MAX_DRONE_SPEED = 1000.0
"""Maximum speed of a drone, m/s."""
MAX_ROTOR_SPEED = 1e5
"""Maximum speed of a rotor, rad/s."""
MAX_ROTOR_INERTIA = 10.0
"""Maximum moment of inertia of a rotor, kg m^2."""
MAX_DAMPING = 1e3
"""Maximum decay rate of angular velocities, 1/s."""
MAX_VOLTAGE = 1e4
"""Maximum voltage of a battery, V."""
MAX_LAG = 100.0
"""Maximum time constant of a motor, s."""
MAX_ROTOR_DRAG = 1.0
"""Maximum drag of a rotor, N per m/s and rad/s."""
MAX_THRUST_TO_WEIGHT = 1000.0
"""Maximum thrust-to-weight ratio."""


def available_airframes() -> list[str]:
    """List the names of the airframes that come with the package."""
    return sorted(path.stem for path in URDF_FOLDER.glob("*.urdf"))


def load_airframe(source: str | Path | Airframe) -> Airframe:
    """Load an airframe.

    Args:
        source: A name (of `available_airframes` or registered), `module:Name` of an `Airframe` or
            of a path, the path of a URDF, which ends in ".urdf", or an `Airframe`.

    Returns:
        The airframe.

    Raises:
        ValueError: If the name is unknown, or a value is missing or not physical. The message names
            file, tag and value.
        FileNotFoundError: If the file does not exist.
    """
    if isinstance(source, Airframe):
        source.require_physical()
        return source
    if not isinstance(source, str | Path):
        raise ValueError(
            f"airframe is {shown(source)}: a name, the path of a URDF, or an Airframe is needed"
        )
    if isinstance(source, str) and not source.endswith(".urdf"):
        found = _find_by_name(source)
        if isinstance(found, Airframe):
            return load_airframe(found)
        source = found
    path = require_file(
        "airframe", source, f"pass the path of a URDF or one of {available_airframes()}"
    )
    path = path.resolve()
    if printable_text(str(path)) != str(path):
        raise ValueError(
            f"airframe {shown(str(path))} has bytes in its path that are no UTF-8: rename the file "
            f"or its folder"
        )
    return _read_shipped(path) if path.parent == URDF_FOLDER else _read_airframe(path)


def _find_by_name(name: str) -> str | Path | Airframe:
    """Find the airframe or path of a name: files of the package come before registered names."""
    if name in available_airframes():
        return URDF_FOLDER / f"{name}.urdf"
    found: str | Path | Airframe = find("airframe", name, _is_airframe_or_path)
    if not _is_airframe_or_path(found):
        raise ValueError(
            f"airframe {name} is {shown(found)}: the path of a URDF, or an Airframe is needed"
        )
    return found


def _is_airframe_or_path(ingredient: object) -> bool:
    return isinstance(ingredient, str | Path | Airframe)


@functools.cache
def _read_shipped(path: Path) -> Airframe:
    """Read a file of the package, once per process."""
    return _read_airframe(path)


def _read_airframe(path: Path) -> Airframe:
    """Read an airframe from a URDF file."""
    # Files of other simulators are recognised before their meshes are, of formats not read here
    urdf = UrdfFile(path, needs_meshes=False)
    urdf.require_one_link()
    _require_known_tags(urdf)
    urdf.require_meshes()
    shape = urdf.collision_shape()
    for element in (urdf.root, urdf.element("link")):
        if not element.get("name"):
            raise urdf.make_error(f"{element.tag} name", "missing", "the engine needs it")
    # Each number is read within the domain of the dynamics.
    mass = urdf.number(urdf.element("link/inertial/mass"), "value", low=0, most=MAX_MASS)
    inertia = urdf.inertia()
    wings = _read_wings(urdf)
    rotors = _read_rotors(urdf, bool(wings))
    thrust_coefficient = _read_positive(urdf, "thrust_coefficient", MAX_MAGNITUDE)
    drag_xy = _read_non_negative(urdf, "rotor_drag", "xy", MAX_ROTOR_DRAG)
    propeller_radius = _read_positive(urdf, "propeller_radius", MAX_LENGTH)
    defaults = scaled_constants(
        inertia,
        rotors,
        thrust_coefficient,
        drag_xy,
        propeller_radius,
        hover_speed(mass * STANDARD_GRAVITY, len(rotors), thrust_coefficient),
    )
    if wings:
        defaults = without_rotor_effects(defaults, propeller_radius)
    near = _read_optional(
        urdf, "ground_effect", {"reach": MAX_LENGTH}, {"gain": 1.0}, defaults.ground_effect
    )
    wake = _read_optional(
        urdf, "wake", {"radius": MAX_LENGTH}, {"share": 1.0, "spread": 1.0}, defaults.wake
    )
    power = _read_optional(
        urdf, "power", {"efficiency": 1.0}, {"electronics": MAX_MAGNITUDE}, defaults.power
    )
    damping = _read_optional(
        urdf, "rate_damping", {}, dict.fromkeys("xyz", MAX_DAMPING), defaults.damping
    )
    body_drag = _read_optional(
        urdf, "body_drag", {}, {"xy": MAX_LENGTH**2, "z": MAX_LENGTH**2}, defaults.body_drag
    )
    turning = _read_optional(urdf, "rotor_inertia", {}, {"value": MAX_ROTOR_INERTIA}, (0.0,))
    airframe = Airframe(
        name=urdf.root.get("name", ""),
        urdf=urdf.path,
        mass=mass,
        inertia=inertia,
        rotors=rotors,
        thrust_coefficient=thrust_coefficient,
        torque_ratio=_read_positive(urdf, "torque_ratio", MAX_LENGTH),
        max_rotor_speed=_read_positive(urdf, "max_rotor_speed", MAX_ROTOR_SPEED),
        lag_up=_read_non_negative(urdf, "motor_lag", "up", MAX_LAG),
        lag_down=_read_non_negative(urdf, "motor_lag", "down", MAX_LAG),
        drag_xy=drag_xy,
        drag_z=_read_non_negative(urdf, "rotor_drag", "z", MAX_ROTOR_DRAG),
        drag_height=_read_drag_height(urdf),
        propeller_radius=propeller_radius,
        rotor_inertia=turning[0],
        damping=(damping[0], damping[1], damping[2]),
        body_drag=(body_drag[0], body_drag[1]),
        ground_effect_reach=near[0],
        ground_effect_gain=near[1],
        wake_radius=wake[0],
        wake_share=wake[1],
        wake_spread=wake[2],
        efficiency=power[0],
        electronics=power[1],
        max_speed=_read_positive(urdf, "max_speed", MAX_DRONE_SPEED),
        shape=shape,
        pack=_read_pack(urdf),
        pwm=_read_pwm(urdf),
        friction=_read_contact(urdf, "friction", DEFAULT_FRICTION, MAX_FRICTION),
        restitution=_read_contact(urdf, "restitution", 0.0, 1.0),
        wings=wings,
        forward_rotors=_read_forward_rotors(urdf),
        rotor_heights=_read_rotor_heights(urdf) if wings else (),
    )
    _require_flyable(urdf, airframe)
    return airframe


def _require_known_tags(urdf: UrdfFile) -> None:
    """Raise ValueError for unknown tags within `<airframe>`, such as misspelt ones."""
    for element in urdf.element("airframe"):
        if isinstance(element.tag, str) and element.tag not in TAGS:
            reason = str(unknown("tag", element.tag, TAGS))
            raise urdf.make_error(f"airframe/{element.tag}", "unknown", reason)


def _read_positive(urdf: UrdfFile, tag: str, most: float) -> float:
    """Read the value of a tag within `<airframe>` that must be greater than 0."""
    return urdf.number(urdf.element(f"airframe/{tag}"), "value", low=0, most=most)


def _read_non_negative(urdf: UrdfFile, tag: str, attribute: str, most: float) -> float:
    """Read an attribute of a tag within `<airframe>` that must be at least 0."""
    element = urdf.element(f"airframe/{tag}")
    return urdf.number(element, attribute, low=0, strict=False, most=most)


def _read_optional(
    urdf: UrdfFile,
    tag: str,
    positive: dict[str, float],
    others: dict[str, float],
    defaults: tuple[float, ...],
) -> tuple[float, ...]:
    """Read the attributes of an optional tag within `<airframe>`.

    Args:
        urdf: The file.
        tag: The tag; if it is there, it needs all attributes.
        positive: Attributes that must be greater than 0, with their maximum values.
        others: Attributes that must be at least 0, with their maximum values.
        defaults: Default values if the tag is left out.

    Returns:
        The values, in this order.
    """
    element = urdf.root.find(f"airframe/{tag}")
    if element is None:
        return defaults
    return (
        *(urdf.number(element, name, low=0, most=most) for name, most in positive.items()),
        *(_read_non_negative(urdf, tag, name, most) for name, most in others.items()),
    )


def _read_drag_height(urdf: UrdfFile) -> float:
    """Read the height at which the rotors' drag acts, 0 if the file has none."""
    element = urdf.element("airframe/rotor_drag")
    return urdf.number(element, "height", most=MAX_LENGTH) if "height" in element.attrib else 0.0


def _read_pack(urdf: UrdfFile) -> Pack | None:
    """Read the battery, None if the file has none."""
    element = urdf.root.find("airframe/battery")
    if element is None:
        return None
    cells = urdf.number(element, "cells", low=0)
    if cells != int(cells):
        raise urdf.make_error("battery cells", cells, "a whole number is needed")
    return Pack(
        cells=int(cells),
        capacity=urdf.number(element, "capacity", low=0),
        resistance=urdf.number(element, "resistance", low=0, strict=False),
        voltage=urdf.number(element, "voltage", low=0, most=MAX_VOLTAGE),
    )


def _read_rotors(urdf: UrdfFile, winged: bool) -> tuple[tuple[float, float, int], ...]:
    """Read the position (m) and direction of rotation of each rotor."""
    elements = urdf.root.findall("airframe/rotor")
    fewest = 1 if winged else MIN_ROTORS
    if not fewest <= len(elements) <= MAX_ROTORS:
        reason = f"between {fewest} and {MAX_ROTORS} rotors are supported"
        raise urdf.make_error("rotor", f"there {len(elements)} times", reason)
    turns = {"cw": 1, "ccw": -1}
    for element in elements:
        if element.get("spin") not in turns:
            spin = element.get("spin", "missing")
            raise urdf.make_error(
                "rotor spin",
                spin,
                "it must be cw or ccw, seen from the side that its thrust points to",
            )
        if winged:
            _require_known_attributes(urdf, element, ROTOR_ATTRIBUTES)
            if element.get("axis", "z") not in ("x", "z"):
                raise urdf.make_error("rotor axis", element.get("axis"), "it must be x or z")
        else:
            for name in ("z", "axis"):
                if name in element.attrib:
                    reason = "it has no effect without wings: remove it"
                    raise urdf.make_error(f"rotor {name}", element.get(name), reason)
    return tuple(
        (
            urdf.number(element, "x", most=MAX_LENGTH),
            urdf.number(element, "y", most=MAX_LENGTH),
            turns[element.get("spin", "")],
        )
        for element in elements
    )


def _read_forward_rotors(urdf: UrdfFile) -> tuple[int, ...]:
    """Read the indices of the rotors whose thrust is along x."""
    elements = urdf.root.findall("airframe/rotor")
    return tuple(k for k, element in enumerate(elements) if element.get("axis") == "x")


def _read_rotor_heights(urdf: UrdfFile) -> tuple[float, ...]:
    """Read the position z of each rotor, m; 0 for a rotor without."""
    return tuple(
        urdf.number(element, "z", most=MAX_LENGTH) if "z" in element.attrib else 0.0
        for element in urdf.root.findall("airframe/rotor")
    )


def _read_wings(urdf: UrdfFile) -> tuple[Wing, ...]:
    """Read the wings; none for a multirotor."""
    elements = urdf.root.findall("airframe/wing")
    if len(elements) > MAX_WINGS:
        reason = f"at most {MAX_WINGS} wings are supported"
        raise urdf.make_error("wing", f"there {len(elements)} times", reason)
    if elements:
        for tag in TAGS_WITHOUT_WINGS:
            if urdf.root.find(f"airframe/{tag}") is not None:
                raise urdf.make_error(f"airframe/{tag}", "there", _NO_EFFECT)
        height = _read_drag_height(urdf)
        if height:
            raise urdf.make_error("rotor_drag height", height, _NO_EFFECT)
    wings = tuple(_read_wing(urdf, element) for element in elements)
    _require_different_names(urdf, "wing", [wing.name for wing in wings])
    surfaces = [wing.surface.name for wing in wings if wing.surface is not None]
    _require_different_names(urdf, "surface", surfaces)
    return wings


def _read_wing(urdf: UrdfFile, element: Element) -> Wing:
    """Read one wing.

    The aspect ratio is the span divided by the chord if the file has none, and the lift slope that
    of Helmbold's equation.

    References:
        H. B. Helmbold, Jahrbuch der Deutschen Luftfahrtforschung 1942; USAF Stability and Control
        DATCOM, 4.1.3.2, whose formula is the same for unswept wings with a section slope of 2 pi.
    """
    _require_known_attributes(urdf, element, WING_ATTRIBUTES)
    name = _read_name(urdf, element)
    x, y, z = (urdf.number(element, key, most=MAX_LENGTH) for key in "xyz")
    values = {"dihedral": 0.0, "incidence": 0.0, "downwash": 0.0, "slipstream": 0.0}
    optional = (*values, "aspect_ratio", "lift_slope")
    for key, bounds in WING_BOUNDS.items():
        if key in element.attrib or key not in optional:
            values[key] = _read_bounded(urdf, element, key, bounds)
    values.setdefault("aspect_ratio", values["span"] / values["chord"])
    values.setdefault("lift_slope", helmbold_slope(values["aspect_ratio"]))
    return Wing(name=name, position=(x, y, z), surface=_read_surface(urdf, element), **values)


def helmbold_slope(aspect_ratio: float) -> float:
    """Compute the lift slope of a straight wing by Helmbold's equation, 1/rad.

    Args:
        aspect_ratio: Square of the span divided by the area.

    Returns:
        2 pi A / (2 + sqrt(4 + A^2)): 2 pi for a long wing, pi A / 2 for a short one.
    """
    root = math.sqrt(4.0 + aspect_ratio * aspect_ratio)
    return 2.0 * math.pi * aspect_ratio / (2.0 + root)


def _read_surface(urdf: UrdfFile, wing: Element) -> ControlSurface | None:
    """Read the control surface of a wing, None if it has none."""
    for child in wing:
        if isinstance(child.tag, str) and child.tag != "surface":
            reason = str(unknown("tag", child.tag, ("surface",)))
            raise urdf.make_error(f"wing/{child.tag}", "unknown", reason)
    elements = wing.findall("surface")
    if not elements:
        return None
    if len(elements) > 1:
        reason = "a wing has at most one control surface: divide the wing"
        raise urdf.make_error("surface", f"there {len(elements)} times", reason)
    element = elements[0]
    _require_known_attributes(urdf, element, SURFACE_ATTRIBUTES)
    name = _read_name(urdf, element)
    chord = _read_bounded(urdf, element, "chord", SURFACE_BOUNDS["chord_fraction"])
    low, high, rate = (
        _read_bounded(urdf, element, key, SURFACE_BOUNDS[key]) for key in ("low", "high", "rate")
    )
    return ControlSurface(name=name, chord_fraction=chord, low=low, high=high, rate=rate)


def _read_bounded(urdf: UrdfFile, element: Element, key: str, bounds: tuple[float, float]) -> float:
    """Read a number of a wing or control surface from its lowest to its highest value."""
    low, most = bounds
    strict = key in ABOVE_ZERO
    value = urdf.number(element, key, low=low, strict=strict, most=max(-low, most))
    if value > most:
        raise urdf.make_error(f"{element.tag} {key}", element.get(key), f"at most {most:g}")
    return value


def _read_name(urdf: UrdfFile, element: Element) -> str:
    """Read the name of a wing or control surface, which messages and labels use."""
    name = element.get("name", "")
    if not name:
        reason = "each needs a name for messages, such as left wing"
        raise urdf.make_error(f"{element.tag} name", "missing", reason)
    return name


def _require_different_names(urdf: UrdfFile, tag: str, names: list[str]) -> None:
    """Raise ValueError if two wings or control surfaces have the same name."""
    for name in names:
        if names.count(name) > 1:
            reason = "another has the same name: choose a different one"
            raise urdf.make_error(f"{tag} name", name, reason)


def _require_known_attributes(urdf: UrdfFile, element: Element, known: tuple[str, ...]) -> None:
    """Raise ValueError for unknown attributes, as most have defaults and misspelt ones get lost."""
    for name in element.attrib:
        if name not in known:
            reason = str(unknown("attribute", name, known))
            raise urdf.make_error(f"{element.tag} {name}", element.get(name), reason)


def _read_pwm(urdf: UrdfFile) -> Pwm | None:
    """Read the motor command, None if the file has none."""
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


def _read_contact(urdf: UrdfFile, attribute: str, default: float, most: float) -> float:
    """Read an attribute of the optional tag `<contact>` within `<airframe>`."""
    element = urdf.root.find("airframe/contact")
    if element is None or attribute not in element.attrib:
        return default
    value = urdf.number(element, attribute, low=0, strict=False)
    if value > most:
        raise urdf.make_error(f"contact {attribute}", value, f"at most {most:g} is possible")
    return value


def _require_flyable(urdf: UrdfFile, airframe: Airframe) -> None:
    """Raise ValueError for airframes that cannot fly, cannot rotate, or are far too strong."""
    weight = airframe.mass * STANDARD_GRAVITY
    if airframe.max_thrust <= weight and not airframe.wings:
        thrust = f"{airframe.max_rotor_speed:g} (thrust {airframe.max_thrust:.4g} N)"
        reason = f"the drone weighs {weight:.4g} N and cannot hover"
        raise urdf.make_error("max_rotor_speed", thrust, reason)
    square = airframe.max_rotor_speed * airframe.max_rotor_speed
    total = len(airframe.rotors) * airframe.thrust_coefficient * square
    if total > MAX_THRUST_TO_WEIGHT * weight:
        thrust = f"{airframe.thrust_coefficient:g} (thrust {total:.4g} N)"
        reason = (
            f"the thrust must be at most {MAX_THRUST_TO_WEIGHT:g} times the weight of "
            f"{airframe.mass:g} kg"
        )
        raise urdf.make_error("thrust_coefficient", thrust, reason)
    if airframe.wings:
        _require_level_flight(urdf, airframe)
        if not airframe.can_hover:
            return
    if np.linalg.matrix_rank(airframe.allocation()) < 4:
        reason = "these rotors cannot control the torque about all three axes"
        raise urdf.make_error("rotor", airframe.rotors, reason)


def _require_level_flight(urdf: UrdfFile, airframe: Airframe) -> None:
    """Raise ValueError for an airframe with wings that cannot fly level on them as it should.

    A multirotor with wings and no forward rotor need not.
    """
    if airframe.can_hover and not airframe.forward_rotors:
        return
    try:
        find_envelope(airframe)
    except ValueError as error:
        raise urdf.make_error("airframe", "not able to fly on its wings", str(error)) from None


# Register the paths of the package's airframes; each file is read when it is first used.
for _path in URDF_FOLDER.glob("*.urdf"):
    if _path.stem.isidentifier():
        register("airframe", _path.stem)(_path)
