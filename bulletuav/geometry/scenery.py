"""What drones can touch in each world, as one table for compiled code.

Its pieces are convex: the drones themselves, obstacles, bodies that users add, and the pieces of
city layouts. The ground is the half space z <= 0.
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
"""Coordinate x, y and z of pieces that are not placed, m: far below the ground"""


class Scenery(NamedTuple):
    """Shapes of N drones, R pieces of bodies in each of W worlds, and T pieces of city layouts.

    Poses are in each world's own frame. Bodies that are added later make a new `Scenery`.

    Attributes:
        table: Shapes of the drones (0 to N - 1), of the pieces of bodies (`first_body` and on), of
            the pieces of all layouts (`first_piece` and on), and last of the ground.
        first_body: Number of the first body's shape: N.
        first_piece: Number of the shape of the first layout's first piece: N + R.
        ground: Number of the ground's shape: N + R + T.
        place: (W, R, 3) positions of the pieces of bodies, m; NOWHERE where they are not placed.
        quaternion: (W, R, 4) their attitudes, body to world.
        velocity: (W, R, 3) their velocities, m/s.
        other: (R,) what a contact calls the body that a piece is part of.
        piece_place: (T, 3) origins of the layouts' pieces, the middles of their bounding boxes, m.
            They are not turned.
        friction: (R,) coefficients of friction of the pieces of bodies.
        restitution: (R,) share of the speed that an impact with them gives back.
        city_grid: The layouts' pieces by cells, and which layout stands in each world.
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
        shape: Its shape in axes of its own.
        place: (3,) its origin in the body's axes, m.
        quaternion: (4,) its turn, piece to body.
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
    """Make the table of what stands before anything is added; no obstacle is placed.

    Args:
        drones: Shapes of the N drones of a world.
        obstacles: The K obstacles of each world, one piece each.
        others: What a contact calls each obstacle.
        layouts: The city layouts.
        city_grid: The grid of these layouts.
    """
    num_worlds = len(city_grid.layout)
    count = len(obstacles)
    # Pieces of cities never turn, so their boxes are known from the start
    place = (city_grid.low + city_grid.high) / 2
    half = (city_grid.high - city_grid.low) / 2
    pieces = _city_shapes(layouts, place, half)
    # Order of the table: drones, obstacles, pieces, and the ground last
    shapes = [*drones, *(one.shape for one in obstacles), *pieces, Shape(HALF_SPACE, (np.inf,) * 3)]
    # Obstacles are nowhere until an episode puts them somewhere
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
    """Make the shapes of all pieces of layouts, about their places (T, 3); half extents (T, 3)."""
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
    """Make a scenery that has one more body.

    Args:
        scenery: The one before.
        shapes: Shapes of the P pieces of the body.
        place: (W, P, 3) their positions, m; NOWHERE in worlds where the body is not.
        quaternion: (W, P, 4) their attitudes, body to world.
        other: What a contact calls the body.
        friction: Coefficient of friction.
        restitution: Share of the speed that an impact gives back.
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
