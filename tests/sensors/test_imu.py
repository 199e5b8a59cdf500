import math

import numpy as np
import pytest
import sensing
from scipy.spatial.transform import Rotation

from bulletuav.sensors.imu import Imu

G = 9.80665
KINDS = ("accelerometer", "gyroscope")


def feel(period=0.1, before=0.0, gravity=G, attitude=None, **state):
    """Readings of one drone without errors that had the velocity `before`."""
    turn = sensing.LEVEL if attitude is None else attitude.as_quat()
    imu = sensing.sensor_of(Imu, period=period, gravity=gravity)
    after = sensing.swarm_of(1, 1, quaternion=turn, **state)
    sensing.measure(imu, after, before=sensing.swarm_of(1, 1, velocity=before))
    return imu.acceleration[0, 0], imu.rates[0, 0]


def errors(imu, count, seed=0):
    """(count, 2, N, 3) what world 0 reads at rest, beyond the truth."""
    rng = np.random.default_rng(seed)
    still = sensing.swarm_of(*imu.rates.shape[:2])
    sensing.start(imu, 0, still, rng)
    rows = np.empty((count, 2, imu.rates.shape[1], 3))
    for row in rows:
        sensing.measure(imu, still, rngs=[rng])
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
    """Tilted by 30 degrees in level flight the thrust is G / cos 30.

    The drone accelerates by G tan 30.
    """
    tilt = Rotation.from_euler("y", 30, degrees=True)
    acceleration, _ = feel(attitude=tilt, velocity=(0.1 * G * math.tan(math.pi / 6), 0.0, 0.0))
    np.testing.assert_allclose(acceleration, (0, 0, G / math.cos(math.pi / 6)), atol=1e-13)


@pytest.mark.parametrize("kind", range(2), ids=KINDS)
def test_white_noise_has_the_standard_deviation_asked_for(kind):
    imu, count = sensing.sensor_of(Imu, (1, 40), period=0.01), 20000
    getattr(imu, f"{KINDS[kind]}_noise")[:] = np.tile((2.0, 0.5), 20)  # of twenty pairs of drones
    rows = errors(imu, count // 20).reshape(-1, 2, 20, 2, 3).swapaxes(1, 2)
    expected = np.zeros((2, 2, 3))
    expected[kind] = [[2.0] * 3, [0.5] * 3]
    np.testing.assert_allclose(
        rows.std(axis=(0, 1)), expected, rtol=5 / math.sqrt(2 * count)
    )  # five of its standard errors
    assert (np.abs(rows.mean(axis=(0, 1))) <= 5 * expected / math.sqrt(count)).all()
    columns = rows[:, :, kind].reshape(-1, 20, 6)
    both = np.concatenate([columns[:-1], columns[1:]], axis=-1).reshape(-1, 12)
    correlations = np.corrcoef(both.T) - np.eye(12)
    assert np.abs(correlations).max() < 5 / math.sqrt(count)


@pytest.mark.parametrize("period", [0.1, 0.02])
@pytest.mark.parametrize("kind", range(2), ids=KINDS)
def test_biases_walk_with_the_root_of_time_whatever_the_period(kind, period):
    drones = 4000
    imu = sensing.sensor_of(Imu, (1, drones), period=period)
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
    imu, count = sensing.sensor_of(Imu, (1, 20)), 20000
    imu.accelerometer_noise[:] = imu.gyroscope_noise[:] = 1.0
    force, rates = errors(imu, count // 20).swapaxes(0, 1).reshape(2, count, 3)
    assert np.abs(np.corrcoef(force.T, rates.T)[:3, 3:]).max() < 5 / math.sqrt(count)


def test_white_noise_and_steps_of_the_bias_are_independent():
    imu, count = sensing.sensor_of(Imu, (1, 20), period=1.0), 20000
    imu.accelerometer_noise[:] = imu.gyroscope_noise[:] = 1.0
    imu.accelerometer_walk[:] = imu.gyroscope_walk[:] = 1.0
    steps = np.diff(errors(imu, count // 20), axis=0)
    np.testing.assert_allclose(
        steps.var(axis=(0, 2)), 1 + 2, rtol=5 * math.sqrt(22 / 9 / count)
    )  # 2 sum of squared correlations


def test_the_first_readings_of_an_episode_are_of_steady_flight_with_noise_but_without_bias():
    imu, drones = sensing.sensor_of(Imu, (2, 2000)), 2000
    imu.gyroscope_walk[:] = 100.0
    imu.accelerometer_noise[1] = 2.0
    swarm = sensing.swarm_of(2, drones, velocity=(5.0, 0.0, 0.0), rates=(0.1, 0.2, 0.3))
    rng = np.random.default_rng(0)
    sensing.start(imu, 1, swarm, rng)
    np.testing.assert_array_equal(imu.rates[1], np.tile((0.1, 0.2, 0.3), (drones, 1)))
    white = imu.acceleration[1] - (0, 0, G)
    assert white.std() == pytest.approx(2, rel=5 / math.sqrt(2 * 3 * drones))
    assert not imu.acceleration[0].any()
    second = np.repeat([[False], [True]], drones, axis=1)
    sensing.measure(imu, swarm, mask=second, rngs=[None, rng])
    assert np.abs(imu.rates[1]).max() > 1
    sensing.start(imu, 1, swarm, rng)
    np.testing.assert_array_equal(imu.rates[1], np.tile((0.1, 0.2, 0.3), (drones, 1)))


def test_worlds_that_do_not_fly_keep_their_readings_and_draw_nothing():
    imu, swarm = sensing.sensor_of(Imu, (2, 1)), sensing.swarm_of(2, 1)
    imu.accelerometer_noise[:] = imu.gyroscope_noise[:] = 1.0
    imu.accelerometer_walk[:] = imu.gyroscope_walk[:] = 1.0
    rng = np.random.default_rng(0)
    for k in range(2):
        sensing.start(imu, k, swarm, rng)
    acceleration, rates, bias = imu.acceleration.copy(), imu.rates.copy(), imu._bias.copy()
    sensing.measure(imu, swarm, mask=[[True], [False]], rngs=[rng, None])
    assert (imu.acceleration[0] != acceleration[0]).all()
    assert (imu.rates[0] != rates[0]).all()
    np.testing.assert_array_equal(imu.acceleration[1], acceleration[1])
    np.testing.assert_array_equal(imu.rates[1], rates[1])
    np.testing.assert_array_equal(imu._bias[1], bias[1])


def test_worlds_do_not_feel_each_other_and_draw_only_where_asked_for():
    together, alone = sensing.sensor_of(Imu, (2, 3)), sensing.sensor_of(Imu, (1, 3))
    together.gyroscope_noise[1] = alone.gyroscope_noise[0] = 1.0
    exact, noisy, same = (np.random.default_rng(seed) for seed in (1, 0, 0))
    two, one = sensing.swarm_of(2, 3), sensing.swarm_of(1, 3)
    sensing.start(together, 0, two, exact)
    sensing.start(together, 1, two, noisy)
    sensing.start(alone, 0, one, same)
    for _ in range(3):
        sensing.measure(together, two, rngs=[exact, noisy])
        sensing.measure(alone, one, rngs=[same])
    np.testing.assert_array_equal(together.rates[1], alone.rates[0])
    assert not together.rates[0].any()
    assert exact.random() == np.random.default_rng(1).random()
