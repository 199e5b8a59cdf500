import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav.sensors.imu import Imu
from bulletuav.vehicle.swarm import Swarm

G = 9.80665
KINDS = ("acceleration", "rates")


def swarm_of(worlds, drones, attitude=None, velocity=0.0, rates=0.0):
    swarm = Swarm.zeros(worlds, drones, 4)
    if attitude is not None:
        swarm.quaternion[:] = attitude.as_quat()
    swarm.velocity[:], swarm.rates[:] = velocity, rates
    return swarm


def feel(period=0.1, before=0.0, gravity=G, **state):
    """Readings of one drone without errors that had the velocity `before`."""
    imu, after = Imu((1, 1), period, gravity), swarm_of(1, 1, **state)
    imu.read(swarm_of(1, 1, velocity=before), after, np.ones(1, dtype=bool), [None])
    return imu.acceleration[0, 0], imu.rates[0, 0]


def errors(imu, count, seed=0):
    """(count, 2, N, 3) what world 0 reads at rest, beyond the truth."""
    rng = np.random.default_rng(seed)
    still = swarm_of(*imu.rates.shape[:2])
    imu.start(0, still, rng)
    rows = np.empty((count, 2, imu.rates.shape[1], 3))
    for row in rows:
        imu.read(still, still, np.ones(len(imu.rates), dtype=bool), [rng])
        row[:] = imu.acceleration[0] - (0, 0, G), imu.rates[0]
    return rows


@pytest.mark.parametrize(
    ("axis", "degrees", "force"),
    [
        ("x", 0, (0, 0, G)),
        ("x", 90, (0, G, 0)),
        ("y", 90, (-G, 0, 0)),
        ("z", 77, (0, 0, G)),
        ("x", 180, (0, 0, -G)),
    ],
)
def test_at_rest_it_feels_gravity_upwards(axis, degrees, force):
    acceleration, rates = feel(attitude=Rotation.from_euler(axis, degrees, degrees=True))
    np.testing.assert_allclose(acceleration, force, atol=1e-14)
    assert not rates.any()


def test_in_free_fall_it_feels_nothing_however_it_turns():
    for seed in range(5):
        attitude = Rotation.random(random_state=seed)
        acceleration, rates = feel(
            attitude=attitude,
            before=(3.0, -2.0, 1.0),
            velocity=(3.0, -2.0, 1.0 - 0.1 * G),
            rates=2.0,
        )
        np.testing.assert_allclose(acceleration, 0, atol=1e-13)
        np.testing.assert_array_equal(rates, 2.0)


def test_acceleration_to_the_north_is_felt_ahead_when_facing_it():
    north = Rotation.from_euler("z", 90, degrees=True)
    acceleration, _ = feel(
        period=0.02, attitude=north, before=(0.0, 1.0, 0.0), velocity=(0.0, 1.1, 0.0)
    )
    np.testing.assert_allclose(acceleration, (5, 0, G), atol=1e-12)
    acceleration, _ = feel(gravity=1.62, velocity=(-0.3, 0.2, 0.1))
    np.testing.assert_allclose(acceleration, (-3, 2, 2.62), atol=1e-12)


def test_a_thrust_along_the_body_is_felt_along_the_body():
    """Tilted by 30 degrees in level flight, the thrust is G / cos 30 and the drone accelerates by G tan 30."""
    tilt = Rotation.from_euler("y", 30, degrees=True)
    acceleration, _ = feel(attitude=tilt, velocity=(0.1 * G * math.tan(math.pi / 6), 0.0, 0.0))
    np.testing.assert_allclose(acceleration, (0, 0, G / math.cos(math.pi / 6)), atol=1e-13)


@pytest.mark.parametrize("kind", range(2), ids=KINDS)
def test_white_noise_has_the_standard_deviation_asked_for(kind):
    imu, count = Imu((1, 2), 0.01), 20000
    getattr(imu, f"{KINDS[kind]}_noise")[:] = (2.0, 0.5)
    rows = errors(imu, count)
    expected = np.zeros((2, 2, 3))
    expected[kind] = [[2.0] * 3, [0.5] * 3]
    np.testing.assert_allclose(
        rows.std(axis=0), expected, rtol=5 / math.sqrt(2 * count)
    )  # five of its standard errors
    assert (np.abs(rows.mean(axis=0)) <= 5 * expected / math.sqrt(count)).all()
    columns = rows[:, kind].reshape(count, 6)
    correlations = np.corrcoef(np.concatenate([columns[:-1], columns[1:]], axis=1).T) - np.eye(12)
    assert np.abs(correlations).max() < 5 / math.sqrt(count)


@pytest.mark.parametrize("period", [0.1, 0.02])
@pytest.mark.parametrize("kind", range(2), ids=KINDS)
def test_biases_walk_with_the_root_of_time_whatever_the_period(kind, period):
    drones = 4000
    imu = Imu((1, drones), period)
    getattr(imu, f"{KINDS[kind]}_walk")[:] = 0.3
    rows = errors(imu, round(4 / period))
    error = 5 / math.sqrt(2 * 3 * drones)
    first, last = rows[round(1 / period) - 1], rows[-1]
    assert first[kind].std() == pytest.approx(0.3, rel=error)
    assert last[kind].std() == pytest.approx(0.6, rel=error)
    np.testing.assert_allclose(rows[:, 1 - kind], 0, atol=1e-14)
    rest = last[kind] - first[kind]
    assert abs(np.corrcoef(rest.ravel(), first[kind].ravel())[0, 1]) < 5 / math.sqrt(3 * drones)


def test_accelerometer_and_gyroscope_err_apart_from_each_other():
    imu, count = Imu((1, 1), 0.1), 20000
    imu.acceleration_noise[:] = imu.rates_noise[:] = 1.0
    rows = errors(imu, count)[:, :, 0]
    assert np.abs(np.corrcoef(rows[:, 0].T, rows[:, 1].T)[:3, 3:]).max() < 5 / math.sqrt(count)


def test_white_noise_and_steps_of_the_bias_are_independent():
    imu, count = Imu((1, 1), 1.0), 20000
    imu.acceleration_noise[:] = imu.acceleration_walk[:] = imu.rates_noise[:] = imu.rates_walk[
        :
    ] = 1.0
    steps = np.diff(errors(imu, count)[:, :, 0], axis=0)
    np.testing.assert_allclose(
        steps.var(axis=0), 1 + 2, rtol=5 * math.sqrt(22 / 9 / count)
    )  # 2 sum of squared correlations


def test_the_first_readings_of_an_episode_are_of_steady_flight_with_noise_but_without_bias():
    imu, drones = Imu((2, 2000), 0.1), 2000
    imu.rates_walk[:] = 100.0
    imu.acceleration_noise[1] = 2.0
    swarm, rng = (
        swarm_of(2, drones, velocity=(5.0, 0.0, 0.0), rates=(0.1, 0.2, 0.3)),
        np.random.default_rng(0),
    )
    imu.start(1, swarm, rng)
    np.testing.assert_array_equal(imu.rates[1], np.tile((0.1, 0.2, 0.3), (drones, 1)))
    white = imu.acceleration[1] - (0, 0, G)
    assert white.std() == pytest.approx(2, rel=5 / math.sqrt(2 * 3 * drones))
    assert not imu.acceleration[0].any()
    imu.read(swarm, swarm, np.array([False, True]), [None, rng])
    assert np.abs(imu.rates[1]).max() > 1
    imu.start(1, swarm, rng)
    np.testing.assert_array_equal(imu.rates[1], np.tile((0.1, 0.2, 0.3), (drones, 1)))


def test_worlds_that_do_not_fly_keep_their_readings_and_draw_nothing():
    imu, swarm = Imu((2, 1), 0.1), swarm_of(2, 1)
    imu.acceleration_noise[:] = imu.rates_noise[:] = imu.acceleration_walk[:] = imu.rates_walk[
        :
    ] = 1.0
    rng = np.random.default_rng(0)
    for k in range(2):
        imu.start(k, swarm, rng)
    acceleration, rates, bias = imu.acceleration.copy(), imu.rates.copy(), imu._bias.copy()
    imu.read(swarm, swarm, np.array([True, False]), [rng, None])
    assert (imu.acceleration[0] != acceleration[0]).all()
    assert (imu.rates[0] != rates[0]).all()
    np.testing.assert_array_equal(imu.acceleration[1], acceleration[1])
    np.testing.assert_array_equal(imu.rates[1], rates[1])
    np.testing.assert_array_equal(imu._bias[1], bias[1])


def test_worlds_do_not_feel_each_other_and_draw_only_where_asked_for():
    together, alone = Imu((2, 3), 0.1), Imu((1, 3), 0.1)
    together.rates_noise[1] = alone.rates_noise[0] = 1.0
    exact, noisy, same = (np.random.default_rng(seed) for seed in (1, 0, 0))
    two, one = swarm_of(2, 3), swarm_of(1, 3)
    together.start(0, two, exact)
    together.start(1, two, noisy)
    alone.start(0, one, same)
    for _ in range(3):
        together.read(two, two, np.ones(2, dtype=bool), [exact, noisy])
        alone.read(one, one, np.ones(1, dtype=bool), [same])
    np.testing.assert_array_equal(together.rates[1], alone.rates[0])
    assert not together.rates[0].any()
    assert exact.random() == np.random.default_rng(1).random()
