"""Pressures against tables of the standard atmosphere, and what errors do to heights."""

import math

import numpy as np
import pytest
import sensing

import bulletuav
from bulletuav.earth import geometric_height
from bulletuav.sensors.barometer import Barometer
from bulletuav.sensors.imperfect import Imperfect

ISO = {0.0: 101325.0, 1000.0: 89874.6, 5000.0: 54019.9, 11000.0: 22632.0}
"""Pressures, Pa, at geopotential heights, m: ISO 2533:1975"""
PASCAL = 288.15 * 287.05287 / (9.80665 * 101325.0)
"""m; height of a pascal at sea level: the weight of dry air of 1.225 kg/m^3"""


def exact(altitude=0.0, shape=(1, 1), period=0.1, **uncertain):
    """A barometer without errors but those given."""
    sensor = sensing.sensor_of(Barometer(altitude), shape, period=period)
    for name in sensor.uncertain:
        getattr(sensor, name)[:] = uncertain.get(name, 0.0)
    return sensor


def at(z, sensor=None, **moment):
    """Pressure and height that the drones of a world read at a height."""
    sensor = exact() if sensor is None else sensor
    swarm = sensing.swarm_of(*sensor.setup.shape, position=(3.0, -7.0, z))
    readings = sensing.measure(sensor, swarm, **moment)
    return readings["barometer"], readings["barometric_height"]


def rows_of(sensor, count, seed=0, z=0.0):
    """(count, 2, N) pressures and heights of an episode at rest, the first at its reset."""
    rng = np.random.default_rng(seed)
    still = sensing.swarm_of(*sensor.setup.shape, position=(0.0, 0.0, z))
    sensing.start(sensor, 0, still, rng)
    given = [sensing.measure(sensor, still, steps=k, rngs=[rng]) for k in range(count)]
    return np.array([[one["barometer"][0], one["barometric_height"][0]] for one in given])


@pytest.mark.parametrize("geopotential", ISO)
@pytest.mark.parametrize("altitude", [0.0, 488.0, -400.0])
def test_pressure_is_that_of_the_table(geopotential, altitude):
    z = float(geometric_height(geopotential)) - altitude
    pressure, height = at(z, exact(altitude))
    assert pressure == pytest.approx(ISO[geopotential], rel=5e-6)
    assert height == pytest.approx(z, abs=1e-7)


def test_a_pascal_is_the_height_that_weighs_a_pascal():
    assert pytest.approx(0.0832, abs=1e-4) == PASCAL
    true, _ = at(0.0)
    higher, _ = at(1.0)
    assert true - higher == pytest.approx(1.0 / PASCAL, rel=1e-4)
    pressure, height = at(0.0, exact(bias=10.0))
    assert pressure == pytest.approx(101335.0)
    assert height == pytest.approx(-10.0 * PASCAL, rel=1e-3)  # too much pressure: too low


def test_it_measures_pressure_whatever_the_attitude_and_where_it_is():
    sensor = exact(shape=(1, 2))
    swarm = sensing.swarm_of(1, 2, position=[(0, 0, 20), (1e3, -1e3, 20)])
    swarm.quaternion[0, 1] = (1.0, 0.0, 0.0, 0.0)
    swarm.velocity[0, 1] = (20.0, 0.0, -5.0)
    pressure = sensing.measure(sensor, swarm)["barometer"]
    assert pressure[0, 0] == pressure[0, 1]


def test_white_noise_has_the_standard_deviation_asked_for():
    noise = np.tile((2.0, 0.5), 20)  # of twenty pairs of drones
    rows = rows_of(exact(shape=(1, 40), noise=noise[None]), 1000).reshape(1000, 2, 20, 2)
    pressure, height = rows[:, 0], rows[:, 1]
    np.testing.assert_allclose(pressure.std(axis=(0, 1)), (2.0, 0.5), rtol=0.03)
    np.testing.assert_allclose(height.std(axis=(0, 1)), (2.0 * PASCAL, 0.5 * PASCAL), rtol=0.03)
    np.testing.assert_allclose(pressure.mean(axis=(0, 1)), 101325.0, atol=0.1)
    before, after = pressure[:-1, :, 0].ravel(), pressure[1:, :, 0].ravel()
    assert abs(np.corrcoef(before, after)[0, 1]) < 0.04


@pytest.mark.parametrize("period", [0.1, 0.02])
def test_the_walk_begins_at_nothing_and_grows_with_the_root_of_time(period):
    rows = rows_of(exact(shape=(1, 4000), period=period, walk=0.3), round(4 / period) + 1)[:, 0]
    assert (rows[0] == 101325.0).all()
    assert rows[round(1 / period)].std() == pytest.approx(0.3, rel=0.05)
    assert rows[-1].std() == pytest.approx(0.6, rel=0.05)


def test_an_episode_forgets_what_walked_in_the_last_one():
    sensor = exact(walk=5.0)
    first = rows_of(sensor, 50)
    assert abs(first[-1, 0, 0] - 101325.0) > 1
    np.testing.assert_array_equal(rows_of(sensor, 50), first)


def test_usual_errors_are_those_of_a_bmp388():
    sensor = sensing.sensor_of(Barometer, (1, 2000))
    rows = rows_of(sensor, 2)
    assert rows[0, 1].std() == pytest.approx(0.11, rel=0.05)  # m
    assert not sensor.bias.any()


def test_worlds_and_drones_that_do_not_measure_keep_their_readings():
    sensor = exact(shape=(2, 2), walk=1.0)
    rngs = [np.random.default_rng(0), None]
    at(10.0, sensor, mask=[[True, True], [False, False]], rngs=rngs)
    pressure, height = at(50.0, sensor, mask=[[True, False], [False, False]], rngs=rngs)
    np.testing.assert_allclose(height[0], (50.0, 10.0), atol=1.0)
    assert pressure[0, 0] < pressure[0, 1]
    assert not pressure[1].any()
    assert not sensor._drift[1].any()


def test_no_random_numbers_are_drawn_where_nothing_is_uncertain():
    rng = np.random.default_rng(3)
    at(1.0, exact(bias=20.0), rngs=[rng])
    assert rng.random() == np.random.default_rng(3).random()


@pytest.mark.parametrize(("z", "least"), [(-1e4, -4999.0), (1e6, 20000.0), (-3.0, -3.0)])
def test_below_ground_and_beyond_the_atmosphere_readings_are_finite(z, least):
    pressure, height = at(z, exact(noise=1000.0), rngs=[np.random.default_rng(0)])
    assert np.isfinite(pressure).all()
    assert pressure > 5e3
    pressure, height = at(z)
    assert height == pytest.approx(least, abs=70)


@pytest.mark.parametrize(
    ("altitude", "message"),
    [
        (math.nan, "altitude is nan: a finite number is needed"),
        (9001.0, "altitude is 9001: at most 9000"),
        (-501, "altitude is -501: at least -500"),
        ("sea", "altitude is 'sea'"),
        (None, "altitude is None"),
    ],
)
def test_an_altitude_that_cannot_be_is_refused(altitude, message):
    with pytest.raises(ValueError, match=message):
        Barometer(altitude)


def test_an_environment_observes_pressure_and_height():
    aviary = bulletuav.Aviary(
        "hover",
        2,
        dynamics="point_mass",
        action="velocity",
        sensors=(Barometer(altitude=488.0),),
        observation=("barometer", "barometric_height"),
        observation_format="dict",
        randomization={"barometer_noise": 0.0, "barometer_walk": 0.0, "barometer_bias": (5, 50)},
    )
    try:
        observed = aviary.reset(seeds=0)
        z, bias = aviary.swarm.position[..., 2], aviary.first_info()["random/barometer_bias"]
        assert ((bias >= 5) & (bias <= 50)).all()
        low = z - observed["barometric_height"][..., 0]
        # A pascal is more height where the air is thinner: 1.1678 kg/m^3 at 488 m
        np.testing.assert_allclose(low, bias * PASCAL * 1.225 / 1.1687, rtol=5e-3)
        high = {one.name: one.high for one in aviary.observer.labels}
        assert high["pressure"] == 125e3
        assert high["barometric height"] == 9200 - 488
    finally:
        aviary.close()


def test_an_airspace_carries_it_at_a_rate_of_its_own():
    airspace = bulletuav.Airspace(
        [(0.0, 0.0, 5.0), (0.0, 0.0, 80.0)],
        decision_hz=100,
        physics_hz=1000,
        sensors=(Imperfect(Barometer(), rate=50),),
    )
    heights = []
    for _ in range(9):
        airspace.step()
        heights.append(airspace.readings["barometric_height"])
    np.testing.assert_allclose(heights[0], (5.0, 80.0), atol=0.6)
    changes = (np.diff(heights, axis=0) != 0).all(axis=1)
    assert changes.sum() == 4
    assert not (changes[1:] & changes[:-1]).any()
    airspace.close()
