import numpy as np
import pytest
import sensing
from bench import MULTIROTORS
from scipy.spatial.transform import Rotation
from sensing import swarm_at

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.lidar import Beam, Lidar, make_beams

FAR = 60.0


def tower(height):
    return Solids(np.array([[(20.0, -5, 0), (40, 5, height)]]))


@pytest.fixture
def make_world():
    """Builds worlds in which the first of some layouts stands."""
    made = []

    def make(*arguments, **options):
        made.append(sensing.open_world(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def lidar_of(engine, beams, frame="yaw"):
    looks = {"beams": tuple(beams), "max_range": FAR, "beam_frame": frame}
    return sensing.sensor_of(Lidar, engine.shape, engine, **looks)


def scan(engine, swarm, beams, frame="yaw", mask=None, rngs=None, **uncertain):
    """(W, N, B) ranges of one scan."""
    lidar = lidar_of(engine, beams, frame)
    for name, value in uncertain.items():
        getattr(lidar, name)[:] = value
    sensing.measure(lidar, swarm, mask=mask, rngs=rngs)
    return lidar.ranges


ENGINE = {"obstacles": (Obstacle("sphere", (1.0,)),), "rays": "bullet"}
both_ways = pytest.mark.parametrize("options", [{}, ENGINE], ids=["walk", "engine"])
"""With obstacles, here nowhere near, and rays="bullet" the engine is asked."""


def level(*azimuths):
    return [Beam(azimuth, 0.0) for azimuth in azimuths]


# Ranges


def test_beams_go_around_at_each_elevation_the_first_ahead():
    expected = [(0, 0), (90, 0), (180, 0), (270, 0), (0, -30), (90, -30), (180, -30), (270, -30)]
    assert make_beams(4, (0.0, -30.0)) == tuple(expected)


@both_ways
def test_ranges_of_a_tower_are_exact(make_world, options):
    """20 / cos 10 = 20.308532 m, at y = 3.527 m; at 15 degrees y = 5.359 m: past it."""
    engine = make_world((tower(60),), **options)
    ranges = scan(engine, swarm_at(engine, (0, 0, 30)), level(0, 10, 15, 180))
    np.testing.assert_allclose(ranges[0, 0], (20, 20.308532, FAR, FAR), atol=1e-6)


@both_ways
def test_level_beams_above_a_roof_miss(make_world, options):
    engine = make_world((tower(25),), **options)
    assert (scan(engine, swarm_at(engine, (0, 0, 30)), make_beams(36, (0.0,))) == FAR).all()


@both_ways
@pytest.mark.parametrize("thickness", [0.5, 0.05])
def test_a_thin_wall_is_seen_where_it_stands(make_world, thickness, options):
    engine = make_world((Solids(np.array([[(20.0, -5, 0), (20 + thickness, 5, 60)]])),), **options)
    assert scan(engine, swarm_at(engine, (0, 0, 30)), level(0))[0, 0] == pytest.approx(20, abs=1e-6)


@both_ways
def test_beams_that_look_down_see_ground_and_roof(make_world, options):
    """From 30 m: 30 / sin of the angle.

    The roof 5 m below is met 20 m ahead and farther, at less than 14 degrees down.
    """
    engine = make_world((tower(25),), **options)
    beams = [Beam(90, -90), Beam(90, -45), Beam(90, -31), Beam(90, -29), Beam(0, -10)]
    ranges = scan(engine, swarm_at(engine, (0, 0, 30)), beams)[0, 0]
    np.testing.assert_allclose(
        ranges,
        (30, 42.426407, 30 / np.sin(np.radians(31)), FAR, 5 / np.sin(np.radians(10))),
        atol=1e-6,
    )


def test_obstacles_are_seen(make_world):
    engine = make_world(obstacles=(Obstacle("sphere", (2.0,)),))
    engine.set_obstacles(np.array([[(0.0, 15, 30)]]), np.array([[sensing.LEVEL]]), np.array([True]))
    np.testing.assert_allclose(
        scan(engine, swarm_at(engine, (0, 0, 30)), level(90, 0))[0, 0], (13, FAR), atol=1e-3
    )


def test_what_is_at_the_end_of_the_range_is_seen_and_beyond_it_is_not(make_world):
    engine = make_world((tower(60),))
    assert scan(engine, swarm_at(engine, (-39.99, 0, 30)), level(0))[0, 0] == pytest.approx(
        59.99, abs=1e-6
    )
    assert scan(engine, swarm_at(engine, (-40.01, 0, 30)), level(0))[0, 0] == FAR


# Other drones


@pytest.mark.parametrize("tilt", [0, 30])
@pytest.mark.parametrize("airframe", MULTIROTORS)
def test_the_shape_of_another_drone_is_seen(make_world, airframe, tilt):
    """A disc of radius r and half-height h ahead, tilted towards the beam.

    Its rim r / cos, or its face h / sin, is met.
    """
    engine = make_world(drones=2, airframe=airframe)
    low, high = disc(airframe)
    swarm = swarm_at(
        engine, [(0, 0, 100), (10, 0, 100)], Rotation.from_euler("y", tilt, degrees=True).as_quat()
    )
    met = low if tilt == 0 else min(low / np.cos(np.radians(tilt)), high / np.sin(np.radians(tilt)))
    ranges = scan(engine, swarm, level(0, 180))[0]
    np.testing.assert_allclose(ranges, [(10 - met, FAR), (FAR, 10 - met)], atol=2e-3)


def disc(airframe):
    """Radius and half-height of an airframe's collision shape, m.

    They follow from its thinnest extent and its bounding sphere.
    """
    one = bulletuav.load_airframe(airframe)
    half = one.thinnest / 2
    return np.sqrt(one.collision_radius**2 - half**2), half


@pytest.mark.parametrize("tilt", [0, 30])
@pytest.mark.parametrize("airframe", bulletuav.available_airframes())
def test_no_drone_sees_itself(make_world, airframe, tilt):
    """In 200 directions, with another drone in the engine, out of range."""
    engine = make_world(drones=2, airframe=airframe)
    swarm = swarm_at(
        engine,
        [(0, 0, 500), (0, 100, 500)],
        Rotation.from_euler("zx", (20, tilt), degrees=True).as_quat(),
    )
    way = Rotation.random(200, rng=np.random.default_rng(0)).apply((1, 0, 0))
    beams = [
        Beam(*angles)
        for angles in np.degrees(
            np.stack([np.arctan2(way[:, 1], way[:, 0]), np.arcsin(way[:, 2])], axis=1)
        )
    ]
    assert (scan(engine, swarm, beams) == FAR).all()


def test_drones_that_left_the_airspace_are_not_seen(make_world):
    engine = make_world(drones=2)
    swarm = swarm_at(engine, [(0, 0, 100), (10, 0, 100)])
    gone = np.array([[False, True]])
    engine.park(gone)
    ranges = scan(engine, swarm, level(0), mask=~gone)
    assert (ranges == FAR).all()


def test_a_drone_whose_centre_is_out_of_range_shows_its_rim(make_world):
    engine = make_world(drones=2)
    for away, expected in ((FAR + 0.2, FAR - 0.07), (FAR + 0.28, FAR)):
        ranges = scan(engine, swarm_at(engine, [(0, 0, 100), (away, 0, 100)]), level(0))
        assert ranges[0, 0, 0] == pytest.approx(expected, abs=2e-3)


def test_drones_of_other_worlds_are_not_seen(make_world):
    engine = make_world(worlds=2, drones=2)
    swarm = swarm_at(engine, [[(0, 0, 100), (0, 10, 100)], [(10, 0, 100), (20, 0, 100)]])
    ranges = scan(engine, swarm, level(0, 90))
    np.testing.assert_allclose(ranges[0, 0], (FAR, 9.73), atol=2e-3)
    np.testing.assert_allclose(ranges[1, 0], (9.73, FAR), atol=2e-3)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_a_drone_that_flies_fast_is_seen_where_it_is(make_bench, dynamics):
    """Past another at 20 m/s, 8 cm a substep, its leading edge too: 21 beams from rim to rim."""
    bench = make_bench(dynamics, drones=2, effects=(), gravity=0.0)
    bench.swarm.position[0], bench.swarm.velocity[0, 1] = [(0, 0, 100), (10, -4, 100)], (0, 20, 0)
    bench.swarm.rotor_speed[:] = 0
    setpoint = {
        SetpointLevel.ROTOR: np.zeros((1, 2, 4)),
        SetpointLevel.ACCELERATION: np.zeros((1, 2, 4)),
    }.get(
        bench.dynamics.consumes,
        np.concatenate([bench.swarm.velocity, np.zeros((1, 2, 1))], axis=-1),
    )
    bench.place()
    for _ in range(2):
        bench.dynamics.fly(
            bench.swarm, bench.alive, bench.dynamics.consumes, setpoint, bench.wind, bench.motion
        )
    bench.dynamics.show(bench.swarm, bench.alive)
    x, y, _ = bench.swarm.position[0, 1]
    assert (x, y) == pytest.approx((10, 0), abs=1e-6)
    aside = np.linspace(-0.26, 0.26, 21)
    ranges = scan(bench.engine, bench.swarm, level(*np.degrees(np.arctan2(y + aside, x))))[0, 0]
    along = np.hypot(x, aside) - np.sqrt(0.27**2 - aside**2)
    np.testing.assert_allclose(ranges, along, atol=0.01)


# Frames


@pytest.mark.parametrize("tilt", [(0, 0), (30, 20), (-25, 10)])
@pytest.mark.parametrize("heading", [0, 10, -90, 135])
def test_beams_turn_with_the_heading_and_stay_level(make_world, heading, tilt):
    """The tower is to the east, -heading degrees to the left of the nose.

    Beams tilted by 30 would read 23.09 m.
    """
    engine = make_world((tower(60),))
    turn = Rotation.from_euler("ZYX", (heading, *tilt), degrees=True).as_quat()
    swarm = swarm_at(engine, (0, 0, 30), turn)
    ranges = scan(engine, swarm, level(-heading, 10 - heading, 180 - heading), "yaw")[0, 0]
    np.testing.assert_allclose(ranges, (20, 20.308532, FAR), atol=1e-6)
    ranges = scan(engine, swarm, level(0, 10, 180), "world")[0, 0]
    np.testing.assert_allclose(ranges, (20, 20.308532, FAR), atol=1e-6)


def test_a_drone_on_its_nose_still_has_some_heading(make_world):
    engine = make_world((tower(60),))
    swarm = swarm_at(engine, (0, 0, 30), Rotation.from_euler("y", 90, degrees=True).as_quat())
    ranges = scan(engine, swarm, make_beams(36, (0.0,)))[0, 0]
    assert np.isfinite(ranges).all()
    assert (ranges < FAR).sum() in (2, 3)  # the tower's sides are at 14 degrees


# Uncertainty


def many(engine, count, **uncertain):
    """(count, 100) ranges of a tower 20 m ahead."""
    swarm, rng = swarm_at(engine, (0, 0, 30)), [np.random.default_rng(0)]
    return np.array(
        [scan(engine, swarm, level(*[0] * 100), rngs=rng, **uncertain)[0, 0] for _ in range(count)]
    )


def test_noise_has_its_mean_and_deviation(make_world):
    """10,000 ranges: the mean's own deviation is 0.3 / 100."""
    ranges = many(make_world((tower(60),)), 100, noise=0.3)
    assert ranges.mean() == pytest.approx(20, abs=0.012)
    assert ranges.std() == pytest.approx(0.3, rel=0.03)
    assert np.abs(np.corrcoef(ranges[:, :2].T)[0, 1]) < 0.4


def test_dropout_has_its_share(make_world):
    """10,000 ranges: the share's own deviation is 0.003."""
    ranges = many(make_world((tower(60),)), 100, dropout=0.1)
    assert (ranges == FAR).mean() == pytest.approx(0.1, abs=0.012)
    np.testing.assert_allclose(ranges[ranges < FAR], 20, atol=1e-6)


def test_ranges_stay_within_their_bounds(make_world):
    ranges = many(make_world((tower(60),)), 20, noise=60.0, dropout=0.1)
    assert (ranges.min(), ranges.max()) == (0, FAR)


def test_what_is_not_hit_stays_so_under_noise(make_world):
    engine = make_world((tower(60),))
    ranges = scan(
        engine,
        swarm_at(engine, (0, 0, 30)),
        level(*[180] * 100),
        rngs=[np.random.default_rng(0)],
        noise=5.0,
    )
    assert (ranges == FAR).all()


def test_each_drone_has_its_own_noise(make_world):
    engine = make_world((tower(60),), drones=2)
    swarm = swarm_at(engine, [(0, 0, 30), (0, 2, 30)])
    ranges = scan(engine, swarm, level(0), rngs=[np.random.default_rng(0)], noise=[[0.5, 0.0]])[
        0, :, 0
    ]
    assert ranges[1] == pytest.approx(20, abs=1e-6)
    assert abs(ranges[0] - 20) > 1e-3


def test_the_same_seed_gives_the_same_bits_whatever_other_worlds_read(make_world):
    engine = make_world((tower(60),), worlds=2, drones=2)
    swarm = swarm_at(engine, [(0, 0, 30), (0, 2, 30)])

    def read(seeds, noise, mask=None):
        rngs = [np.random.default_rng(seed) for seed in seeds]
        noise = np.broadcast_to(np.array(noise)[:, None], (2, 2))
        return scan(
            engine, swarm, make_beams(16, (0.0,)), mask=mask, rngs=rngs, noise=noise, dropout=0.1
        )[1]

    bits = read((1, 2), (0.3, 0.3)).tobytes()
    assert read((5, 2), (0.3, 0.3)).tobytes() == bits
    assert read((1, 2), (0.0, 0.3)).tobytes() == bits
    assert read((1, 2), (0.3, 0.3), np.array([[False, False], [True, True]])).tobytes() == bits
    assert read((1, 3), (0.3, 0.3)).tobytes() != bits


def test_a_drone_reads_the_same_whether_or_not_another_has_left(make_world):
    engine = make_world((tower(60),), drones=2)
    swarm = swarm_at(engine, [(0, 0, 30), (0, 2, 30)])
    ranges = [
        scan(
            engine,
            swarm,
            level(0, 10),
            mask=np.array([[first, True]]),
            rngs=[np.random.default_rng(3)],
            noise=0.3,
        )[0, 1]
        for first in (True, False)
    ]
    assert ranges[0].tobytes() == ranges[1].tobytes()


def test_who_does_not_scan_keeps_its_ranges(make_world):
    engine = make_world((tower(60),), drones=2)
    lidar, swarm = lidar_of(engine, level(0)), swarm_at(engine, [(0, 0, 30), (0, 2, 30)])
    sensing.measure(lidar, swarm)
    moved = swarm_at(engine, [(5, 0, 30), (5, 2, 30)])
    sensing.measure(lidar, moved, mask=[[True, False]])
    np.testing.assert_allclose(lidar.ranges[0, :, 0], (15, 20), atol=1e-6)
    sensing.measure(lidar, moved, mask=[[False, False]])
    np.testing.assert_allclose(lidar.ranges[0, :, 0], (15, 20), atol=1e-6)


# In environments


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_every_dynamics_sees_the_same_and_only_who_flies(make_world, dynamics):
    """After 30 decisions, in which some crash: what a world apart sees from where they are."""
    town = {
        "area": 200.0,
        "leg": 20.0,
        "num_drones": 12,
        "min_separation": 3.0,
        "num_layouts": 2,
        "height": (2.0, 12.0),
    }
    aviary = bulletuav.Aviary(
        "lidar_navigation", 2, dynamics=dynamics, action="velocity", max_speed=8.0, **town
    )
    aviary.reset(seeds=3)
    action = np.random.default_rng(0).uniform(-1, 1, (2, 12, 3)) * (1, 1, 0.2)
    for _ in range(30):
        aviary.step(action)
    alive, ranges = aviary.alive, aviary.worlds.frame.readings["lidar"]
    assert 0 < alive.sum() < 24
    engine = make_world(aviary.task.layouts(), worlds=2, drones=12)
    engine.set_layouts(aviary.scene.layout, np.ones(2, dtype=bool))
    engine.set_states(aviary.swarm, alive)
    fresh = scan(engine, aviary.swarm, make_beams(16, (0.0,)), mask=alive)
    np.testing.assert_allclose(ranges[alive], fresh[alive], atol=1e-9)
    assert (fresh[alive] < FAR).sum() > 10
    aviary.close()
