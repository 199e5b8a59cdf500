"""Setpoints that C takes over are held as those that Python looks at; one thread at a time."""

import inspect
import threading

import numpy as np
import pytest

import bulletuav
from bulletuav.envs import airspace
from bulletuav.envs.airspace_inputs import hold, hold_plainly
from bulletuav.envs.environment import Environment, exclusive, exclusive_plainly

LEVELS = bulletuav.SetpointLevel
START = [(0.0, 0.0, 1.0), (2.0, 0.0, 1.0), (4.0, 0.0, 1.0)]
TURNED = np.array([(0.0, 0.0, np.sin(a / 2), np.cos(a / 2)) for a in (0.3, -0.4, 2.0)])
POINTS = np.arange(9.0).reshape(3, 3)
FOUR = np.arange(12.0).reshape(3, 4)
SPEED = (1000.0, 1100.0, 1200.0, 1300.0)
COMMANDS = {
    "all alike": [(None, LEVELS.ROTOR, SPEED)],
    "each its own": [(None, LEVELS.ROTOR, 300 * FOUR)],
    "one": [(1, LEVELS.RATES, np.array(SPEED) / 1e4)],
    "with a yaw": [(None, LEVELS.POSITION, FOUR), (2, LEVELS.VELOCITY, (0.5, 0.25, 0.0, -1.0))],
    "without": [(None, LEVELS.POSITION, POINTS), (1, LEVELS.VELOCITY, (1.0, 0.0, 0.5))],
    "without, at first": [(0, LEVELS.POSITION, (0.0, 1.0, 2.0)), (None, LEVELS.VELOCITY, POINTS)],
    "after an attitude": [
        (None, LEVELS.ATTITUDE, (0.0, 0.1, 1.0, 0.3)),
        (None, LEVELS.ACCELERATION, (0.0, 0.0, 1.0)),
    ],
    "several": [([2, 0], LEVELS.POSITION, FOUR[:2]), (np.array([1]), LEVELS.ROTOR, SPEED)],
    "whole numbers": [(0, LEVELS.POSITION, (0, 1, 2, 3)), (1, LEVELS.POSITION, [0.0, 1.0, 2.0])],
    "by name": [(0, "position", (0.0, 1.0, 2.0, 3.0))],
    "large": [(0, LEVELS.POSITION, (1e8, 0.0, 0.0, 0.0))],
    "other arrays": [(None, LEVELS.ROTOR, np.full((3, 8), 900.0)[:, ::2])],
    "a view": [(2, LEVELS.ROTOR, np.arange(8.0, dtype=np.float32)[::2])],
}


def told(commands, taken_over, monkeypatch, **options):
    """What an airspace holds after commands, and how many of them were taken over."""
    count = 0

    def counted(*arguments):
        nonlocal count
        done = taken_over(*arguments)
        count += done
        return done

    monkeypatch.setattr(airspace, "hold", counted)
    with bulletuav.Airspace(START, **options) as one:
        one.place(None, START, quaternion=TURNED)
        for command in commands:
            one.command(*command)
        held = (one.levels.copy(), one.setpoint.copy(), one.world.state.commanded[0].copy())
        one.step()
        return *held, one.swarm.position.copy(), count


@pytest.mark.parametrize("controller", ["lee", "pid"])
@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_taken_over_at_once_is_held_as_after_a_closer_look(name, controller, monkeypatch):
    if controller == "pid" and name in ("one", "after an attitude"):
        pytest.skip("the PID takes positions and velocities")
    options = {"controller": controller, "effects": ("ground_effect",)}
    *expected, none = told(COMMANDS[name], hold_plainly, monkeypatch, **options)
    *held, _ = told(COMMANDS[name], hold, monkeypatch, **options)
    for one, other in zip(held, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    assert none == 0


@pytest.mark.skipif(hold is hold_plainly, reason="not built")
def test_usual_commands_are_taken_over(monkeypatch):
    usual = {"all alike": 1, "each its own": 1, "one": 1, "with a yaw": 2, "without": 1}
    for name, count in usual.items():
        assert told(COMMANDS[name], hold, monkeypatch)[-1] == count, name
    for name in ("several", "whole numbers", "by name", "large", "after an attitude"):
        taken = told(COMMANDS[name], hold, monkeypatch)[-1]
        assert taken == (name == "after an attitude"), name


@pytest.mark.parametrize(
    ("drones", "setpoint"),
    [
        (3, SPEED),
        (-1, SPEED),
        (2**70, SPEED),
        (0, SPEED[:3]),
        (0, (*SPEED[:3], float("nan"))),
        (0, (*SPEED[:3], "1")),
        (0, np.array([SPEED])),
        (None, np.array([SPEED])),
        (None, np.zeros((3, 5))),
        (None, np.full((3, 4), np.inf)),
        (None, ()),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_changes(drones, setpoint):
    with bulletuav.Airspace(START) as one:
        one.command(None, LEVELS.RATES, (0.0, 0.0, 0.0, 0.25))
        before = (one.levels.copy(), one.setpoint.copy())
        with pytest.raises(ValueError, match="drones|setpoint"):
            one.command(drones, LEVELS.ROTOR, setpoint)
        np.testing.assert_array_equal(one.levels, before[0])
        np.testing.assert_array_equal(one.setpoint, before[1])


@pytest.mark.skipif(hold is hold_plainly, reason="not built")
def test_in_c_arrays_that_are_not_as_needed_are_an_error():
    levels, setpoint, told = np.zeros((1, 3), int), np.zeros((1, 3, 4)), np.zeros((1, 3), bool)
    good = (levels, setpoint, told, None, LEVELS.ROTOR, 4, SPEED)
    assert hold(*good) is True
    wrong = {0: setpoint, 1: setpoint[:, :2], 2: levels, 4: "rotor", 5: 5}
    for place, value in wrong.items():
        with pytest.raises(TypeError):
            hold(*good[:place], value, *good[place + 1 :])
    with pytest.raises(TypeError):
        hold(*good[:-1])


def user_of(guard):
    """A class with methods that one thread is in at a time."""

    class User(Environment):
        @guard
        def ask(self, one, *, two=2):
            """Ask."""
            return one, two, self._busy.copy()

        @guard
        def ask_twice(self):
            return self.ask(1)

        @guard
        def fail(self):
            raise KeyError("as it has to")

    return User


BOTH = pytest.mark.parametrize("guard", [exclusive_plainly, exclusive])


@BOTH
def test_a_guarded_method_is_one_like_others(guard):
    kind = user_of(guard)
    user = kind()
    assert user.ask(1)[:2] == kind.ask(user, 1)[:2] == (1, 2)
    assert user.ask(one=5, two=7)[:2] == (5, 7)
    bound = user.ask
    assert bound(3)[:2] == (3, 2)
    assert list(inspect.signature(user.ask).parameters) == ["one", "two"]
    assert (kind.ask.__name__, kind.ask.__doc__) == ("ask", "Ask.")
    assert inspect.isroutine(kind.ask)
    for wrong in ((), (1, 2)):
        with pytest.raises(TypeError):
            user.ask(*wrong)
    with pytest.raises(TypeError):
        kind.ask()


@BOTH
def test_a_thread_is_in_it_until_it_is_out(guard):
    user = user_of(guard)()
    for call in (lambda: user.ask(1), user.ask_twice):
        assert call()[2] == {"user": (threading.get_ident(),)}
        assert not user._busy
    with pytest.raises(KeyError, match="as it has to"):
        user.fail()
    assert not user._busy
    user._busy["user"] = other = (threading.get_ident() + 1,)
    with pytest.raises(RuntimeError, match="this User is in use by another thread"):
        user.ask(1)
    assert user._busy["user"] is other


@pytest.mark.skipif(exclusive is exclusive_plainly, reason="not built")
def test_no_guard_can_be_made_of_nothing():
    with pytest.raises(TypeError, match="cannot create"):
        type(exclusive(len))()
