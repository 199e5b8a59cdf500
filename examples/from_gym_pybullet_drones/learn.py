"""The script learn.py of gym-pybullet-drones in bulletuav: PPO learns to hover.

Trains PPO of stable-baselines3 on Gymnasium environments of the task `hover`. Prints the return
before and after, and the final distance from the target. The docs compare this script with the
original, line by line. Many worlds in one call learn faster: see examples/ppo_hover.py.

Run it:

    python examples/from_gym_pybullet_drones/learn.py
    python examples/from_gym_pybullet_drones/learn.py --steps 1000000 --out longer

Takes a minute on one core. Needs the extra `sb3`.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import bulletuav  # noqa: F401, registers its environments with Gymnasium

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--steps", type=int, default=300_000, help="decisions to learn from")
parser.add_argument("--out", type=Path, default=Path("learn"), help="folder for the model")
args = parser.parse_args()

options = {
    "action": "velocity",
    "observation": ("goal_offset", "velocity"),
    "weights": {"distance": -1.0, "speed": -0.5},  # of the reward
}
env = make_vec_env("bulletuav/Hover-v2", n_envs=16, seed=0, env_kwargs=options)
check = make_vec_env("bulletuav/Hover-v2", n_envs=1, seed=1000, env_kwargs=options)
model = PPO(
    "MlpPolicy",
    env,
    n_steps=128,
    batch_size=512,
    learning_rate=1e-3,
    gamma=0.97,  # horizon of about one second
    policy_kwargs={"log_std_init": -1.5},  # small initial noise
    seed=0,
    device="cpu",
)


def evaluate(name: str) -> None:
    """Fly 10 episodes, and print returns and final distances from the target."""
    ends = []

    def note(local: dict[str, Any], _: dict[str, Any]) -> None:
        if local["done"]:
            ends.append(local["info"]["goal_distance"][0])

    mean, spread = evaluate_policy(model, check, n_eval_episodes=10, callback=note)
    print(
        f"{name} learning: return {mean:.1f} +- {spread:.1f}, "
        f"ends {100 * np.mean(ends):.1f} cm from the target"
    )


evaluate("before")
model.learn(args.steps)
evaluate("after")
args.out.mkdir(parents=True, exist_ok=True)
model.save(args.out / "model")
env.close()
check.close()
