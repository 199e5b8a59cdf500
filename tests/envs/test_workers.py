"""Batches over several processes."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import psutil
import pytest
from gymnasium.vector import AutoresetMode
from waiting import PATIENCE

import bulletuav
from bulletuav.envs import worker
from bulletuav.envs.worker import poll_number


def rolled(workers, task="crossing", steps=25, num_envs=5, **options):
    """Everything that comes out of a rollout with random actions, by name."""
    env = bulletuav.batch_env(task, num_envs, workers=workers, num_drones=3, horizon=10, **options)
    rng = np.random.default_rng(0)
    observations, infos = env.reset(seed=3)
    rows = [{"observations": observations, **infos}]
    for _ in range(steps):
        shape = (
            (num_envs, 3)
            if env.action_space.shape == ()
            else (num_envs, 3, *env.action_space.shape)
        )
        actions = rng.integers(0, 7, shape) if len(shape) == 2 else rng.uniform(-1, 1, shape)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        row = {
            "observations": observations,
            "rewards": rewards,
            "terminated": terminated,
            "truncated": truncated,
        }
        rows.append({**row, **infos, "alive": env.alive, "ended": env.ended, "state": env.state()})
    env.close()
    return rows


def assert_same(one, two, masks):
    """All entries are equal, in the worlds of the masks; in all for None."""
    assert set(one) == set(two)
    for name, value in one.items():
        if isinstance(value, dict):
            assert_same(value, two[name], masks)
        else:
            chosen = slice(None) if masks is None else masks
            np.testing.assert_array_equal(
                np.asarray(value)[chosen], np.asarray(two[name])[chosen], err_msg=name
            )
            assert np.asarray(value).dtype == np.asarray(two[name]).dtype


@pytest.mark.parametrize(
    ("workers", "options"),
    [
        (2, {}),
        (5, {"dynamics": "rigid_body", "turbulence": "moderate"}),
        (2, {"task": "hover", "action": "discrete", "dynamics": "point_mass", "seed": 7}),
        (
            2,
            {
                "task": "hover",
                "observation": ("position", "rgb"),
                "camera_size": (16, 12),
                "action": "velocity",
            },
        ),
        (2, {"start_method": "spawn", "dynamics": "single_integrator"}),
        (
            2,
            {
                "airframe": ("trainer", "hummingbird", "quadplane"),
                "dynamics": "rigid_body",
                "action": "rotor",
            },
        ),
    ],
)
def test_the_number_of_processes_changes_no_bit(workers, options):
    plain = {name: value for name, value in options.items() if name != "start_method"}
    for mine, theirs in zip(rolled(1, **plain), rolled(workers, **options), strict=True):
        assert_same(mine, theirs, None)


@pytest.mark.parametrize("cores", [1, 1.1, 2])
def test_who_has_fewer_cores_than_processes_sleeps_at_once(cores, monkeypatch):
    monkeypatch.setattr("bulletuav.envs.workers.count_cores", lambda: cores)
    looked = []
    look = poll_number
    monkeypatch.setattr(
        "bulletuav.envs.workers.poll_number", lambda *given: looked.append(given[2]) or look(*given)
    )
    some = rolled(2, steps=3)
    assert looked
    assert (max(looked) > 0.0) is (cores == 2)
    for mine, theirs in zip(rolled(1, steps=3), some, strict=True):
        assert_same(mine, theirs, None)


def test_requests_and_answers_are_counted_on_both_sides():
    env = bulletuav.batch_env("crossing", 4, workers=2, num_drones=2)
    env.reset(seed=0)
    for asked in (1, 2, 3):
        env.step(np.zeros((4, 2, *env.action_space.shape)))
        assert env._arrays["requests"][2] == asked + 1
        # The worker counts an answer when it has sent it
        assert poll_number(env._arrays["answers"][2:], asked + 2, PATIENCE)
    env.close()


def test_who_sees_a_question_does_not_wait_for_the_pipe(monkeypatch):
    class Pipe:
        def poll(self, seconds):
            raise AssertionError("waits")

        def recv(self):
            return "question"

    monkeypatch.setattr(worker.multiprocessing, "parent_process", lambda: "somebody")
    assert worker._next_request(Pipe(), np.array([7]), 7, 1.0) == "question"
    with pytest.raises(AssertionError, match="waits"):
        worker._next_request(Pipe(), np.array([6]), 7, 0.0)


def test_a_number_in_shared_memory_is_looked_for_until_it_is_there_or_for_a_time():
    numbers = np.array([3, 0])
    assert poll_number(numbers, 3, 0.0)
    assert not poll_number(numbers, 4, 0.01)
    late = threading.Timer(0.02, numbers.__setitem__, (0, 5))
    late.start()
    assert poll_number(numbers, 5, PATIENCE)
    late.join()


def test_final_observations_of_several_processes():
    mode = {"autoreset_mode": AutoresetMode.SAME_STEP, "dynamics": "point_mass"}
    ended = 0
    for mine, theirs in zip(rolled(1, **mode), rolled(2, **mode), strict=True):
        assert set(mine) == set(theirs)
        if "final_obs" in mine:
            masks = mine["_final_obs"]
            ended += masks.sum()
            for name in ("final_obs", "final_state", "final_info"):
                assert_same({name: mine.pop(name)}, {name: theirs.pop(name)}, masks)
        assert_same(mine, theirs, None)
    assert ended >= 5


class OddError(Exception):
    """One that pickle cannot bring back."""

    def __init__(self, a, b):
        super().__init__(f"{a} {b}")


@pytest.mark.parametrize("worlds", [1, 2])
def test_an_error_in_one_part_is_told_and_no_answer_taken_for_another(worlds):
    def wind(position, time):
        # This process has one of three worlds, the other has two.
        if (time > 0.2).any() and len(position) == worlds:
            raise OddError("blown", "away")
        return np.zeros_like(position)

    env = bulletuav.batch_env(
        "hover", 3, workers=2, action="velocity", wind=wind, start_method="fork"
    )
    env.reset(seed=0)
    said = "OddError: blown away"
    with pytest.raises(RuntimeError, match=said) as raised:  # noqa: PT012, it comes at some step
        for _ in range(20):
            env.step(np.zeros((3, 1, 3)))
    # Of this process it is told where it comes from
    cause = raised.value.__cause__
    assert isinstance(cause, OddError) == (worlds == 1)
    assert worlds == 2 or cause.__traceback__ is not None
    fresh = bulletuav.batch_env("hover", 3, action="velocity")
    np.testing.assert_array_equal(env.reset(seed=4)[0], fresh.reset(seed=4)[0])
    np.testing.assert_array_equal(
        env.step(np.ones((3, 1, 3)))[1], fresh.step(np.ones((3, 1, 3)))[1]
    )
    env.close()
    fresh.close()


def test_an_interrupt_ends_the_processes(monkeypatch):
    env, children = make_children()
    env.reset(seed=0)
    pipe = env._pipes[1]

    class Interrupted:
        def send(self, question):
            pipe.send(question)

        def poll(self, timeout):
            raise KeyboardInterrupt

    env._pipes[1] = Interrupted()
    monkeypatch.setitem(env._arrays, "answers", np.zeros(3))  # none is seen to have come
    with pytest.raises(KeyboardInterrupt):
        env.step(np.zeros((3, 1, 3)))
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.zeros((3, 1, 3)))
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]


@pytest.mark.parametrize("start_method", ["fork", "spawn"])
def test_a_worker_that_is_stopped_or_killed_ends_in_words(start_method):
    options = {
        "dynamics": "point_mass",
        "action": "velocity",
        "workers": 2,
        "start_method": start_method,
    }
    for sign, said in (
        (signal.SIGSTOP, "has not answered for 0.5 s"),
        (signal.SIGKILL, "has died"),
    ):
        env = bulletuav.batch_env("hover", 2, timeout=PATIENCE, **options)
        env.reset(seed=0)
        if sign == signal.SIGSTOP:
            env._timeout = 0.5
        children = [psutil.Process(process.pid) for process in env._processes]
        os.kill(children[0].pid, sign)
        with pytest.raises(RuntimeError, match=said):
            env.step(np.zeros((2, 1, 3)))
        env.close()
        assert not psutil.wait_procs(children, timeout=PATIENCE)[1]


@pytest.mark.parametrize("workers", [1, 2])
def test_processes_that_cannot_be_are_refused_however_many_there_are(workers):
    for wrong, said in (
        ({"timeout": 0}, "timeout is 0 s"),
        ({"start_method": "frok"}, "did you mean 'fork'"),
        ({"autoreset_mode": "zzz"}, "unknown autoreset_mode 'zzz'"),
        ({"workers": 1000}, "workers is 1000: a whole number from 1 to 256"),
        ({"num_envs": 2**63}, "num_envs is 9223372036854775808"),
    ):
        with pytest.raises(ValueError, match=said):
            bulletuav.batch_env("hover", **{"num_envs": 2, "workers": workers, **wrong})
    env = bulletuav.batch_env(
        "hover", 2, workers=workers, start_method="fork", autoreset_mode="SAME_STEP"
    )
    with pytest.raises(ValueError, match="options is 3: a dict"):
        env.reset(seed=0, options=3)
    env.reset(seed=0)
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.state()


def test_closing_does_not_wait_for_ever_for_a_stopped_worker(monkeypatch):
    monkeypatch.setattr("bulletuav.envs.worker.JOIN_TIMEOUT", 0.5)
    env = bulletuav.batch_env("hover", 2, workers=2, start_method="fork")
    children = [psutil.Process(process.pid) for process in env._processes]
    os.kill(children[0].pid, signal.SIGSTOP)
    env.close()
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]


def test_workers_end_with_a_process_that_is_killed():
    program = (
        "import bulletuav, psutil, time\n"
        "options = {'dynamics': 'point_mass', 'action': 'velocity', 'start_method': 'fork'}\n"
        "env = bulletuav.batch_env('hover', 3, workers=3, **options)\n"
        "print(*(child.pid for child in psutil.Process().children()), flush=True)\n"
        "time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    children = [psutil.Process(int(pid)) for pid in process.stdout.readline().split()]
    assert len(children) == 2  # beside the process itself
    process.kill()
    process.communicate()
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]


def test_a_diverged_flight_is_named_by_its_world_among_all():
    """The wind blows where the drone starts, so it is the same one in whichever process."""
    places = bulletuav.Aviary("hover", 4)
    places.reset(seeds=0)
    doomed = places.swarm.position[3, 0].copy()
    places.close()

    def storm(position, time):
        return np.where(
            np.abs(position - doomed).max(axis=-1, keepdims=True) < 1e-9, 1e20, 0.0
        ) * np.ones(3)

    for workers in (1, 2):
        env = bulletuav.batch_env(
            "hover",
            4,
            workers=workers,
            action="velocity",
            dynamics="rigid_body",
            wind=storm,
            start_method="fork",
        )
        env.reset(seed=0)
        with pytest.raises(RuntimeError, match="drone 0 in world 3 diverged"):
            env.step(np.zeros((4, 1, 3)))
        env.close()


def test_options_that_processes_cannot_have():
    with pytest.raises(ValueError, match="did you mean 'spawn'"):
        bulletuav.batch_env("hover", 2, workers=2, start_method="spown")
    with pytest.raises(ValueError, match="no lambda"):
        bulletuav.batch_env(
            "hover", 2, workers=2, start_method="spawn", wind=lambda position, time: position
        )


def test_partial_resets_and_seeds():
    envs = [
        bulletuav.batch_env("hover", 3, workers=workers, autoreset_mode="Disabled")
        for workers in (1, 2)
    ]
    mask = np.array([False, True, True])
    for seed, options in (
        (5, None),
        ([1, 2, 3], {"reset_mask": mask}),
        (None, {"reset_mask": ~mask}),
    ):
        one, two = (env.reset(seed=seed, options=options)[0] for env in envs)
        np.testing.assert_array_equal(one, two)
    for env in envs:
        env.close()


def test_bad_input_is_refused_and_the_worlds_fly_on():
    env = bulletuav.batch_env(
        "hover", 4, workers=2, action="velocity", render_mode="rgb_array", render_size=(32, 24)
    )
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        env.step(np.zeros((4, 1, 3)))
    env.reset(seed=0)
    before = env.state()
    for wrong, message in ((np.zeros((4, 1, 2)), "shape"), (np.full((4, 1, 3), np.nan), "finite")):
        with pytest.raises(ValueError, match=message):
            env.step(wrong)
    for seed in (-1, [1, 2], "a"):
        with pytest.raises(ValueError, match="seed"):
            env.reset(seed=seed)
    with pytest.raises(ValueError, match="mask"):
        env.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    with pytest.raises(ValueError, match="world is 4"):
        env.render(4)
    np.testing.assert_array_equal(env.state(), before)
    env.step(np.zeros((4, 1, 3)))
    assert env.render(3).shape == (24, 32, 3)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.state()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers is 0"),
        ({"workers": 3}, "at most one for each of the 2 worlds"),
        ({"workers": 2, "render_mode": "human"}, "workers=1"),
        ({"workers": 2, "drones": 2}, "num_drones"),
        ({"workers": 2, "action": "rates", "dynamics": "point_mass"}, "rates"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(ValueError, match=message):
        bulletuav.batch_env("hover", 2, **options)


def make_children():
    """An environment of three worlds and the processes that it has started."""
    others = set(psutil.Process().children())
    env = bulletuav.batch_env("hover", 3, workers=3, action="velocity", dynamics="point_mass")
    children = [child for child in psutil.Process().children() if child not in others]
    assert len(children) == 2
    return env, children


def test_a_worker_that_dies_is_told_and_processes_end():
    env, children = make_children()
    env.reset(seed=0)
    os.kill(children[-1].pid, signal.SIGKILL)
    with pytest.raises(RuntimeError, match="worker process has died"):
        env.step(np.zeros((3, 1, 3)))
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]


def test_a_forgotten_environment_leaves_no_process():
    env, children = make_children()
    del env
    time.sleep(0.01)
    assert not psutil.wait_procs(children, timeout=PATIENCE)[1]
