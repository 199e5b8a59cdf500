"""Every public entry point, used first in a new process: `python first_use.py threads|fork|...`.

Prints "ok", or the errors by entry point.
"""

import multiprocessing
import os
import sys
import threading
import traceback

LIMIT = 600
"""Time after which a thread is taken to hang, s: the first run on a machine compiles"""
FEW = ("parallel_env", "gymnasium.make", "check_sensor")
"""Entry points that processes of their own use"""


def entry_points():
    """Return a call for each public entry point, by name."""
    import gymnasium
    import pettingzoo

    import bulletuav
    from bulletuav.geometry.obstacle import Obstacle

    options = {"dynamics": "point_mass", "action": "velocity", "horizon": 3}

    def flown(env):
        env.reset(seed=0)
        env.close()

    def recorded():
        with bulletuav.Airspace([(0.0, 0.0, 1.0)], dynamics="point_mass") as airspace:
            bulletuav.AirspaceRecorder(airspace).close()

    return {
        "Airframe": lambda: bulletuav.Airframe,
        "Airspace": lambda: bulletuav.Airspace([(0.0, 0.0, 1.0)]).close(),
        "AirspaceRecorder": recorded,
        "Aviary": lambda: bulletuav.Aviary("crossing", 2, **options).close(),
        "SetpointLevel": lambda: bulletuav.SetpointLevel.ROTOR,
        "Versus": lambda: bulletuav.Versus(chasers="pursue", evaders="stay"),
        "aec_env": lambda: flown(bulletuav.aec_env("hover", **options)),
        "available_airframes": lambda: bulletuav.available_airframes(),
        "batch_env": lambda: flown(bulletuav.batch_env("formation", 2, **options)),
        "check_dynamics": lambda: bulletuav.check_dynamics("point_mass", horizon=3),
        "check_policy": lambda: bulletuav.check_policy("straight", "hover", **options),
        "check_sensor": lambda: bulletuav.check_sensor("radio", **options),
        "check_task": lambda: bulletuav.check_task("hover", **options),
        "curriculum_env": lambda: flown(bulletuav.curriculum_env("hover", ({}, {}), **options)),
        "evaluate": lambda: bulletuav.evaluate("crossing", "orca", 1, **options),
        "list_tasks": lambda: bulletuav.list_tasks(),
        "load_airframe": lambda: bulletuav.load_airframe("cf2x"),
        "make_load": lambda: bulletuav.make_load(Obstacle("box", (0.1, 0.1, 0.1)), 0.2),
        "parallel_env": lambda: flown(bulletuav.parallel_env("mec", **options)),
        "register": lambda: bulletuav.register("reward", "own")(len),
        "team_env": lambda: flown(
            bulletuav.team_env("pursuit_evasion", "chasers", "stay", **options)
        ),
        "gymnasium.make": lambda: flown(gymnasium.make("bulletuav/Hover-v2", **options)),
        "gymnasium.make_vec": lambda: flown(
            gymnasium.make_vec("bulletuav/Crossing-v2", num_envs=2, **options)
        ),
        "pettingzoo": lambda: (
            hasattr(pettingzoo, "register")
            and flown(pettingzoo.make("parallel", "bulletuav/Hover-v2", **options))
        ),
    }


def in_threads(calls):
    """Make calls in threads that start together; return the errors by name."""
    errors, start = {}, threading.Barrier(len(calls))

    def run(name, call):
        start.wait(LIMIT)
        try:
            call()
        except BaseException:
            errors[name] = traceback.format_exc()

    threads = {
        name: threading.Thread(target=run, args=(name, call), daemon=True)
        for name, call in calls.items()
    }
    for one in threads.values():
        one.start()
    for one in threads.values():
        one.join(LIMIT)
    return errors | {name: "hangs" for name, one in threads.items() if one.is_alive()}


def use_few():
    """Use some entry points in threads; fail where one raises."""
    errors = in_threads({name: call for name, call in entry_points().items() if name in FEW})
    assert not errors, errors


def import_and_use():
    """Import the package in several threads, and use an entry point in each."""
    names = (*FEW, "evaluate", "batch_env", "aec_env")
    return in_threads({name: lambda one=name: entry_points()[one]() for name in names})


def in_processes(method):
    """Use some entry points in two processes that start by a method; return their exit codes."""
    import bulletuav  # noqa: F401  # in this process, which a fork copies

    context = multiprocessing.get_context(method)
    processes = [context.Process(target=use_few) for _ in range(2)]
    for one in processes:
        one.start()
    for one in processes:
        one.join(LIMIT)
    return {one.name: one.exitcode for one in processes if one.exitcode != 0}


if __name__ == "__main__":
    uses = {
        "threads": lambda: in_threads(entry_points()),
        "import": import_and_use,
        "fork": lambda: in_processes("fork"),
        "spawn": lambda: in_processes("spawn"),
    }
    print(uses[sys.argv[1]]() or "ok", flush=True)
    os._exit(0)  # threads that hang must not keep the process alive
