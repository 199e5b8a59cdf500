"""Reader of URDF files: bounded numbers, inertia and collision shapes.

Every error message names the file, the tag and the value.
"""

import contextlib
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from bulletuav.errors import read_file, shown
from bulletuav.geometry.convex import contains_origin, inscribed_radius
from bulletuav.geometry.mesh_file import read_obj
from bulletuav.geometry.obstacle import hull_from_points
from bulletuav.geometry.rotation import from_euler
from bulletuav.geometry.shapes import BOX, CYLINDER, HULL, SPHERE, Shape
from bulletuav.parsing import parse_number, read_xml

MIN_MAGNITUDE = 1e-20
"""Minimum magnitude of a non-zero number: products of a few such numbers do not underflow."""
MAX_MAGNITUDE = 1e9
"""Maximum magnitude of a number: squares and products of a few such numbers are finite."""
MAX_LENGTH = 100.0
"""Maximum length on a drone, m."""
MIN_SHAPE_SIDE = 1e-4
"""Minimum side of a collision shape, m: Bullet's margins are as large as thinner ones."""
MAX_SHOWN_CHARACTERS = 200
"""Maximum number of characters of a value in a message."""
MAX_PATH_BYTES = 800
"""Maximum length of a path that a mesh names, bytes: Bullet crashes from about 1,000 on."""
TEXTURE_KEYWORDS = ("map_Ka", "map_Kd", "map_Ks", "map_Ns")
"""Keywords of a material file that are followed by the name of an image."""
ZERO = r"[+-]?(?:0+\.?0*|\.0+)(?:[eE][+-]?[0-9]+)?"
"""Pattern of a number that is 0."""


class UrdfFile:
    """A URDF file whose values are read by tag and checked.

    Attributes:
        path: Path of the file.
        root: The `<robot>` element.
        widest: Maximum length of a shape, m.
    """

    def __init__(self, path: Path, widest: float = MAX_LENGTH, needs_meshes: bool = True) -> None:
        """Parse the file.

        Args:
            path: Path of the file.
            widest: Maximum length of a shape, m.
            needs_meshes: Whether all meshes are checked, as the engine reads them.

        Raises:
            ValueError: If the file is no XML, or names a mesh that cannot be read.
        """
        self.path = path
        self.widest = widest
        self.root = read_xml(path)
        if needs_meshes:
            self.require_meshes()

    def require_meshes(self) -> None:
        """Check all meshes and textures that the file names.

        Bullet reads them in C++ without checks, from the folder of the file, a folder above it or
        the current folder. It would wait forever for a pipe or a device.

        Raises:
            ValueError: If a mesh is missing, damaged or of another format, or a texture is no file.
        """
        for mesh in self.root.iter("mesh"):
            name = mesh.get("filename", "")
            try:
                files = self._find_files(name)
                for path in files:
                    _require_mesh(path)
            except (OSError, ValueError) as error:
                raise self.make_error("mesh filename", name, str(error)) from None
            if not files:
                reason = (
                    "the name of a Wavefront OBJ file (.obj) or binary STL file (.stl) next to the "
                    "URDF is needed, and there is no such file"
                )
                raise self.make_error("mesh filename", name or "missing", reason)
        for texture in self.root.iter("texture"):
            name = texture.get("filename", "")
            try:
                self._find_files(name)
            except (OSError, ValueError) as error:
                raise self.make_error("texture filename", name, str(error)) from None

    def _find_files(self, name: str) -> list[Path]:
        """Find the files that Bullet may read for a name.

        Raises:
            ValueError: If one is no regular file.
        """
        local = name.removeprefix("package://").removeprefix("model://")
        paths = [folder / local for folder in (Path(), *self.path.resolve().parents)]
        return [path for path in paths if _is_file(path)]

    def make_error(self, tag: str, value: object, reason: str) -> ValueError:
        """Return the ValueError for a value of the file."""
        text = (
            value if isinstance(value, str) and len(value) < MAX_SHOWN_CHARACTERS else shown(value)
        )
        return ValueError(f"{self.path}: <{tag}> is {text}: {reason}")

    def element(self, tag: str, parent: ElementTree.Element | None = None) -> ElementTree.Element:
        """Find a required element.

        Args:
            tag: Tag of the element, or the path of tags to it.
            parent: Element to search in; the root if None.

        Returns:
            The element.

        Raises:
            ValueError: If there is no such element.
        """
        found = (self.root if parent is None else parent).find(tag)
        if found is None:
            reason = (
                "every airframe needs it; assets/urdf/cf2x.urdf shows the form, and `bulletuav "
                "convert` writes it from URDFs of other simulators"
            )
            raise self.make_error(tag, "missing", reason)
        return found

    def number(
        self,
        element: ElementTree.Element,
        attribute: str,
        low: float = -math.inf,
        strict: bool = True,
        most: float = MAX_MAGNITUDE,
    ) -> float:
        """Read a finite number from an attribute.

        Args:
            element: The element.
            attribute: Name of the attribute.
            low: Lower bound, exclusive if `strict`.
            strict: False if the number may be equal to `low`.
            most: Maximum magnitude of the number.

        Returns:
            The number.

        Raises:
            ValueError: If the attribute is missing, no number or out of bounds.
        """
        text = element.get(attribute)
        label = f"{element.tag} {attribute}"
        try:
            value = parse_number("missing" if text is None else text)
        except ValueError:
            written = text if text is not None else "missing"
            raise self.make_error(label, written, "a number is needed") from None
        if value < low or (strict and value == low):
            bound = f"{'above' if strict else 'at least'} {low:g}"
            raise self.make_error(label, text, f"it must be finite and {bound}")
        if value != 0 and not MIN_MAGNITUDE <= abs(value) <= most:
            reason = f"its magnitude must be from {MIN_MAGNITUDE:g} to {most:g}"
            raise self.make_error(label, text, reason)
        return value

    def inertia(self) -> tuple[float, float, float]:
        """Read the principal moments of inertia (x, y, z), kg m^2.

        Raises:
            ValueError: If the link frame is not the principal frame, or the moments are not
                physical.
        """
        inertial = self.element("link/inertial")
        self._require_zero_origin(
            inertial, "the link frame must be the principal frame at the centre of mass"
        )
        element = self.element("inertia", inertial)
        for key in ("ixy", "ixz", "iyz"):
            if key in element.attrib and self.number(element, key) != 0:
                reason = "use principal axes: off-diagonal terms must be 0"
                raise self.make_error(f"inertia {key}", element.get(key), reason)
        ixx, iyy, izz = (self.number(element, key, low=0) for key in ("ixx", "iyy", "izz"))
        # Triangle inequality of the moments, with a tolerance for flat bodies
        if 2 * max(ixx, iyy, izz) > (ixx + iyy + izz) * (1 + 1e-9):
            text = f"({ixx:g}, {iyy:g}, {izz:g})"
            reason = "it is not physical: each moment must be at most the sum of the other two"
            raise self.make_error("inertia", text, reason)
        return ixx, iyy, izz

    def require_one_link(self) -> None:
        """Raise ValueError for robots of several links.

        Raises:
            ValueError: If there is not exactly one link, or there is a joint.
        """
        links = self.root.findall("link")
        if len(links) != 1 or self.root.find("joint") is not None:
            reason = (
                "exactly one link and no joint (propellers are visuals); `bulletuav convert FILE "
                "--out NAME.urdf` merges the links of drones of other simulators"
            )
            raise self.make_error("link", f"{len(links)} links", reason)

    def collision_shape(self) -> Shape:
        """Read the collision shape of an airframe.

        Raises:
            ValueError: If there is not exactly one shape, it is shifted or rotated, or no cylinder,
                box, sphere or mesh; or the centre of mass is not inside the mesh.
        """
        shapes = self.root.findall("link/collision")
        if len(shapes) != 1:
            reason = "exactly one convex shape keeps contacts reproducible"
            raise self.make_error("collision", f"there {len(shapes)} times", reason)
        self._require_zero_origin(shapes[0], "the collision shape must be centred and not turned")
        shape = self.shape(shapes[0])
        if shape.kind == HULL and not contains_origin(shape):
            reason = "the centre of mass, the mesh's origin, must be within its convex hull"
            raise self.make_error("mesh", "elsewhere", reason)
        return shape

    def shape(self, collision: ElementTree.Element) -> Shape:
        """Read the shape of a `<collision>` element.

        Args:
            collision: The element; its origin is not read.

        Returns:
            The shape in the element's own axes.

        Raises:
            ValueError: If it is no cylinder, box, sphere or mesh, too small or too large.
        """
        geometry = self.element("geometry", collision)
        kinds = [shape.tag for shape in geometry]
        if kinds not in (["cylinder"], ["box"], ["sphere"], ["mesh"]):
            reason = "it must be one cylinder, box, sphere or mesh"
            raise self.make_error("collision geometry", kinds, reason)
        shape = geometry[0]
        if shape.tag == "sphere":
            radius = self._read_length(shape, "radius")
            return Shape(SPHERE, (radius, radius, radius))
        if shape.tag == "cylinder":
            radius = self._read_length(shape, "radius")
            length = self._read_length(shape, "length")
            return Shape(CYLINDER, (radius, radius, length / 2))
        return self._read_box(shape) if shape.tag == "box" else self._read_hull(shape)

    def origin(self, parent: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
        """Read the `<origin>` of an element.

        Args:
            parent: The element; a missing origin is the identity.

        Returns:
            Position (3,), m, and quaternion (4,).

        Raises:
            ValueError: If it does not consist of numbers.
        """
        found = parent.find("origin")
        element = ElementTree.Element("origin") if found is None else found
        place = self._read_vector(element, "xyz", "0 0 0")
        roll, pitch, yaw = self._read_vector(element, "rpy", "0 0 0")
        return np.array(place), np.array(from_euler(roll, pitch, yaw))

    def _read_vector(
        self, element: ElementTree.Element, attribute: str, default: str = ""
    ) -> tuple[float, float, float]:
        """Read three finite numbers from an attribute."""
        text = element.get(attribute, default)
        with contextlib.suppress(ValueError):
            x, y, z = map(parse_number, text.split())
            if max(abs(x), abs(y), abs(z)) <= MAX_MAGNITUDE:
                return x, y, z
        reason = f"three numbers up to {MAX_MAGNITUDE:g} are needed"
        raise self.make_error(f"{element.tag} {attribute}", text or "missing", reason)

    def _read_hull(self, mesh: ElementTree.Element) -> Shape:
        """Read the convex hull of a mesh, an OBJ file next to the URDF."""
        name = mesh.get("filename", "")
        path, scale = self.mesh_file(mesh)
        try:
            hull = hull_from_points(str(path), np.concatenate(read_obj(path)) * scale)
        except ValueError as error:
            raise self.make_error("mesh filename", name, str(error)) from None
        size = 2 * max(hull.half)
        if size > self.widest or 2 * inscribed_radius(hull) < MIN_SHAPE_SIDE:
            reason = f"its extents must be from {MIN_SHAPE_SIDE:g} to {self.widest:g} m"
            raise self.make_error("mesh filename", name, reason)
        return hull

    def mesh_file(self, mesh: ElementTree.Element) -> tuple[Path, tuple[float, float, float]]:
        """Read the path of an OBJ file next to the URDF, and the factors of its x, y and z.

        Raises:
            ValueError: If there is no such file, or a factor is not above 0.
        """
        name = mesh.get("filename", "")
        path = self.path.parent / name
        if not name.lower().endswith(".obj") or not path.is_file():
            reason = "the name of a Wavefront OBJ file (.obj) next to the URDF is needed"
            raise self.make_error("mesh filename", name or "missing", reason)
        scale = self._read_vector(mesh, "scale", "1 1 1")
        if min(scale) <= 0:
            raise self.make_error("mesh scale", mesh.get("scale"), "it must be above 0")
        return path, scale

    def _read_box(self, shape: ElementTree.Element) -> Shape:
        """Read a box from its three edge lengths."""
        try:
            size = [parse_number(part) for part in shape.get("size", "").split()]
        except ValueError:
            size = []
        if len(size) == 3 and all(MIN_SHAPE_SIDE <= side <= self.widest for side in size):
            return Shape(BOX, (size[0] / 2, size[1] / 2, size[2] / 2))
        reason = f"three positive numbers from {MIN_SHAPE_SIDE:g} to {self.widest:g} are needed"
        raise self.make_error("box size", shape.get("size", "missing"), reason)

    def _read_length(self, shape: ElementTree.Element, attribute: str) -> float:
        """Read a length of the collision shape, m."""
        side = self.number(shape, attribute, low=0, most=self.widest)
        if side < MIN_SHAPE_SIDE:
            reason = f"at least {MIN_SHAPE_SIDE:g} m is needed"
            raise self.make_error(f"{shape.tag} {attribute}", shape.get(attribute), reason)
        return side

    def _require_zero_origin(self, parent: ElementTree.Element, reason: str) -> None:
        """Raise ValueError for an `<origin>` with a number other than 0."""
        origin = parent.find("origin")
        for key in ("xyz", "rpy"):
            text = "0 0 0" if origin is None else origin.get(key, "0 0 0")
            # Any other text is no number, or a number other than 0
            if not re.fullmatch(rf"\s*{ZERO}\s+{ZERO}\s+{ZERO}\s*", text, re.ASCII):
                raise self.make_error(f"{parent.tag} origin {key}", text, reason)


def _is_file(path: Path) -> bool:
    """Return True for a regular file, False for a folder or a missing path.

    Raises:
        ValueError: If the path is a pipe, a device or the like.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError(f"{path} is not a regular file: a mesh or image file is needed")
    return path.is_file()


def _require_mesh(path: Path) -> None:
    """Raise ValueError for a mesh file with inconsistent contents."""
    match path.suffix.lower():
        case ".obj":
            read_obj(path)
            _require_materials(path)
        case ".stl":
            content = path.read_bytes()
            count = int.from_bytes(content[80:84], "little")
            if len(content) != 84 + 50 * count:
                raise ValueError(
                    f"{path}: {len(content)} bytes, and a binary STL file of {count} triangles has "
                    f"{84 + 50 * count}: export it again"
                )
        case _:
            raise ValueError(
                f"{path} has a format that cannot be checked before the engine reads it: convert "
                f"it to a Wavefront OBJ file (.obj), as modelling programs can"
            )


def _require_materials(mesh: Path) -> None:
    """Check the material files that an OBJ file names, and the images that these name.

    Raises:
        ValueError: If one is no regular file, or has a path that is too long for Bullet.
    """
    for material in _list_named_files(mesh, ("mtllib",)):
        if _is_file(material):
            for picture in _list_named_files(material, TEXTURE_KEYWORDS):
                _is_file(picture)


def _list_named_files(path: Path, words: tuple[str, ...]) -> list[Path]:
    """List the files that a file names after any of some keywords.

    Raises:
        ValueError: If a path is longer than `MAX_PATH_BYTES`.
    """
    lines = (line.strip() for line in read_file(path, newline="").split("\n"))
    files = []
    for line in lines:
        word, _, name = line.replace("\t", " ").partition(" ")
        if word in words:
            files.append(path.parent / name.strip())
            if len(os.fsencode(files[-1])) > MAX_PATH_BYTES:
                raise ValueError(
                    f"{path}: {word} {shown(name)} makes a path of more than {MAX_PATH_BYTES} "
                    f"bytes, which the engine cannot read: shorten it"
                )
    return files
