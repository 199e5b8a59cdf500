"""The field against published values in all attitudes, and what iron does to it."""

import datetime
import math

import numpy as np
import pytest
import sensing
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.earth import flu_to_frd
from bulletuav.sensors.magnetometer import Magnetometer

FIELD = np.array((1.451, 22.843, -41.825))
"""uT east, north and up at 45 N, 10 E, 0 m in 2025.0: geomag.bgs.ac.uk, as in tests of the Earth"""
PLACE = {"latitude": 45.0, "longitude": 10.0, "altitude": 0.0}


def compass(shape=(1, 1), noise=0.0, hard_iron=0.0, **place):
    """A magnetometer at a place with the errors given."""
    sensor = sensing.sensor_of(Magnetometer(**{**PLACE, **place}), shape)
    sensor.noise[:], sensor.hard_iron[:] = noise, hard_iron
    return sensor


def felt(attitude=None, sensor=None, **moment):
    """(W, N, 3) readings at an attitude."""
    sensor = compass() if sensor is None else sensor
    turn = sensing.LEVEL if attitude is None else attitude.as_quat()
    swarm = sensing.swarm_of(*sensor.setup.shape, position=(5.0, 2.0, 30.0), quaternion=turn)
    return sensing.measure(sensor, swarm, **moment)["magnetometer"]


@pytest.mark.parametrize(
    ("axis", "degrees", "forward_left_up"),
    [
        ("z", 0, (1.451, 22.843, -41.825)),  # looks east: north is to the left
        ("z", 90, (22.843, -1.451, -41.825)),  # looks north: east is to the right
        ("z", 180, (-1.451, -22.843, -41.825)),
        ("z", -90, (-22.843, 1.451, -41.825)),
        ("x", 180, (1.451, -22.843, 41.825)),  # upside down
        ("y", 90, (41.825, 22.843, 1.451)),  # on its nose, whose tail is up: forward is down
        ("x", 90, (1.451, -41.825, -22.843)),  # on its right side: left is up
    ],
)
def test_the_field_in_body_axes(axis, degrees, forward_left_up):
    reading = felt(Rotation.from_euler(axis, degrees, degrees=True))
    np.testing.assert_allclose(reading[0, 0], forward_left_up, atol=6e-4)


def test_turning_the_body_turns_the_reading_the_other_way():
    level = felt()[0, 0]
    for seed in range(20):
        attitude = Rotation.random(rng=np.random.default_rng(seed))
        reading = felt(attitude)[0, 0]
        np.testing.assert_allclose(attitude.apply(reading), level, atol=1e-12)
        assert np.linalg.norm(reading) == pytest.approx(np.linalg.norm(FIELD), abs=1e-3)


def test_a_compass_finds_north_in_the_axes_of_autopilots():
    """Its declination at 45 N, 10 E is atan(1451 / 22843) = 3.634 degrees to the east."""
    heading = 30.0  # degrees east of north
    yaw = Rotation.from_euler("z", 90 - heading, degrees=True)
    forward, right, down = flu_to_frd(felt(yaw)[0, 0])
    assert down > 0  # in the north it enters the ground
    magnetic = math.degrees(math.atan2(-right, forward))
    assert magnetic + 3.634 == pytest.approx(heading, abs=2e-3)


def test_without_options_it_is_in_zurich():
    """NOAA's WMM2025, another model, tells so there, computed by the package ahrs."""
    field = felt(sensor=exact_in_zurich())[0, 0]
    np.testing.assert_allclose(field, (1.28684, 21.51986, -43.24238), atol=0.025)
    assert np.linalg.norm(field) == pytest.approx(48.318, abs=0.025)


def exact_in_zurich():
    sensor = sensing.sensor_of(Magnetometer)
    sensor.noise[:] = sensor.hard_iron[:] = 0.0
    return sensor


def test_the_field_changes_by_years_as_it_is_foreseen():
    """At 82.73 W, 21.46 N, 101.99 km high in 2027.0 by igrf14syn, see the tests of the Earth."""
    place = {"latitude": 90 - 68.54, "longitude": 277.27 - 360, "altitude": 101.99e3}
    reading = felt(sensor=compass(**place, date=2027.0))[0, 0]
    np.testing.assert_allclose(reading, (-2.28398317, 24.64790876, -29.26817197), atol=1e-4)
    day = felt(sensor=compass(**place, date=datetime.date(2027, 1, 1)))[0, 0]
    np.testing.assert_array_equal(day, reading)
    assert np.abs(felt(sensor=compass(**place))[0, 0] - reading).max() > 0.05


def test_white_noise_has_the_standard_deviation_asked_for():
    noise, rng = np.tile((0.3, 2.0), 20), np.random.default_rng(0)  # of twenty pairs of drones
    sensor = compass((1, 40), noise=[noise])
    rows = np.array([felt(sensor=sensor, rngs=[rng])[0] for _ in range(1000)]) - FIELD
    rows = rows.reshape(1000, 20, 6)
    np.testing.assert_allclose(rows.std(axis=(0, 1)), [0.3] * 3 + [2.0] * 3, rtol=0.03)
    np.testing.assert_allclose(rows.mean(axis=(0, 1)), 0, atol=0.08)
    assert np.abs(np.corrcoef(rows.reshape(-1, 6).T) - np.eye(6)).max() < 0.04
    assert abs(np.corrcoef(rows[:-1, :, 0].ravel(), rows[1:, :, 0].ravel())[0, 1]) < 0.04


def test_iron_on_board_turns_with_the_drone_and_is_another_in_each_episode():
    sensor, rng = compass((1, 4000), hard_iron=2.0), np.random.default_rng(0)
    swarm = sensing.swarm_of(1, 4000)
    sensing.start(sensor, 0, swarm, rng)
    iron = felt(sensor=sensor)[0] - FIELD
    assert iron.std() == pytest.approx(2.0, rel=0.03)
    np.testing.assert_allclose(np.corrcoef(iron.T), np.eye(3), atol=0.06)
    # It is the same in body axes, however the drone turns, until the episode ends.
    attitude = Rotation.from_euler("zyx", (50, 20, -70), degrees=True)
    turned = felt(attitude, sensor)[0] - attitude.inv().apply(FIELD)
    np.testing.assert_allclose(turned, iron, atol=2e-3)
    sensing.start(sensor, 0, swarm, rng)
    assert (felt(sensor=sensor)[0] - FIELD != iron).all()


def test_an_episode_without_iron_forgets_that_of_the_last_one():
    sensor, rng = compass(hard_iron=5.0), np.random.default_rng(0)
    sensing.start(sensor, 0, sensing.swarm_of(1, 1), rng)
    sensor.hard_iron[:] = 0.0
    state = rng.bit_generator.state
    sensing.start(sensor, 0, sensing.swarm_of(1, 1), rng)
    np.testing.assert_allclose(felt(sensor=sensor, rngs=[rng])[0, 0], FIELD, atol=1e-3)
    assert rng.bit_generator.state == state  # nothing is drawn where nothing is uncertain


def test_drones_that_do_not_measure_keep_their_readings():
    sensor = compass((2, 2))
    felt(sensor=sensor, mask=[[True, True], [False, False]])
    over = Rotation.from_euler("x", 180, degrees=True)
    up = felt(over, sensor, mask=[[False, True], [False, False]])[..., 2]
    np.testing.assert_allclose(up, [(-41.825, 41.825), (0, 0)], atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"latitude": 91.0}, "latitude is 91: at most 90"),
        ({"latitude": math.nan}, "latitude is nan: a finite number"),
        ({"longitude": 181.0}, "longitude is 181: at most 180"),
        ({"longitude": "east"}, "longitude is 'east'"),
        ({"altitude": 2e6}, r"altitude is 2e\+06: at most 1e\+06"),
        ({"altitude": math.inf}, "altitude is inf"),
        ({"date": 2024.9}, "date is 2024.9: at least 2025"),
        ({"date": datetime.date(2030, 1, 2)}, "date is .*: at most 2030"),
        ({"date": "2026-01-01"}, "date is '2026-01-01'"),
        ({"date": math.nan}, "date is nan"),
        ({"date": None}, "date is None"),
    ],
)
def test_places_and_dates_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Magnetometer(**options)


def test_environments_and_airspaces_carry_it():
    quiet = {"magnetometer_noise": 0.0, "magnetometer_hard_iron": 0.0}
    aviary = bulletuav.Aviary(
        "hover", 2, num_drones=2, observation="magnetometer", randomization=quiet
    )
    observed = aviary.reset(seeds=0)
    attitude = Rotation.from_quat(aviary.swarm.quaternion.reshape(4, 4))
    aviary.close()
    expected = attitude.inv().apply(felt(sensor=exact_in_zurich())[0, 0])
    np.testing.assert_allclose(observed.reshape(4, 3), expected, atol=1e-5)
    airspace = bulletuav.Airspace(
        [(0.0, 0.0, 5.0)], sensors=(Magnetometer(**PLACE),), randomization=quiet
    )
    airspace.step()
    turn = Rotation.from_quat(airspace.swarm.quaternion[0])
    reading = turn.apply(airspace.readings["magnetometer"][0])
    np.testing.assert_allclose(reading, FIELD, atol=1e-3)
    airspace.close()
