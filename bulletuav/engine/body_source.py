"""Convex pieces of the bodies that users add: from a URDF, a mesh, corners or an obstacle."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bulletuav.errors import as_sequence, finite, require_file, shown
from bulletuav.geometry.mesh_file import read_obj_faces
from bulletuav.geometry.mesh_split import split_body
from bulletuav.geometry.obstacle import MAX_SIZE, Obstacle, hull_from_points
from bulletuav.geometry.rotation import normalise_quaternion, to_world
from bulletuav.geometry.scenery import BodyPiece
from bulletuav.geometry.shapes import HULL, Shape
from bulletuav.vehicle.links import place_links
from bulletuav.vehicle.urdf import UrdfFile

BodySource = str | Path | Obstacle | np.ndarray | Sequence[Sequence[float]]
"""Path of a URDF or of an OBJ, an obstacle, or corners (V, 3) of a hull, m"""

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
REMEDY = "pass the path of a URDF (.urdf) or of a mesh (.obj), corners (V, 3), or an Obstacle"
MOST_PIECES = 1024
"""Maximum number of pieces of a body"""
UNIT = 1e-3
"""Tolerance of the norm of a quaternion"""


def pieces_of(source: BodySource) -> list[BodyPiece]:
    """Read the convex pieces of a body.

    Args:
        source: See `BodySource`.

    Returns:
        The pieces. Hulls have their origin at the centre of their bounding box.

    Raises:
        ValueError: If the source is not a `BodySource`, or its contents are invalid.
        FileNotFoundError: If the file does not exist.
    """
    if isinstance(source, Obstacle):
        pieces = [_centred(source.shape)]
    elif not isinstance(source, str | Path):
        pieces = [_centred(hull_from_points("corners of a body", source))]
    elif str(source).lower().endswith(".obj"):
        pieces = [_centred(hull) for hull in _hulls_of_mesh(Path(source))]
    elif str(source).lower().endswith(".urdf"):
        pieces = _of_urdf(require_file("body", source, REMEDY))
    else:
        raise ValueError(f"body is {shown(str(source))}: {REMEDY}")
    _require_few(len(pieces))
    return pieces


def _require_few(count: int) -> None:
    """Raise ValueError for a body of too many pieces."""
    if count > MOST_PIECES:
        raise ValueError(f"the body has {count} pieces: at most {MOST_PIECES} are possible")


def _hulls_of_mesh(path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> list[Shape]:
    """Read the convex pieces of all objects of an OBJ file.

    Args:
        path: The file.
        scale: Factors of x, y and z.
    """
    points, objects = read_obj_faces(path)
    _require_few(len(objects))
    points = points * scale
    hulls = []
    for k, faces in enumerate(objects):
        where = f"{path}: object {k}"
        pieces = split_body(points, faces, where)
        hulls += [hull_from_points(where, piece) for piece in pieces]
    return hulls


def _of_urdf(path: Path) -> list[BodyPiece]:
    """Read all collision shapes of a URDF, whose links are joined by fixed joints.

    Meshes are split into convex pieces; with `concave="no"` their convex hull is one.
    """
    urdf = UrdfFile(path.resolve(), widest=MAX_SIZE)
    pieces = []
    for link in place_links(urdf):
        for element in link.element.findall("collision"):
            place, turn = link.pose(urdf, element)
            mesh = element.find("geometry/mesh")
            shapes = [urdf.shape(element)] if mesh is None or _is_hull(urdf, element) else []
            if not shapes:
                assert mesh is not None
                shapes = _hulls_of_mesh(*urdf.mesh_file(mesh))
            pieces += [_centred(shape, place, turn) for shape in shapes]
    if not pieces:
        raise urdf.make_error("collision", "missing", "a body needs one shape or more")
    return pieces


def _is_hull(urdf: UrdfFile, collision: ElementTree.Element) -> bool:
    """Return True if a `<collision>` asks for the convex hull of its mesh."""
    text = collision.get("concave", "yes")
    if text not in ("yes", "no"):
        raise urdf.make_error("collision concave", text, "yes or no is needed")
    return text == "no"


def _centred(
    shape: Shape, place: np.ndarray | None = None, quaternion: np.ndarray = UPRIGHT
) -> BodyPiece:
    """Return a piece at a pose; the origin of a hull is moved to the centre of its bounding box."""
    origin = np.zeros(3) if place is None else place
    if shape.kind != HULL:
        return BodyPiece(shape, origin, quaternion)
    corners = np.array(shape.corners)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    half = (corners.max(axis=0) - corners.min(axis=0)) / 2
    moved = Shape(HULL, tuple(half.tolist()), tuple(map(tuple, (corners - middle).tolist())))
    return BodyPiece(moved, origin + to_world(quaternion, middle), quaternion)


def check_pose(
    position: Sequence[float], quaternion: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Check the pose of a body.

    Args:
        position: (3,) position, m.
        quaternion: (4,) unit quaternion, body to world.

    Returns:
        Position and normalised quaternion as arrays.

    Raises:
        ValueError: If a number is not finite, or the norm of the quaternion is not 1.
    """
    place = [
        finite("position", one, -MAX_SIZE, MAX_SIZE) for one in as_sequence("position", position, 3)
    ]
    turn = [finite("quaternion", one) for one in as_sequence("quaternion", quaternion, 4)]
    if abs(np.linalg.norm(turn) - 1) > UNIT:
        raise ValueError(f"quaternion is {shown(quaternion)}: a length of 1 is needed")
    return np.array(place), np.array(normalise_quaternion(np.array(turn)))
