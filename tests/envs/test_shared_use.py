"""Environments that threads or processes share, that are interrupted, closed, or full."""

import copy
import gc
import os
import pickle
import sys
import threading

import gymnasium
import numpy as np
import pytest
from pettingzoo import ParallelEnv

import bulletuav

OPTIONS = {"dynamics": "point_mass", "horizon": 6}
MAKERS = {
    "Aviary": lambda: bulletuav.Aviary("crossing", 2, **OPTIONS),
    "parallel": lambda: bulletuav.parallel_env("crossing", **OPTIONS),
    "aec": lambda: bulletuav.aec_env("crossing", **OPTIONS),
    "batch": lambda: bulletuav.batch_env("crossing", 2, **OPTIONS),
    "workers": lambda: bulletuav.batch_env("crossing", 2, workers=2, **OPTIONS),
    "central": lambda: gymnasium.make("bulletuav/Crossing-v2", **OPTIONS).unwrapped,
    "vector": lambda: gymnasium.make_vec("bulletuav/Crossing-v2", num_envs=2, **OPTIONS),
    "curriculum": lambda: bulletuav.curriculum_env("crossing", ({}, {}), **OPTIONS),
    "team": lambda: bulletuav.team_env("pursuit_evasion", "chasers", "stay", **OPTIONS),
    "central team": lambda: bulletuav.team_env(
        "pursuit_evasion", "chasers", "stay", central=True, **OPTIONS
    ),
    "airspace": lambda: bulletuav.Airspace([(0.0, 0.0, 1.0)]),
}
METHODS = ("reset", "step", "state", "state_hash", "save_state", "render", "close", "place")


@pytest.fixture(params=MAKERS)
def env(request):
    one = MAKERS[request.param]()
    yield one
    one.close()


def in_thread(call):
    """Call something in another thread; the error that it raised."""
    errors = []

    def run():
        try:
            call()
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return errors[0] if errors else None


def calls_of(env):
    """What it can be asked for, each as a call that another thread may make."""
    given = {
        "step": [] if isinstance(env, bulletuav.Airspace) else [None],
        "place": [0, (0.0, 0.0, 1.0)],
    }
    for name in METHODS:
        own = getattr(type(env), name, None)
        if own is not None and own is not getattr(ParallelEnv, name, None):
            yield name, lambda one=name: getattr(env, one)(*given.get(one, []))


def test_every_method_is_refused_while_another_thread_is_in_one(env):
    if not isinstance(env, bulletuav.Airspace):
        env.reset(seed=0) if not isinstance(env, bulletuav.Aviary) else env.reset(seeds=0)
    env._busy["user"] = (threading.get_ident(),)  # as it is within a method
    told = {name: str(in_thread(call)) for name, call in calls_of(env)}
    env._busy.clear()
    assert len(told) >= 3
    assert all("in use by another thread" in text for text in told.values()), told


@pytest.mark.parametrize("after", range(8))
def test_an_interrupt_leaves_no_environment_locked(after):
    """At each of the first calls and returns, also right after the one that takes the lock."""
    env = bulletuav.parallel_env("crossing", **OPTIONS)
    left = after

    def profile(frame, event, _):
        nonlocal left
        left -= event in ("call", "c_return")
        if left < 0:
            sys.setprofile(None)
            raise KeyboardInterrupt

    def interrupted():
        sys.setprofile(profile)
        env.reset(seed=0)

    gc.disable()  # nothing tells of an exception that is raised while garbage is collected
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        gc.enable()
        sys.setprofile(None)
    assert in_thread(lambda: env.reset(seed=0)) is None
    env.close()


def test_a_thread_that_is_refused_leaves_the_other_one_in():
    env = bulletuav.parallel_env("crossing", **OPTIONS)
    env._busy["user"] = mine = (threading.get_ident(),)
    for _ in range(2):
        assert "in use by another thread" in str(in_thread(env.reset))
        assert env._busy["user"] is mine
    env.reset()  # who is in may go on
    assert env._busy["user"] is mine
    env._busy.clear()
    env.close()


def test_what_is_closed_stays_closed(env):
    env.close()
    calls = {name: call for name, call in calls_of(env) if name not in ("close", "step")}
    for name, call in calls.items():
        with pytest.raises(RuntimeError, match="closed|not been started"):
            call()
        assert name
    env.close()


def test_a_curriculum_that_was_closed_before_it_flew_makes_no_engine():
    env = bulletuav.curriculum_env("crossing", ({}, {}), **OPTIONS)
    env.close()
    with pytest.raises(RuntimeError, match="this environment is closed: make a new one"):
        env.reset(seed=0)
    with pytest.raises(RuntimeError, match="this environment is closed: make a new one"):
        env.step({})


def test_turns_end_with_the_environment():
    env = bulletuav.aec_env("crossing", **OPTIONS)
    env.reset(seed=0)
    env.close()
    with pytest.raises(RuntimeError, match="this environment is closed: make a new one"):
        env.step(np.zeros(3))


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_a_curriculum_begins_without_episodes(how):
    env = bulletuav.curriculum_env("crossing", ({}, {}), **OPTIONS)
    for seed in range(3):
        env.reset(seed=seed)
        while env.agents:
            env.step({agent: np.zeros(3) for agent in env.agents})
    assert len(env.curriculum.state()["recent"]) == 2
    assert how(env).curriculum.state() == {"stage": 0, "recent": []}
    env.close()


def test_a_copied_curriculum_goes_its_own_way():
    curriculum = bulletuav.curriculum_env("crossing", ({}, {}), **OPTIONS).curriculum
    curriculum.record(1.0)
    again = copy.copy(curriculum)
    again.record(0.0)
    assert again.state() == {"stage": 0, "recent": [1.0, 0.0]}
    assert curriculum.state() == {"stage": 0, "recent": [1.0]}


def test_curricula_refuse_places_that_a_task_does_not_take_when_they_are_made():
    goal = np.zeros((4, 3))
    with pytest.raises(ValueError, match="goal cannot be given in task 'coverage'"):
        bulletuav.curriculum_env("coverage", ({},), num_layouts=1, area=250.0, goal=goal)


def test_a_fork_does_not_take_the_answers_of_the_workers_from_its_parent():
    env = bulletuav.batch_env("crossing", 2, workers=2, num_drones=2, **OPTIONS)
    env.reset(seed=0)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            env.step(np.zeros((2, 2, 3)))
            told = "it flew"
        except RuntimeError as error:
            told = str(error)
        os.write(writer, told.encode())
        os._exit(0)
    os.waitpid(child, 0)
    os.close(writer)
    with os.fdopen(reader) as stream:
        assert "of another process: make a new one" in stream.read()
    assert env.step(np.zeros((2, 2, 3)))[1].shape == (2, 2)
    env.close()


def test_actions_of_several_lengths_are_named(env):
    if isinstance(env, bulletuav.Airspace | bulletuav.Aviary):
        pytest.skip("they take arrays by themselves, see test_bad_input")
    env.reset(seed=0)
    ragged = [[1.0], [1.0, 2.0]]
    if hasattr(env, "possible_agents") and not hasattr(env, "agent_selection"):
        ragged = dict.fromkeys(env.agents, ragged)
    with pytest.raises(ValueError, match="not numbers"):
        env.step(ragged)


@pytest.mark.parametrize("task", ["crossing", "formation"])
def test_a_reset_mends_what_an_interrupt_left_wherever_it_came(task):
    """The first decision makes programs: an interrupt must leave none that is half made."""
    package = os.path.dirname(bulletuav.__file__)
    fresh = bulletuav.Aviary(task, num_drones=3, **OPTIONS)
    env = bulletuav.Aviary(task, num_drones=3, **OPTIONS)
    expected = fresh.reset(seeds=0)
    flown = fresh.step(np.zeros((1, 3, 3)))

    for after in np.geomspace(40, 40_000, 40).astype(int).tolist():
        left = after

        def profile(frame, event, _):
            nonlocal left
            if event not in ("call", "c_return"):
                return
            if not frame.f_code.co_filename.startswith(package):
                return
            if frame.f_code.co_name == "<genexpr>":
                return  # `any` closes it early; Python ignores what is raised meanwhile
            left -= 1
            if left < 0:
                sys.setprofile(None)
                raise KeyboardInterrupt

        env.add_body([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], (900.0, 0.0, 0.0))  # look anew
        env.reset(seeds=1)
        sys.setprofile(profile)
        try:
            env.step(np.zeros((1, 3, 3)))
        except KeyboardInterrupt:
            pass
        finally:
            sys.setprofile(None)
        np.testing.assert_array_equal(env.reset(seeds=0), expected)
        again = env.step(np.zeros((1, 3, 3)))
        np.testing.assert_array_equal(again.observations, flown.observations)
        np.testing.assert_array_equal(again.rewards, flown.rewards)
    assert left > 0  # up to the end of a decision
    fresh.close()
    env.close()


def test_curricula_refuse_actions_that_do_not_drive_the_dynamics_when_they_are_made():
    stages = ({}, {"action": "rotor"})
    with pytest.raises(ValueError, match="gives rotor setpoints, but dynamics 'point_mass'"):
        bulletuav.curriculum_env("hover", stages, dynamics="point_mass", action="velocity")


@pytest.mark.parametrize("bad", [None, "text", np.full(3, np.nan), np.zeros(2), [[1.0], [1, 2]]])
def test_an_action_that_cannot_be_leaves_the_turn_with_its_agent(bad):
    env = bulletuav.aec_env("crossing", num_drones=2, **OPTIONS)
    env.reset(seed=0)
    for agent in ("drone_0", "drone_1"):
        with pytest.raises(ValueError, match="action"):
            env.step(bad)
        assert env.agent_selection == agent
        env.step(np.zeros(3))
    assert env.agent_selection == "drone_0"
    assert env.rewards["drone_0"] != 0.0  # they have flown
    env.close()


def test_snapshots_of_another_class_or_of_stages_that_are_not_there_are_refused():
    def made(count):
        one = bulletuav.curriculum_env("crossing", ({},) * count, window=1, down=0.0, **OPTIONS)
        one.reset(seed=0)
        return one

    turns, few, many = bulletuav.aec_env("crossing", **OPTIONS), made(1), made(2)
    turns.reset(seed=0)
    before = few.state_hash(), turns.state_hash()
    with pytest.raises(ValueError, match="of aec_env, and this is of curriculum_env"):
        few.load_state(turns.save_state())
    with pytest.raises(ValueError, match="of curriculum_env, and this is of aec_env"):
        turns.load_state(few.save_state())
    few.load_state(many.save_state())  # it was at the first stage
    many.curriculum.record(1.0)
    with pytest.raises(ValueError, match="of stage 1, and this curriculum has 1 stages"):
        few.load_state(many.save_state())
    assert (few.state_hash(), turns.state_hash()) == before
    for env in (turns, few, many):
        env.close()


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_a_world_whose_start_finds_no_room_starts_with_a_later_step(mode, monkeypatch):
    env = bulletuav.batch_env("crossing", 2, autoreset_mode=mode, num_drones=2, **OPTIONS)
    env.reset(seed=0)
    task, full = env.aviary.task, [True]
    spawn_many = task.spawn_many

    def crowded(generators):
        if full:
            raise ValueError("no room for a start")
        return spawn_many(generators)

    monkeypatch.setattr(task, "spawn_many", crowded)
    decisions = 5 if mode == "SAME_STEP" else 6
    for _ in range(decisions):
        env.step(np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="no room"):
        env.step(np.zeros((2, 2, 3)))
    assert not env.alive.any()
    with pytest.raises(ValueError, match="no room"):
        env.step(np.zeros((2, 2, 3)))
    full.clear()
    _, rewards, terminated, truncated, _ = env.step(np.zeros((2, 2, 3)))
    assert env.alive.all()
    assert not rewards.any()
    assert not (terminated | truncated).any()
    assert env.step(np.zeros((2, 2, 3)))[1].all()
    env.close()
