"""Convex pieces of the bodies that users add: from a URDF, a mesh, corners or an obstacle."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bulletuav.errors import as_sequence, finite, require_file, shown
from bulletuav.geometry.mesh_file import read_obj
from bulletuav.geometry.obstacle import MAX_SIZE, Obstacle, hull_from_points
from bulletuav.geometry.rotation import normalise_quaternion, to_world
from bulletuav.geometry.scenery import BodyPiece
from bulletuav.geometry.shapes import HULL, Shape
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
        hulls = [
            hull_from_points(f"{source}: object {k}", one) for k, one in enumerate(read_obj(source))
        ]
        pieces = [_centred(hull) for hull in hulls]
    elif str(source).lower().endswith(".urdf"):
        pieces = _of_urdf(require_file("body", source, REMEDY))
    else:
        raise ValueError(f"body is {shown(str(source))}: {REMEDY}")
    if len(pieces) > MOST_PIECES:
        raise ValueError(f"the body has {len(pieces)} pieces: at most {MOST_PIECES} are possible")
    return pieces


def _of_urdf(path: Path) -> list[BodyPiece]:
    """Read all collision shapes of a URDF with one link."""
    urdf = UrdfFile(path.resolve(), widest=MAX_SIZE)
    urdf.require_one_link()
    elements = urdf.root.findall("link/collision")
    if not elements:
        raise urdf.make_error("collision", "missing", "a body needs one shape or more")
    pieces = []
    for element in elements:
        place, turn = urdf.origin(element)
        pieces.append(_centred(urdf.shape(element), place, turn))
    return pieces


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
