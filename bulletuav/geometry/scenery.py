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
from bulletuav.geometry.rotation import product, to_world
from bulletuav.geometry.shapes import BOX, HALF_SPACE, Shape
from bulletuav.geometry.solids import Solids

NOWHERE = -2000.0
"""Coordinate x, y and z of pieces that are not in a world, m: far below the ground"""


class Bodies(NamedTuple):
    """Poses and motion of the B bodies that users add, in each of W worlds, and their pieces.

    Their pieces are the last P of the R pieces in a `Scenery`.

    Attributes:
        position: (W, B, 3) origins of the bodies, m; NOWHERE if they are not in the world.
        quaternion: (W, B, 4) attitudes, body to world.
        velocity: (W, B, 3) velocities of the origins, m/s.
        spin: (W, B, 3) angular velocities, world axes, rad/s.
        displacement: (W, B, 3) displacements in the present decision, m.
        rotation: (W, B, 3) rotations in the present decision, axis times angle, world axes, rad.
        reach: (B,) radii of the bounding spheres about the origins, m.
        owner: (P,) body of each piece.
        offset: (P, 3) origins of the pieces in the axes of their bodies, m.
        attitude: (P, 4) rotations from the axes of the pieces to those of their bodies.
    """

    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    displacement: np.ndarray
    rotation: np.ndarray
    reach: np.ndarray
    owner: np.ndarray
    offset: np.ndarray
    attitude: np.ndarray


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
        spin: (W, R, 3) angular velocities of the pieces of bodies, world axes, rad/s.
        other: (R,) index in `Contacts.other` of the body to which a piece belongs.
        piece_place: (T, 3) origins of the layouts' pieces, the centres of their bounding boxes, m.
            They are not rotated.
        friction: (R,) coefficients of friction of the pieces of bodies.
        restitution: (R,) coefficients of restitution of the pieces of bodies.
        city_grid: Grid of the layouts' pieces, and the layout of each world.
        bodies: Bodies that users add; their pieces are the last ones.
    """

    table: ShapeTable
    first_body: int
    first_piece: int
    ground: int
    place: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    other: np.ndarray
    piece_place: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    city_grid: CityGrid
    bodies: Bodies


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
        spin=np.zeros((num_worlds, count, 3)),
        other=np.array(others, dtype=np.int64),
        piece_place=place,
        friction=np.array([one.friction for one in obstacles], dtype=float),
        restitution=np.array([one.restitution for one in obstacles], dtype=float),
        city_grid=city_grid,
        bodies=_no_bodies(num_worlds),
    )


def _no_bodies(num_worlds: int) -> Bodies:
    """Make the table of no bodies."""
    vectors, turns = np.zeros((num_worlds, 0, 3)), np.zeros((num_worlds, 0, 4))
    return Bodies(
        position=vectors,
        quaternion=turns,
        velocity=vectors.copy(),
        spin=vectors.copy(),
        displacement=vectors.copy(),
        rotation=vectors.copy(),
        reach=np.zeros(0),
        owner=np.zeros(0, dtype=np.int64),
        offset=np.zeros((0, 3)),
        attitude=np.zeros((0, 4)),
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
    """Make a scenery with more pieces, which move with no entry of `Scenery.bodies`.

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
        spin=np.concatenate([scenery.spin, np.zeros(place.shape)], axis=1),
        other=np.append(scenery.other, np.full(count, other)),
        friction=np.append(scenery.friction, np.full(count, friction)),
        restitution=np.append(scenery.restitution, np.full(count, restitution)),
    )


def add_body(
    scenery: Scenery,
    pieces: Sequence[BodyPiece],
    position: np.ndarray,
    quaternion: np.ndarray,
    other: int,
    friction: float,
    restitution: float,
) -> Scenery:
    """Make a scenery with one more body, at rest.

    Args:
        scenery: The present scenery.
        pieces: The P pieces of the body.
        position: (W, 3) positions of the body, m; NOWHERE in worlds without it.
        quaternion: (W, 4) attitudes of the body, body to world.
        other: Index in `Contacts.other` of the body.
        friction: Coefficient of friction.
        restitution: Coefficient of restitution.

    Returns:
        The extended scenery.
    """
    count, worlds = len(pieces), len(position)
    scenery = add_pieces(
        scenery,
        [piece.shape for piece in pieces],
        place=np.full((worlds, count, 3), NOWHERE),
        quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (worlds, count, 1)),
        other=other,
        friction=friction,
        restitution=restitution,
    )
    known, still = scenery.bodies, np.zeros((worlds, 1, 3))
    b = len(known.reach)
    radii = scenery.table.radius[scenery.first_piece - count : scenery.first_piece]
    places = np.array([piece.place for piece in pieces]).reshape(-1, 3)
    turns = np.array([piece.quaternion for piece in pieces]).reshape(-1, 4)
    bodies = Bodies(
        position=np.concatenate([known.position, position[:, None]], axis=1),
        quaternion=np.concatenate([known.quaternion, quaternion[:, None]], axis=1),
        velocity=np.concatenate([known.velocity, still], axis=1),
        spin=np.concatenate([known.spin, still], axis=1),
        displacement=np.concatenate([known.displacement, still], axis=1),
        rotation=np.concatenate([known.rotation, still], axis=1),
        reach=np.append(known.reach, (np.linalg.norm(places, axis=1) + radii).max()),
        owner=np.append(known.owner, np.full(count, b)),
        offset=np.concatenate([known.offset, places]),
        attitude=np.concatenate([known.attitude, turns]),
    )
    scenery = scenery._replace(bodies=bodies)
    for w in range(worlds):
        place_body(scenery, w, b)
    return scenery


def place_body(scenery: Scenery, w: int, b: int) -> None:
    """Set the pieces of body b of world w to its pose, at rest."""
    bodies = scenery.bodies
    first = scenery.place.shape[1] - len(bodies.owner)
    here, turn = bodies.position[w, b], bodies.quaternion[w, b]
    for p in np.flatnonzero(bodies.owner == b).tolist():
        place = here
        if here[2] != NOWHERE:
            place = here + to_world(turn, bodies.offset[p])
        scenery.place[w, first + p] = place
        scenery.quaternion[w, first + p] = product(turn, bodies.attitude[p])
        scenery.velocity[w, first + p] = scenery.spin[w, first + p] = 0.0
