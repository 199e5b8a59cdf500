"""Shapes and poses of everything that drones can touch, as one table for compiled code.

All shapes are convex: the drones, obstacles, bodies that users add, and the pieces of city layouts.
The ground is the half-space z <= 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.city_grid import CityGrid
from bulletuav.geometry.convex import ShapeTable, insert_shapes, make_hull_shape, make_shape_table
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.shapes import BOX, HALF_SPACE, Shape
from bulletuav.geometry.solids import Solids

NOWHERE = -2000.0
"""Coordinate x, y and z of pieces that are not in a world, m: far below the ground"""


class Scenery(NamedTuple):
    """Shapes of N drones, R pieces of bodies in each of W worlds, and T pieces of city layouts.

    Poses are in the frame of each world. Adding a body makes a new `Scenery`.

    Attributes:
        table: Shapes of the drones (0 to N - 1), of the pieces of bodies (from `first_body`), of
            the pieces of all layouts (from `first_piece`), and last of the ground.
        first_body: Index of the shape of the first body: N.
        first_piece: Index of the shape of the first piece of the first layout: N + R.
        ground: Index of the ground's shape: N + R + T.
        place: (W, R, 3) positions of the pieces of bodies, m; NOWHERE if they are not in the world.
        quaternion: (W, R, 4) attitudes of the pieces of bodies, body to world.
        velocity: (W, R, 3) velocities of the pieces of bodies, m/s.
        other: (R,) index in `Contacts.other` of the body to which a piece belongs.
        piece_place: (T, 3) origins of the layouts' pieces, the centres of their bounding boxes, m.
            They are not rotated.
        friction: (R,) coefficients of friction of the pieces of bodies.
        restitution: (R,) coefficients of restitution of the pieces of bodies.
        city_grid: Grid of the layouts' pieces, and the layout of each world.
    """

    table: ShapeTable
    first_body: int
    first_piece: int
    ground: int
    place: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    other: np.ndarray
    piece_place: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    city_grid: CityGrid


class BodyPiece(NamedTuple):
    """One convex piece of a body.

    Attributes:
        shape: Shape of the piece in its own axes.
        place: (3,) origin of the piece in the body's axes, m.
        quaternion: (4,) rotation from the piece's axes to the body's.
    """

    shape: Shape
    place: np.ndarray
    quaternion: np.ndarray


def make_scenery(
    drones: Sequence[Shape],
    obstacles: Sequence[Obstacle],
    others: Sequence[int],
    layouts: Sequence[Solids],
    city_grid: CityGrid,
) -> Scenery:
    """Make the scenery of drones, obstacles and city layouts; no obstacle is placed.

    Args:
        drones: Shapes of the N drones of a world.
        obstacles: The K obstacles of each world, one piece each.
        others: Index in `Contacts.other` of each obstacle.
        layouts: The city layouts.
        city_grid: The grid of these layouts.

    Returns:
        The scenery.
    """
    num_worlds = len(city_grid.layout)
    count = len(obstacles)
    # Pieces of cities are never rotated, so their bounding boxes are constant
    place = (city_grid.low + city_grid.high) / 2
    half = (city_grid.high - city_grid.low) / 2
    pieces = _city_shapes(layouts, place, half)
    # Order of the table: drones, obstacles, pieces, and the ground last
    shapes = [*drones, *(one.shape for one in obstacles), *pieces, Shape(HALF_SPACE, (np.inf,) * 3)]
    # Obstacles are outside the worlds until a reset places them
    upright = np.zeros((num_worlds, count, 4))
    upright[..., 3] = 1.0
    return Scenery(
        table=make_shape_table(shapes),
        first_body=len(drones),
        first_piece=len(drones) + count,
        ground=len(shapes) - 1,
        place=np.full((num_worlds, count, 3), NOWHERE),
        quaternion=upright,
        velocity=np.zeros((num_worlds, count, 3)),
        other=np.array(others, dtype=np.int64),
        piece_place=place,
        friction=np.array([one.friction for one in obstacles], dtype=float),
        restitution=np.array([one.restitution for one in obstacles], dtype=float),
        city_grid=city_grid,
    )


def _city_shapes(layouts: Sequence[Solids], place: np.ndarray, half: np.ndarray) -> list[Shape]:
    """Make the shapes of all pieces from their centres (T, 3) and half extents (T, 3)."""
    shapes: list[Shape] = []
    for solids in layouts:
        # Boxes come first, then hulls, as in the grid.
        for _ in solids.boxes:
            width, depth, height = half[len(shapes)].tolist()
            shapes.append(Shape(BOX, (width, depth, height)))
        for hull in solids.hulls:
            shapes.append(make_hull_shape(hull - place[len(shapes)]))
    return shapes


def add_pieces(
    scenery: Scenery,
    shapes: Sequence[Shape],
    place: np.ndarray,
    quaternion: np.ndarray,
    other: int,
    friction: float,
    restitution: float,
) -> Scenery:
    """Make a scenery with one more body.

    Args:
        scenery: The present scenery.
        shapes: Shapes of the P pieces of the body.
        place: (W, P, 3) positions of the pieces, m; NOWHERE in worlds without the body.
        quaternion: (W, P, 4) attitudes of the pieces, body to world.
        other: Index in `Contacts.other` of the body.
        friction: Coefficient of friction.
        restitution: Coefficient of restitution.

    Returns:
        The extended scenery.
    """
    count = len(shapes)
    table = insert_shapes(scenery.table, scenery.first_piece, make_shape_table(shapes))
    return scenery._replace(
        table=table,
        first_piece=scenery.first_piece + count,
        ground=scenery.ground + count,
        place=np.concatenate([scenery.place, place], axis=1),
        quaternion=np.concatenate([scenery.quaternion, quaternion], axis=1),
        velocity=np.concatenate([scenery.velocity, np.zeros(place.shape)], axis=1),
        other=np.append(scenery.other, np.full(count, other)),
        friction=np.append(scenery.friction, np.full(count, friction)),
        restitution=np.append(scenery.restitution, np.full(count, restitution)),
    )
