"""Actions become setpoints."""

import dataclasses

import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.control.actions import ACTIONS, ActionContext, limit_norm, make_action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import names
from bulletuav.vehicle.envelope import find_envelope


@pytest.fixture
def context():
    return ActionContext(
        [load_airframe("cf2x")],
        10.0,
        10.0,
        np.array((-20.0, -10, 0)),
        np.array((20.0, 30, 8)),
        0.1,
        9.80665,
    )


def decode(name, context, action):
    commanded = np.array([[(1.0, 2.0, -1.0)]])
    return make_action(name, context).decode(np.array(action, float).reshape(1, 1, -1), commanded)[
        0, 0
    ]


def test_velocity_scales_and_limits_the_norm(context):
    np.testing.assert_allclose(decode("velocity", context, (0.3, -0.4, 0)), (3, -4, 0, 0))
    np.testing.assert_allclose(decode("velocity", context, (1, 1, 1)), (*[10 / np.sqrt(3)] * 3, 0))


def test_acceleration_scales_to_half_of_gravity_and_limits_the_norm(context):
    half = context.gravity / 2
    np.testing.assert_allclose(
        decode("acceleration", context, (0.3, -0.4, 0)), (0.3 * half, -0.4 * half, 0, 0)
    )
    longest = decode("acceleration", context, (1, 1, 1))[:3]
    np.testing.assert_allclose(longest, np.full(3, half / np.sqrt(3)))


def test_target_position_spans_the_arena(context):
    np.testing.assert_allclose(decode("target_position", context, (-1, 1, 0)), (-20, 30, 4, 0))


def test_rotor_is_linear_in_thrust(context):
    most = context.airframes[0].max_rotor_speed
    np.testing.assert_allclose(
        decode("rotor", context, (-1, 1, 0, -0.5)) ** 2, np.array((0, 1, 0.5, 0.25)) * most**2
    )


def test_velocity_increment_adds_to_what_was_commanded(context):
    np.testing.assert_allclose(decode("velocity_increment", context, (0.5, -1, 0)), (1.5, 1, -1, 0))
    fast = make_action("velocity_increment", context).decode(
        np.ones((1, 1, 3)), np.array([[(6.0, 8.0, 0.0)]])
    )
    assert np.linalg.norm(fast[0, 0, :3]) == pytest.approx(10)


def test_heading_speed_points_the_nose(context):
    np.testing.assert_allclose(
        decode("heading_speed", context, (0.5, 0, 0)), (0, 5, 0, np.pi / 2), atol=1e-12
    )
    np.testing.assert_allclose(
        decode("heading_speed", context, (0, -1, 0.3)), (0, 0, 3, 0), atol=1e-12
    )
    np.testing.assert_allclose(
        np.linalg.norm(decode("heading_speed", context, (0.2, 1, 1))[:3]), 10
    )


def test_heading_speed_climb_spans_the_limits_of_each_airframe(context):
    trainer = load_airframe("trainer")
    envelope = find_envelope(trainer)
    fleet = dataclasses.replace(
        context, airframes=[context.airframes[0], trainer], max_speed=20.0, max_climb=3.0
    )
    action = make_action("heading_speed_climb", fleet)

    def decoded(*numbers):
        return action.decode(np.tile(np.array(numbers, float), (1, 2, 1)), np.zeros((1, 2, 3)))[0]

    slow, fast = decoded(0.5, -1, 0), decoded(0, 1, 0)
    np.testing.assert_allclose(slow[0], (0, 0, 0, np.pi / 2), atol=1e-12)
    np.testing.assert_allclose(slow[1], (0, envelope.min_speed, 0, np.pi / 2), atol=1e-12)
    np.testing.assert_allclose(fast[0], (context.airframes[0].max_speed, 0, 0, 0), atol=1e-12)
    np.testing.assert_allclose(fast[1], (envelope.max_speed, 0, 0, 0), atol=1e-12)
    # The climb has priority over the speed, and the minimum speed over the climb
    up, down = decoded(0, 1, 1), decoded(0, -1, -1)
    assert up[:, 2].tolist() == [3.0, 3.0]
    assert np.hypot(up[0, 0], 3) == pytest.approx(context.airframes[0].max_speed)
    np.testing.assert_allclose(down[:, 2], (-3, -envelope.max_sink))
    assert down[1, 0] == pytest.approx(envelope.min_speed)
    assert f"{envelope.min_speed:.3f}" in action.labels[1][1]
    # Velocities within the limits are encoded and decoded
    wanted = np.array([[(3.0, -4.0, 1.0), (-9.0, 8.0, -0.5)]])
    again = action.decode(action.encode(wanted, None), np.zeros((1, 2, 3)))
    np.testing.assert_allclose(again[..., :3], wanted, rtol=1e-12)


def test_rotor_actions_have_a_number_for_each_control_surface(context):
    trainer = load_airframe("trainer")
    fleet = dataclasses.replace(context, airframes=[context.airframes[0], trainer])
    for name, speed in (("rotor", 1.0), ("rpm", trainer.max_rotor_speed * 30 / np.pi)):
        action = make_action(name, fleet)
        assert [action.size(0), action.size(1), action.low.shape] == [4, 5, (2, 5)]
        assert action.labels[1][1:] == (
            "left aileron: -1 to 1 for -22.9183 to 22.9183 degrees",
            *action.labels[1][2:],
        )
        numbers = np.zeros((1, 2, 5))
        numbers[0, 1] = speed, 1, -1, 0.5, 0
        setpoint = action.decode(numbers, np.zeros((1, 2, 3)))[0, 1]
        aileron, _, elevator, _ = trainer.surfaces
        np.testing.assert_allclose(
            setpoint,
            (trainer.max_rotor_speed, aileron.high, aileron.low, 0.5 * elevator.high, 0),
            atol=1e-12,
        )
        assert action.low[1].tolist()[1:] == [-1.0] * 4
        assert action.high[1].tolist()[1:] == [1.0] * 4


def test_the_thrust_of_an_aeroplane_is_that_of_its_forward_rotors(context):
    trainer = load_airframe("trainer")
    fleet = dataclasses.replace(context, airframes=[trainer])
    most = trainer.thrust_coefficient * trainer.max_rotor_speed**2
    for name in ("attitude", "rates"):
        assert decode(name, fleet, (0, 0, 0, 1))[3] == pytest.approx(most)


def test_hover_rpm_refuses_wings(context):
    fleet = dataclasses.replace(context, airframes=[load_airframe("quadplane")])
    with pytest.raises(
        ValueError, match="'hover_rpm' is for multirotors, and airframe 'quadplane'"
    ):
        make_action("hover_rpm", fleet)


def test_turn_speed_turns_from_the_last_commanded_heading(context):
    before = np.arctan2(2.0, 1.0)  # of the commanded velocity (1, 2, -1)
    left = before + 0.5 * np.pi * 0.1
    np.testing.assert_allclose(
        decode("turn_speed", context, (0.5, 0.2, 0.1)),
        (6 * np.cos(left), 6 * np.sin(left), 1, left),
        rtol=1e-12,
    )
    slowest = decode("turn_speed", context, (0, -1, 0))
    np.testing.assert_allclose(
        slowest, (0.01 / np.sqrt(5), 0.02 / np.sqrt(5), 0, before), rtol=1e-12
    )
    np.testing.assert_allclose(np.linalg.norm(decode("turn_speed", context, (1, 1, 1))[:3]), 10)


def test_attitude_and_rates_scale(context):
    most = context.airframes[0].max_thrust
    np.testing.assert_allclose(
        decode("attitude", context, (1, -1, 0.5, 0)), (*np.radians((55, -55, 90)), most / 2)
    )
    np.testing.assert_allclose(
        decode("rates", context, (1, -0.5, 1, 1)), (2 * np.pi, -np.pi, np.pi, most)
    )


def test_hover_rpm_is_five_percent_about_hover(context):
    hover = context.airframes[0].hover_speed()
    np.testing.assert_allclose(
        decode("hover_rpm", context, (0, 1, -1, 0)), hover * np.array((1, 1.05, 0.95, 1))
    )


def test_discrete_directions(context):
    expected = [
        (0, 0, 0),
        (10, 0, 0),
        (-10, 0, 0),
        (0, 10, 0),
        (0, -10, 0),
        (0, 0, 10),
        (0, 0, -10),
    ]
    np.testing.assert_allclose([decode("discrete", context, k)[:3] for k in range(7)], expected)
    table = np.array([decode("discrete_27", context, k)[:3] for k in range(27)])
    assert len(np.unique(table.round(6), axis=0)) == 27
    np.testing.assert_allclose(np.linalg.norm(table[1:], axis=1), 10)
    np.testing.assert_allclose(table[1], np.full(3, -10 / np.sqrt(3)))


def test_drones_with_fewer_rotors_read_fewer_numbers():
    both = ActionContext(
        [load_airframe("cf2x"), load_airframe("firefly")],
        5.0,
        5.0,
        np.zeros(3),
        np.ones(3),
        0.1,
        9.80665,
    )
    action = make_action("rotor", both)
    assert (action.size(0), action.size(1), action.low.shape) == (4, 6, (2, 6))
    assert (action.low[0, 4:] == action.high[0, 4:]).all()


def test_rpm_is_raw(context):
    np.testing.assert_allclose(
        decode("rpm", context, (0, 60, 16608, 60)), (0, 2 * np.pi, 16608 * np.pi / 30, 2 * np.pi)
    )
    assert make_action("rpm", context).high[0, 0] == pytest.approx(2607.5 * 30 / np.pi)


@pytest.mark.parametrize("name", ["velocity", "acceleration", "target_position"])
def test_encoding_is_the_inverse(context, name):
    action = make_action(name, context)
    setpoint = np.array((1.5, -2.0, 3.0)).reshape(1, 1, 3)
    np.testing.assert_allclose(
        action.decode(action.encode(setpoint), np.zeros((1, 1, 3)))[..., :3], setpoint
    )


def test_every_action_has_a_label_and_bounds_for_each_number(context):
    for name in ACTIONS:
        action = make_action(name, context)
        assert action.size(0) == action.low.shape[1] == action.high.shape[1]
        assert (action.low < action.high).all()
        assert action.level in SetpointLevel
    with pytest.raises(ValueError, match="did you mean 'velocity'"):
        make_action("velocty", context)


def test_an_action_is_given_by_name_by_module_or_as_its_maker(context):
    for source in ("rates", "bulletuav.control.actions.attitudes:rates", ACTIONS["rates"]):
        assert make_action(source, context).labels == make_action("rates", context).labels
    with pytest.raises(ValueError, match="unknown action 3"):
        make_action(3, context)


def test_the_table_of_actions_is_the_registrys_and_read_only():
    assert sorted(ACTIONS) == names("action")
    with pytest.raises(TypeError):
        ACTIONS["own"] = ACTIONS["rates"]


def test_limit_norm_keeps_direction_and_short_vectors():
    np.testing.assert_allclose(
        limit_norm(np.array([[(3.0, 4, 0), (0.3, 0.4, 0), (0, 0, 0)]]), 1.0),
        [[(0.6, 0.8, 0), (0.3, 0.4, 0), (0, 0, 0)]],
    )


@pytest.mark.parametrize("size", [1, 2, 4, 5])
def test_limit_norm_takes_vectors_of_any_size(size):
    given = np.full((2, 3, size), 2.0)
    np.testing.assert_allclose(limit_norm(given, 1.5), np.full(given.shape, 1.5 / size**0.5))
