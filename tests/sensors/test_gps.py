import numpy as np
import pytest
import sensing

from bulletuav.sensors.gps import VELOCITY_FRACTION, Gps


def readings(gps, count, seed=0):
    rng = np.random.default_rng(seed)
    still = sensing.swarm_of(1, gps.noise.shape[1])
    sensing.start(gps, 0, still, rng)
    rows = []
    for _ in range(count):
        sensing.measure(gps, still, rngs=[rng])
        rows.append((gps.position[0].copy(), gps.velocity[0].copy()))
    return np.array(rows)  # (count, 2, N, 3)


def test_without_errors_it_reads_the_truth():
    gps = sensing.sensor_of(Gps, (2, 3))
    rng = np.random.default_rng(0)
    position, velocity = rng.normal(size=(2, 3, 3))
    sensing.start(gps, 1, sensing.swarm_of(2, 3, position, velocity), rng)
    np.testing.assert_array_equal(gps.position[1], position)
    np.testing.assert_array_equal(gps.velocity[1], velocity)
    assert not gps.position[0].any()


def test_white_noise_has_the_standard_deviation_asked_for():
    gps = sensing.sensor_of(Gps, (1, 40))
    gps.noise[:] = np.tile((2.0, 0.5), 20)  # of twenty pairs of drones
    rows = readings(gps, 1000).reshape(1000, 2, 20, 2, 3)
    expected = np.array([[2.0] * 3, [0.5] * 3])
    np.testing.assert_allclose(rows[:, 0].std(axis=(0, 1)), expected, rtol=0.03)
    np.testing.assert_allclose(rows[:, 1].std(axis=(0, 1)), VELOCITY_FRACTION * expected, rtol=0.03)
    before, after = rows[:-1, 0, :, 0, 0].ravel(), rows[1:, 0, :, 0, 0].ravel()
    assert abs(np.corrcoef(before, after)[0, 1]) < 0.03


@pytest.mark.parametrize("period", [0.1, 0.02])
def test_the_walk_grows_with_the_root_of_time_whatever_the_period(period):
    gps = sensing.sensor_of(Gps, (1, 4000), period=period)
    gps.walk[:] = 0.3
    rows = readings(gps, round(4 / period))
    assert rows[-1, 0].std() == pytest.approx(0.3 * 2, rel=0.03)
    assert rows[round(1 / period) - 1, 0].std() == pytest.approx(0.3, rel=0.03)


def test_readings_that_fail_leave_the_last_ones():
    gps = sensing.sensor_of(Gps, (1, 20))
    gps.noise[:], gps.dropout[:] = 1.0, 0.25
    same = (np.diff(readings(gps, 1000), axis=0) == 0).all(axis=(1, 3))
    assert same.mean() == pytest.approx(0.25, abs=0.02)
    gps.dropout[:] = 1.0
    assert (np.diff(readings(gps, 10)[:, 0, 0], axis=0) == 0).all()


def test_worlds_that_do_not_fly_keep_their_readings_and_draw_nothing():
    gps = sensing.sensor_of(Gps, (2, 1))
    gps.noise[:] = gps.walk[:] = 1.0
    rng = np.random.default_rng(0)
    still = sensing.swarm_of(2, 1)
    for k in range(2):
        sensing.start(gps, k, still, rng)
    first, drift = gps.position.copy(), gps._drift.copy()
    sensing.measure(gps, still, mask=[[True], [False]], rngs=[rng, None])
    assert (gps.position[0] != first[0]).all()
    np.testing.assert_array_equal(gps.position[1], first[1])
    np.testing.assert_array_equal(gps._drift[1], drift[1])
