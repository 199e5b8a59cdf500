"""Airspeed of a pitot tube against hand numbers, its errors, and the wind that it feels."""

import math

import numpy as np
import pytest
import sensing

import bulletuav
from bulletuav.envs.airspace import Airspace
from bulletuav.sensors.airspeed import MAX_AIRSPEED, MAX_PRESSURE, NOISE, Airspeed
from bulletuav.sensors.imperfect import Imperfect


def exact(shape=(1, 1), **uncertain):
    """A sensor without errors but those given."""
    sensor = sensing.sensor_of(Airspeed(), shape)
    for name in sensor.uncertain:
        getattr(sensor, name)[:] = uncertain.get(name, 0.0)
    return sensor


def read(velocity, quaternion=(0.0, 0.0, 0.0, 1.0), wind=None, sensor=None, **moment):
    """Pressure, Pa, and airspeed, m/s, of one drone."""
    sensor = exact() if sensor is None else sensor
    swarm = sensing.swarm_of(*sensor.setup.shape, position=(0.0, 0.0, 50.0))
    swarm.velocity[:], swarm.quaternion[:] = velocity, quaternion
    at = sensing.moment_of(swarm, **moment)
    if wind is not None:
        at = at._replace(wind=np.broadcast_to(np.array(wind), swarm.velocity.shape))
    readings = sensor.measure(at)
    return readings["differential_pressure"][0, 0], readings["airspeed"][0, 0]


def test_pressure_by_hand():
    """1.225 / 2 * 12^2 = 88.2 Pa."""
    assert read((12.0, 0.0, 0.0)) == pytest.approx((88.2, 12.0), rel=1e-12)


def test_the_tube_feels_the_air_along_it():
    """A nose 30 degrees up, and an attitude towards the north."""
    half = math.radians(-15.0)
    up = (0.0, math.sin(half), 0.0, math.cos(half))
    assert read((10.0, 0.0, 0.0), up)[1] == pytest.approx(10 * math.cos(math.radians(30)))
    north = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    assert read((0.0, 15.0, 0.0), north)[1] == pytest.approx(15.0)
    assert read((15.0, 0.0, 0.0), north)[1] == pytest.approx(0.0, abs=1e-6)


def test_wind_counts_and_air_from_behind_does_not():
    assert read((10.0, 0.0, 0.0), wind=(-4.0, 3.0, 1.0))[1] == pytest.approx(14.0)
    assert read((10.0, 0.0, 0.0), wind=(12.0, 0.0, 0.0)) == (0.0, 0.0)
    assert read((-10.0, 0.0, 0.0)) == (0.0, 0.0)


def test_a_bias_of_pressure_matters_at_low_speed():
    """2 Pa are 1.81 m/s at rest, 0.14 m/s at 12 m/s; a negative pressure indicates 0."""
    biased = exact(bias=2.0)
    assert read((0.0, 0.0, 0.0), sensor=biased) == pytest.approx((2.0, math.sqrt(4 / 1.225)))
    assert read((12.0, 0.0, 0.0), sensor=biased)[1] == pytest.approx(12.0 + 0.1353, abs=1e-4)
    assert read((0.0, 0.0, 0.0), sensor=exact(bias=-2.0)) == (-2.0, 0.0)


def test_the_range_is_limited():
    pressure, airspeed = read((150.0, 0.0, 0.0))
    assert (pressure, airspeed) == (MAX_PRESSURE, pytest.approx(MAX_AIRSPEED, abs=0.01))
    assert airspeed <= MAX_AIRSPEED


def test_noise_has_the_standard_deviation_asked_for():
    sensor = exact((1, 400), noise=np.tile((1.0, 3.0), 200)[None])
    swarm = sensing.swarm_of(1, 400, position=(0.0, 0.0, 50.0))
    swarm.velocity[:] = (12.0, 0.0, 0.0)
    rng = np.random.default_rng(0)
    rows = [sensing.measure(sensor, swarm, rngs=[rng]) for _ in range(100)]
    pressure = np.array([one["differential_pressure"][0] for one in rows]).reshape(100, 200, 2)
    np.testing.assert_allclose(pressure.std(axis=(0, 1)), (1.0, 3.0), rtol=0.02)
    np.testing.assert_allclose(pressure.mean(axis=(0, 1)), 88.2, atol=0.1)
    airspeed = np.array([one["airspeed"][0] for one in rows]).reshape(100, 200, 2)
    # An error of pressure is divided by density times speed
    np.testing.assert_allclose(
        airspeed.std(axis=(0, 1)), np.array((1.0, 3.0)) / (1.225 * 12), rtol=0.02
    )


def test_worlds_without_noise_draw_nothing():
    sensor = exact((2, 1), noise=np.array([[0.0], [1.0]]))
    swarm = sensing.swarm_of(2, 1, position=(0.0, 0.0, 50.0))
    rngs = [np.random.default_rng(k) for k in range(2)]
    sensing.measure(sensor, swarm, rngs=rngs)
    assert rngs[0].random() == np.random.default_rng(0).random()
    assert rngs[1].random() != np.random.default_rng(1).random()


def test_default_noise():
    sensor = sensing.sensor_of(Airspeed(), (1, 1))
    assert (sensor.noise == NOISE).all()
    assert (sensor.bias == 0).all()


@pytest.mark.parametrize("sensor", ["airspeed", Imperfect(Airspeed(), rate=120)])
def test_aeroplanes_measure_the_wind_and_thermals(sensor):
    """The airspeed is that of the trainer through the air at its own place."""
    airspace = Airspace(
        [(0, 0, 100), (500, 0, 100)],
        airframe="trainer",
        dynamics="rigid_body",
        sensors=(sensor,),
        wind=(-3.0, 0.0, 0.0),
        thermals={"centres": [(0, 0)], "side": 700.0},
        randomization={"airspeed_noise": 0.0},
        decision_hz=120,
    )
    for _ in range(10):
        airspace.step()
    found = airspace.readings["airspeed"]
    swarm = airspace.swarm
    wind = airspace.world.wind.sample(swarm.position[None], np.array([10 / 120]))[0]
    x, y, z, w = swarm.quaternion.T
    ahead = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    expected = (ahead * (swarm.velocity - wind)).sum(axis=1)
    np.testing.assert_allclose(np.ravel(found), expected, rtol=1e-9)
    assert wind[0, 2] > 0.5 > wind[1, 2]
    airspace.close()


def test_it_is_observed():
    aviary = bulletuav.Aviary(
        "crossing",
        num_drones=2,
        dynamics="point_mass",
        observation=("airspeed", "differential_pressure"),
        wind=(1.0, 2.0, 0.0),
        randomization={"airspeed_noise": 0.0},
    )
    rows = aviary.reset(seeds=0)[0]
    labels = [(one.name, one.unit) for one in aviary.observer.labels]
    assert labels == [("airspeed", "m/s"), ("differential pressure", "Pa")]
    np.testing.assert_allclose(rows[:, 1], 0.6125 * rows[:, 0] ** 2, rtol=1e-5)
    aviary.close()
