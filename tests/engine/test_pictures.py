"""Pictures of the rasteriser are those of a ray through each pixel."""

import itertools
import threading

import numpy as np
import pytest
import sensing
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.engine.engine import Engine
from bulletuav.engine.pictures import Look
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.raster import MAX_FLOW, Cameras, Earlier, Images, make_pixel_rays
from bulletuav.geometry.rotation import axes, from_euler, to_world
from bulletuav.geometry.shapes import HULL
from bulletuav.geometry.solids import Solids, box_corners
from bulletuav.geometry.view import BUILDING, DRONE, FAR, LAND, OBSTACLE, SKY
from bulletuav.geometry.view_blocks import make_faces
from bulletuav.vehicle.swarm import Swarm

LENS = make_pixel_rays(48, 36)
SHIFT = 1e-9
"""Change of a ray's direction next to the ray, for rays that go exactly through an edge"""
TETRAHEDRON = [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 6.0)]
WALLS = np.array(
    [
        [(20.0, -5.0, 0.0), (40.0, 5.0, 60.0)],
        [(60.0, 5.0, 0.0), (80.0, 25.0, 20.0)],
        [(-40.0, -5.0, 0.0), (-20.0, 5.0, 10.0)],
        # Coplanar with the first
        [(20.0, 5.0, 0.0), (30.0, 12.0, 60.0)],
    ]
)


def blank(pictures, lens=LENS, depth=True, labels=True, colours=True, normals=True, flow=True):
    """Pictures to be drawn."""
    size = (len(lens.y), len(lens.x))
    return Images(
        np.zeros((pictures * depth, *size), dtype=np.float32),
        np.zeros((pictures * labels, *size), dtype=np.uint8),
        np.zeros((pictures * colours, *size, 3), dtype=np.uint8),
        np.zeros((pictures * normals, *size, 3), dtype=np.float32),
        np.zeros((pictures * flow, *size, 2), dtype=np.float32),
    )


def cameras_of(world, eye, quaternion, drone=None):
    world = np.array(world)
    drone = np.full(len(world), -1) if drone is None else np.array(drone)
    eye, quaternion = np.array(eye, dtype=float), np.array(quaternion, dtype=float)
    tangent = np.ones(len(world))
    return Cameras(world, drone, eye, quaternion, tangent, np.arange(len(world)))


def draw(engine, cameras, drones=None, lens=LENS):
    images = blank(len(cameras.world), lens)
    engine.pictures(cameras, images, drones)
    return images


def cast(engine, cameras, camera, x, y, drones=None):
    """Depths of the rays of cameras (M,) in directions (M,), float64."""
    frames = np.array([np.stack(axes(one)) for one in cameras.quaternion])[camera]
    ahead, left, up = frames[:, 0], frames[:, 1], frames[:, 2]
    change = FAR * (ahead + x[:, None] * left + y[:, None] * up)
    start = cameras.eye[camera]
    fraction = np.ones(len(camera))
    kinds = np.stack([cameras.world, cameras.drone], axis=1)[camera]
    for w, i in np.unique(kinds, axis=0).tolist():
        chosen = (kinds == (w, i)).all(axis=1)
        shown = None
        if drones is not None:
            swarm, mask = drones
            mask = mask.copy()
            mask[w, i] &= i < 0
            shown = (swarm, mask)
        world = np.full(chosen.sum(), w)
        ends = start[chosen] + change[chosen]
        fraction[chosen] = engine.cast_rays(start[chosen], ends, world, shown)
    return FAR * fraction


def compare(engine, cameras, drones=None, lens=LENS):
    """Compare pictures to rays; return the number of rays exactly through edges, and the pictures.

    All other depths are equal to the bit. A ray through an edge has a neighbour within `SHIFT` with
    the depth of the picture.
    """
    images = draw(engine, cameras, drones, lens)
    camera, row, column = (one.ravel() for one in np.indices(images.depth.shape))
    x, y = lens.x[column], lens.y[row]
    depth = cast(engine, cameras, camera, x, y, drones).astype(np.float32)
    differs = np.flatnonzero(depth != images.depth.ravel())
    drawn = images.depth.ravel()[differs].astype(float)
    is_near = np.abs(depth[differs] - drawn) <= 1e-6 * drawn
    for dx, dy in itertools.product((-SHIFT, 0, SHIFT), repeat=2):
        near = (x[differs] + dx, y[differs] + dy)
        beside = cast(engine, cameras, camera[differs], *near, drones)
        is_near |= np.abs(beside - drawn) <= 1e-5 * drawn
    wrong = differs[~is_near]
    seen = (camera, row, column, images.depth.ravel(), depth)
    assert not len(wrong), np.column_stack([one[wrong] for one in seen])[:5]
    return len(differs), images


def prisms_of(boxes, rng):
    """Prisms with 5 to 8 corners in plan inside boxes."""
    hulls = []
    for low, high in boxes:
        corners = rng.integers(5, 9)
        angle = 2 * np.pi * np.arange(corners) / corners + rng.uniform(-0.2, 0.2, corners)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        plan = (low + high)[:2] / 2 + circle * (high - low)[:2] / 2
        ends = [np.column_stack([plan, np.full(corners, z)]) for z in (low[2], high[2])]
        hulls.append(np.concatenate(ends))
    return tuple(hulls)


def random_engine(rng, num_worlds=3, num_drones=4):
    """Worlds in different layouts, with obstacles and bodies of all kinds in any pose."""
    layouts = []
    for style, has_prisms in (("dense", False), ("suburban", True), ("dense", True)):
        boxes = generate(style, rng.uniform(150, 400), rng, rng.uniform(0, 0.5)).solids.boxes
        count = len(boxes) // 2 if has_prisms else 0
        layouts.append(Solids(boxes[count:], prisms_of(boxes[:count], rng)))
    obstacles = (
        Obstacle("sphere", (2.0,)),
        Obstacle("cylinder", (1.0, 12.0)),
        Obstacle("box", (4.0, 3.0, 10.0)),
    )
    airframes = [bulletuav.load_airframe("hummingbird")] * num_drones
    engine = Engine(airframes, num_worlds, 1 / 240, obstacles, layouts)
    every = np.ones(num_worlds, dtype=bool)
    layout = rng.integers(-1, len(layouts), num_worlds)
    layout[0] = 0
    engine.set_layouts(layout, every)
    engine.add_body(TETRAHEDRON, (5.0, 5.0, 0.0), world=0)
    place_obstacles(engine, rng)
    return engine


def place_obstacles(engine, rng):
    num_worlds = engine.shape[0]
    place = rng.uniform((-30, -30, 0), (30, 30, 20), (num_worlds, 3, 3))
    angles = rng.uniform(-1, 1, (num_worlds * 3, 3))
    turn = np.array([from_euler(*one) for one in angles]).reshape(num_worlds, 3, 4)
    engine.set_obstacles(place, turn, np.ones(num_worlds, dtype=bool))


def random_drones(engine, rng):
    num_worlds, num_drones = engine.shape
    swarm = Swarm.zeros(num_worlds, num_drones, 4)
    swarm.position[:] = rng.uniform((-40, -40, 0.5), (40, 40, 30), swarm.position.shape)
    swarm.position[:, 1] = swarm.position[:, 0] + rng.normal(size=(num_worlds, 3))
    for w, i in np.ndindex(num_worlds, num_drones):
        swarm.quaternion[w, i] = from_euler(*rng.uniform((-3, -1.5, -3), (3, 1.5, 3)))
    return swarm, rng.random((num_worlds, num_drones)) < 0.8


def hostile_cameras(engine, swarm, rng):
    """Two cameras on each drone: ahead, straight down, along axes, inside pieces, in the ground."""
    world, drone = (np.tile(one.ravel(), 2) for one in np.indices(engine.shape))
    eye = swarm.position[world, drone] + rng.normal(size=(len(world), 3)) * 0.2
    quaternion = swarm.quaternion[world, drone].copy()
    grid = engine.city_grid
    for c in range(len(world)):
        quarter = np.pi / 2 * rng.integers(4)
        if c % 8 == 1:
            quaternion[c] = from_euler(0.0, np.pi / 2 * rng.integers(-1, 2), quarter)
        elif c % 8 == 2:
            quaternion[c] = from_euler(0.0, 0.0, quarter / 2)
        elif c % 8 == 3:
            p = rng.integers(len(grid.low))
            eye[c] = (grid.low[p] + grid.high[p]) / 2
        elif c % 8 == 4:
            eye[c, 2] = 0.0
        elif c % 8 == 5:
            eye[c, 2] = rng.uniform(200, 1500)
            quaternion[c] = from_euler(0.0, np.pi / 2 - 0.05 * rng.normal(), 1.0)
        elif c % 8 == 6:
            p = rng.integers(len(grid.low))
            eye[c] = rng.uniform(grid.low[p], grid.high[p])
            eye[c, rng.integers(3)] = grid.high[p, rng.integers(3)]
        elif c % 8 == 7:
            eye[c, 2] = -rng.uniform(0, 5)
    return cameras_of(world, eye, quaternion, drone)


@pytest.mark.parametrize("seed", range(6))
def test_pictures_of_random_worlds_are_those_of_rays(seed):
    rng = np.random.default_rng(seed)
    engine = random_engine(rng)
    edges = pixels = 0
    for _ in range(3):
        drones = random_drones(engine, rng)
        cameras = hostile_cameras(engine, drones[0], rng)
        through_edges, images = compare(engine, cameras, drones)
        edges += through_edges
        pixels += images.depth.size
        place_obstacles(engine, rng)
    assert edges <= 2e-4 * pixels
    engine.close()


def test_eyes_in_the_planes_of_walls_and_roofs():
    """Every edge passes exactly through pixels, and some planes through the eye."""
    hulls = prisms_of(WALLS[1:3], np.random.default_rng(3))
    edges = pixels = 0
    for solids in (Solids(WALLS), Solids(WALLS[[0, 3]], hulls)):
        engine = sensing.open_world((solids,))
        grid = engine.city_grid
        coordinates = [np.unique(np.concatenate([grid.low[:, k], grid.high[:, k]])) for k in (0, 1)]
        eyes = [
            (x, y, z)
            for x, y in itertools.product((0.0, *coordinates[0]), (-30.0, *coordinates[1]))
            for z in (5.0, 20.0, 60.0)
        ]
        turns = [from_euler(0.0, 0.0, k * np.pi / 2) for k in range(4)]
        turns += [from_euler(0.3, -0.5, 2.0), from_euler(0.0, np.pi / 2, 0.0)]
        pairs = list(itertools.product(eyes, turns))
        eye, quaternion = zip(*pairs, strict=True)
        cameras = cameras_of([0] * len(pairs), eye, quaternion)
        through_edges, images = compare(engine, cameras, lens=make_pixel_rays(24, 18))
        edges += through_edges
        pixels += images.depth.size
        engine.close()
    assert edges <= 4e-3 * pixels


def test_eyes_in_the_planes_of_hulls():
    """Faces of a turned tetrahedron, in whose planes the eye lies up to rounding."""
    rng = np.random.default_rng(0)
    engine = sensing.open_world()
    turn = from_euler(0.4, 0.2, 1.0)
    engine.add_body(TETRAHEDRON, (0.0, 0.0, 60.0), turn)
    corners = np.array([to_world(turn, one) for one in TETRAHEDRON]) + [0.0, 0.0, 60.0]
    eyes, turns = [], []
    for a, b, c in itertools.combinations(corners, 3):
        for _ in range(4):
            one, two = rng.uniform((1.5, 0.5), (3.0, 2.0))
            eyes.append(a + one * (b - a) + two * (c - a))
            to_middle = corners.mean(axis=0) - eyes[-1]
            rise = np.arctan2(to_middle[2], np.hypot(*to_middle[:2]))
            turns.append(from_euler(0.2, -rise, np.arctan2(to_middle[1], to_middle[0])))
    cameras = cameras_of([0] * len(eyes), eyes, turns)
    edges, images = compare(engine, cameras)
    assert (images.labels == OBSTACLE).any(axis=(1, 2)).all()
    assert edges <= 1e-3 * images.depth.size
    engine.close()


def test_labels_are_those_of_the_nearest_surface():
    """Rays in engines that have only some of the bodies find the nearest."""
    rng = np.random.default_rng(8)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    cameras = hostile_cameras(engine, drones[0], rng)
    images = draw(engine, cameras, drones)
    camera, row, column = (one.ravel() for one in np.indices(images.depth.shape))
    rays = (cameras, camera, LENS.x[column], LENS.y[row])
    ground = cast(Engine([bulletuav.load_airframe("cf2x")], 3, 1 / 240), *rays)
    without_drones = cast(engine, *rays)
    layout = engine.city_grid.layout.copy()
    engine.set_layouts(np.full(3, -1), np.ones(3, dtype=bool))
    without_city = cast(engine, *rays)
    engine.set_layouts(layout, np.ones(3, dtype=bool))
    depth = cast(engine, *rays, drones)
    label = np.where(depth == FAR, SKY, LAND)
    label[(depth < ground)] = BUILDING
    label[(without_city == depth) & (without_city < ground)] = OBSTACLE
    label[depth < without_drones] = DRONE
    # Surfaces at the same depth: any of them
    is_tie = (without_city == depth) & (images.labels.ravel() == BUILDING)
    is_edge = images.depth.ravel() != depth.astype(np.float32)
    chosen = ~is_tie & ~is_edge
    assert chosen.mean() > 0.99
    assert (images.labels.ravel() == label)[chosen].all()
    assert set(np.unique(label)) == {SKY, LAND, BUILDING, OBSTACLE, DRONE}
    engine.close()


def test_pictures_do_not_depend_on_the_batch():
    """One by one, all together, in reverse, in other rows, and only some of the images."""
    rng = np.random.default_rng(4)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    cameras = hostile_cameras(engine, drones[0], rng)
    whole = draw(engine, cameras, drones)
    count = len(cameras.world)
    for c in range(count):
        one = cameras._replace(**{k: v[c : c + 1] for k, v in cameras._asdict().items()})
        single = blank(1)
        engine.pictures(one._replace(slot=np.array([0])), single, drones)
        for mine, theirs in zip(single, whole, strict=True):
            np.testing.assert_array_equal(mine[0], theirs[c])
    backward = blank(count)
    engine.pictures(cameras._replace(slot=np.arange(count)[::-1].copy()), backward, drones)
    for mine, theirs in zip(backward, whole, strict=True):
        np.testing.assert_array_equal(mine[::-1], theirs)
    for k, name in enumerate(Images._fields):
        few = blank(count, **{other: other == name for other in Images._fields})
        engine.pictures(cameras, few, drones)
        np.testing.assert_array_equal(few[k], whole[k])
    engine.close()


def test_each_camera_has_its_field_of_view():
    """Narrow and wide pictures of one batch are those of rays at these angles."""
    rng = np.random.default_rng(6)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    cameras = hostile_cameras(engine, drones[0], rng)
    tangents = (0.2, 1.0, 3.0)
    mixed = cameras._replace(tangent=np.resize(tangents, len(cameras.world)))
    images = draw(engine, mixed, drones)
    for k, tangent in enumerate(tangents):
        same = cameras._replace(tangent=np.full(len(cameras.world), tangent))
        _, expected = compare(engine, same, drones, make_pixel_rays(48, 36, tangent))
        np.testing.assert_array_equal(images.depth[k::3], expected.depth[k::3])
    engine.close()


def test_threads_do_not_disturb_each_other():
    rng = np.random.default_rng(5)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    cameras = hostile_cameras(engine, drones[0], rng)
    expected = draw(engine, cameras, drones)
    found = []

    def work():
        for _ in range(5):
            found.append(draw(engine, cameras, drones).depth)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(found) == 20
    assert all((one == expected.depth).all() for one in found)
    engine.close()


def test_coplanar_faces_show_the_lower_id_from_either_side():
    """Of two buildings with one wall plane, and of a building that repeats another."""
    twice = Solids(np.concatenate([WALLS[:1], WALLS[:1]]))
    once = Solids(WALLS[:1])
    turns = [from_euler(0.0, 0.0, 0.3), from_euler(0.5, 0.1, -0.2)]
    cameras = cameras_of([0, 0], [(0.0, 0.0, 30.0), (0.0, 3.0, 20.0)], turns)
    pictures = []
    for solids in (once, twice):
        engine = sensing.open_world((solids,))
        pictures.append(draw(engine, cameras).colours)
        engine.close()
    np.testing.assert_array_equal(*pictures)


def test_the_own_drone_is_not_shown():
    engine = sensing.open_world(drones=2)
    swarm = sensing.swarm_of(1, 2, [[(0.0, 0.0, 10.0), (1.0, 0.0, 10.0)]])
    eye = [(-2.0, 0.0, 10.0)] * 2
    cameras = cameras_of([0, 0], eye, [sensing.LEVEL] * 2, [0, -1])
    images = draw(engine, cameras, (swarm, np.ones((1, 2), dtype=bool)))
    middle = images.depth[:, len(LENS.y) // 2 - 1, len(LENS.x) // 2]
    assert middle[0] > middle[1] + 0.9
    masked = draw(engine, cameras, (swarm, np.array([[False, True]])))
    np.testing.assert_array_equal(masked.depth[0], masked.depth[1])
    engine.close()


def test_an_eye_that_is_not_finite_does_no_harm():
    engine = sensing.open_world((Solids(WALLS),))
    for eye in ((np.nan, 0.0, 1.0), (np.inf, 0.0, 1.0), (1e300, -1e300, 1e300)):
        draw(engine, cameras_of([0], [eye], [sensing.LEVEL]))
    engine.close()


def test_a_new_body_is_shown():
    engine = sensing.open_world()
    cameras = cameras_of([0], [(-10.0, 0.5, 2.0)], [sensing.LEVEL])
    before = draw(engine, cameras)
    engine.add_body(TETRAHEDRON, (0.0, 0.0, 0.0))
    after = draw(engine, cameras)
    assert OBSTACLE not in before.labels
    assert (after.labels == OBSTACLE).sum() > 50
    engine.close()


def test_edges_join_the_two_faces_that_share_their_corners():
    """Of prisms, a tetrahedron, and a box as a hull: each pair of faces with two common corners."""
    hulls = prisms_of(WALLS[:3], np.random.default_rng(1))
    engine = sensing.open_world((Solids(WALLS[:1], (*hulls, box_corners(WALLS[0]))),))
    engine.add_body(TETRAHEDRON, (0.0, 0.0, 0.0))
    table, faces = engine.scenery.table, make_faces(engine.scenery)
    for s in np.flatnonzero(table.kind == HULL):
        planes = range(*table.face_range[s])
        corners = {
            f: set(table.face_vertices[slice(*table.face_vertex_range[f])].tolist()) for f in planes
        }
        pairs = itertools.combinations(planes, 2)
        expected = {(f, g) for f, g in pairs if len(corners[f] & corners[g]) == 2}
        found = faces.edges[slice(*faces.edge_range[s])]
        assert {tuple(sorted(edge)) for edge in found.tolist()} == expected
        assert len(found) == len(expected)
    assert (np.diff(faces.edge_range)[table.kind != HULL] == 0).all()
    engine.close()


def test_a_hull_without_a_closed_surface_is_drawn_by_rays():
    rng = np.random.default_rng(9)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    cameras = hostile_cameras(engine, drones[0], rng)
    expected = draw(engine, cameras, drones)
    table = engine.scenery.table
    # The first face of each hull has its first corner twice
    first, end = table.face_vertex_range[table.face_range[table.kind == HULL, 0]].T
    table.face_vertices[end - 1] = table.face_vertices[first]
    engine._picture_maker._set_faces(engine.scenery)
    assert (np.diff(engine._picture_maker._faces.edge_range) == 0).all()
    np.testing.assert_array_equal(draw(engine, cameras, drones).depth, expected.depth)
    engine.close()


def test_normals_are_the_gradients_of_inverse_depths():
    """For a plane, 1/depth is n (1, x, y) up to a factor: in pixels away from edges."""
    rng = np.random.default_rng(11)
    engine = random_engine(rng)
    drones = random_drones(engine, rng)
    # Above all roofs, as normals within solids are those of any face
    eye = rng.uniform((-40, -40, 70), (40, 40, 100), (40, 3))
    angles = rng.uniform((-0.5, 0.2, -3), (0.5, 1.4, 3), (40, 3))
    world = rng.integers(0, 2, 40)
    # Around a tilted box and a tilted tetrahedron in a world without buildings
    engine.set_layouts(np.full(3, -1), np.array([False, False, True]))
    engine.set_obstacles(
        np.array([[(80.0, 0.0, 5.0), (80.0, 20.0, 5.0), (0.0, 80.0, 12.0)]] * 3),
        np.array([[sensing.LEVEL, sensing.LEVEL, from_euler(0.4, -0.3, 1.0)]] * 3),
        np.array([False, False, True]),
    )
    engine.add_body(TETRAHEDRON, (0.0, 120.0, 12.0), from_euler(0.3, 0.5, 2.0), world=2)
    yaw = rng.uniform(-3, 3, 40)
    target = np.array([(0.0, 80.0, 12.0), (0.0, 120.0, 12.0)] * 20)
    away = np.stack([np.cos(yaw), np.sin(yaw), np.full(40, 0.3)], axis=1)
    eye = np.concatenate([eye, target - 14 * away * (1, 1, -1)])
    angles = np.concatenate([angles, np.stack([angles[:, 0], np.full(40, 0.3), yaw], axis=1)])
    turns = [from_euler(*one) for one in angles.tolist()]
    cameras = cameras_of(np.concatenate([world, np.full(40, 2)]), eye, turns)
    images = draw(engine, cameras, drones)
    inverse = 1.0 / images.depth.astype(float)
    across, down = inverse[:, 1:-1, 2:], inverse[:, 2:, 1:-1]
    left, above = inverse[:, 1:-1, :-2], inverse[:, :-2, 1:-1]
    here = inverse[:, 1:-1, 1:-1]
    bend = np.maximum(np.abs(across + left - 2 * here), np.abs(down + above - 2 * here))
    b = (across - left) / (LENS.x[2:] - LENS.x[:-2])
    c = (down - above) / (LENS.y[2:] - LENS.y[:-2])[:, None]
    a = here - b * LENS.x[1:-1] - c * LENS.y[1:-1, None]
    # Normals of what is seen point to the camera
    expected = -np.stack([a, b, c], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    normals = images.normals[:, 1:-1, 1:-1]
    labels = images.labels[:, 1:-1, 1:-1]
    chosen = (bend < 1e-6 * here) & (labels != SKY)
    assert chosen.mean() > 0.3
    for label in (LAND, BUILDING, OBSTACLE):
        assert (chosen & (labels == label)).sum() > 1000
    cosine = (normals * expected).sum(axis=-1)[chosen]
    assert (cosine > 0.999).mean() > 0.999
    assert (images.normals[images.labels == SKY] == 0.0).all()
    length = np.linalg.norm(images.normals, axis=-1)[images.labels != SKY]
    np.testing.assert_allclose(length, 1.0, rtol=1e-6)
    engine.close()


def test_normals_of_round_shapes_and_walls():
    """A ball, a tilted cylinder with its cap, a wall and the ground, each in known places."""
    obstacles = (Obstacle("sphere", (2.0,)), Obstacle("cylinder", (1.0, 4.0)))
    engine = sensing.open_world((Solids(WALLS[:1]),), obstacles=obstacles)
    turn = from_euler(0.0, -1.2, 0.4)
    place = np.array([(10.0, 4.0, 10.0), (10.0, -4.0, 10.0)])
    attitude = np.array([sensing.LEVEL, turn])
    engine.set_obstacles(place[None], attitude[None], np.ones(1, dtype=bool))
    camera = from_euler(0.1, 0.05, 0.02)
    eye = np.array([0.0, 0.0, 10.0])
    images = draw(engine, cameras_of([0], [eye], [camera]))
    depth, labels = images.depth[0].astype(float), images.labels[0]
    frame = np.array(axes(camera))
    rays = np.stack(np.broadcast_arrays(1.0, LENS.x, LENS.y[:, None]), axis=-1)
    points = eye + depth[..., None] * rays @ frame
    normals = images.normals[0] @ frame
    for label, normal in ((LAND, (0.0, 0.0, 1.0)), (BUILDING, (-1.0, 0.0, 0.0))):
        shown = normals[labels == label]
        assert len(shown) > 100
        np.testing.assert_allclose(shown, np.broadcast_to(normal, shown.shape), atol=1e-6)
    ball = (labels == OBSTACLE) & (points[..., 1] > 0)
    assert ball.sum() > 20
    assert normals[ball] == pytest.approx((points[ball] - place[0]) / 2.0, abs=1e-4)
    tube = (labels == OBSTACLE) & (points[..., 1] < 0)
    local = (points[tube] - place[1]) @ np.array(axes(turn)).T
    mine = normals[tube] @ np.array(axes(turn)).T
    is_cap = np.hypot(local[:, 0], local[:, 1]) < 1.0 - 1e-4
    assert 3 < is_cap.sum() < tube.sum() - 10
    assert np.abs(local[is_cap, 2]) == pytest.approx(2.0, abs=1e-4)
    assert mine[is_cap] == pytest.approx(
        np.sign(local[is_cap, 2])[:, None] * np.array([0.0, 0.0, 1.0]), abs=1e-5
    )
    side = local[~is_cap] * [1.0, 1.0, 0.0]
    assert mine[~is_cap] == pytest.approx(side, abs=1e-3)
    engine.close()


def scene_of_walls(worlds=1):
    """An engine with walls, and a camera in each world before a wall."""
    engine = sensing.open_world((Solids(WALLS),), worlds)
    count = list(range(worlds))
    turn = from_euler(0.05, 0.02, 0.2)
    return engine, cameras_of(count, [(0.0, -3.0, 12.0)] * worlds, [turn] * worlds)


def test_a_look_changes_the_colours_of_its_world_only():
    engine, cameras = scene_of_walls(worlds=3)
    before = draw(engine, cameras)
    engine.set_look(1, Look())
    engine.set_look(1, Look(1.0, 5))
    after = draw(engine, cameras)
    for world in (0, 2):
        np.testing.assert_array_equal(after.colours[world], before.colours[world])
    for one, other in zip(after, before, strict=True):
        if one is not after.colours:
            np.testing.assert_array_equal(one, other)
    for label in (SKY, LAND, BUILDING):
        shown = after.labels[1] == label
        assert (after.colours[1][shown] != before.colours[1][shown]).any(axis=1).mean() > 0.9
    engine.set_look(2, Look(1.0, 5))
    engine.set_look(0, Look(1.0, 6))
    again = draw(engine, cameras)
    np.testing.assert_array_equal(again.colours[2], after.colours[1])
    assert (again.colours[0] != after.colours[1]).mean() > 0.8
    for world in range(3):
        engine.set_look(world, Look())
    np.testing.assert_array_equal(draw(engine, cameras).colours, before.colours)
    # Weak looks are near the default
    engine.set_look(0, Look(0.1, 5))
    error = draw(engine, cameras).colours[0].astype(float) - before.colours[0]
    assert 0 < np.abs(error).mean() < 30
    engine.close()


def test_windows_are_where_coordinates_on_walls_say():
    engine, cameras = scene_of_walls()
    engine.set_look(0, Look(1.0, 3))
    images = draw(engine, cameras)
    across, up, fraction, lit = engine._picture_maker._paint.windows[0]
    assert lit != 0.0
    frame = np.array(axes(cameras.quaternion[0]))
    rays = np.stack(np.broadcast_arrays(1.0, LENS.x, LENS.y[:, None]), axis=-1)
    points = cameras.eye[0] + images.depth[0].astype(float)[..., None] * rays @ frame
    normals = images.normals[0] @ frame
    # The wall at x = 20 from y = -5 to 5
    wall = (images.labels[0] == BUILDING) & (normals[..., 0] < -0.99) & (points[..., 1] < 4.999)
    y, z = points[wall][:, 1], points[wall][:, 2]
    part = np.stack([(-y / across) % 1.0, (z / up) % 1.0])
    clear = (np.abs(part - fraction) > 1e-4).all(axis=0) & (part > 1e-4).all(axis=0)
    is_window = (part < fraction).all(axis=0)
    colours = images.colours[0][wall][clear].astype(int)
    kinds = [np.unique(colours[is_window[clear] == one], axis=0) for one in (False, True)]
    assert [len(one) for one in kinds] == [1, 1]
    expected = np.clip(kinds[0][0] + lit, 0, 255)
    assert np.abs(kinds[1][0] - expected).max() <= 1
    assert 0.05 < is_window.mean() < 0.7
    engine.close()


def test_flow_is_the_motion_of_projected_points():
    """Of walls, ground and sky, of a ball that rolls, and of another drone, by SciPy's rotations.

    Two cameras move and turn in different ways; one has a narrow field of view.
    """
    engine = sensing.open_world((Solids(WALLS),), drones=2, obstacles=(Obstacle("sphere", (2.0,)),))
    rng = np.random.default_rng(2)

    def random_turns(count):
        return Rotation.from_euler("ZYX", rng.uniform(-0.2, 0.2, (count, 3)))

    # Positions and attitudes of the cameras, the ball and the drones: earlier, and now
    eye = np.array([(0.0, -3.0, 12.0), (-3.0, 1.0, 10.0)])
    ball, drone = np.array([(15.0, -4.0, 11.0)]), np.array([(0.0, 90.0, 9.0), (6.0, 0.5, 11.0)])
    places = [(one + rng.normal(size=one.shape) * 0.3, one) for one in (eye, ball, drone)]
    turns = [(random_turns(len(one)), random_turns(len(one))) for one in (eye, ball, drone)]
    states = [[(a[k], b[k].as_quat()) for a, b in zip(places, turns, strict=True)] for k in (0, 1)]
    before, now = states
    engine.set_obstacles(*(one[None] for one in now[1]), np.ones(1, dtype=bool))
    swarm = sensing.swarm_of(1, 2, now[2][0], quaternion=now[2][1])
    cameras = cameras_of([0, 0], *now[0])._replace(tangent=np.array([1.0, 0.6]))
    earlier = Earlier(
        *before[0], tuple(one[None] for one in before[2]), tuple(one[None] for one in before[1])
    )
    images = blank(2)
    engine.pictures(cameras, images, (swarm, np.ones((1, 2), dtype=bool)), earlier)
    assert set(np.unique(images.labels)) == {SKY, LAND, BUILDING, OBSTACLE, DRONE}
    row, column = np.indices((36, 48))
    for c, tangent in enumerate((1.0, 0.6)):
        lens = make_pixel_rays(48, 36, tangent)
        rays = np.stack(np.broadcast_arrays(1.0, lens.x, lens.y[:, None]), axis=-1)
        rays = turns[0][1][c].apply(rays.reshape(-1, 3)).reshape(rays.shape)
        away = images.depth[c].astype(float)[..., None] * rays
        points = places[0][1][c] + away
        labels = images.labels[c]
        for label, kind, k in ((OBSTACLE, 1, 0), (DRONE, 2, 1)):
            shown = labels == label
            local = turns[kind][1][k].inv().apply(points[shown] - places[kind][1][k])
            points[shown] = places[kind][0][k] + turns[kind][0][k].apply(local)
        seen = points - places[0][0][c]
        seen[labels == SKY] = away[labels == SKY]
        seen = turns[0][0][c].inv().apply(seen.reshape(-1, 3)).reshape(seen.shape)
        # Columns and rows of the earlier picture, by the focal length
        focal = 18 / tangent
        column0 = 24 - focal * seen[..., 1] / seen[..., 0]
        row0 = 17 - focal * seen[..., 2] / seen[..., 0]
        expected = np.stack([column - column0, row - row0], axis=-1)
        ahead = seen[..., 0] > 0.1
        assert ahead.mean() > 0.99
        np.testing.assert_allclose(images.flow[c][ahead], expected[ahead], rtol=1e-4, atol=1e-3)
        assert np.abs(images.flow[c]).max() < MAX_FLOW
        assert np.abs(images.flow[c]).mean() > 1.0
    # Nothing has moved since now
    still = draw(engine, cameras, (swarm, np.ones((1, 2), dtype=bool)))
    np.testing.assert_allclose(still.flow, 0.0, atol=1e-6)
    engine.close()


def test_points_that_were_behind_the_camera_have_no_flow():
    engine, cameras = scene_of_walls()
    turned = cameras.quaternion[:, [1, 0, 3, 2]] * [1, -1, 1, -1]  # by half a turn about z
    poses = [(np.zeros((1, count, 3)), np.zeros((1, count, 4))) for count in (1, 0)]
    images = blank(1)
    engine.pictures(cameras, images, None, Earlier(cameras.eye, turned, *poses))
    assert (images.flow == 0.0).all()
    engine.close()
