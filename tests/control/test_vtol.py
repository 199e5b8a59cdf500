"""VTOLs hover, fly on their wings, and lose little height on the way between both."""

import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.control.autopilot import AUTOPILOT_MEMORY, WING_BORNE
from bulletuav.control.gains import MAX_DECELERATION, gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.envelope import find_envelope
from tests.bench import Bench

QUADPLANE = load_airframe("quadplane")
ENVELOPE = find_envelope(QUADPLANE)
POSITION, VELOCITY, ACCELERATION, ATTITUDE, RATES, _ = SetpointLevel
DECISION = 10 / 240
FAST = 14.0
MAX_HEIGHT_CHANGE = 2.0
"""Documented change of height in a transition, m"""
MAX_HEIGHT_CHANGE_FROM_TOP_SPEED = 6.0
"""Documented change of height in a transition from the top speed to another direction, m"""


def hovering(wind=(0, 0, 0)):
    """A quadplane that hovers at 100 m, its nose to the east."""
    bench = Bench("rigid_body", airframe="quadplane", substeps=10, wind=wind)
    bench.swarm.position[..., 2] = 100
    bench.swarm.rotor_speed[..., -1] = 0
    return bench.place()


def trace(bench, level, setpoint, seconds):
    return bench.trace(level, setpoint, round(seconds / DECISION))


def is_wing_borne(bench):
    memory = bench.dynamics.flight.cascade.memory[0, 0]
    return memory[len(memory) - AUTOPILOT_MEMORY + WING_BORNE] > 0


def test_it_hovers_as_a_multirotor():
    bench = hovering()
    position, velocity = trace(bench, VELOCITY, (0, 0, 0, 0), 5)
    assert np.abs(velocity).max() < 0.05
    np.testing.assert_allclose(position[-1], (0, 0, 100), atol=0.05)
    assert bench.swarm.rotor_speed[0, 0, -1] == pytest.approx(0, abs=1)
    assert not is_wing_borne(bench)
    for wanted in ((3, 0, 0), (0, 3, 0), (-3, 0, 0), (0, 0, 2), (0, 0, -2)):
        _, velocity = trace(bench, VELOCITY, (*wanted, 0), 8)
        np.testing.assert_allclose(velocity[-1], wanted, atol=0.3)


@pytest.mark.parametrize("wind", [(0, 0, 0), (4, 0, 0), (-4, 0, 0), (0, 4, 0)])
def test_transitions_keep_the_height(wind):
    bench = hovering(wind)
    position, velocity = trace(bench, VELOCITY, (FAST, 0, 0, 0), 15)
    assert np.ptp(position[:, 2]) < MAX_HEIGHT_CHANGE
    # With the wind it keeps its minimum airspeed
    speed = max(FAST - wind[0], ENVELOPE.min_speed) + wind[0]
    np.testing.assert_allclose(velocity[-1], (speed, 0, 0), atol=0.4)
    assert is_wing_borne(bench)
    # Lift rotors stand still in flight on the wings
    assert bench.swarm.rotor_speed[0, 0, :4].max() < 1
    position, velocity = trace(bench, VELOCITY, (0, 0, 0, 0), 25)
    assert np.ptp(position[:, 2]) < MAX_HEIGHT_CHANGE
    assert np.linalg.norm(velocity[-1]) < 0.3
    assert not is_wing_borne(bench)


def test_a_transition_to_behind_turns_first():
    bench = hovering()
    position, velocity = trace(bench, VELOCITY, (-FAST, 1.0, 0, 0), 20)
    assert np.ptp(position[:, 2]) < MAX_HEIGHT_CHANGE
    np.testing.assert_allclose(velocity[-1], (-FAST, 1, 0), atol=0.4)


@pytest.mark.parametrize("wanted", [(-6, 0), (0, -6), (4, 4)])
@pytest.mark.parametrize(
    ("speed", "most"), [(FAST, MAX_HEIGHT_CHANGE), (20.0, MAX_HEIGHT_CHANGE_FROM_TOP_SPEED)]
)
def test_reversals_and_diagonal_stops_change_the_height_little(speed, most, wanted):
    bench = hovering()
    trace(bench, VELOCITY, (speed, 0, 0, 0), 18)
    position, velocity = trace(bench, VELOCITY, (*wanted, 0, 0), 20)
    assert np.ptp(position[:, 2]) < most
    np.testing.assert_allclose(velocity[-1], (*wanted, 0), atol=0.3)


@pytest.mark.parametrize("descent", [-1.0, -2.0, -3.0])
def test_it_stops_while_it_descends(descent):
    bench = hovering()
    bench.swarm.position[..., 2] = 500
    bench.place()
    trace(bench, VELOCITY, (FAST, 0, 0, 0), 12)
    position, velocity = trace(bench, VELOCITY, (0, 0, descent, 0), 20)
    np.testing.assert_allclose(velocity[-1], (0, 0, descent), atol=0.3)
    # A level stop takes 61 m
    assert position[-1, 0] - position[0, 0] < 67
    commanded = position[0, 2] + descent * DECISION * np.arange(len(position))
    assert np.abs(position[:, 2] - commanded).max() < 16.5
    assert velocity[:, 2].min() > descent - 1


def test_it_does_not_pass_a_position_far_below():
    bench = hovering()
    bench.swarm.position[..., 2] = 200
    bench.place()
    trace(bench, VELOCITY, (FAST, 0, 0, 0), 15)
    goal = bench.swarm.position[0, 0] + (100, 0, -100)
    position, _ = trace(bench, POSITION, (*goal, 0), 45)
    assert position[:, 0].max() < goal[0] + 1
    np.testing.assert_allclose(position[-1], goal, atol=0.3)


def test_a_descent_leads_through_the_transition_without_a_stall():
    bench = hovering()
    position, velocity = trace(bench, VELOCITY, (FAST, 0, -3.0, 0), 20)
    assert velocity[:, 2].min() > -4.5
    assert np.abs(position[:, 1]).max() < 1
    assert is_wing_borne(bench)
    np.testing.assert_allclose(velocity[-1], (FAST, 0, -ENVELOPE.max_sink), atol=0.3)


def test_a_transition_forgets_the_flight_before():
    bench = hovering()
    trace(bench, VELOCITY, (FAST, 0, 0, 0), 12)
    trace(bench, VELOCITY, (FAST, 0, 3.0, 0), 8)
    trace(bench, VELOCITY, (0, 0, 0, 0), 25)
    position, _ = trace(bench, VELOCITY, (FAST, 0, 0, 0), 15)
    first, _ = trace(hovering(), VELOCITY, (FAST, 0, 0, 0), 15)
    assert np.ptp(position[:, 2]) == pytest.approx(np.ptp(first[:, 2]), abs=0.05)


def test_below_the_minimum_speed_it_keeps_its_course_on_its_wings():
    bench = hovering()
    trace(bench, VELOCITY, (FAST, 0, 0, 0), 12)
    _, velocity = trace(bench, VELOCITY, (0.95 * ENVELOPE.min_speed, 0, 0, 0), 12)
    assert is_wing_borne(bench)
    np.testing.assert_allclose(velocity[-1], (ENVELOPE.min_speed, 0, 0), atol=0.3)


def test_it_flies_to_a_position_and_hovers_there():
    bench = hovering()
    _, velocity = trace(bench, POSITION, (200.0, 120.0, 105.0, 0), 25)
    # On its wings on the way
    assert np.linalg.norm(velocity, axis=1).max() > ENVELOPE.min_speed
    position, velocity = trace(bench, POSITION, (200.0, 120.0, 105.0, 0), 35)
    np.testing.assert_allclose(position[-1], (200, 120, 105), atol=0.2)
    assert np.linalg.norm(velocity[-1]) < 0.1


def test_the_transition_has_hysteresis():
    bench = hovering()
    trace(bench, VELOCITY, (FAST, 0, 0, 0), 12)
    slow = 0.95 * ENVELOPE.min_speed
    trace(bench, VELOCITY, (slow, 0, 0, 0), 6)
    assert is_wing_borne(bench)
    trace(bench, VELOCITY, (0.85 * ENVELOPE.min_speed, 0, 0, 0), 1)
    assert not is_wing_borne(bench)
    _, velocity = trace(bench, VELOCITY, (slow, 0, 0, 0), 10)
    assert not is_wing_borne(bench)
    np.testing.assert_allclose(velocity[-1], (slow, 0, 0), atol=0.5)


def test_accelerations_lead_through_the_transition():
    bench = hovering()
    _, velocity = trace(bench, ACCELERATION, (2.0, 0, 0, 0), 8)
    assert is_wing_borne(bench)
    assert velocity[-1, 0] > ENVELOPE.min_speed
    assert np.abs(velocity[:, 2]).max() < 1.5


def test_attitude_and_rates_are_those_of_a_multirotor():
    bench = hovering()
    weight = QUADPLANE.mass * 9.80665
    bench.fly(ATTITUDE, (0.15, 0.0, 0.5, weight), 60)
    assert bench.swarm.rotor_speed[0, 0, -1] == pytest.approx(0, abs=1)
    # A positive roll accelerates to the right
    assert bench.swarm.velocity[0, 0, 1] < -0.5
    bench = hovering()
    bench.fly(RATES, (0, 0, 0.3, weight), 24)
    assert bench.swarm.rates[0, 0, 2] == pytest.approx(0.3, abs=0.1)


def test_it_holds_a_position_in_wind():
    bench = hovering((5.0, 2.0, 0.0))
    position, _ = trace(bench, POSITION, (0, 0, 100, 0), 30)
    np.testing.assert_allclose(position[-1], (0, 0, 100), atol=0.3)


def test_the_deceleration_is_that_of_a_glide():
    row, other = gain_rows([QUADPLANE, load_airframe("cf2x")], 10.0)
    glide = 9.80665 * ENVELOPE.max_sink / ENVELOPE.cruise_speed
    assert row["max_deceleration"] == pytest.approx(0.6 * glide)
    assert other["max_deceleration"] == MAX_DECELERATION
    # The forward rotor has no part in hovering
    assert (row["mixer"][4] == 0).all()
