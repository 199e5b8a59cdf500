import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.control.actions import ACTIONS, Flyable, limit_norm, make_action
from bulletuav.control.levels import Level
from bulletuav.physics.swarm import Swarm


@pytest.fixture
def flyable():
    return Flyable([load_airframe("cf2x")], 10.0, np.array((-20.0, -10, 0)), np.array((20.0, 30, 8)), 0.1)


def decode(name, flyable, action):
    swarm = Swarm.zeros(1, 1, 4)
    swarm.velocity[:] = 1, 2, -1
    return make_action(name, flyable).decode(np.array(action, float).reshape(1, 1, -1), swarm)[0, 0]


def test_velocity_scales_and_limits_the_norm(flyable):
    np.testing.assert_allclose(decode("velocity", flyable, (0.3, -0.4, 0)), (3, -4, 0, 0))
    np.testing.assert_allclose(decode("velocity", flyable, (1, 1, 1)), (*[10 / np.sqrt(3)] * 3, 0))


def test_target_position_spans_the_arena(flyable):
    np.testing.assert_allclose(decode("target_position", flyable, (-1, 1, 0)), (-20, 30, 4, 0))


def test_rotor_is_linear_in_thrust(flyable):
    most = flyable.airframes[0].max_rotor_speed
    np.testing.assert_allclose(decode("rotor", flyable, (-1, 1, 0, -0.5)) ** 2, np.array((0, 1, 0.5, 0.25)) * most**2)


def test_rpm_is_raw(flyable):
    np.testing.assert_allclose(decode("rpm", flyable, (0, 60, 14473, 60)), (0, 2 * np.pi, 14473 * np.pi / 30, 2 * np.pi))
    assert make_action("rpm", flyable).high[0, 0] == pytest.approx(2273.5 * 30 / np.pi)


@pytest.mark.parametrize("name", ["velocity", "target_position"])
def test_encoding_is_the_inverse(flyable, name):
    action = make_action(name, flyable)
    setpoint = np.array((1.5, -2.0, 3.0)).reshape(1, 1, 3)
    np.testing.assert_allclose(action.decode(action.encode(setpoint), Swarm.zeros(1, 1, 4))[..., :3], setpoint)


def test_every_action_has_a_label_and_bounds_for_each_number(flyable):
    for name in ACTIONS:
        action = make_action(name, flyable)
        assert action.size(0) == action.low.shape[1] == action.high.shape[1]
        assert (action.low < action.high).all()
        assert action.level in Level
    with pytest.raises(ValueError, match="did you mean 'velocity'"):
        make_action("velocty", flyable)


def test_limit_norm_keeps_direction_and_short_vectors():
    np.testing.assert_allclose(
        limit_norm(np.array([(3.0, 4, 0), (0.3, 0.4, 0), (0, 0, 0)]), 1.0), [(0.6, 0.8, 0), (0.3, 0.4, 0), (0, 0, 0)]
    )
