"""Train a Crazyflie with PPO to fly to its target and hover there.

Training uses `rigid_body` and 64 worlds. A table every 200,000 decisions shows return and success
rate. Then the policy is evaluated in `bullet`, in which it was not trained, and one flight is
plotted.

Run it:

    python examples/ppo_hover.py
    python examples/ppo_hover.py --steps 500000 --seed 1 --out hover

Takes about 2 minutes on one core. Needs the extra `sb3`.
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
# Weights of the reward; that of the speed prevents overshoot
WEIGHTS = {"distance": -1.0, "speed": -0.5}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="total decisions of all drones"
    )
    parser.add_argument("--episodes", type=int, default=100, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo_hover"), help="folder for the files")
    return parser.parse_args()


def train(steps: int, seed: int, path: Path) -> None:
    """Train in `rigid_body` and save the model."""
    env = DroneVecEnv("hover", num_worlds=64, dynamics="rigid_body", weights=WEIGHTS, **OPTIONS)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=1024,
        n_epochs=5,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        gamma=0.97,  # horizon of about one second, at 30 decisions per second
        gae_lambda=0.95,
        # Small initial standard deviation of actions: 0.2 of max_speed
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.5},
        seed=seed,
        device="cpu",
        verbose=1,
    )
    model.learn(steps, log_interval=100)
    model.save(path)
    env.close()


def evaluate(policy: str, episodes: int) -> None:
    """Evaluate the policy in `bullet` and print metrics with 95 % confidence intervals."""
    result = bulletuav.evaluate(
        "hover", policy, episodes=episodes, seed=1000, dynamics="bullet", trust=True, **OPTIONS
    )
    for metric in ("success", "goal_distance", "collision"):
        estimate = result.estimates()[metric]
        print(
            f"in bullet: {metric} {estimate.mean:.3f} ({estimate.low:.3f} to {estimate.high:.3f})"
        )


def draw_flight(policy: str, path: Path) -> None:
    """Fly one episode in `bullet` from a fixed start, and plot its track."""
    aviary = bulletuav.Aviary("hover", dynamics="bullet", start=((-0.5, -0.5, 1.5),), **OPTIONS)
    pilot = find_policy(policy, trust=True)(aviary)
    recording = fly_episode(aviary, pilot, seed=0)
    plot_tracks(recording, aviary.task.config.d_safe, "PPO hovers", path)
    aviary.close()


def main() -> None:
    """Train, evaluate and plot one flight."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    train(args.steps, args.seed, args.out / "model")
    policy = f"ppo:{args.out / 'model.zip'}"
    evaluate(policy, args.episodes)
    draw_flight(policy, args.out / "flight.png")
    print(f"model and picture are in {args.out}")


if __name__ == "__main__":
    main()
