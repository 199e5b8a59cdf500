import contextlib
import dataclasses
import json

import numpy as np
import pytest
import sensing
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, FAR, LAND, NEAR, OBSTACLE, SKY, SKY_COLOUR
from bulletuav.sensors.camera import Camera
from bulletuav.sensors.mounts import as_mounts

SIZE = (64, 48)
ALL = ["rgb", "depth", "segmentation", "ray_depth"]
TOWER = Solids(np.array([[(20.0, -5, 0), (40, 5, 60)]]))
FACING = [sensing.LEVEL, (0, np.sqrt(0.5), 0, np.sqrt(0.5))]
"""The second drone shows the first its face"""
BOTH = pytest.mark.parametrize(
    "camera", ["compiled", pytest.param("bullet", marks=pytest.mark.bullet)]
)
RADIUS = bulletuav.load_airframe("hummingbird").collision_radius


@pytest.fixture
def photograph():
    """Pictures (N, H, W, ...) by name of drones in front of some solids and an obstacle."""
    made = []

    def make(
        solids,
        position,
        quaternion=sensing.LEVEL,
        obstacle=None,
        world=0,
        worlds=1,
        camera="compiled",
    ):
        drones = len(np.atleast_2d(position))
        obstacles = (Obstacle("sphere", (1.0,)),)
        engine = sensing.open_world((solids,), worlds, drones, obstacles=obstacles)
        made.append(engine)
        if obstacle is not None:
            level = np.tile(sensing.LEVEL, (worlds, 1, 1))
            every = np.ones(worlds, dtype=bool)
            engine.set_obstacles(np.full((worlds, 1, 3), obstacle), level, every)
        swarm = sensing.swarm_at(engine, position, quaternion)
        views = {"radius": (RADIUS,) * drones, "camera_size": SIZE, "wanted": frozenset(ALL)}
        sensor = sensing.sensor_of(Camera, engine.shape, engine, camera=camera, **views)
        sensing.measure(sensor, swarm, steps=0)
        assert set(sensor.pictures) == set(ALL)
        np.testing.assert_array_equal(sensor.pictures["ray_depth"], sensor.pictures["depth"])
        return {name: picture[world] for name, picture in sensor.pictures.items()}

    yield make
    for one in made:
        one.close()


def pixel(ahead, left, up):
    """Row and column that look along a direction.

    The picture is 90 degrees high, and 4 / 3 as wide as high.
    """
    return int(24 * (1 - up / ahead)), int(32 * (1 - left / ahead * 3 / 4))


def flat(labels, depth):
    """(H, W) pixels whose neighbours all show the same, in one plane: away from edges."""
    inner = np.zeros(labels.shape, dtype=bool)
    inverse = np.pad(
        1 / depth.astype(float), 1, mode="edge"
    )  # linear in the pixels' places on a plane
    shown = np.pad(labels, 1, mode="edge")
    inner[:] = True
    for row in range(3):
        for column in range(3):
            inner &= shown[row : row + labels.shape[0], column : column + labels.shape[1]] == labels
    for bend in (
        inverse[1:-1, 2:] + inverse[1:-1, :-2] - 2 / depth,
        inverse[2:, 1:-1] + inverse[:-2, 1:-1] - 2 / depth,
    ):
        inner &= np.abs(bend) < 1e-3 / depth
    return inner


def rounding(depth):
    """What single precision leaves of a depth, m, in the renderer.

    Its buffer is 1 - NEAR / depth.
    """
    return 1e-3 + 2 * np.finfo(np.float32).eps * depth**2 / NEAR


@pytest.mark.parametrize("attitude", [(0, 0, 0), (-60, 20, 0), (-130, 10, 25)])
@pytest.mark.bullet
def test_depths_and_labels_are_those_of_bullets_renderer(photograph, attitude):
    """In a city, over a street; where pixels show a plane, and to what the renderer rounds.

    Walls and streets seen at a slant tell by half a pixel's shift whether both look through the
    same point of a pixel.
    """
    city = generate("dense", 300.0, np.random.default_rng(0), 0.5)
    turn = Rotation.from_euler("ZYX", attitude, degrees=True).as_quat()
    depth, rays, labels = (
        photograph(city.solids, (50, 130, 20), turn, camera=camera)[name][0]
        for camera, name in (
            ("bullet", "depth"),
            ("compiled", "depth"),
            ("compiled", "segmentation"),
        )
    )
    rendered = photograph(city.solids, (50, 130, 20), turn, camera="bullet")["segmentation"][0]
    compared = flat(labels, rays) & (labels != SKY)
    assert {LAND, BUILDING} <= set(labels[compared])
    assert compared.mean() > 0.4
    assert (np.abs(depth - rays) < rounding(rays))[compared].all()
    assert (labels == rendered)[compared].all()
    assert (labels == rendered).mean() > 0.98


@BOTH
def test_the_depth_of_a_wall_is_that_along_the_axis_in_all_its_pixels(photograph, camera):
    """The lens is a drone's radius ahead of its centre."""
    pictures = photograph(TOWER, (0, 0, 30), camera=camera)
    precision = {"compiled": 1e-7, "bullet": 0.01}[camera]
    for up, left in ((0, 0), (3, 4), (-8, -4.5)):
        row, column = pixel(20 - RADIUS, left, up)
        assert pictures["depth"][0, row, column] == pytest.approx(20 - RADIUS, rel=precision)


def test_what_is_nowhere_is_far(photograph):
    pictures = photograph(TOWER, (0, 0, 30), Rotation.from_euler("z", 90, degrees=True).as_quat())
    assert (pictures["depth"][0, :20] == FAR).all()
    assert (pictures["segmentation"][0, :20] == SKY).all()


@BOTH
def test_pixels_are_labelled_by_what_they_show(photograph, camera):
    """A tower ahead, an obstacle to its left, another drone to its right.

    Ground is below and sky above them.
    """
    places = [(0, 0, 30), (RADIUS + 5, -4, 30)]
    pictures = photograph(TOWER, places, FACING, obstacle=(RADIUS + 10, 9, 30), camera=camera)
    labels = pictures["segmentation"][0]
    for label, (ahead, left, up) in (
        (BUILDING, (20, 0, 0)),
        (OBSTACLE, (10, 9, 0)),
        (DRONE, (5, -4, 0)),
        (LAND, (10, 9, -5)),
        (SKY, (10, 9, 5)),
        (SKY, (10, -9, 9)),
        (BUILDING, (20, 0, 15)),
    ):
        assert labels[pixel(ahead, left, up)] == label
    assert set(np.unique(labels)) == {SKY, LAND, BUILDING, OBSTACLE, DRONE}


@pytest.mark.bullet
def test_obstacles_and_drones_are_as_far_as_they_are(photograph):
    """A ball of 1 m 10 m ahead and to the left; a drone 5 m ahead.

    Its collision shape is what rays see of it.
    """
    rays, depth = (
        photograph(
            TOWER,
            [(0, 0, 30), (RADIUS + 5, -4, 30)],
            FACING,
            obstacle=(RADIUS + 10, 9, 30),
            camera=camera,
        )["depth"][0]
        for camera in ("compiled", "bullet")
    )
    ball, drone = pixel(10, 9, 0), pixel(5, -4, 0)
    assert 8.9 < rays[ball] < 9.5
    assert abs(depth[ball] - rays[ball]) < 0.1  # the renderer's ball is made of triangles
    assert rays[drone] == pytest.approx(5 - 0.055, abs=1e-3)
    assert 0 < depth[drone] - rays[drone] < 0.11  # the renderer shows the body within


@BOTH
def test_every_world_is_photographed_where_it_is(photograph, camera):
    here, there = (photograph(TOWER, (0, 0, 30), world=k, worlds=4, camera=camera) for k in (0, 3))
    if camera == "compiled":
        np.testing.assert_array_equal(here["depth"], there["depth"])
        np.testing.assert_array_equal(here["rgb"], there["rgb"])
    # Bullet's renderer is in single precision
    is_equal = here["segmentation"] == there["segmentation"]
    assert is_equal.mean() > (0.99 if camera == "bullet" else 0.999999)


def test_colours_differ_between_faces_and_on_the_ground(photograph):
    """Two sides of a tower, its shaded ground, and the sky."""
    turn = Rotation.from_euler("z", -20, degrees=True).as_quat()
    pictures = photograph(TOWER, (0, 12, 30), turn)
    colours, labels = pictures["rgb"][0], pictures["segmentation"][0]
    seen = {label: np.unique(colours[labels == label], axis=0) for label in (SKY, LAND, BUILDING)}
    assert seen[SKY].tolist() == [list(SKY_COLOUR)]
    assert len(seen[LAND]) > 10
    assert len(seen[BUILDING]) == 2


def test_cameras_that_are_not_due_hold_their_pictures():
    """Every second decision, and only of drones that fly."""
    engine = sensing.open_world((TOWER,), worlds=2, drones=2)
    views = {"radius": (RADIUS,) * 2, "camera_size": SIZE, "wanted": frozenset(ALL)}
    camera = sensing.sensor_of(Camera, engine.shape, engine, camera_every=2, **views)
    swarm = sensing.swarm_of(2, 2, (0, 0, 30))
    assert (camera.pictures["depth"] == FAR).all()
    mask = [[True, False], [True, True]]
    pictures = sensing.measure(camera, swarm, mask=mask, steps=[2, 3])
    taken = (pictures["depth"] != FAR).any(axis=(2, 3))
    assert taken.tolist() == [[True, False], [False, False]]
    engine.close()


@BOTH
@pytest.mark.parametrize(("fov", "edge"), [(60.0, 1 / 3**0.5), (120.0, 3**0.5)])
def test_the_field_of_view_is_between_the_upper_and_the_lower_edge(camera, fov, edge):
    """The depth of the ground at the lower edge of a level picture."""
    with contextlib.closing(
        bulletuav.Aviary(
            "hover",
            observation=("depth", "segmentation"),
            dynamics="point_mass",
            camera=camera,
            camera_size=SIZE,
            randomization={"camera_fov": fov},
        )
    ) as aviary:
        aviary.reset(seeds=0)
        depth = aviary.step(np.zeros((1, 1, 3))).observations["depth"][0, 0]
        eye = aviary.swarm.position[0, 0, 2]
        assert depth[-1, SIZE[0] // 2] == pytest.approx(eye / edge, rel=0.03)


def test_fields_of_view_are_drawn_in_each_episode():
    options = {"observation": ("depth",), "camera_size": (16, 12), "num_drones": 3}
    options |= {"dynamics": "point_mass", "randomization": {"camera_fov": (40.0, 120.0)}}
    with contextlib.closing(bulletuav.Aviary("crossing", 2, **options)) as aviary:
        seen = []
        for seed in (0, 10):
            aviary.reset(seeds=seed)
            fov = aviary.step(np.zeros((2, 3, 3))).info["random/camera_fov"]
            assert ((fov >= 40.0) & (fov <= 120.0)).all()
            seen.append(np.array(fov))
        assert len(np.unique(seen)) == 12


def test_noise_of_depths_grows_with_their_square(photograph):
    """On a wall and on the ground; the sky stays, and other pictures have none."""
    engine = sensing.open_world((TOWER,))
    swarm = sensing.swarm_of(1, 1, (0, 0, 30))
    views = {"radius": (RADIUS,), "camera_size": SIZE, "wanted": frozenset(ALL)}
    exact, noisy = (sensing.sensor_of(Camera, engine.shape, engine, **views) for _ in range(2))
    noisy.depth_noise[:] = 0.001
    true = sensing.measure(exact, swarm, steps=0)
    given = {"steps": 0, "rngs": [np.random.default_rng(0)]}
    found = sensing.measure(noisy, swarm, **given)
    error = (found["depth"] - true["depth"]) / true["depth"] ** 2
    labels = true["segmentation"]
    assert (found["depth"][labels == SKY] == FAR).all()
    for label in (BUILDING, LAND):
        chosen = (labels == label) & (true["depth"] < 100)
        assert error[chosen].std() == pytest.approx(0.001, rel=0.1)
        assert abs(error[chosen].mean()) < 1e-4
    for name in ("rgb", "segmentation"):
        np.testing.assert_array_equal(found[name], true[name])
    # Held pictures keep their noise
    before = found["depth"].copy()
    noisy.setup = dataclasses.replace(noisy.setup, camera_every=2)
    after = sensing.measure(noisy, swarm, steps=1, rngs=[np.random.default_rng(1)])
    np.testing.assert_array_equal(after["depth"], before)
    engine.close()


@BOTH
@pytest.mark.parametrize("depth", ["metres", "linear", "inverse"])
def test_depths_are_clipped_to_the_range_and_normalised(depth, camera):
    """A tower nearer than the range, and a sky beyond it."""
    near, far = 21.0, 36.0
    engine = sensing.open_world((TOWER,))
    swarm = sensing.swarm_at(engine, (0, 0, 30))
    views = {"radius": (RADIUS,), "camera_size": SIZE, "wanted": frozenset(ALL), "camera": camera}
    plain = sensing.sensor_of(Camera, engine.shape, engine, **views)
    views |= {"camera_range": (near, far), "camera_depth": depth}
    ranged = sensing.sensor_of(Camera, engine.shape, engine, **views)
    # No exposure yet: the farthest depth everywhere
    start = {"metres": far, "linear": 1.0, "inverse": 0.0}[depth]
    assert (ranged.pictures["depth"] == start).all()
    metres = sensing.measure(plain, swarm, steps=0)["depth"].astype(float).clip(near, far)
    found = sensing.measure(ranged, swarm, steps=0)["depth"]
    expected = {
        "metres": metres,
        "linear": (metres - 21) / 15,
        "inverse": (36 / metres - 1) / (36 / 21 - 1),
    }[depth]
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-7)
    label = ranged.labels(ranged.setup)["depth"]
    assert (label.low, label.high) == ((near, far) if depth == "metres" else (0.0, 1.0))
    assert (found.min(), found.max()) == (label.low, label.high)
    # Held pictures are not converted again
    before = found.copy()
    held = sensing.measure(ranged, swarm, steps=1, mask=[[False]])["depth"]
    np.testing.assert_array_equal(held, before)
    engine.close()


def shoot(mounts, position, quaternion=sensing.LEVEL, size=SIZE, fov=90.0, **setup):
    """Depths of the cameras of one drone before a tower, (H, W) or (cameras, H, W)."""
    engine = sensing.open_world((TOWER,))
    swarm = sensing.swarm_at(engine, position, quaternion)
    views = {"radius": (0.5,), "camera_size": size, "wanted": frozenset({"depth"}), **setup}
    camera = sensing.sensor_of(
        Camera, engine.shape, engine, camera_mounts=as_mounts(mounts), **views
    )
    camera.fov[:] = fov
    depth = sensing.measure(camera, swarm, steps=0)["depth"][0, 0]
    engine.close()
    return depth


def share_equal(one, other):
    """Fraction of pixels with the same depth but for rounding."""
    assert one.shape == other.shape
    return np.isclose(one, other, rtol=1e-5).mean()


@BOTH
def test_a_mounted_camera_sees_what_a_turned_drone_sees(camera):
    """By SciPy's rotations; signs of angles are those of MAVLink's gimbals."""
    body = Rotation.from_euler("ZYX", [0.3, 0.2, -0.1])
    mount = {"pitch": -20.0, "yaw": 25.0, "roll": 15.0, "offset": (0.3, 0.2, -0.1)}
    turn = Rotation.from_euler("ZYX", [25.0, 20.0, 15.0], degrees=True)
    place = np.array([3.0, -1.0, 30.0])
    found = shoot(mount, place, body.as_quat(), camera=camera)
    eye = place + body.apply([0.3, 0.2, -0.1])
    expected = shoot({"offset": (0.0, 0.0, 0.0)}, eye, (body * turn).as_quat(), camera=camera)
    assert np.ptp(found) > 100
    assert share_equal(found, expected) > (0.99 if camera == "compiled" else 0.9)


def test_cameras_look_where_their_angles_say():
    """Down, up, to the left and back, from the front of the drone."""
    mounts = [{"pitch": -90.0}, {"pitch": 90.0}, {"yaw": 90.0}, {"yaw": 180.0}, {"pitch": -30.0}]
    # The tower is 20 m to the left of a drone that looks to the south
    south = Rotation.from_euler("z", -90, degrees=True).as_quat()
    depth = shoot(mounts, (0.0, 0.0, 30.0), south)
    assert depth.shape == (5, SIZE[1], SIZE[0])
    middle = depth[:, SIZE[1] // 2 - 1, SIZE[0] // 2]
    assert middle == pytest.approx([30.0, FAR, 20.0, FAR, 60.0], rel=1e-6)


def test_the_right_side_of_a_rolled_camera_goes_down():
    """Rolled by 90 degrees, its right edge is at 45 degrees below the horizon."""
    depth = shoot({"roll": 90.0}, (-500.0, 0.0, 10.0), size=(64, 64))
    assert (depth[:, :32] == FAR).any(axis=1).all()
    assert depth[31, 63] == pytest.approx(10.0 / (1 - 2 / 64), rel=1e-5)


def test_a_stabilized_camera_stays_level_and_follows_the_heading():
    yaw = Rotation.from_euler("z", 0.4)
    tilted = (yaw * Rotation.from_euler("YX", [0.5, -0.7])).as_quat()
    mount = {"pitch": -10.0, "yaw": 5.0, "offset": (0.0, 0.0, 0.0)}
    found = shoot({**mount, "stabilized": True}, (0.0, 0.0, 30.0), tilted)
    assert share_equal(found, shoot(mount, (0.0, 0.0, 30.0), yaw.as_quat())) > 0.99
    assert share_equal(found, shoot(mount, (0.0, 0.0, 30.0), tilted)) < 0.5


def test_four_cameras_see_a_panorama():
    """All around at eye level, a box is where the slab method of a plan finds it."""
    yaw = np.array([0.0, 90.0, 180.0, -90.0])
    mounts = [{"yaw": angle, "offset": (0.0, 0.0, 0.0)} for angle in yaw.tolist()]
    # Most of the box is to the right of the first camera and to the left of the last
    place = (10.0, 12.0, 30.0)
    found = shoot(mounts, place, size=(32, 32))[:, 15]
    angle = np.radians(yaw)[:, None]
    left = 1 - np.arange(32) / 16
    x, y = np.cos(angle) - left * np.sin(angle), np.sin(angle) + left * np.cos(angle)
    with np.errstate(divide="ignore"):
        ends = np.array(
            [[(20 - place[0]) / x, (40 - place[0]) / x], [(-5 - place[1]) / y, (5 - place[1]) / y]]
        )
    enters, leaves = ends.min(axis=1).max(axis=0), ends.max(axis=1).min(axis=0)
    expected = np.where((enters <= leaves) & (enters > 0), enters, FAR)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert (expected < FAR).sum(axis=1).tolist() == [12, 0, 0, 7]


def test_pictures_of_several_cameras_are_stacked():
    """Each is the picture of that camera alone, also in observations and their space."""
    mounts = ({"pitch": -20.0}, {"yaw": 120.0, "roll": 5.0}, {"pitch": -90.0, "stabilized": True})
    images = ("depth", "segmentation", "rgb")
    options = {"observation": images, "camera_size": (16, 12), "dynamics": "point_mass"}
    options |= {"num_drones": 2, "randomization": {"camera_fov": (60.0, 100.0)}}

    def observe(camera_mounts):
        """Observations of two worlds after a decision, and the space of a drone."""
        options["camera_mounts"] = camera_mounts
        with contextlib.closing(bulletuav.Aviary("obstacles", 2, **options)) as aviary:
            aviary.reset(seeds=3)
            action = np.full((2, 2, 3), 0.5)
            return aviary.step(action).observations, aviary.observer.space()

    # As files of runs store them
    together, space = observe(json.loads(json.dumps(mounts)))
    assert together["depth"].shape == (2, 2, 3, 12, 16)
    assert together["rgb"].shape == (2, 2, 3, 12, 16, 3)
    assert all(space[name].contains(together[name][0, 0]) for name in images)
    for k, mount in enumerate(mounts):
        alone, _ = observe(mount)
        for name in images:
            np.testing.assert_array_equal(together[name][:, :, k], alone[name])


def test_pictures_are_late():
    """Of two drones, each with its own delay, in two worlds, one of which restarts."""
    engine = sensing.open_world((TOWER,), worlds=2, drones=2)
    views = {"radius": (RADIUS,) * 2, "camera_size": SIZE, "wanted": frozenset(ALL), "period": 0.1}
    camera = sensing.sensor_of(Camera, engine.shape, engine, longest_picture_delay=0.3, **views)
    camera.delay[:] = [[0.0, 0.1], [0.24, 0.3]]
    late = np.array([[0, 1], [2, 3]])
    middle = pixel(20, 0, 0)
    steps = np.zeros(2, dtype=int)
    places = np.zeros((2, 2, 3)) + [0.0, 0.0, 30.0]
    past = []
    for decision in range(14):
        if decision == 8:
            steps[1] = 0
        places[..., 0] = decision + 0.25 * np.arange(4).reshape(2, 2)
        past.append(20 - RADIUS - places[..., 0])
        swarm = sensing.swarm_of(2, 2, places)
        pictures = sensing.measure(camera, swarm, steps=steps)
        then = decision - np.minimum(late, steps[:, None])
        expected = np.take_along_axis(np.array(past), then[None], axis=0)[0]
        found = pictures["depth"][:, :, *middle]
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        np.testing.assert_array_equal(pictures["ray_depth"], pictures["depth"])
        steps += 1
    # A drone that flies no more holds its last picture
    before = pictures["rgb"].copy()
    after = sensing.measure(camera, swarm, mask=[[False] * 2] * 2, steps=steps)["rgb"]
    np.testing.assert_array_equal(after, before)
    engine.close()


def test_delays_are_drawn_in_each_episode_and_kept_in_snapshots():
    options = {"observation": ("depth", "segmentation"), "camera_size": (16, 12), "num_drones": 3}
    options |= {"dynamics": "point_mass", "randomization": {"camera_delay": (0.0, 0.3)}}
    with contextlib.closing(bulletuav.Aviary("crossing", 2, **options)) as aviary:
        aviary.reset(seeds=0)
        action = np.full((2, 3, 3), 0.7)
        for _ in range(4):
            delay = aviary.step(action).info["random/camera_delay"]
        assert len(np.unique(delay)) == 6
        assert ((delay >= 0.0) & (delay <= 0.3)).all()
        kept = aviary.save_state()
        flown = [aviary.step(action).observations for _ in range(4)]
        aviary.load_state(kept)
        again = [aviary.step(action).observations for _ in range(4)]
        for one, other in zip(flown, again, strict=True):
            for name in ("depth", "segmentation"):
                np.testing.assert_array_equal(one[name], other[name])


def test_steps_of_depths_are_those_of_disparities():
    """Of the Kinect; at 5 m Khoshelham and Oude Elberink find steps of 7 cm."""
    engine = sensing.open_world((TOWER,))
    views = {"radius": (0.0,), "camera_size": SIZE, "wanted": frozenset({"depth"})}
    camera = sensing.sensor_of(Camera, engine.shape, engine, **views)
    camera.depth_step[:] = 0.00285
    seen = []
    for ahead in np.linspace(15.0, 15.5, 401):
        swarm = sensing.swarm_of(1, 1, (ahead, 0, 30))
        depth = sensing.measure(camera, swarm, steps=0)["depth"][0, 0]
        seen.append(float(depth[pixel(20, 0, 0)]))
    levels = np.unique(seen)
    assert np.diff(levels) == pytest.approx(0.00285 * levels[1:] * levels[:-1], rel=1e-4)
    assert levels[-1] - levels[-2] == pytest.approx(0.07, abs=0.005)
    truth = 20 - np.linspace(15.0, 15.5, 401)
    assert np.abs(1 / np.array(seen) - 1 / truth).max() <= 0.00285 / 2 * 1.0001
    # Less than half a step of 1/depth is none: 1 / (0.00285 / 2) = 702 m
    assert FAR in depth
    assert depth[depth < FAR].max() <= 1 / 0.00285 * 1.0001
    # Noise may bring a depth down to zero
    camera.depth_noise[:] = 1.0
    rngs = [np.random.default_rng(0)]
    depth = sensing.measure(camera, swarm, steps=0, rngs=rngs)["depth"]
    assert (depth.min(), depth.max()) == (0.0, FAR)
    engine.close()


def test_edges_lose_their_depths():
    """At the two sides of the tower's outline all, inside of its wall and of the ground none."""
    engine = sensing.open_world((TOWER,))
    swarm = sensing.swarm_of(1, 1, (0, 0, 30))
    views = {"radius": (0.0,), "camera_size": SIZE, "wanted": frozenset({"depth"})}
    camera = sensing.sensor_of(Camera, engine.shape, engine, **views)
    true = sensing.measure(camera, swarm, steps=0)["depth"][0, 0].copy()
    wall = np.flatnonzero(true[20] < FAR)
    # 5 m to the left and to the right at 20 m
    assert (wall[0], wall[-1]) == (32 - 6, 32 + 6)
    camera.edge_dropout[:] = 1.0
    rngs = [np.random.default_rng(0)]
    found = sensing.measure(camera, swarm, steps=0, rngs=rngs)["depth"][0, 0]
    lost = np.flatnonzero((found != true)[20])
    assert lost.tolist() == [26, 38]
    np.testing.assert_array_equal(found[20, 27:38], true[20, 27:38])
    ground = found[40:, :20]
    np.testing.assert_array_equal(ground, true[40:, :20])
    # A third of them, drawn at random
    camera.edge_dropout[:] = 1 / 3
    edge, lost = found != true, []
    for _ in range(60):
        drawn = sensing.measure(camera, swarm, steps=0, rngs=rngs)["depth"][0, 0]
        assert not (drawn != true)[~edge].any()
        lost.append((drawn == FAR)[edge].mean())
    assert np.mean(lost) == pytest.approx(1 / 3, abs=0.02)
    engine.close()


def test_colours_are_drawn_in_each_episode_and_kept_in_snapshots():
    options = {"observation": ("rgb", "segmentation"), "camera_size": (32, 24)}
    options |= {"dynamics": "point_mass", "num_layouts": 1, "num_drones": 1}

    def observe(colours):
        """Pictures of two worlds in two episodes, and after the first is restored."""
        randomization = {} if colours is None else {"camera_colours": colours}
        with contextlib.closing(
            bulletuav.Aviary("lidar_navigation", 2, randomization=randomization, **options)
        ) as aviary:
            first = aviary.reset(seeds=(4, 5))["rgb"].copy()
            kept = aviary.save_state()
            second = aviary.reset(seeds=(4, 7))["rgb"].copy()
            aviary.load_state(kept)
            third = aviary.step(np.zeros((2, 1, 3))).observations["rgb"].copy()
            return first, second, third

    plain, _, _ = observe(None)
    first, second, third = observe((0.5, 1.0))
    assert (first != plain).mean() > 0.5
    np.testing.assert_array_equal(first[0], second[0])
    sky = first[:, 0, 0, 0]
    assert not (sky[0] == sky[1]).all()
    assert not (second[1, 0, 0, 0] == sky[1]).all()
    np.testing.assert_array_equal(third[:, 0, 0, 0], sky)
    some, _, _ = observe(0.0)
    np.testing.assert_array_equal(some, plain)


def test_normals_are_observed():
    with contextlib.closing(
        bulletuav.Aviary(
            "hover", observation=("normals",), camera_size=(16, 12), dynamics="point_mass"
        )
    ) as aviary:
        normals = aviary.reset(seeds=0)["normals"]
        assert aviary.observer.space()["normals"].contains(normals[0, 0])
        np.testing.assert_allclose(normals[0, 0, -1, :, 2], 1.0, rtol=1e-6)
    with pytest.raises(ValueError, match="camera 'bullet' draws no 'normals'"):
        bulletuav.Aviary("hover", observation="normals", camera="bullet", dynamics="point_mass")
    options = {"camera": "bullet", "randomization": {"camera_colours": 0.5}}
    with pytest.raises(ValueError, match="camera 'bullet' has its own colours"):
        bulletuav.Aviary("hover", dynamics="point_mass", **options)


def test_flow_is_that_since_the_last_decision():
    """Of a drone that moves 1 m to the left, and of a ball that moves down, but only while it does.

    The focal length is 24 pixels.
    """
    obstacles = (Obstacle("sphere", (1.0,)),)
    engine = sensing.open_world((TOWER,), worlds=2, obstacles=obstacles)
    every, level = np.ones(2, dtype=bool), np.tile(sensing.LEVEL, (2, 1, 1))

    def place_ball(height):
        engine.set_obstacles(np.full((2, 1, 3), (10.0, -4.0, height)), level, every)

    views = {"radius": (0.0,), "camera_size": SIZE, "wanted": frozenset({"flow", "depth"})}
    camera = sensing.sensor_of(Camera, engine.shape, engine, **views)
    here, there = (sensing.swarm_of(2, 1, (0, y, 30)) for y in (0.0, 1.0))
    place_ball(30.0)
    flow = sensing.measure(camera, here, steps=0)["flow"][0, 0]
    assert np.abs(flow).max() < 1e-6
    flow = sensing.measure(camera, there, before=here, steps=1)["flow"][0, 0]
    wall, ball = pixel(20, -1, 0), pixel(9, -5, 0)
    assert flow[wall] == pytest.approx([24 / 20, 0.0], abs=1e-5)
    assert flow[ball] == pytest.approx([24 / 9, 0.0], rel=0.02, abs=1e-5)
    place_ball(29.5)
    flow = sensing.measure(camera, there, steps=[2, 0])["flow"]
    assert flow[0, 0][wall] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert flow[0, 0][ball] == pytest.approx([0.0, 24 * 0.5 / 9], rel=0.02, abs=1e-5)
    # The second world started with the ball there
    assert flow[1, 0][ball] == pytest.approx([0.0, 0.0], abs=1e-5)
    flow = sensing.measure(camera, there, steps=[3, 1])["flow"]
    assert np.abs(flow).max() < 1e-6
    # A new body is still
    engine.add_body([(0.0, 0, 0), (3, 0, 0), (0, 3, 0), (0, 0, 3)], (8.0, 0.0, 28.0))
    flow = sensing.measure(camera, there, steps=[4, 2])["flow"]
    assert np.abs(flow).max() < 1e-6
    engine.close()


def test_flow_is_kept_in_snapshots():
    options = {"observation": ("flow",), "camera_size": (16, 12), "dynamics": "point_mass"}
    with contextlib.closing(bulletuav.Aviary("obstacles", 2, num_moving=3, **options)) as aviary:
        first = aviary.reset(seeds=0)["flow"]
        assert (first == 0.0).all() or np.abs(first).max() < 1e-6
        action = np.full((2, aviary.swarm.position.shape[1], 3), 0.5)
        aviary.step(action)
        kept = aviary.save_state()
        flown = aviary.step(action).observations["flow"].copy()
        aviary.step(action)
        aviary.load_state(kept)
        np.testing.assert_array_equal(aviary.step(action).observations["flow"], flown)
        assert np.abs(flown).max() > 0.1
        assert aviary.observer.space()["flow"].contains(flown[0, 0])
