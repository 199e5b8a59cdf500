"""The bodies of a world, as the engine makes them: ground, drones, obstacles, and what stands in a city."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bulletuav.engine.calls import CITY_GROUP, DRONE_GROUP, RAYS, SIGHT_GROUP, SURFACE_GROUP, bullet
from bulletuav.engine.silence import silenced
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids, apart_groups, obj_lines
from bulletuav.vehicle.airframe import Airframe

FLOOR = 0.02  # m, thickness of the ground in pictures
FLOOR_COLOUR, CITY_COLOUR = (0.86, 0.88, 0.85, 1), (0.72, 0.70, 0.67, 1)
HULL_MARGIN = 1e-3  # m, by which the engine thickens hulls
COMPOUND = 256  # pieces: more take longer to look through for each drone, fewer make more bodies
MEETS = {SURFACE_GROUP: DRONE_GROUP | RAYS, CITY_GROUP: DRONE_GROUP, SIGHT_GROUP: RAYS}
MESH = 100_000  # corners of triangles; the engine takes 131,072 vertices
Body = int
Shape = int


def make_floor(client: int) -> Body:
    """The ground as pictures show it; it touches nothing."""
    floor = bullet.createVisualShape(
        bullet.GEOM_BOX,
        halfExtents=[1000, 1000, FLOOR / 2],
        rgbaColor=FLOOR_COLOUR,
        specularColor=[0, 0, 0],
        physicsClientId=client,
    )
    return bullet.createMultiBody(0, -1, floor, physicsClientId=client)


def make_ground(client: int) -> Body:
    """The plane z = 0, unseen."""
    collision = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
    return _still(client, collision, SURFACE_GROUP, make_speck(client))


def make_speck(client: int) -> Shape:
    """What cannot be seen: bodies without a visual are drawn by their collision shapes."""
    return bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=[1e-3] * 3, physicsClientId=client)


def _still(
    client: int, collision: Shape, group: int, visual: Shape, place: Iterable[float] = (0, 0, 0)
) -> Body:
    """A body that nothing moves."""
    body = bullet.createMultiBody(
        0, collision, visual, list(place), useMaximalCoordinates=1, physicsClientId=client
    )
    bullet.setCollisionFilterGroupMask(body, -1, group, MEETS[group], client)
    return body


def make_drone(client: int, airframe: Airframe, place: np.ndarray) -> Body:
    """One drone. Raises ValueError for a URDF that the engine cannot load."""
    flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_IMPLICIT_CYLINDER
    flags |= bullet.URDF_USE_MATERIAL_COLORS_FROM_MTL
    try:
        with silenced():
            body = bullet.loadURDF(
                str(airframe.urdf), place.tolist(), flags=flags, physicsClientId=client
            )
    except bullet.error as error:
        raise ValueError(f"{airframe.urdf}: the engine cannot load it: {error}") from None
    # Bullet damps velocities by 4 % a second and clamps them at 100 unless told otherwise; mass and inertia are ours, as
    # its own reading of the file may round or scale them.
    bullet.changeDynamics(
        body,
        -1,
        mass=airframe.mass,
        localInertiaDiagonal=airframe.inertia,
        linearDamping=0,
        angularDamping=0,
        maxJointVelocity=1e4,
        physicsClientId=client,
    )
    return body


def make_obstacles(
    client: int, obstacle: Obstacle, places: Iterable[Iterable[float]]
) -> list[Body]:
    """One obstacle for each world."""
    collision = bullet.createCollisionShape(**_shape(obstacle), physicsClientId=client)
    visual = bullet.createVisualShape(
        **_shape(obstacle), rgbaColor=obstacle.colour, physicsClientId=client
    )
    return [_still(client, collision, SURFACE_GROUP, visual, place) for place in places]


def _shape(obstacle: Obstacle) -> dict[str, object]:
    """The engine's words for an obstacle's shape."""
    if obstacle.kind == "box":
        return {"shapeType": bullet.GEOM_BOX, "halfExtents": [edge / 2 for edge in obstacle.size]}
    return {"shapeType": bullet.GEOM_SPHERE, "radius": obstacle.size[0]}


def make_city(
    client: int, solids: Solids, apart: float, places: Iterable[Iterable[float]]
) -> list[tuple[list[Body], list[Body]]]:
    """A city for each world: meshes that only rays meet, and compounds of convex pieces that drones touch.

    No two pieces of a compound are closer than `apart` m: a drone that touches two of them at once would be pushed in an
    order that depends on other worlds. The meshes are what makes rays fast; drones would pass through them.
    """
    speck = make_speck(client)
    meshes = [_sight(client, *mesh) for mesh in solids.meshes(MESH)]
    compounds = [_compound(client, solids, part) for part in _parts(solids.bounds, apart)]
    return [
        (
            [_still(client, mesh, SIGHT_GROUP, speck, place) for mesh in meshes],
            [_still(client, compound, CITY_GROUP, speck, place) for compound in compounds],
        )
        for place in places
    ]


def _sight(client: int, vertices: np.ndarray, triangles: np.ndarray) -> Shape:
    flags, corners = bullet.GEOM_FORCE_CONCAVE_TRIMESH, triangles.ravel().tolist()
    return bullet.createCollisionShape(
        bullet.GEOM_MESH,
        vertices=vertices.tolist(),
        indices=corners,
        flags=flags,
        physicsClientId=client,
    )


def _parts(bounds: np.ndarray, apart: float) -> list[np.ndarray]:
    """Which pieces go into one compound: those of a colour, at most COMPOUND that are near each other."""
    parts = []
    for group in apart_groups(bounds, apart):
        middle = bounds[group].mean(axis=1)
        strips = max(1, round((len(group) / COMPOUND) ** 0.5))
        strip = (
            np.argsort(np.argsort(middle[:, 0], kind="stable"), kind="stable")
            * strips
            // len(group)
        )
        order = group[np.lexsort((middle[:, 1], strip))]
        parts += np.array_split(order, -(-len(group) // COMPOUND))
    return parts


def _compound(client: int, solids: Solids, pieces: np.ndarray) -> Shape:
    """Convex pieces as one shape. It goes through a file: the engine's other ways take sixteen at most."""
    objects = []
    for p in pieces.tolist():
        corners, faces = solids.faces[p]
        if p < len(solids.boxes):  # the engine thickens it again
            inward = corners.mean(axis=0) - corners
            corners = corners + np.sign(inward) * np.minimum(HULL_MARGIN, np.abs(inward) / 2)
        objects.append((f"piece_{p}", corners, faces))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "pieces.obj")
        path.write_text("\n".join(obj_lines(objects)) + "\n")
        with silenced():
            return bullet.createCollisionShape(
                bullet.GEOM_MESH, fileName=str(path), physicsClientId=client
            )


def make_facades(client: int, solids: Solids) -> list[Body]:
    """A city as pictures show it; it touches nothing."""
    return [_facade(client, vertices[triangles]) for vertices, triangles in solids.meshes(MESH)]


def _facade(client: int, corner: np.ndarray) -> Body:
    """Triangles (T, 3, 3), each with its own corners, so that walls are flat."""
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    visual = bullet.createVisualShape(
        bullet.GEOM_MESH,
        vertices=corner.reshape(-1, 3).tolist(),
        indices=list(range(corner.shape[0] * 3)),
        normals=np.repeat(normal, 3, axis=0).tolist(),
        rgbaColor=CITY_COLOUR,
        specularColor=[0, 0, 0],
        physicsClientId=client,
    )
    return bullet.createMultiBody(0, -1, visual, physicsClientId=client)
