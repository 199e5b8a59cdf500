"""What is it worth to learn under uncertainty? The same training with and without it, flown both ways.

A Crazyflie learns to hold its place by velocities, once where all is as its controller believes, once where mass, thrust,
motors and wind differ from flight to flight. Both policies then fly in both worlds, in `bullet`. One sees that the first
holds its place to 1 cm while all is certain, and misses it by 26 cm where nothing is (the controller has no integral term);
the second misses by 6 and 11 cm. Success, within 10 cm, rises from 12 % to 62 %. Takes about 100 s on one core.

    python examples/domain_randomisation.py
    python examples/domain_randomisation.py --steps 300000 --seed 1 --out randomisation
"""

import argparse
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv

# What was commanded last, beside what came of it, tells of the disturbance.
OPTIONS = {"action": "velocity", "observation": ("goal_offset", "velocity", "last_action")}
WORLDS = {
    "certain": {},
    "uncertain": {
        "mass": (0.7, 1.3),  # of what the controller believes; so are the next three
        "thrust": (0.85, 1.1),
        "drag": (0.5, 1.5),
        "motor_lag": (0.5, 1.5),
        "wind": (-3.0, 3.0),  # m/s on each axis
    },
}
METRICS = ("success", "goal_distance", "collision")


def train(randomization: dict, steps: int, seed: int, path: Path) -> None:
    env = DroneVecEnv(
        "hover",
        num_worlds=64,
        dynamics="rigid_body",
        weights={"distance": -1.0, "speed": -0.5},
        randomization=randomization,
        **OPTIONS,
    )
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=1024,
        n_epochs=5,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        gamma=0.97,
        gae_lambda=0.95,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.5},
        seed=seed,
        device="cpu",
    )
    model.learn(steps)
    model.save(path)
    env.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=1_000_000, help="decisions of each training")
    parser.add_argument("--episodes", type=int, default=100, help="of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("domain_randomisation"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    for name, randomization in WORLDS.items():
        print(f"training in the {name} world", flush=True)
        train(randomization, args.steps, args.seed, args.out / name)
    print(
        "trained in".ljust(12)
        + "flown in".ljust(12)
        + "".join(metric.rjust(15) for metric in METRICS)
    )
    for flown, randomization in WORLDS.items():
        for trained in WORLDS:
            policy, options = (
                f"ppo:{args.out / trained}.zip",
                {**OPTIONS, "randomization": randomization},
            )
            estimates = bulletuav.evaluate(
                "hover", policy, args.episodes, seed=1000, trust=True, **options
            ).estimates()
            row = "".join(f"{estimates[metric].mean:15.3f}" for metric in METRICS)
            print(trained.ljust(12) + flown.ljust(12) + row)
    print(f"models are in {args.out}")
