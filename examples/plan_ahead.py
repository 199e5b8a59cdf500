"""Plan with snapshots: simulate many continuations of the present state, and fly the best one.

Random shooting: at each decision all worlds of a second environment continue from a snapshot of the
first one, each with other random deviations from the straight line to the goals. The first action
of the continuation with the highest return is flown. The same flight without planning is printed
for comparison.

Run it:

    python examples/plan_ahead.py
    python examples/plan_ahead.py --drones 6 --plans 128 --seed 1

Takes about 10 seconds on one core, once kernels are compiled.
"""

import argparse

import numpy as np
from rich.progress import track

import bulletuav

DETOUR = 0.5
"""Standard deviation of the deviations, as a fraction of the maximum speed"""


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drones", type=int, default=4)
    parser.add_argument(
        "--plans", type=int, default=64, help="continuations simulated at each decision"
    )
    parser.add_argument("--ahead", type=int, default=20, help="planning horizon in decisions")
    parser.add_argument("--decisions", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def to_goals(aviary: bulletuav.Aviary) -> np.ndarray:
    """Return actions (W, N, 3) straight to the goals, at maximum speed."""
    way = aviary.scene.goal - aviary.swarm.position
    actions: np.ndarray = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1.0)
    return actions


def earned(tries: bulletuav.Aviary, detour: np.ndarray, ahead: int) -> np.ndarray:
    """Fly deviations (W, N, 3) that fade out; return the return of each world (W,)."""
    total = np.zeros(tries.num_worlds)
    for k in range(ahead):
        action = to_goals(tries) + (1 - k / ahead) * detour
        total += tries.step(action).rewards.sum(axis=1)
    return total


def fly(arguments: argparse.Namespace, plans: bool) -> tuple[float, int]:
    """Fly an episode, with or without planning; return its return and conflicts."""
    options = {"num_drones": arguments.drones, "dynamics": "rigid_body", "difficulty": "easy"}
    world = bulletuav.Aviary("crossing", jitter=0.0, altitude_spread=0.0, **options)
    tries = bulletuav.Aviary(
        "crossing", arguments.plans, jitter=0.0, altitude_spread=0.0, **options
    )
    world.reset(seeds=arguments.seed)
    rng = np.random.default_rng(arguments.seed)
    total, conflicts = 0.0, 0
    for _ in track(range(arguments.decisions), "planned" if plans else "straight"):
        detour = np.zeros((1, arguments.drones, 3))
        if plans:
            tries.load_state(world.save_state()[[0] * arguments.plans])
            tried = rng.normal(0.0, DETOUR, (arguments.plans, arguments.drones, 3))
            tried[0] = 0.0  # one of them is straight
            best = int(earned(tries, tried, arguments.ahead).argmax())
            detour = tried[[best]]
        step = world.step(to_goals(world) + detour)
        total += float(step.rewards.sum())
        conflicts += int(step.info["conflicts"].sum()) // 2
        if not world.alive.any():
            break
    world.close()
    tries.close()
    return total, conflicts


def main() -> None:
    """Fly with and without planning."""
    arguments = parse_arguments()
    for plans in (False, True):
        total, conflicts = fly(arguments, plans)
        name = "planned" if plans else "straight"
        print(f"{name}: return {total:.0f}, conflicts {conflicts}")


if __name__ == "__main__":
    main()
