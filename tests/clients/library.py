"""What clients of trainer libraries share: the task, rates, and a report of one line."""

import inspect
import json
import sys
import time
from importlib.metadata import version

import numpy as np

import bulletuav

TASK = "crossing"
OPTIONS = {"num_drones": 4, "dynamics": "point_mass", "difficulty": "easy"}
SECONDS = 3.0
"""CPU time of a measured rate, s"""


def make_env():
    """Make the PettingZoo environment, whose drones stay in it until the episode ends.

    Most libraries read results of all agents in each step.
    """
    import supersuit

    return supersuit.black_death_v3(bulletuav.parallel_env(TASK, **OPTIONS))


def measure(step, decisions):
    """Return decisions of one drone per CPU-second, where `step` flies some at a time."""
    step()
    since, count = time.process_time(), 0
    while time.process_time() - since < SECONDS:
        step()
        count += decisions
    return count / (time.process_time() - since)


def batch_rate(worlds):
    """Return the rate of `batch_env` with as many worlds."""
    env = bulletuav.batch_env(TASK, worlds, **OPTIONS)
    rng = np.random.default_rng(0)
    shape = (worlds, env.num_drones, *env.action_space.shape)
    actions = rng.uniform(-1, 1, shape).astype(np.float32)
    env.reset(seed=0)
    rate = measure(lambda: env.step(actions), worlds * env.num_drones)
    env.close()
    return rate


def report(packages, how, glue, worlds, collect, train):
    """Measure, train, and print a line of JSON.

    Args:
        packages: Names of the packages whose versions count.
        how: What was trained.
        glue: Functions and classes that a user must write, or their lines.
        worlds: Number of worlds.
        collect: Returns a function that flies a decision of all worlds by the library.
        train: Trains, and returns the number of decisions of drones.
    """
    if not isinstance(glue, int):
        glue = sum(len(inspect.getsource(one).splitlines()) for one in glue)
    rate = measure(collect(), worlds * OPTIONS["num_drones"])
    since = time.process_time()
    decisions = train()
    seconds = time.process_time() - since
    found = {
        "versions": {name: version(name) for name in packages},
        "python": ".".join(map(str, sys.version_info[:2])),
        "how": how,
        "glue": glue,
        "worlds": worlds,
        "share": rate / batch_rate(worlds),
        "training": decisions / seconds,
    }
    print(json.dumps(found))
