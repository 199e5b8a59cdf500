"""Rules of every environment class: copies, threads, and nothing handed out is shared."""

import copy
import pickle
import subprocess
import sys
import threading
from collections.abc import Mapping

import cloudpickle
import gymnasium
import numpy as np
import pytest

import bulletuav

OPTIONS = {
    "dynamics": "point_mass",
    "num_drones": 3,
    "difficulty": "medium",
    "horizon": 6,
    "seed": 7,
}
NOISY = {"gps_noise": 1.0, "wind": (0.0, 1.0), "radio_delay": 0.2}


def gymnasium_env(**options):
    return gymnasium.make("bulletuav/Crossing-v2", **options).unwrapped


def vector_env(**options):
    return gymnasium.make_vec("bulletuav/Crossing-v2", num_envs=2, **options)


def drone_vec_env(**options):
    from bulletuav.adapters.sb3 import DroneVecEnv

    return DroneVecEnv("crossing", 2, **options)


MAKERS = {
    "Aviary": lambda **options: bulletuav.Aviary("crossing", 2, **options),
    "parallel_env": lambda **options: bulletuav.parallel_env("crossing", **options),
    "aec_env": lambda **options: bulletuav.aec_env("crossing", **options),
    "batch_env": lambda **options: bulletuav.batch_env("crossing", 2, **options),
    "batch_env, workers": lambda **options: bulletuav.batch_env(
        "crossing", 2, workers=2, start_method="fork", **options
    ),
    "curriculum_env": lambda **options: bulletuav.curriculum_env(
        "crossing", ({"d_safe": 5.0}, {"d_safe": 6.0}), **options
    ),
    "gymnasium.make": gymnasium_env,
    "gymnasium.make_vec": vector_env,
    "DroneVecEnv": drone_vec_env,
}


def act(env, k):
    """Step any environment under actions that follow from k; what it returns."""
    wave = 0.5 * np.sin(k + np.arange(18.0))
    if isinstance(env, bulletuav.Aviary):
        return env.step(wave.reshape(2, 3, 3))
    if hasattr(env, "agent_selection"):
        agent = env.agent_selection
        is_done = env.terminations[agent] or env.truncations[agent]
        env.step(None if is_done else wave[:3])
        return env.last() if env.agents else ()
    if hasattr(env, "possible_agents"):
        return env.step({agent: wave[3 * i : 3 * i + 3] for i, agent in enumerate(env.agents)})
    if type(env).__name__ == "DroneVecEnv":
        return env.step(wave.reshape(6, 3))
    if isinstance(env, gymnasium.vector.VectorEnv):
        return env.step(wave.reshape(2, 9))
    if isinstance(env, gymnasium.Env):
        return env.step(wave[:9])
    return env.step(wave.reshape(2, 3, 3))


def arrays(value):
    """All arrays in what an environment returns."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from arrays(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from arrays(one)


def flight(env, steps=5):
    """What an environment returns at a reset and the steps after it."""
    if hasattr(env, "agent_selection") or type(env).__name__ == "TurnAviary":
        env.reset()
        return [env.last(), *(act(env, k) for k in range(steps))]
    return [env.reset(), *(act(env, k) for k in range(steps))]


def assert_same(one, two):
    """All arrays in both are equal, and there are some."""
    one = list(arrays(one))
    two = list(arrays(two))
    assert len(one) == len(two) > 0
    for mine, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(mine, other)


COPIES = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "deepcopy": copy.deepcopy,
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_copy_is_made_anew_from_the_same_options_and_flies_the_same(name):
    env = MAKERS[name](**OPTIONS)
    made = [how(env) for how in COPIES.values()]
    before = flight(env)
    # Copies that are made in the middle of an episode begin anew, too.
    made += [how(env) for how in COPIES.values()]
    for other in made:
        assert type(other) is type(env)
        assert_same(flight(other), before)
        other.close()
    # The original goes on.
    act(env, 5)
    with pytest.raises(TypeError, match="would share its engine: use copy.deepcopy"):
        copy.copy(env)
    env.close()
    closed = pickle.loads(pickle.dumps(env))
    assert_same(flight(closed), before)
    closed.close()


def test_a_recipe_keeps_what_the_options_were():
    weights = {"goal": 2.0}
    env = bulletuav.Aviary("crossing", weights=weights)
    weights["goal"] = 3.0
    again = copy.deepcopy(env)
    assert again.task.weights["goal"] == env.task.weights["goal"] == 2.0
    again.close()
    env.close()


def is_opened(one):
    """Tell whether an object is one of ours or PettingZoo's, or a `functools.partial`."""
    is_ours = type(one).__module__.startswith(("bulletuav", "pettingzoo"))
    return is_ours or callable(getattr(one, "func", None))


def reachable(root):
    """All arrays that an object holds, through the package's own objects and containers."""
    seen = set()
    found = []
    left = [root]
    while left:
        one = left.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, np.ndarray):
            found.append(one)
        elif isinstance(one, Mapping):
            left += list(one.values())
        elif isinstance(one, list | tuple | set):
            left += list(one)
        elif is_opened(one):
            left += list(getattr(one, "__dict__", {}).values())
            left += [cell.cell_contents for cell in getattr(one, "__closure__", None) or ()]
    return found


@pytest.mark.parametrize("name", MAKERS)
def test_nothing_handed_out_shares_memory_with_what_goes_on(name):
    """Neither with anything the environment holds, nor with what it hands out later."""
    env = MAKERS[name](**{**OPTIONS, "horizon": 3}, randomization=NOISY)
    handed = []
    for k, given in enumerate(flight(env, 4)):
        handed.append(list(arrays(given)))
        assert handed[-1] or k
    extra = [env.state()] if hasattr(env, "state") and name != "DroneVecEnv" else []
    extra += [getattr(env, attribute) for attribute in ("ended",) if hasattr(env, attribute)]
    handed.append(extra + ([env.alive] if name.startswith("batch") else []))
    held = reachable(env)
    assert len(held) > 20 or "workers" in name
    everything = [array for given in handed for array in given]
    for given in everything:
        assert given.flags.writeable
        assert not any(np.shares_memory(given, own) for own in held)
    for k, given in enumerate(handed):
        later = [array for rest in handed[k + 1 :] for array in rest]
        assert not any(np.shares_memory(one, other) for one in given for other in later)
    env.close()


def test_what_is_written_into_results_changes_no_flight():
    flights = []
    for scribble in (False, True):
        env = bulletuav.batch_env("crossing", 2, randomization=NOISY, **OPTIONS)
        env.reset()
        rows = []
        for k in range(8):
            given = act(env, k)
            rows.append([array.copy() for array in arrays(given)])
            if scribble:
                for array in arrays(given):
                    array[...] = 1
        flights.append(rows)
        env.close()
    assert_same(*flights)


THREADS = """
import threading, sys
import numpy as np
import bulletuav

def fly(seed, out):
    for repeat in range(8):
        bulletuav.Aviary("hover").close()
    for repeat in range(2):
        dynamics = ("bullet", "rigid_body")[seed % 2]
        env = bulletuav.Aviary("obstacles", 2, num_drones=3, dynamics=dynamics, seed=seed)
        env.reset()
        for k in range(4):
            step = env.step(np.full((2, 3, 3), 0.3))
        out[seed] = step.observations
        env.close()

alone, together = {}, {}
for seed in range(3):
    fly(seed, alone)
threads = [threading.Thread(target=fly, args=(seed, together)) for seed in range(3)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert all((alone[seed] == together[seed]).all() for seed in range(3))
print("said")
print("told", file=sys.stderr)
"""


def test_environments_in_threads_keep_the_output_and_the_bits():
    done = subprocess.run(
        [sys.executable, "-c", THREADS], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr, done.returncode) == ("said\n", "told\n", 0)


def test_a_fork_while_another_thread_builds_leaves_the_child_its_output():
    program = """
import os, threading, bulletuav
stop = threading.Event()
def build():
    while not stop.is_set():
        bulletuav.Aviary("hover").close()
thread = threading.Thread(target=build)
thread.start()
for _ in range(20):
    child = os.fork()
    if child == 0:
        os.write(1, b"x")
        os._exit(0)
    os.waitpid(child, 0)
stop.set()
thread.join()
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("x" * 20, 0)


@pytest.mark.parametrize("closed", ["1, 2"])
def test_a_process_without_standard_streams_can_fly(closed, tmp_path):
    program = (
        f"import os; [os.close(k) for k in ({closed},)]; "
        f"import bulletuav; bulletuav.Aviary('hover').reset(); "
        f"open({str(tmp_path / 'done')!r}, 'w').close()"
    )
    subprocess.run(
        [sys.executable, "-c", program],
        check=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert (tmp_path / "done").exists()


class Waiting:
    """A wind that lets another thread try meanwhile."""

    def __init__(self):
        self.entered, self.leave = threading.Event(), threading.Event()

    def __call__(self, position, time):
        self.entered.set()
        assert self.leave.wait(60)
        return np.zeros_like(position)


@pytest.mark.parametrize(
    "name", ["Aviary", "parallel_env", "batch_env", "gymnasium.make", "DroneVecEnv"]
)
def test_a_second_thread_is_refused_and_the_first_flies_on(name):
    wind = Waiting()
    env = MAKERS[name](**OPTIONS, wind=wind)
    env.reset()
    results = []
    thread = threading.Thread(target=lambda: results.append(act(env, 0)))
    thread.start()
    assert wind.entered.wait(60)
    for call in (lambda: act(env, 0), env.reset, env.close):
        with pytest.raises(RuntimeError, match="in use by another thread"):
            call()
    wind.leave.set()
    thread.join()
    act(env, 1)  # one after the other is fine
    assert results
    env.close()
