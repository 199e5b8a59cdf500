"""Digests of what environments do, to see that a change moves nothing.

    python tests/digests.py [--jobs N] > after.txt

Each line is for one environment: a sum over all arrays that it gives, blind to their names and
order. Compare two outputs of one machine, as another processor or C library may round differently.
`tests/digests.txt` is the table of the machine it names.
"""

import argparse
import hashlib
import itertools
import multiprocessing
import platform
import sys
import warnings

import numpy as np

import bulletuav
from bulletuav.commands import covering

DECISIONS = 90
RANDOM = 20  # of them at random
TO_GOAL = 20  # then so many towards the goal, and the others down
UNCERTAIN = dict(covering.UNCERTAIN)
DOWN = (0.0, 0.0, -1.0)
DYNAMICS = ("single_integrator", "double_integrator", "point_mass", "rigid_body", "bullet")
DIFFICULTIES = ("easy", "medium", "hard", "extreme")
ROTORS = ("rigid_body", "bullet")
ACTIONS = (
    "velocity",
    "velocity_increment",
    "heading_speed",
    "target_position",
    "attitude",
    "rates",
    "rotor",
    "rpm",
    "hover_rpm",
    "discrete",
    "discrete_27",
)
BLOCKS = (
    "clearance",
    "imu",
    "lidar",
    "battery",
    "neighbours",
    "all_neighbours",
    "obstacles",
    "identity",
    "alive",
    "last_action",
)


def variations():
    """Give the options of all environments whose digest is taken."""
    for task, dynamics, difficulty in itertools.product(
        bulletuav.list_tasks(), DYNAMICS, DIFFICULTIES
    ):
        plain = {"task": task, "dynamics": dynamics, "difficulty": difficulty}
        if dynamics not in ROTORS and task == "hover":
            plain["action"] = "velocity"
        if dynamics == "single_integrator" and task in ("crossing", "hover"):
            plain["action"] = "velocity_increment"
        yield plain | {"num_worlds": 1}
        yield plain | {"num_worlds": 5, "randomization": UNCERTAIN}
    for action, task in itertools.product(ACTIONS, ("crossing", "hover")):
        yield {"task": task, "action": action, "num_worlds": 5, "num_drones": 3}
    for block in BLOCKS:
        yield {
            "task": "obstacles",
            "observation": ("position", block),
            "num_worlds": 5,
            "randomization": UNCERTAIN,
        }
    for images in (("rgb", "depth", "segmentation"), ("velocity", "ray_depth")):
        yield {
            "task": "navigation",
            "observation": images,
            "camera_size": (16, 12),
            "num_worlds": 2,
        }
    for boundary, at_goal in itertools.product(
        ("end", "soft", "hard", "open"), ("leave", "land", "hold")
    ):
        yield {"task": "converge", "boundary": boundary, "at_goal": at_goal, "num_worlds": 5}
    for ends in ("drone", "world"):
        yield {"task": "converge", "conflict_ends": ends, "contact_ends": ends, "num_worlds": 5}
    weights = {
        "efficiency": 1.0,
        "speed_keeping": 1.0,
        "time": -1.0,
        "shaping": 1.0,
        "fairness": -0.1,
        "concession": 1.0,
    }
    yield {"task": "pursuit", "weights": weights, "num_worlds": 5}
    yield {"task": "crossing", "preset": "uavconflict", "num_worlds": 5}
    yield {"task": "hover", "preset": "hover_aviary", "num_worlds": 5}
    yield {"task": "mec", "preset": "urbanmarl", "num_worlds": 5}
    yield {
        "task": "crossing",
        "airframe": ["cf2x", "hummingbird", "firefly", "iris"],
        "num_worlds": 5,
    }
    yield {
        "task": "crossing",
        "controller": "pid",
        "airframe": "cf2x",
        "effects": ("drag", "downwash"),
        "num_worlds": 5,
    }
    yield {
        "task": "crossing",
        "wind": (3.0, 1.0, 0.5),
        "turbulence": "severe",
        "normalise": True,
        "num_worlds": 5,
    }
    yield {"task": "crossing", "energy": "actuator", "battery_capacity": 0.05, "num_worlds": 5}
    yield {"task": "hover", "gravity": 0.0, "num_worlds": 5}
    yield {"task": "crossing", "horizon": 15, "num_worlds": 5}
    yield {
        "task": "free_flight",
        "airframe": "quadplane",
        "dynamics": "rigid_body",
        "num_worlds": 5,
    }
    yield {
        "task": "crossing",
        "airframe": "trainer",
        "action": "target_position",
        "dynamics": "rigid_body",
        "num_worlds": 5,
    }


def digest(given):
    """Give eight bytes of what an environment gives, or the error of options that it refuses."""
    options = dict(given)
    task, worlds = options.pop("task"), options.pop("num_worlds")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            aviary = bulletuav.Aviary(task, worlds, **options)
        except ValueError as error:
            return f"refused: {str(error)[:60]}"
    total = 0
    try:
        for array in _fly(aviary):
            array = np.ascontiguousarray(array)
            data = repr((array.shape, array.dtype.kind)).encode() + array.tobytes()
            total += int.from_bytes(hashlib.sha256(data).digest()[:8], "big")
    finally:
        aviary.close()
    return f"{total % 2**64:016x}"


def _fly(aviary):
    """Yield everything that it gives: in random flight, then to the goal, then into the ground.

    Ended worlds start anew.
    """
    rng = np.random.default_rng(1)
    yield from _arrays(aviary.reset(seeds=3))
    yield from _infos(aviary.first_info())
    low, high = np.nan_to_num(aviary.action.low), np.nan_to_num(aviary.action.high)
    for k in range(DECISIONS):
        actions = rng.uniform(low, high, (aviary.num_worlds, *low.shape))
        if aviary.action.choices is not None:
            actions = np.floor(actions)
        elif k >= RANDOM and aviary.options.action in ("velocity", "velocity_increment"):
            offset = aviary.scene.goal - aviary.swarm.position
            way = offset / (1 + np.linalg.norm(offset, axis=-1, keepdims=True))
            actions = np.clip(0.2 * actions + (way if k < RANDOM + TO_GOAL else DOWN), low, high)
        elif k >= RANDOM + TO_GOAL:
            actions = np.clip(0.1 * actions + low, low, high)
        step = aviary.step(actions)
        yield from _arrays(step.observations)
        yield from (step.rewards, step.terminated, step.truncated, aviary.alive)
        yield from _infos(step.info)
        over = ~aviary.alive.any(axis=1)
        if k % 17 == 11:
            over[k % aviary.num_worlds] = True  # in the middle of an episode, while others fly on
        if over.any():
            yield from _arrays(aviary.reset(over))
            yield from _infos(aviary.first_info())
    yield aviary.state()
    yield from (
        aviary.swarm.position,
        aviary.swarm.quaternion,
        aviary.swarm.velocity,
        aviary.swarm.rates,
    )
    yield from (aviary.scene.goal, aviary.scene.obstacle, aviary.commanded)
    yield from (generator.random(2) for generator in aviary.rng)


def _infos(info):
    """Infos but reward terms that are zero: those of weight 0 may be told or left out."""
    return (
        value for name, value in info.items() if not name.startswith("reward/") or np.any(value)
    )


def _arrays(observations):
    return observations.values() if isinstance(observations, dict) else (observations,)


def machine():
    """Name what the bits of a table may depend on."""
    return f"{platform.machine()} {platform.libc_ver()} NumPy {np.__version__}"


def line(given):
    """Return an environment's line of the table."""
    shown = dict(given)
    if shown.get("randomization") == UNCERTAIN:
        shown["randomization"] = "all"
    try:
        value = digest(given)
    except Exception as error:
        value = f"failed: {type(error).__name__}: {str(error)[:60]}"
    return f"{value}  " + " ".join(f"{name}={value}" for name, value in shown.items())


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--every", type=int, default=1, help="only each nth line")
    args = parser.parse_args()
    chosen = list(variations())[:: args.every]
    print(f"# {machine()}: {len(chosen)} environments", flush=True)
    failed = False
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for row in pool.imap(line, chosen):
            print(row, flush=True)
            failed |= row.startswith("failed")
    sys.exit(failed)


if __name__ == "__main__":
    main()
