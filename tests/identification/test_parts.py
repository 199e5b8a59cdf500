"""Parts of the identification against numbers computed elsewhere."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav import load_airframe
from bulletuav.geometry.quaternions import multiply_quaternions, rotate_vectors
from bulletuav.identification.battery import fit_battery
from bulletuav.identification.constants import CONSTANTS, choose_constants
from bulletuav.identification.errors import conjugate
from bulletuav.identification.example import fly_example
from bulletuav.identification.identify import _limit_yaw_inertia, identify
from bulletuav.identification.intervals import Information, newey_west, quantile
from bulletuav.identification.logs import Log
from bulletuav.identification.smoothing import compute_body_rates
from bulletuav.vehicle.battery import VOLTS


def test_rates_of_a_steady_turn():
    rates = np.array([0.5, -1.0, 2.0])
    time = np.arange(0, 2, 0.01)
    turns = Rotation.from_euler("xyz", (0.3, 0.2, 1.0)) * Rotation.from_rotvec(
        time[:, None] * rates
    )
    np.testing.assert_allclose(
        compute_body_rates(time, turns.as_quat()), np.tile(rates, (200, 1)), atol=1e-5
    )


def test_products_of_quaternions_are_those_of_scipy():
    p, q = (Rotation.random(5, random_state=k) for k in (1, 2))
    found = multiply_quaternions(p.as_quat(), q.as_quat())
    np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), (p * q).as_matrix())
    np.testing.assert_allclose(multiply_quaternions(p.as_quat(), conjugate(p.as_quat()))[:, 3], 1.0)
    vectors = np.random.default_rng(3).normal(size=(5, 3))
    np.testing.assert_allclose(rotate_vectors(p.as_quat(), vectors), p.apply(vectors))


def test_every_constant_is_read_and_replaced():
    drone = load_airframe("cf2x")
    for constant in CONSTANTS:
        number = constant.encode(drone)
        assert constant.decode(number) == pytest.approx(constant.get(drone))
        other = constant.replace(drone, 1.25 * constant.get(drone))
        assert constant.get(other) == pytest.approx(1.25 * constant.get(drone))
        differing = [one.name for one in CONSTANTS if one.get(one.replace(other, 1.0)) != 1.0]
        assert not differing
        rest = [one for one in CONSTANTS if one.get(other) != one.get(drone)]
        assert rest == [constant]


def test_a_group_stands_for_its_constants():
    names = [one.name for one in choose_constants(["inertia", "inertia_x"], False, False)]
    assert names == ["inertia_x", "inertia_y", "inertia_z"]


def test_newey_west_by_hand():
    # 1, 2, 3, 4: squares 30, neighbours 20, next ones 11; reach 3 weighs 3/4, 1/2, 1/4
    scores = np.array([[1.0], [2.0], [3.0], [4.0]])
    # lag 3 is 4; 30 + 2 (0.75 20 + 0.5 11 + 0.25 4) = 73
    assert newey_west(scores) == pytest.approx(73.0)


def test_intervals_of_a_mean_are_those_of_students_t():
    # One number, windows of one error each: the jackknife of a mean
    values = np.random.default_rng(0).standard_normal(200)
    off = values - values.mean()
    known = Information([np.ones((200, 1, 1))], [off[:, None]], np.zeros(1), np.zeros(1))
    spread = np.sqrt(known.covariance(np.array([0]))[0, 0])
    assert spread == pytest.approx(values.std(ddof=1) / np.sqrt(200), rel=0.2)
    assert quantile(11, 1) == pytest.approx(2.2281, abs=1e-4)  # t, 97.5 %, 10 degrees of freedom


def test_intervals_hold_for_correlated_errors():
    # The mean of 400 errors that follow e' = e / 2 + noise: 2 deviations of independent ones
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(300):
        noise = rng.standard_normal(500)
        for k in range(1, 500):
            noise[k] += 0.5 * noise[k - 1]
        values = noise[100:]
        off = values - values.mean()
        known = Information([np.ones((400, 1, 1))], [off[:, None]], np.zeros(1), np.zeros(1))
        spread = np.sqrt(known.covariance(np.array([0]))[0, 0])
        inside += abs(values.mean()) < quantile(400, 1) * spread
    assert 0.88 < inside / 300 < 0.98


def test_an_inertia_that_no_body_has_is_taken_down_with_the_torque():
    drone = load_airframe("cf2x")
    flat = dataclasses.replace(drone, inertia=(1e-5, 1.5e-5, 2.93e-5))
    found, note = _limit_yaw_inertia(flat, ())
    assert found.inertia == (1e-5, 1.5e-5, 2.475e-5)
    assert found.torque_ratio / found.inertia[2] == pytest.approx(
        drone.torque_ratio / 2.93e-5, rel=1e-4
    )
    assert "inertia_z of 2.93e-05" in note
    assert _limit_yaw_inertia(drone, ()) == (drone, "")


def battery_log(charge, capacity, resistance, path):
    """A battery's voltage by its own laws, written out: V = E - R I with steps of current."""
    time = np.arange(0, 240, 0.02)
    current = 2.0 + 0.8 * np.sign(np.sin(0.7 * time)) + 0.3 * np.sin(0.23 * time)
    volts = np.empty_like(time)
    left = charge
    for k, ampere in enumerate(current):
        rest = np.interp(10 * left, np.arange(11), VOLTS)
        volts[k] = rest - resistance * ampere
        left -= volts[k] * ampere * 0.02 / 3600 / capacity
    noise = 0.005 * np.random.default_rng(0).standard_normal(len(time))
    return Log(path, {"t": time, "vbat": volts + noise, "current": current}, {})


def test_a_battery_comes_back_within_its_intervals(tmp_path):
    drone = load_airframe("cf2x")
    found = fit_battery([battery_log(0.95, 0.85, 0.11, tmp_path)], drone)
    assert found.is_identified == (True, True)
    for (value, low, high), true in ((found.resistance, 0.11), (found.capacity, 0.85)):
        assert low <= true <= high
        assert value == pytest.approx(true, rel=0.03)
    assert found.start[0] == pytest.approx(0.95, abs=0.02)
    assert found.error[0] == pytest.approx(0.005, rel=0.2)
    assert found.error[1] == pytest.approx(0.005, rel=0.2)
    changed = found.apply_to(drone)
    assert (changed.pack.resistance, changed.pack.capacity) == (
        found.resistance[0],
        found.capacity[0],
    )


def test_wings_are_not_identified():
    for start in (
        lambda: identify([], "trainer"),
        lambda: fly_example(load_airframe("trainer"), 1.0, seed=0),
    ):
        with pytest.raises(ValueError, match="'trainer' has wings, .* pass a multirotor"):
            start()
