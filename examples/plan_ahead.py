"""Plan with snapshots: try many ways to go on from where drones are, and fly the best one.

Random shooting: in each decision all worlds of a second environment go on from a snapshot of the
first one. Each tries other detours from the straight way to the goals. The first action of the one
that earns most is flown. The same flight without a plan is told beside it.

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
"""Standard deviation of detours, as a share of the greatest speed"""


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drones", type=int, default=4)
    parser.add_argument(
        "--plans", type=int, default=64, help="ways that are tried in each decision"
    )
    parser.add_argument("--ahead", type=int, default=20, help="decisions that they look ahead")
    parser.add_argument("--decisions", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def to_goals(aviary: bulletuav.Aviary) -> np.ndarray:
    """Give actions (W, N, 3) straight to the goals, at full speed."""
    way = aviary.scene.goal - aviary.swarm.position
    actions: np.ndarray = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1.0)
    return actions


def earned(tries: bulletuav.Aviary, detour: np.ndarray, ahead: int) -> np.ndarray:
    """Fly detours (W, N, 3) that fade out; give what each world earns."""
    total = np.zeros(tries.num_worlds)
    for k in range(ahead):
        action = to_goals(tries) + (1 - k / ahead) * detour
        total += tries.step(action).rewards.sum(axis=1)
    return total


def fly(arguments: argparse.Namespace, plans: bool) -> tuple[float, int]:
    """Fly an episode, with plans or straight; give its return and the conflicts."""
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
            tried[0] = 0.0  # among them straight on
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
    """Fly with plans and without."""
    arguments = parse_arguments()
    for plans in (False, True):
        total, conflicts = fly(arguments, plans)
        name = "planned" if plans else "straight"
        print(f"{name}: return {total:.0f}, conflicts {conflicts}")


if __name__ == "__main__":
    main()
