"""Golden trajectories: what the default environments do.

`python tests/golden.py TASK ...` writes them anew.
"""

import sys
from pathlib import Path

import numpy as np

import bulletuav
from bulletuav.dynamics import DEFAULT_DYNAMICS
from bulletuav.engine.calls import require_bullet

FOLDER = Path(__file__).parent / "golden"
STEPS = 100
SEEDS = {"obstacles": 1}
"""Seeds with which nothing is hit, where that is not so with 0"""


def fly(task):
    """Fly 100 steps of the default environment under smooth actions.

    Gives its observations, rewards and states.
    """
    aviary = bulletuav.Aviary(task)
    if aviary.options.dynamics == DEFAULT_DYNAMICS:
        require_bullet("golden trajectories of the default dynamics")
    rows = {
        "observations": [aviary.reset(seeds=SEEDS.get(task, 0))[0]],
        "rewards": [],
        "position": [],
        "quaternion": [],
        "rotor_speed": [],
    }
    shape = (aviary.num_drones, aviary.action.low.shape[-1])
    phase = np.arange(np.prod(shape)).reshape(shape)
    for k in range(min(STEPS, aviary.options.horizon - 1)):
        if aviary.options.action == "rotor":  # a hover with small disturbances
            airframe = aviary.options.airframe[0]
            hover = 2 * (airframe.hover_speed() / airframe.max_rotor_speed) ** 2 - 1
            action = hover + 0.001 * np.sin(0.9 * k + phase)
        else:
            size = 0.3  # small enough not to hit anything, where there is anything
            size = 0.1 if aviary.task.obstacles() else 0.05 if aviary.task.layouts() else size
            size *= min(1.0, aviary.options.decision_hz / 10)
            action = (
                size * np.sin(0.07 * k + phase)
                + aviary.scene.goal_velocity[0] / aviary.options.max_speed
            )
        step = aviary.step(action[None])
        rows["observations"].append(step.observations[0])
        rows["rewards"].append(step.rewards[0])
        for name in ("position", "quaternion", "rotor_speed"):
            rows[name].append(getattr(aviary.swarm, name)[0].copy())
    flown = {name: np.array(value) for name, value in rows.items()}
    flown["alive"] = aviary.alive[0].copy()
    aviary.close()
    return flown


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or bulletuav.list_tasks():
        np.savez_compressed(FOLDER / f"{name}.npz", **fly(name))
