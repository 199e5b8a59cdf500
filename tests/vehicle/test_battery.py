import numpy as np
import pytest

from bulletuav.vehicle.battery import (
    Battery,
    battery_speed_ratio,
    loaded_voltage,
    resting_voltage,
)

# W, W, W, m/s, see test_power.py
HOVER = 168.4842
LONGEST = 126.0027
FARTHEST = 161.5216
FARTHEST_SPEED = 18.295


def time_to_depletion(power, capacity, seconds):
    battery, flying = Battery((1, 1), capacity), np.ones((1, 1), dtype=bool)
    steps = 0
    while not battery.depleted[0, 0]:
        battery.drain(np.full((1, 1), power), seconds, flying)
        steps += 1
    return steps * seconds


@pytest.mark.parametrize(("power", "minutes"), [(HOVER, 31.77), (LONGEST, 42.48)])
def test_how_long_89_watt_hours_last(power, minutes):
    assert time_to_depletion(power, 89.2, 0.1) / 60 == pytest.approx(minutes, abs=5e-3 + 0.1 / 60)


def test_how_far_89_watt_hours_reach():
    assert time_to_depletion(FARTHEST, 89.2, 0.1) * FARTHEST_SPEED / 1000 == pytest.approx(
        36.37, abs=5e-3
    )


def test_the_share_left_is_what_was_not_taken_whatever_the_period():
    for seconds in (0.02, 0.1, 36.0):
        battery = Battery((1, 2), np.array([1.0, 4.0]))
        for _ in range(round(360 / seconds)):
            battery.drain(np.full((1, 2), 5.0), seconds, np.ones((1, 2), dtype=bool))
        np.testing.assert_allclose(battery.charge, [[0.5, 0.875]], rtol=1e-10)
        assert not battery.depleted.any()


def test_drones_that_do_not_fly_keep_their_charge():
    battery = Battery((1, 3), 1.0)
    battery.drain(np.array([[1800.0, np.nan, 1800.0]]), 1.0, np.array([[True, False, False]]))
    np.testing.assert_array_equal(battery.charge, [[0.5, 1.0, 1.0]])


def test_an_empty_battery_stays_at_zero():
    battery = Battery((1, 2), 1.0)
    flying = np.ones((1, 2), dtype=bool)
    battery.drain(np.array([[3600.0, 1800.0]]), 1.0, flying)
    np.testing.assert_array_equal(battery.depleted, [[True, False]])
    battery.drain(np.array([[3600.0, 3600.0]]), 1.0, flying)
    np.testing.assert_array_equal(battery.charge, [[0.0, 0.0]])
    assert battery.depleted.all()


def test_a_world_starts_full_or_as_told_and_leaves_the_others():
    battery = Battery((3, 2), np.full((3, 2), 1.0))
    battery.drain(np.full((3, 2), 900.0), 1.0, np.ones((3, 2), dtype=bool))
    battery.start(0)
    battery.start(1, np.array([0.5, 0.25]))
    np.testing.assert_array_equal(battery.charge, [[1.0, 1.0], [0.5, 0.25], [0.75, 0.75]])


@pytest.mark.parametrize("capacity", [0.0, -1.0, np.nan, "full", np.array([1.0, 0.0])])
def test_a_battery_without_capacity_is_refused(capacity):
    with pytest.raises(ValueError, match="capacity is "):
        Battery((1, 2), capacity)


@pytest.mark.parametrize("charge", [0.0, 1.01, np.nan, "full", np.array([0.5, -0.5])])
def test_a_start_without_charge_is_refused_and_changes_nothing(charge):
    battery = Battery((1, 2), 1.0)
    with pytest.raises(ValueError, match="charge is "):
        battery.start(0, charge)
    np.testing.assert_array_equal(battery.charge, 1.0)


# Voltage


def test_a_resting_cell_by_the_table():
    assert [resting_voltage(charge) for charge in (0.0, 0.1, 0.5, 1.0)] == [3.27, 3.69, 3.84, 4.20]
    assert resting_voltage(0.95) == pytest.approx((4.11 + 4.20) / 2)
    assert resting_voltage(-0.2) == 3.27
    assert resting_voltage(1.5) == 4.20
    volts = [resting_voltage(charge) for charge in np.linspace(0, 1, 500)]
    assert (np.diff(volts) > 0).all()


def test_a_loaded_cell_by_hand():
    """4 V with 0.16 ohm at 2 A: 3.68 V, so 7.36 W."""
    assert loaded_voltage(4.0, 7.36, 0.16) == pytest.approx(3.68)
    assert loaded_voltage(4.0, 0.0, 0.16) == 4.0
    assert loaded_voltage(4.0, 7.36, 0.0) == 4.0
    # The most that it can give is E^2 / 4 R = 25 W
    assert loaded_voltage(4.0, 25.0, 0.16) == pytest.approx(2.0)
    assert loaded_voltage(4.0, 99.0, 0.16) == 2.0


def test_motors_turn_slower_at_a_lower_voltage():
    assert battery_speed_ratio(3.57, 3.57) == 1.0
    assert battery_speed_ratio(0.9 * 3.57, 3.57) == pytest.approx(1 - 0.089)
    assert battery_speed_ratio(0.0, 3.57) == pytest.approx(0.11)
