"""Flow and distance of the ground, by hand, in all attitudes, and at the ends of the range."""

import math

import numpy as np
import pytest
import sensing
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.earth import flu_to_frd
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.imperfect import Imperfect
from bulletuav.sensors.optical_flow import OpticalFlow, angular_flow, range_deviation

WIDE = {"max_distance": 50.0, "max_flow": 100.0, "max_tilt": 89.0}
QUIET = {"noise": 0.0, "range_noise": 0.0, "dropout": 0.0}


@pytest.fixture(scope="module")
def ground():
    """Two drones above flat ground."""
    engine = sensing.open_world(drones=2)
    yield engine
    engine.close()


@pytest.fixture
def make_world():
    """Builds worlds that are closed in the end."""
    made = []

    def make(*arguments, **options):
        made.append(sensing.open_world(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def sensor_in(engine, limits=None, period=0.1, **uncertain):
    """A sensor without errors but those given."""
    made = OpticalFlow(**(limits or {}))
    sensor = sensing.sensor_of(made, engine.shape, engine, period=period)
    for name, value in {**QUIET, **uncertain}.items():
        getattr(sensor, name)[:] = value
    return sensor


def see(engine, position, *, sensor=None, limits=None, turn=None, mask=None, rngs=None, **motion):
    """Flow (2,), quality and distance of the first drone; the other one is far away."""
    sensor = sensor_in(engine, limits) if sensor is None else sensor
    places = [position, (1e3, 1e3, 500.0)][: engine.shape[1]]
    quaternion = sensing.LEVEL if turn is None else turn.as_quat()
    swarm = sensing.swarm_of(*engine.shape, places, quaternion=quaternion, **motion)
    readings = sensing.measure(sensor, swarm, mask=mask, rngs=rngs)
    flow, distance = readings["optical_flow"][0, 0], readings["ground_distance"][0, 0]
    return flow[:2], flow[2], distance


def turned(axes, degrees):
    return Rotation.from_euler(axes, degrees, degrees=True)


# The formula


@pytest.mark.parametrize(
    ("velocity", "rates", "height", "flow"),
    [
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, (0.0, -1.0)),  # ahead: as if it pitched up
        ((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 1.0, (1.0, 0.0)),  # to the left: as if it rolled right
        ((1.0, -2.0, 0.0), (0.0, 0.0, 0.0), 4.0, (-0.5, -0.25)),
        ((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 2.0, (0.0, 0.0)),  # upwards: the middle stays
        ((0.0, 0.0, 0.0), (0.3, -0.4, 5.0), 2.0, (0.3, -0.4)),  # turns are seen as they are
        ((1.5, 0.0, 0.0), (0.0, 0.75, 0.0), 2.0, (0.0, 0.0)),  # both at once can cancel
    ],
)
def test_flow_by_hand(velocity, rates, height, flow):
    np.testing.assert_allclose(angular_flow(velocity, rates, height), flow, atol=1e-15)


def test_signs_are_those_of_mavlink_in_its_axes():
    """OPTICAL_FLOW_RAD, forward, right, down: right turns are positive about both axes, motion
    along +y gives negative flow about x, and motion along +x positive flow about y."""
    for velocity, flow in (((2.0, 0, 0), (0, 2.0)), ((0, 2.0, 0), (-2.0, 0))):
        left = flu_to_frd(velocity)  # the conversion is its own inverse
        seen = flu_to_frd((*angular_flow(tuple(left), (0.0, 0.0, 0.0), 1.0), 0.0))
        np.testing.assert_allclose(seen[:2], flow, atol=1e-15)
    for rates in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        seen = flu_to_frd((*angular_flow((0.0,) * 3, tuple(flu_to_frd(rates)), 1.0), 0.0))
        np.testing.assert_allclose(seen, rates, atol=1e-15)


def test_it_is_the_model_of_the_crazyflie():
    """mm_flow.c: pixels in x are dt N / theta (v_x R22 / z - w_y), those in y (v_y R22 / z + w_x).

    Its pixels in x count flow about -y, those in y flow about x. R22 / z is one over the distance.
    """
    rng = np.random.default_rng(0)
    for _ in range(20):
        velocity, rates = rng.normal(size=(2, 3))
        z, cosine = rng.uniform(0.2, 3.0), rng.uniform(0.8, 1.0)
        pixels_x = velocity[0] * cosine / z - rates[1]
        pixels_y = velocity[1] * cosine / z + rates[0]
        flow = angular_flow(velocity, rates, z / cosine)
        np.testing.assert_allclose(flow, (pixels_y, -pixels_x), rtol=1e-12)


# In a world


def test_hovering_at_one_metre_and_flying_east_at_one_metre_a_second(ground):
    flow, quality, distance = see(ground, (0, 0, 1), velocity=(1.0, 0, 0))
    np.testing.assert_allclose(flow, (0, -1), atol=1e-9)
    assert quality == 1
    assert distance == pytest.approx(1.0, abs=1e-9)
    north = turned("z", 90)  # east is to its right
    flow, _, _ = see(ground, (0, 0, 1), velocity=(1.0, 0, 0), turn=north)
    np.testing.assert_allclose(flow, (-1, 0), atol=1e-9)
    flow, quality, _ = see(ground, (0, 0, 1))
    assert not flow.any()
    assert quality == 1


@pytest.mark.parametrize("yaw", [0.0, 37.0, 180.0, -101.0])
def test_flow_in_body_axes_is_the_same_whatever_the_yaw(ground, yaw):
    """Level and tilted: what turns with the drone looks the same to it."""
    for lean in (turned("y", 0), turned("yx", (20, -10))):
        ahead, rates = np.array((0.7, -0.4, 0.2)), np.array((0.3, 0.2, -1.0))
        expected, quality, distance = see(ground, (0, 0, 2), turn=lean, velocity=ahead, rates=rates)
        turn = turned("z", yaw)
        flow, same, far = see(
            ground, (0, 0, 2), turn=turn * lean, velocity=turn.apply(ahead), rates=rates
        )
        np.testing.assert_allclose(flow, expected, atol=1e-9)
        assert (same, quality) == (1, 1)
        assert far == pytest.approx(distance, abs=1e-9)


def test_flow_falls_with_one_over_the_distance_and_grows_with_the_speed(ground):
    for height in (0.5, 1.0, 2.0, 3.5):
        for speed in (0.3, 1.0, -2.0):
            flow, _, _ = see(ground, (0, 0, height), limits=WIDE, velocity=(speed, 2 * speed, 0.4))
            np.testing.assert_allclose(flow * height / speed, (2, -1), atol=1e-8)


def test_flow_of_a_point_on_tilted_ground_is_that_of_its_direction(ground):
    """Numerically: the direction of a point that the sensor looks at, a microsecond later."""
    rng, step = np.random.default_rng(1), 1e-6
    for _ in range(20):
        turn = turned("zyx", rng.uniform((-180, -40, -40), (180, 40, 40)))
        velocity, rates = rng.normal(size=(2, 3))
        position = np.array((0.0, 0.0, rng.uniform(0.5, 3.0)))
        flow, quality, distance = see(
            ground, position, limits=WIDE, turn=turn, velocity=velocity, rates=rates
        )
        down = turn.apply((0.0, 0.0, -1.0))
        point = position - position[2] / down[2] * down
        assert point[2] == pytest.approx(0.0, abs=1e-12)
        assert distance == pytest.approx(np.linalg.norm(point - position), rel=1e-9)
        later = turn * Rotation.from_rotvec(rates * step)
        seen = later.inv().apply(point - position - velocity * step)
        # The point moves from (0, 0, -1) by -flow x (0, 0, -1)
        moved = seen / -seen[2] - (0, 0, -1)
        np.testing.assert_allclose((-moved[1], moved[0]), flow * step, rtol=1e-4, atol=1e-11)
        assert quality == 1


def test_a_roof_is_nearer_than_the_ground(make_world):
    engine = make_world((Solids(np.array([[(20.0, -5, 0), (40, 5, 10)]])),))
    for x, height in ((30.0, 2.0), (0.0, 12.0)):
        flow, _, distance = see(engine, (x, 0, 12), limits=WIDE, velocity=(3.0, 0, 0))
        assert distance == pytest.approx(height, abs=1e-6)
        np.testing.assert_allclose(flow, (0, -3 / height), atol=1e-6)


def test_obstacles_and_other_drones_are_seen_and_those_that_are_gone_are_not(make_world):
    engine = make_world(obstacles=(Obstacle("sphere", (1.0,)),), drones=2)
    engine.set_obstacles(np.array([[(0.0, 0, 5)]]), np.array([[sensing.LEVEL]]), np.array([True]))
    assert see(engine, (0, 0, 8), limits=WIDE)[2] == pytest.approx(2.0, abs=1e-3)
    sensor = sensor_in(engine, WIDE)
    swarm = sensing.swarm_at(engine, [(20, 0, 8), (20, 0, 3)])
    assert sensing.measure(sensor, swarm)["ground_distance"][0, 0] < 5
    alone = sensing.measure(sensor, swarm, mask=[[True, False]])
    assert alone["ground_distance"][0, 0] == pytest.approx(8.0, abs=1e-6)


# Limits


@pytest.mark.parametrize(
    ("height", "quality", "distance"),
    [(0.05, 0, 0.05), (0.079, 0, 0.079), (0.081, 1, 0.081), (3.99, 1, 3.99), (4.01, 0, 4.0)],
)
def test_the_ends_of_the_range(ground, height, quality, distance):
    flow, seen, far = see(ground, (0, 0, height), velocity=(0.1, 0, 0))
    assert seen == quality
    assert far == pytest.approx(distance, abs=1e-9)
    np.testing.assert_allclose(flow, (0, -quality * 0.1 / height), atol=1e-8)


@pytest.mark.parametrize(
    ("velocity", "rates", "quality"),
    [
        ((7.3, 0, 0), 0, 1),
        ((7.5, 0, 0), 0, 0),
        ((0, -7.5, 0), 0, 0),
        ((5.5, 5.5, 0), 0, 0),  # together 7.8
        ((0, 0, 0), (0, 7.5, 0), 0),
        ((0, 0, 9), (0, 0, 30), 1),  # neither is seen
        ((7.5, 0, 0), (0, 1, 0), 1),  # turned against
    ],
)
def test_ground_that_passes_too_fast_is_not_followed(ground, velocity, rates, quality):
    flow, seen, distance = see(ground, (0, 0, 1), velocity=velocity, rates=rates)
    assert seen == quality
    assert distance == pytest.approx(1.0, abs=1e-9)
    if not quality:
        assert not flow.any()


@pytest.mark.parametrize(("tilt", "quality"), [(44, 1), (46, 0), (89, 0), (91, 0), (180, 0)])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_drone_that_is_too_tilted_measures_a_distance_alone(ground, axis, tilt, quality):
    flow, seen, distance = see(ground, (0, 0, 2), turn=turned(axis, tilt), velocity=(1, 1, 0))
    assert seen == quality
    slant = 2 / math.cos(math.radians(tilt)) if tilt < 90 else math.inf
    assert distance == pytest.approx(min(slant, 4.0), rel=1e-9)
    if not quality:
        assert not flow.any()


def test_upside_down_the_range_finder_sees_what_is_above(make_world):
    engine = make_world(obstacles=(Obstacle("sphere", (1.0,)),))
    engine.set_obstacles(np.array([[(0.0, 0, 5)]]), np.array([[sensing.LEVEL]]), np.array([True]))
    _, quality, distance = see(engine, (0, 0, 2), turn=turned("x", 180))
    assert quality == 0
    assert distance == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("z", [-0.5, -100.0, 0.0])
def test_below_the_ground_there_is_none(ground, z):
    flow, quality, distance = see(ground, (0, 0, z), velocity=(1.0, 0, 0))
    assert quality == 0
    assert not flow.any()
    assert 0 <= distance <= 4


# Errors


def rows_of(engine, sensor, count, position, **motion):
    """(count, 4) flow, quality and distance of the first drone."""
    rng = [np.random.default_rng(0)]
    rows = [see(engine, position, sensor=sensor, rngs=rng, **motion) for _ in range(count)]
    return np.array([(*flow, quality, distance) for flow, quality, distance in rows])


def test_white_noise_has_the_standard_deviation_asked_for(ground):
    sensor = sensor_in(ground, noise=0.2, range_noise=0.01)
    rows = rows_of(ground, sensor, 8000, (0, 0, 1), velocity=(1.0, 0, 0))
    np.testing.assert_allclose(rows.mean(axis=0), (0, -1, 1, 1), atol=0.01)
    # At 1 m the range finder's noise has hardly begun to grow: by exp(4.382 (1 - 2.5) / 1.5)
    np.testing.assert_allclose(rows.std(axis=0), (0.2, 0.2, 0, 0.01 * 1.0125), rtol=0.04)
    assert np.abs(np.corrcoef(rows[:, (0, 1, 3)].T) - np.eye(3)).max() < 0.06


def test_noise_of_the_range_finder_grows_towards_its_end():
    """That of the Crazyflie: 0.0025 (1 + exp(ln(0.2 / 0.0025) / 1.5 (d - 2.5))), range 4 m."""
    distance = np.array((0.0, 1.0, 2.5, 3.0, 4.0))
    expected = 1 + np.exp(math.log(0.2 / 0.0025) / 1.5 * (distance - 2.5))
    np.testing.assert_allclose(range_deviation(distance, 4.0), expected, rtol=1e-12)
    np.testing.assert_allclose(range_deviation(10 * distance, 40.0), expected, rtol=1e-12)
    assert range_deviation(np.array(4.0), 4.0) == pytest.approx(81.0)


def test_noise_makes_no_ground_where_none_is_and_stays_within_limits(ground):
    sensor = sensor_in(ground, noise=50.0, range_noise=50.0)
    rows = rows_of(ground, sensor, 200, (0, 0, 1))
    assert np.abs(rows[:, :2]).max() == 7.4
    assert (rows[:, 2] == 1).all()
    assert rows[:, 3].min() == 0
    assert rows[:, 3].max() == 4
    rows = rows_of(ground, sensor, 20, (0, 0, 5))
    np.testing.assert_array_equal(rows, [(0, 0, 0, 4)] * 20)


def test_readings_fail_as_often_as_asked_for(ground):
    sensor = sensor_in(ground, dropout=0.25)
    rows = rows_of(ground, sensor, 4000, (0, 0, 1), velocity=(1.0, 0, 0))
    fails = rows[:, 2] == 0
    assert fails.mean() == pytest.approx(0.25, abs=0.03)
    np.testing.assert_array_equal(rows[fails][:, :2], 0)
    np.testing.assert_allclose(rows[~fails][:, 1], -1, atol=1e-9)
    np.testing.assert_allclose(rows[:, 3], 1, atol=1e-9)


def test_no_random_numbers_are_drawn_where_nothing_is_uncertain(ground):
    rng = np.random.default_rng(3)
    see(ground, (0, 0, 1), rngs=[rng])
    assert rng.random() == np.random.default_rng(3).random()


def test_drones_that_do_not_measure_keep_their_readings(ground):
    sensor = sensor_in(ground)
    see(ground, (0, 0, 1), sensor=sensor, velocity=(1.0, 0, 0), mask=[[True, False]])
    flow, quality, distance = see(ground, (0, 0, 2), sensor=sensor, mask=[[False, True]])
    np.testing.assert_allclose((*flow, quality, distance), (0, -1, 1, 1), atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_distance": math.nan}, "min_distance is nan: a finite number"),
        ({"min_distance": 0.0}, "min_distance is 0: at least 0.001"),
        ({"max_distance": math.inf}, "max_distance is inf: a finite number"),
        ({"max_distance": 0.05}, "min_distance is 0.08 and max_distance 0.05: a greater"),
        ({"max_distance": 2000.0}, "max_distance is 2000: at most 1000"),
        ({"max_flow": -1.0}, "max_flow is -1: at least 0.001"),
        ({"max_tilt": 91.0}, "max_tilt is 91: at most 90"),
        ({"max_tilt": "none"}, "max_tilt is 'none'"),
    ],
)
def test_limits_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        OpticalFlow(**options)


def test_an_environment_observes_flow_within_its_bounds():
    aviary = bulletuav.Aviary(
        "hover",
        2,
        dynamics="point_mass",
        action="velocity",
        sensors=(OpticalFlow(max_distance=100.0, max_flow=50.0),),
        observation=("optical_flow", "ground_distance"),
        randomization={f"optical_flow_{key}": value for key, value in QUIET.items()},
    )
    try:
        aviary.reset(seeds=0)
        for _ in range(5):
            observed = aviary.step(np.full((2, 1, 3), (0.4, 0.2, 0.0))).observations
        swarm = aviary.swarm
        height = swarm.position[..., 2]
        np.testing.assert_allclose(observed[..., 3], height, rtol=1e-5)
        expected = swarm.velocity[..., 1] / height, -swarm.velocity[..., 0] / height
        np.testing.assert_allclose(observed[..., :2], np.stack(expected, axis=-1), atol=1e-5)
        assert (observed[..., 2] == 1).all()
        assert aviary.observer.high.tolist() == [50, 50, 1, 100]
        assert aviary.observer.low.tolist() == [-50, -50, 0, 0]
    finally:
        aviary.close()


def test_an_airspace_carries_it_at_a_rate_of_its_own():
    airspace = bulletuav.Airspace(
        [(0.0, 0.0, 1.0), (5.0, 0.0, 30.0)],
        decision_hz=100,
        physics_hz=1000,
        sensors=(Imperfect(OpticalFlow(), rate=20),),
    )
    for _ in range(3):
        airspace.step()
    assert airspace.readings["optical_flow"].shape == (2, 3)
    np.testing.assert_allclose(airspace.readings["ground_distance"], (1.0, 4.0), atol=0.02)
    np.testing.assert_array_equal(airspace.readings["optical_flow"][:, 2], (1, 0))
    airspace.close()
