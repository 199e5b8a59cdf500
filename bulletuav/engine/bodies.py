"""Functions that create the bodies of an engine except drones: ground, obstacles and cities."""

import tempfile
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.engine.calls import CITY_GROUP, DRONE_GROUP, RAYS, SIGHT_GROUP, SURFACE_GROUP, bullet
from bulletuav.engine.silence import silenced
from bulletuav.geometry.shapes import BOX, CYLINDER, HULL, SPHERE, Shape
from bulletuav.geometry.solids import Solids, format_obj_lines, group_separated

FLOOR = 0.02
"""Thickness of the visual ground, m"""
FLOOR_HALF_EDGE = 20_000.0
"""Half the edge length of the visual ground, m"""
FLOOR_COLOUR = (0.86, 0.88, 0.85, 1)
LOAD_COLOUR = (0.72, 0.53, 0.30, 1)
CITY_COLOUR = (0.72, 0.70, 0.67, 1)
SIDES = 48
"""Number of sides of a visual cylinder"""
HULL_MARGIN = 1e-3
"""Thickness that Bullet adds to hulls, m"""
COMPOUND = 256
"""Maximum pieces of a compound: more pieces slow down the search, fewer pieces make more bodies"""
MEETS = {SURFACE_GROUP: DRONE_GROUP | RAYS, CITY_GROUP: DRONE_GROUP, SIGHT_GROUP: RAYS}
"""Collision groups that each group of static bodies collides with"""
MESH = 100_000
"""Maximum corners of the triangles of a mesh; Bullet takes at most 131,072 vertices"""
UNSEEN = 1e-3
"""Half the edge length of the visual of an invisible body, m"""
_HANDED = threading.local()
"""Lists that are passed to Bullet, and their rows, by name, for each thread"""

Body = int
"""Id of a body in Bullet"""
ShapeNumber = int
"""Id of a collision or visual shape in Bullet"""
Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, from 0 to 1"""
Pose = tuple[Iterable[float], Iterable[float]]
"""Position (3,), m, and quaternion (4,)"""


def make_floor(client: int) -> Body:
    """Create the visual ground, without a collision shape."""
    floor = bullet.createVisualShape(
        bullet.GEOM_BOX,
        halfExtents=[FLOOR_HALF_EDGE, FLOOR_HALF_EDGE, FLOOR / 2],
        rgbaColor=FLOOR_COLOUR,
        specularColor=[0, 0, 0],
        physicsClientId=client,
    )
    body: Body = bullet.createMultiBody(0, -1, floor, physicsClientId=client)
    return body


def make_ground(client: int) -> Body:
    """Create the invisible collision plane z = 0."""
    collision = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
    return _make_still(client, collision, SURFACE_GROUP, make_speck(client))


def make_speck(client: int) -> ShapeNumber:
    """Create an invisibly small visual shape: without one Bullet draws the collision shape."""
    speck: ShapeNumber = bullet.createVisualShape(
        bullet.GEOM_BOX,
        halfExtents=[UNSEEN] * 3,
        physicsClientId=client,
    )
    return speck


def _make_still(
    client: int,
    collision: ShapeNumber,
    group: int,
    visual: ShapeNumber,
    place: Iterable[float] = (0, 0, 0),
    quaternion: Iterable[float] = (0, 0, 0, 1),
) -> Body:
    """Create a static body."""
    body: Body = bullet.createMultiBody(
        0,
        collision,
        visual,
        list(place),
        list(quaternion),
        useMaximalCoordinates=1,
        physicsClientId=client,
    )
    bullet.setCollisionFilterGroupMask(body, -1, group, MEETS[group], client)
    return body


def make_solids(client: int, shape: Shape, colour: Colour, poses: Iterable[Pose]) -> list[Body]:
    """Create bodies of one shape that only `EngineCalls.pose` moves.

    Args:
        client: Id of the client in Bullet.
        shape: Sphere, cylinder, box or hull.
        colour: Red, green, blue and opacity, from 0 to 1.
        poses: Position (3,) in Bullet's frame, m, and quaternion (4,) of each.

    Returns:
        A body for each pose.
    """
    collision = _collision_shape(client, shape)
    visual = _visual_shape(client, shape, colour)
    return [_make_still(client, collision, SURFACE_GROUP, visual, *pose) for pose in poses]


def make_load_body(client: int, shape: Shape, mass: float, place: Iterable[float]) -> Body:
    """Create the body of a load at a position (3,) in Bullet's frame, m."""
    body: Body = bullet.createMultiBody(
        mass,
        _collision_shape(client, shape),
        _visual_shape(client, shape, LOAD_COLOUR),
        list(place),
        physicsClientId=client,
    )
    return body


def _collision_shape(client: int, shape: Shape) -> ShapeNumber:
    """Create a collision shape."""
    keywords: dict[str, object] = {"shapeType": bullet.GEOM_MESH, "vertices": shape.corners}
    if shape.kind == BOX:
        keywords = {"shapeType": bullet.GEOM_BOX, "halfExtents": list(shape.half)}
    elif shape.kind == SPHERE:
        keywords = {"shapeType": bullet.GEOM_SPHERE, "radius": shape.half[0]}
    elif shape.kind == CYLINDER:
        radius, _, half = shape.half
        size = {"radius": radius, "height": 2 * half}
        keywords = {"shapeType": bullet.GEOM_CYLINDER, **size}
    number: ShapeNumber = bullet.createCollisionShape(**keywords, physicsClientId=client)
    return number


def _visual_shape(client: int, shape: Shape, colour: Colour) -> ShapeNumber:
    """Create the visual of a shape."""
    if shape.kind == CYLINDER:
        # Bullet's renderer rounds the ends of cylinders.
        return _flat_visual(client, rims(shape, SIDES)[cylinder_triangles(SIDES)], colour)
    if shape.kind == HULL:
        corners, triangles = Solids(np.zeros((0, 2, 3)), (np.array(shape.corners),)).mesh
        return _flat_visual(client, corners[triangles], colour)
    keywords: dict[str, object] = {"shapeType": bullet.GEOM_BOX, "halfExtents": list(shape.half)}
    if shape.kind == SPHERE:
        keywords = {"shapeType": bullet.GEOM_SPHERE, "radius": shape.half[0]}
    number: ShapeNumber = bullet.createVisualShape(
        **keywords, rgbaColor=colour, physicsClientId=client
    )
    return number


def rims(cylinder: Shape, sides: int) -> np.ndarray:
    """Return points (2 sides, 3) on both rims of a cylinder, m."""
    radius, _, half = cylinder.half
    turn = 2 * np.pi * np.arange(sides) / sides
    across = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    both = [np.column_stack([across, np.full(sides, height)]) for height in (-half, half)]
    return np.concatenate(both)


def cylinder_triangles(sides: int) -> np.ndarray:
    """Return the triangles (T, 3) of a cylinder as indices of its `rims`, outside in front."""
    # Corners of the lower rim, the next corners, and both on the upper rim
    low = np.arange(sides)
    after = (low + 1) % sides
    high, beyond = low + sides, after + sides
    walls = [(low, after, beyond), (low, beyond, high)]
    # Caps are fans around the first corners
    fan = low[1:-1]
    caps = [(0 * fan, fan + 1, fan), (0 * fan + sides, fan + sides, fan + 1 + sides)]
    return np.concatenate([np.stack(three, axis=1) for three in (*walls, *caps)])


def make_city(
    client: int, solids: Solids, apart: float, places: Iterable[Iterable[float]]
) -> list[tuple[list[Body], list[Body]]]:
    """Create a city in each world: meshes for rays, and compounds that drones collide with.

    Meshes make rays fast, but drones would pass through them. Compounds of convex pieces are
    therefore created, too. No two pieces of a compound are near each other: the order in which a
    drone's contacts with two pieces are solved would depend on other worlds.

    Args:
        client: Id of the client in Bullet.
        solids: Pieces of the city.
        apart: Minimum distance of two pieces of a compound, m.
        places: (3,) origin of the city in each world, in Bullet's frame, m.

    Returns:
        Meshes and compounds for each place.
    """
    # The bodies of all worlds share their shapes.
    speck = make_speck(client)
    meshes = [_make_mesh(client, *mesh) for mesh in solids.meshes(MESH)]
    compounds = [_make_compound(client, solids, part) for part in _parts(solids.bounds, apart)]
    return [
        (
            [_make_still(client, mesh, SIGHT_GROUP, speck, place) for mesh in meshes],
            [_make_still(client, compound, CITY_GROUP, speck, place) for compound in compounds],
        )
        for place in places
    ]


def _handed(name: str, values: np.ndarray) -> list[Any]:
    """Write numbers into a list for Bullet, the same list in each call.

    PyBullet 3.2.7 never frees the lists of a mesh: new lists would be a memory leak.
    """
    kept: tuple[list[Any], list[Any]] = _HANDED.__dict__.setdefault(name, ([], []))
    handed, rows = kept
    numbers = values.tolist()
    if values.ndim > 1:
        rows.extend([] for _ in range(len(numbers) - len(rows)))
        for row, one in zip(rows, numbers, strict=False):
            row[:] = one
        numbers = rows[: len(numbers)]
    handed[:] = numbers
    return handed


def _make_mesh(client: int, vertices: np.ndarray, triangles: np.ndarray) -> ShapeNumber:
    """Create a collision shape from triangles (T, 3) of vertices (V, 3), m."""
    mesh: ShapeNumber = bullet.createCollisionShape(
        bullet.GEOM_MESH,
        vertices=_handed("vertices", vertices),
        indices=_handed("indices", triangles.ravel()),
        flags=bullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    return mesh


def _parts(bounds: np.ndarray, apart: float) -> list[np.ndarray]:
    """Group the pieces into compounds of at most `COMPOUND` pieces of one neighbourhood.

    Args:
        bounds: (P, 2, 3) low and high corner of each piece, m.
        apart: Minimum distance of two pieces of a compound, m.

    Returns:
        Indices of the pieces of each compound.
    """
    parts: list[np.ndarray] = []
    for group in group_separated(bounds, apart):
        # Strips from west to east with equal numbers of pieces, sorted from south to north.
        middle = bounds[group].mean(axis=1)
        strips = max(1, round((len(group) / COMPOUND) ** 0.5))
        rank = np.argsort(np.argsort(middle[:, 0], kind="stable"), kind="stable")
        strip = rank * strips // len(group)
        order = group[np.lexsort((middle[:, 1], strip))]
        parts += np.array_split(order, -(-len(group) // COMPOUND))
    return parts


def _make_compound(client: int, solids: Solids, pieces: np.ndarray) -> ShapeNumber:
    """Create one collision shape of convex pieces.

    The pieces are loaded from a file, as Bullet's other functions take at most sixteen pieces.
    """
    objects = []
    for p in pieces.tolist():
        corners, faces = solids.faces[p]
        # Shrink boxes by the margin that Bullet adds.
        if p < len(solids.boxes):
            inward = corners.mean(axis=0) - corners
            corners = corners + np.sign(inward) * np.minimum(HULL_MARGIN, np.abs(inward) / 2)
        objects.append((f"piece_{p}", corners, faces))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "pieces.obj")
        path.write_text("\n".join(format_obj_lines(objects)) + "\n", encoding="utf-8")
        with silenced():
            compound: ShapeNumber = bullet.createCollisionShape(
                bullet.GEOM_MESH,
                fileName=str(path),
                physicsClientId=client,
            )
    return compound


def make_facades(client: int, solids: Solids) -> list[Body]:
    """Create the visual bodies of a city, without collision shapes."""
    return [
        _make_facade(client, vertices[triangles], colour)
        for part, colour in _split_by_colour(solids)
        for vertices, triangles in part.meshes(MESH)
    ]


def _split_by_colour(solids: Solids) -> list[tuple[Solids, Colour]]:
    """Return the pieces of each colour."""
    if solids.colours is None:
        return [(solids, CITY_COLOUR)]
    parts = []
    first = len(solids.boxes)
    for colour in np.unique(solids.colours, axis=0):
        is_own = (solids.colours == colour).all(axis=1)
        hulls = zip(solids.hulls, is_own[first:].tolist(), strict=True)
        part = Solids(solids.boxes[is_own[:first]], tuple(hull for hull, own in hulls if own))
        red, green, blue = (colour / 255).tolist()
        parts.append((part, (red, green, blue, 1.0)))
    return parts


def _make_facade(client: int, corner: np.ndarray, colour: Colour) -> Body:
    """Create a visual body of triangles (T, 3, 3)."""
    visual = _flat_visual(client, corner, colour)
    facade: Body = bullet.createMultiBody(0, -1, visual, physicsClientId=client)
    return facade


def _flat_visual(client: int, corner: np.ndarray, colour: Colour) -> ShapeNumber:
    """Create a visual of triangles (T, 3, 3) that share no vertices, for flat shading."""
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    visual: ShapeNumber = bullet.createVisualShape(
        bullet.GEOM_MESH,
        vertices=_handed("vertices", corner.reshape(-1, 3)),
        indices=_handed("indices", np.arange(corner.shape[0] * 3)),
        normals=_handed("normals", np.repeat(normal, 3, axis=0)),
        rgbaColor=colour,
        specularColor=[0, 0, 0],
        physicsClientId=client,
    )
    return visual
