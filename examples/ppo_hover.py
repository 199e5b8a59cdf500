"""PPO teaches a Crazyflie to fly to its target and stay there, and the engine examines it.

One sees the return and the success rate rise, in a table every 200,000 decisions, from 64 worlds at once in `rigid_body`.
Then the policy flies in `bullet`, where it never was, and a picture shows one flight. Takes about 2 minutes on one core.

    python examples/ppo_hover.py
    python examples/ppo_hover.py --steps 500000 --seed 1 --out hover
"""

import argparse
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.analysis.recording import fly_episode
from bulletuav.policies import find_policy
from bulletuav.report.pictures import plot_tracks

OPTIONS = {"action": "velocity", "observation": ("goal_offset", "velocity")}
WEIGHTS = {"distance": -1.0, "speed": -0.5}  # of the reward; the speed keeps it from shooting past


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="decisions of all drones together"
    )
    parser.add_argument("--episodes", type=int, default=100, help="of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo_hover"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    env = DroneVecEnv("hover", num_worlds=64, dynamics="rigid_body", weights=WEIGHTS, **OPTIONS)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=1024,
        n_epochs=5,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        gamma=0.97,  # looks about a second ahead, at 30 decisions a second
        gae_lambda=0.95,
        policy_kwargs={
            "net_arch": [64, 64],
            "log_std_init": -1.5,
        },  # begins with small noise: 0.2 of max_speed
        seed=args.seed,
        device="cpu",
        verbose=1,
    )
    model.learn(args.steps, log_interval=100)
    model.save(args.out / "model")
    env.close()

    pilot = f"ppo:{args.out / 'model.zip'}"
    result = bulletuav.evaluate(
        "hover", pilot, episodes=args.episodes, seed=1000, dynamics="bullet", trust=True, **OPTIONS
    )
    for metric in ("success", "goal_distance", "collision"):
        estimate = result.estimates()[metric]
        print(
            f"in bullet: {metric} {estimate.mean:.3f} ({estimate.low:.3f} to {estimate.high:.3f})"
        )

    aviary = bulletuav.Aviary("hover", dynamics="bullet", start=((-0.5, -0.5, 1.5),), **OPTIONS)
    recording = fly_episode(aviary, find_policy(pilot, trust=True)(aviary), seed=0)
    plot_tracks(recording, aviary.task.config.d_safe, "PPO hovers", args.out / "flight.png")
    aviary.close()
    print(f"model and picture are in {args.out}")
