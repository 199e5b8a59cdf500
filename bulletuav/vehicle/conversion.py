"""Conversion of a drone's URDF of another simulator into the one-link form of `airframes`.

All links are joined to one body, see `links`. Rotors are the links of motor plugins, or those whose
names contain "prop" or "rotor". Constants come from the forms that `dialects` reads. A report lists
each value with its origin, and all that is not used.
"""

import math
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from bulletuav.compiled.functions import acos, atan2, cos, hypot, sin
from bulletuav.errors import require_file
from bulletuav.files import replace_file
from bulletuav.geometry.rotation import Quat4Like, axes
from bulletuav.geometry.shapes import BOX, CYLINDER, HULL, SPHERE, Shape
from bulletuav.parsing import parse_number
from bulletuav.vehicle.airframe import MAX_ROTORS, MIN_ROTORS, Airframe
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.dialects import (
    Constants,
    Entry,
    list_other_tags,
    read_constants,
    require_expanded,
)
from bulletuav.vehicle.links import PlacedLink, RigidBody, join_links, place_links
from bulletuav.vehicle.urdf import UrdfFile

REMEDY = "pass the path of a drone's URDF"
ROTOR_NAME = re.compile("prop|rotor", re.IGNORECASE)
"""Part of the names of rotors' links, after the last slash."""
JOINTS = frozenset({"fixed", "continuous"})
"""Accepted joints; those of type continuous are for rotors."""
MAX_PRODUCT = 0.1
"""Maximum product of inertia that is neglected, as a fraction of the minimum moment."""
MAX_EXCESS = 1.5
"""Maximum ratio of a moment of inertia to the sum of the other two that is limited to 1."""
MAX_TILT = math.radians(1)
"""Maximum tilt of a rotor's axis, rad."""
DEFAULT_SPEED = 10.0
"""Maximum commanded speed, m/s, of a drone whose file has none: that of the Crazyflie."""
NEAR = 1e-6
"""Distance, m, and sine of an angle, up to which a shape counts as centred and upright."""
SIDES = 64
"""Number of sides of the prism that encloses a tilted cylinder."""
DISC_THICKNESS = 0.1
"""Thickness of a rotor's disc in images, in propeller radii (our choice)."""
REQUIRED = {
    "thrust_coefficient": 'kf="..." (N/rpm^2)',
    "torque_ratio": 'km="..." (N m/rpm^2)',
    "max_rotor_speed": 'thrust2weight="..." (maximum thrust / weight)',
    "propeller_radius": 'prop_radius="..." (m)',
}
"""Attribute of `<properties>` by the required tag that it provides."""


class Conversion(NamedTuple):
    """Result of a conversion.

    Attributes:
        airframe: The airframe of the written file.
        entries: The report.
    """

    airframe: Airframe
    entries: list[Entry]


class _Rotor(NamedTuple):
    """Rotor: its link, place (3,) relative to the centre of mass, m, and direction of rotation."""

    link: PlacedLink | None
    place: np.ndarray
    spin: str


def convert_urdf(source: str | Path, out: str | Path) -> Conversion:
    """Convert the URDF of a drone into an airframe, and write it.

    Args:
        source: A URDF of gym-pybullet-drones, PyFlyt (with its YAML file next to it), RotorS
            (without macros), or of the same form.
        out: The file to write, NAME.urdf. Its first comment is the report.

    Returns:
        The airframe and the report.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is invalid, has no rotors or lacks a constant, or if the airframe
            cannot hover. The message names file, tag, value and remedy.
    """
    path = require_file("URDF", source, REMEDY)
    out = Path(out)
    if out.suffix != ".urdf":
        raise ValueError(f"the output {out} must end in .urdf, as paths of airframes do")
    if out.resolve() == path.resolve():
        raise ValueError(f"{out} is the file to convert: choose another name for the output")
    urdf = UrdfFile(path, needs_meshes=False)
    require_expanded(urdf)
    if urdf.root.find("airframe") is not None:
        raise urdf.make_error("airframe", "there", "the file needs no conversion: load it directly")
    text, entries = _convert(urdf)
    airframe = _try_airframe(text, urdf.path)
    entries += _list_defaults(text, airframe)
    lines = [f"Converted by bulletuav from {path.name}.", *map(_format_entry, entries)]
    # XML forbids two hyphens in a comment
    comment = "\n     ".join(lines).replace("--", "- -")
    out.parent.mkdir(parents=True, exist_ok=True)
    replace_file(out, f'<?xml version="1.0"?>\n<!-- {comment} -->\n{text}')
    return Conversion(load_airframe(out), entries)


def _try_airframe(text: str, source: Path) -> Airframe:
    """Load an airframe from a text; raise ValueError that names the source if it cannot fly."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "converted.urdf")
        path.write_text(text, encoding="utf-8")
        try:
            return load_airframe(path)
        except ValueError as error:
            reason = str(error).replace(str(path.resolve()), "the converted airframe")
            raise ValueError(f"{source}: {reason}") from None


def _format_entry(entry: Entry) -> str:
    return f"{entry.kind}: {entry.what} {entry.value}: {entry.origin}"


def _convert(urdf: UrdfFile) -> tuple[str, list[Entry]]:
    """Return the text of the converted file, without its comment, and the report."""
    links = place_links(urdf, JOINTS)
    body = join_links(urdf, links)
    named = [link for link in links if ROTOR_NAME.search(link.name.rpartition("/")[2])]
    motors = read_constants(urdf, body.mass, max(len(named), MIN_ROTORS)).motors
    # Rotors of RotorS that turn slower have as much more inertia
    body = join_links(urdf, links, {motor.link: motor.slowdown for motor in motors})
    rotor_links = _pick_rotor_links(urdf, links, [m.link for m in motors], named)
    count = len(rotor_links) or MIN_ROTORS
    constants = read_constants(urdf, body.mass, count)
    entries = [
        Entry("taken", "mass", f"{body.mass:.6g}", f"sum over {len(links)} links, kg"),
        *_list_joints(urdf, links, rotor_links),
    ]
    moments, notes = _principal_moments(urdf, body, len(links))
    entries += notes
    rotors, notes = _place_rotors(urdf, rotor_links, body, constants)
    entries += notes
    _add_radius(urdf, rotors, constants)
    _add_rotor_inertia(urdf, rotors, constants)
    _add_defaults(urdf, rotors, constants)
    shape, notes = _enclose_shapes(urdf, links, rotors, body, constants)
    entries += notes
    visuals, notes = _list_visuals(urdf, links, rotors, body, constants, shape)
    entries += [*constants.entries, *notes, *list_other_tags(urdf), *_list_link_tags(links)]
    return _format_robot(urdf, body, moments, rotors, constants, shape, visuals), entries


def _pick_rotor_links(
    urdf: UrdfFile, links: list[PlacedLink], of_motors: list[str], named: list[PlacedLink]
) -> list[PlacedLink]:
    """Return the links of the rotors in their order; none if the file has no such links."""
    by_name = {link.name: link for link in links}
    for name in of_motors:
        if name not in by_name:
            raise urdf.make_error("plugin linkName", name, "there is no such link")
    found = [by_name[name] for name in of_motors] or named
    if found and not MIN_ROTORS <= len(found) <= MAX_ROTORS:
        names = ", ".join(link.name for link in found[: MAX_ROTORS + 1])
        reason = (
            f"{MIN_ROTORS} to {MAX_ROTORS} links of rotors are needed: rename the others, so that "
            f"only names of rotors contain prop or rotor"
        )
        raise urdf.make_error("link", names, reason)
    for link in links:
        if link.joint == "continuous" and link not in found:
            reason = "only rotors may turn: change the type to fixed in a copy of the file"
            raise urdf.make_error("joint", f"{link.joint_name}, type continuous", reason)
    return found


def _list_joints(
    urdf: UrdfFile, links: list[PlacedLink], rotors: list[PlacedLink]
) -> Iterator[Entry]:
    """Report which links are rotors, and which joints are kept at 0."""
    if rotors:
        names = ", ".join(link.name for link in rotors)
        yield Entry("taken", "rotor links", names, "places of the rotors, in this order")
    for link in links:
        if link.joint not in ("", "fixed"):
            origin = "kept at 0: links are one body, in which rotors' thrusts act"
            yield Entry("not used", f"joint {link.joint_name}", link.joint, origin)


def _principal_moments(
    urdf: UrdfFile, body: RigidBody, num_links: int
) -> tuple[tuple[float, float, float], list[Entry]]:
    """Return the moments of inertia about the root's axes; products must be small."""
    xx, yy, zz = np.diag(body.inertia).tolist()
    origin = f"sum over {num_links} links about the centre of mass (parallel axes), kg m^2"
    entries = [Entry("derived", "inertia", f"({xx:.6g}, {yy:.6g}, {zz:.6g})", origin)]
    x, y, z = body.centre.tolist()
    if max(abs(x), abs(y), abs(z)) > NEAR:
        origin = "centre of mass in the root link's axes, m: origin of the converted link"
        entries.append(Entry("derived", "centre of mass", f"({x:.6g}, {y:.6g}, {z:.6g})", origin))
    moments = [xx, yy, zz]
    others = sum(sorted(moments)[:2])
    if max(moments) > (1 + 1e-9) * others:
        if max(moments) > MAX_EXCESS * others:
            reason = "each moment is at most the sum of the other two: correct it in a copy"
            raise urdf.make_error("inertia", entries[0].value, reason)
        k = moments.index(max(moments))
        origin = (
            f"the file's {moments[k]:.6g} is not physical: limited to the sum of the other two, "
            f"that of a flat body, kg m^2"
        )
        moments[k] = others
        entries.append(Entry("derived", f"inertia about {'xyz'[k]}", f"{others:.6g}", origin))
    xx, yy, zz = moments
    for name, (i, j) in {"ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}.items():
        value = float(body.inertia[i, j])
        if abs(value) > MAX_PRODUCT * min(xx, yy, zz):
            reason = (
                f"the moments are ({xx:.4g}, {yy:.4g}, {zz:.4g}): the model has principal axes "
                f"only; turn the root link's axes to the principal ones in a copy of the file"
            )
            raise urdf.make_error(f"inertia {name}", f"{value:.4g}", reason)
        if abs(value) > 1e-9 * min(xx, yy, zz):
            share = 100 * abs(value) / min(xx, yy, zz)
            reason = f"the model has principal axes only; {share:.2g} % of the minimum moment"
            entries.append(Entry("not used", f"inertia {name}", f"{value:.4g}", reason))
    return (xx, yy, zz), entries


def _place_rotors(
    urdf: UrdfFile, links: list[PlacedLink], body: RigidBody, constants: Constants
) -> tuple[list[_Rotor], list[Entry]]:
    """Place the rotors relative to the centre of mass, and find their directions of rotation."""
    properties = urdf.root.find("properties")
    properties = ElementTree.Element("properties") if properties is None else properties
    if not links:
        places = _place_on_arms(urdf, properties) - body.centre
        origin = "places of the rotors at <properties> arm, m, as it has no links of rotors"
        entries = [Entry("derived", "rotor", properties.get("layout", ""), origin)]
    else:
        places = np.array([_rotor_place(urdf, link) for link in links]) - body.centre
        entries = [
            Entry(
                "not used", f"properties {key}", properties.get(key, ""), "links place the rotors"
            )
            for key in ("arm", "layout")
            if key in properties.attrib
        ]
    height = float(places[:, 2].mean())
    if np.abs(places[:, 2]).max() > NEAR:
        origin = "mean height of rotors above the centre of mass, m, at which their drag acts"
        if constants.values.get(("rotor_drag", "xy")) and constants.motors:
            constants.add("derived", "rotor_drag", "height", height, origin)
        else:
            reason = "thrusts act in the plane of the centre of mass"
            entries.append(Entry("not used", "height of rotors", f"{height:.4g} m", reason))
    if constants.motors:
        spins = [motor.spin for motor in constants.motors]
        entries.append(Entry("taken", "rotor spin", " ".join(spins), "motor plugins"))
    else:
        spins = _alternate(urdf, places)
        origin = (
            "the file has none: alternating, the first from the nose to the right ccw; compare "
            "them with the code that flew the file"
        )
        entries.append(Entry("derived", "rotor spin", " ".join(spins), origin))
    named: list[PlacedLink | None] = [*links, *[None] * (len(places) - len(links))]
    return [_Rotor(*row) for row in zip(named, places, spins, strict=True)], entries


def _rotor_place(urdf: UrdfFile, link: PlacedLink) -> np.ndarray:
    """Return the place of a rotor: the centre of mass of its link, where the simulators push."""
    up = axes(link.quaternion)[2]
    if up[2] < cos(MAX_TILT):
        tilt = math.degrees(acos(max(-1.0, min(1.0, up[2]))))
        reason = f"its axis leans by {tilt:.3g} degrees: rotors push along z of the root link"
        raise urdf.make_error("link", link.name, reason)
    inertial = link.element.find("inertial")
    return link.place if inertial is None else link.pose(urdf, inertial)[0]


def _place_on_arms(urdf: UrdfFile, properties: ElementTree.Element) -> np.ndarray:
    """Return the places (4, 3) of four rotors on arms, in the order of gym-pybullet-drones."""
    if "arm" not in properties.attrib:
        reason = (
            "no links of rotors: name them prop... or rotor..., or add <properties arm=... (m) "
            "layout=.../> to a copy of the file, with layout x or +"
        )
        raise urdf.make_error("link", ", ".join(e.get("name", "") for e in
                              urdf.root.findall("link")[:5]), reason)  # fmt: skip
    arm = urdf.number(properties, "arm", low=0)
    first = {"x": -math.pi / 4, "+": 0.0}.get(properties.get("layout", ""))
    if first is None:
        reason = "x or + is needed, as there are no links of rotors"
        raise urdf.make_error("properties layout", properties.get("layout", "missing"), reason)
    turn = first - np.arange(4) * math.pi / 2
    return arm * np.stack([cos(turn), sin(turn), np.zeros(4)], axis=1)


def _alternate(urdf: UrdfFile, places: np.ndarray) -> list[str]:
    """Return alternating directions of rotation; from the nose rightwards the first is ccw."""
    if len(places) % 2:
        reason = "directions of rotation cannot alternate: add a motor plugin for each rotor"
        raise urdf.make_error("rotor", f"there {len(places)} times", reason)
    # Rounded, so that a rotor at the nose is the first
    azimuth = np.round(np.degrees(atan2(-places[:, 1], places[:, 0])), 6) % 360
    rank = np.argsort(np.argsort(azimuth, kind="stable"), kind="stable")
    return ["cw" if k % 2 else "ccw" for k in rank.tolist()]


def _add_radius(urdf: UrdfFile, rotors: list[_Rotor], constants: Constants) -> None:
    """Add the radius of the propellers: that of the cylinders of their links, if not given."""
    found = []
    for rotor in rotors:
        elements = [] if rotor.link is None else rotor.link.element.iterfind(".//cylinder")
        found += [urdf.number(element, "radius", low=0) for element in elements]
    if found and ("propeller_radius", "value") not in constants.values:
        origin = "maximum radius of the cylinders of rotors' links, m"
        constants.add("derived", "propeller_radius", "value", max(found), origin)


def _add_rotor_inertia(urdf: UrdfFile, rotors: list[_Rotor], constants: Constants) -> None:
    """Add the moment of inertia of rotors that turn about a joint."""
    found = set()
    for rotor in rotors:
        if rotor.link is not None and rotor.link.joint == "continuous":
            inertial = rotor.link.element.find("inertial")
            if inertial is not None and urdf.number(urdf.element("mass", inertial), "value") > 0:
                found.add(round(float(join_links(urdf, [rotor.link]).inertia[2, 2]), 15))
    if len(found) == 1:
        slowdown = constants.motors[0].slowdown if constants.motors else 1.0
        origin = f"izz of a rotor's link / {slowdown:g} (slowdown: same angular momentum), kg m^2"
        constants.add("derived", "rotor_inertia", "value", found.pop() / slowdown, origin)
    elif found:
        constants.skip("inertia of rotors", "differs", "rotors of an airframe are equal")


def _add_defaults(urdf: UrdfFile, rotors: list[_Rotor], constants: Constants) -> None:
    """Add tags that every airframe has; raise ValueError for those without a default."""
    for tag, attribute in REQUIRED.items():
        if (tag, "value") not in constants.values:
            reason = f"add {attribute} to <properties> in a copy of the file"
            raise urdf.make_error(tag, "missing", reason)
    for attribute in ("up", "down"):
        if ("motor_lag", attribute) not in constants.values:
            origin = "the file has none: rotors follow commands without lag"
            constants.add("default", "motor_lag", attribute, 0.0, origin)
    for attribute in ("xy", "z"):
        if ("rotor_drag", attribute) not in constants.values:
            origin = "the file has none: no drag of rotors"
            constants.add("default", "rotor_drag", attribute, 0.0, origin)
    if ("max_speed", "value") not in constants.values:
        origin = "the file has none: that of the Crazyflie, m/s; change it in the written file"
        constants.add("default", "max_speed", "value", DEFAULT_SPEED, origin)


def _enclose_shapes(
    urdf: UrdfFile,
    links: list[PlacedLink],
    rotors: list[_Rotor],
    body: RigidBody,
    constants: Constants,
) -> tuple[Shape, list[Entry]]:
    """Return the collision shape: the only centred one, or a cylinder around all of them."""
    pieces: list[tuple[Shape, np.ndarray, Quat4Like]] = []
    entries = []
    for link in links:
        for collision in link.element.findall("collision"):
            try:
                shape = urdf.shape(collision)
            except ValueError as error:
                if collision.find("geometry/mesh") is None:
                    raise
                name = urdf.element("geometry/mesh", collision).get("filename", "")
                entries.append(
                    Entry("not used", f"collision mesh of {link.name}", name, str(error))
                )
                continue
            place, turn = link.pose(urdf, collision)
            pieces.append((shape, place - body.centre, turn))
    if not pieces:
        reason = "no collision shape that can be read: add a <collision> with a box or cylinder"
        raise urdf.make_error("collision", "missing", reason)
    if len(pieces) == 1 and not entries:
        shape, place, quaternion = pieces[0]
        is_upright = np.abs(np.array(axes(quaternion)) - np.eye(3)).max() < NEAR
        if shape.kind != HULL and np.abs(place).max() < NEAR and is_upright:
            return shape, [Entry("taken", "collision", _describe(shape), "the only shape, m")]
    if entries:
        radius = constants.values["propeller_radius", "value"]
        disc = Shape(CYLINDER, (radius, radius, DISC_THICKNESS * radius / 2))
        pieces += [(disc, rotor.place, (0.0, 0.0, 0.0, 1.0)) for rotor in rotors]
    reaches = [_reach(*piece) for piece in pieces]
    radius, half = (max(values) for values in zip(*reaches, strict=True))
    shape = Shape(CYLINDER, (radius, radius, half))
    with_discs = " and the rotors' discs" if entries else ""
    origin = f"cylinder around the centre of mass and {len(pieces)} shapes{with_discs}, m"
    return shape, [*entries, Entry("derived", "collision", _describe(shape), origin)]


def _describe(shape: Shape) -> str:
    x, y, z = shape.half
    if shape.kind == BOX:
        return f"box {2 * x:.6g} {2 * y:.6g} {2 * z:.6g}"
    if shape.kind == SPHERE:
        return f"sphere of radius {x:.6g}"
    return f"cylinder of radius {x:.6g} and length {2 * z:.6g}"


def _reach(shape: Shape, place: np.ndarray, turn: Quat4Like) -> tuple[float, float]:
    """Return the maximum distance from the z axis, and the maximum distance from z = 0, m."""
    if shape.kind == SPHERE:
        radius = shape.half[0]
        return float(hypot(place[0], place[1])) + radius, abs(float(place[2])) + radius
    rotation = np.array(axes(turn)).T
    if shape.kind == CYLINDER and rotation[2, 2] ** 2 > 1 - NEAR**2:
        radius, _, half = shape.half
        return float(hypot(place[0], place[1])) + radius, abs(float(place[2])) + half
    if shape.kind == HULL:
        corners = np.array(shape.corners)
    elif shape.kind == BOX:
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        corners = signs * shape.half
    else:
        angle = 2 * np.pi * np.arange(SIDES) / SIDES
        wide = shape.half[0] / cos(math.pi / SIDES)
        ring = wide * np.stack([cos(angle), sin(angle), np.zeros(SIDES)], axis=1)
        corners = np.concatenate(
            [ring + np.array((0, 0, z)) for z in (-shape.half[2], shape.half[2])]
        )
    points = corners @ rotation.T + place
    return float(hypot(points[:, 0], points[:, 1]).max()), float(np.abs(points[:, 2]).max())


def _list_visuals(
    urdf: UrdfFile,
    links: list[PlacedLink],
    rotors: list[_Rotor],
    body: RigidBody,
    constants: Constants,
    shape: Shape,
) -> tuple[list[str], list[Entry]]:
    """Return the elements of the visuals, without meshes; discs and the shape if there are none."""
    colours = _colours(urdf)
    drawn, entries = [], []
    of_rotors = {rotor.link.name for rotor in rotors if rotor.link is not None}
    has_body = has_discs = False
    for link in links:
        for visual in link.element.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None:
                name = mesh.get("filename", "")
                reason = "meshes are not copied: discs and the collision shape are drawn instead"
                entries.append(Entry("not used", f"visual mesh of {link.name}", name, reason))
                continue
            found = urdf.shape(visual)
            place, turn = link.pose(urdf, visual)
            material = visual.find("material")
            name = "" if material is None else material.get("name", "")
            drawn.append(_format_visual(found, place - body.centre, turn, colours.get(name)))
            has_discs |= link.name in of_rotors
            has_body |= link.name not in of_rotors
    upright = (0.0, 0.0, 0.0, 1.0)
    if not has_discs:
        radius = constants.values["propeller_radius", "value"]
        disc = Shape(CYLINDER, (radius, radius, DISC_THICKNESS * radius / 2))
        drawn += [_format_visual(disc, rotor.place, upright, None) for rotor in rotors]
    if not has_body:
        # A smaller body leaves the discs visible
        across, deep, high = shape.half
        core = Shape(BOX, (across / 2, deep / 2, high))
        drawn.append(_format_visual(core, np.zeros(3), upright, "0.2 0.2 0.25 1"))
    return drawn, entries


def _colours(urdf: UrdfFile) -> dict[str, str]:
    """Return the colours of all named materials."""
    found = {}
    for material in urdf.root.iter("material"):
        colour = material.find("color")
        words = "" if colour is None else colour.get("rgba", "")
        try:
            numbers = [parse_number(word) for word in words.split()]
        except ValueError:
            raise urdf.make_error("color rgba", words, "four numbers are needed") from None
        if len(numbers) == 4:
            found[material.get("name", "")] = _numbers(numbers)
    return found


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)


def _format_visual(shape: Shape, place: np.ndarray, turn: Quat4Like, colour: str | None) -> str:
    """Return a `<visual>` element of a shape at a pose."""
    x, y, z, w = turn
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.pi / 2 - acos(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    material = ""
    if colour is not None:
        name = quoteattr(f"colour {colour}")
        material = f'\n      <material name={name}><color rgba="{colour}"/></material>'
    return (
        f'    <visual>\n      <origin xyz="{_numbers(place.tolist())}" '
        f'rpy="{_numbers((roll, pitch, yaw))}"/>\n'
        f"      <geometry>{_format_shape(shape)}</geometry>{material}\n    </visual>"
    )


def _format_shape(shape: Shape) -> str:
    """Return the element of a box, sphere or cylinder."""
    x, y, z = (repr(float(half)) for half in shape.half)
    if shape.kind == SPHERE:
        return f'<sphere radius="{x}"/>'
    if shape.kind == CYLINDER:
        return f'<cylinder radius="{x}" length="{2 * shape.half[2]!r}"/>'
    x, y, z = (repr(2 * float(half)) for half in shape.half)
    return f'<box size="{x} {y} {z}"/>'


def _list_link_tags(links: list[PlacedLink]) -> Iterator[Entry]:
    """Report elements of links that are neither shapes nor inertial."""
    known = {"visual", "collision", "inertial"}
    for link in links:
        for element in link.element:
            if isinstance(element.tag, str) and element.tag not in known:
                reason = "it has no counterpart here"
                yield Entry("not used", f"<{element.tag}> of {link.name}", "", reason)


def _list_defaults(text: str, airframe: Airframe) -> Iterator[Entry]:
    """Report the values of tags that the converted file leaves out."""
    origin = "missing: from size and disc loading, see bulletuav.vehicle.scaling"
    values = {
        "rate_damping": airframe.damping,
        "body_drag": airframe.body_drag,
        "ground_effect": (airframe.ground_effect_reach, airframe.ground_effect_gain),
        "wake": (airframe.wake_radius, airframe.wake_share, airframe.wake_spread),
        "power": (airframe.efficiency, airframe.electronics),
    }
    for tag, numbers in values.items():
        if f"<{tag} " not in text:
            yield Entry("default", tag, ", ".join(f"{one:.4g}" for one in numbers), origin)
    others = {"rotor_inertia": "0", "battery": "none", "pwm": "none", "contact": "0.5 0"}
    for tag, value in others.items():
        if f"<{tag} " not in text:
            yield Entry("default", tag, value, "missing: the default of airframes")


def _format_robot(
    urdf: UrdfFile,
    body: RigidBody,
    moments: tuple[float, float, float],
    rotors: list[_Rotor],
    constants: Constants,
    shape: Shape,
    visuals: list[str],
) -> str:
    """Return the text of the one-link URDF."""
    tags: dict[str, list[str]] = {}
    for (tag, attribute), value in constants.values.items():
        tags.setdefault(tag, []).append(f'{attribute}="{value!r}"')
    lines = [
        f"<robot name={quoteattr(urdf.root.get('name') or urdf.path.stem)}>",
        "  <airframe>",
        *(f"    <{tag} {' '.join(words)}/>" for tag, words in tags.items()),
    ]
    for rotor in rotors:
        x, y, _ = (repr(float(value)) for value in rotor.place)
        lines.append(f'    <rotor x="{x}" y="{y}" spin="{rotor.spin}"/>')
    ixx, iyy, izz = map(repr, moments)
    lines += [
        "  </airframe>",
        '  <link name="base">',
        "    <inertial>",
        f'      <mass value="{body.mass!r}"/>',
        f'      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
        "    <collision>",
        f"      <geometry>{_format_shape(shape)}</geometry>",
        "    </collision>",
        *visuals,
        "  </link>",
        "</robot>",
        "",
    ]
    return "\n".join(lines)
