"""Train eight drones with PPO to cross an airspace without conflict.

All drones share one policy. A table every 320,000 decisions shows the return: drones first learn to
fly to their goals, then to avoid each other. Training uses `point_mass`, which is fast; the
evaluation uses `bullet` with all forces. Two baselines that read the true state are evaluated for
comparison: `straight` does not avoid other drones, `orca` is a collision avoidance algorithm. One
flight is plotted.

Run it:

    python examples/ppo_crossing.py
    python examples/ppo_crossing.py --steps 500000 --seed 1 --out crossing

Takes about 90 s on one core. Needs the extra `sb3`.
"""

import argparse
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv, LivingRollouts, Symlog
from bulletuav.analysis.recording import fly_episode
from bulletuav.policies import find_policy
from bulletuav.report.pictures import plot_tracks

# Smaller than the default weights of the task, so that returns are of the order of 1
WEIGHTS = {
    "progress": 0.05,
    "goal": 2.0,
    "conflict": -3.0,
    "warning": -0.1,
    "collision": -5.0,
    "out_of_bounds": -5.0,
    "energy": -0.0005,
    "time": -0.02,
}
METRICS = (
    "success",
    "drone_success",
    "conflict",
    "conflicts",
    "collision",
    "path_efficiency",
    "length",
)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=2_000_000, help="total decisions of all slots")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("ppo_crossing"), help="folder for the files"
    )
    return parser.parse_args()


def train(steps: int, seed: int, path: Path) -> None:
    """Train in `point_mass` and save the model."""
    env = DroneVecEnv("crossing", num_worlds=32, dynamics="point_mass", weights=WEIGHTS)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=2048,
        n_epochs=5,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        gamma=0.99,
        gae_lambda=0.95,
        # Drones leave at their goals; slots without a drone are dropped
        rollout_buffer_class=LivingRollouts,
        policy_kwargs={
            "features_extractor_class": Symlog,
            "net_arch": [64, 64],
            "log_std_init": -1.0,
        },
        seed=seed,
        device="cpu",
        verbose=1,
    )
    model.learn(steps, log_interval=20)
    model.save(path)
    env.close()


def compare(policies: dict[str, str], episodes: int) -> None:
    """Evaluate policies in `bullet` and print a table of their mean metrics."""
    print("\n" + "in bullet".ljust(10) + "".join(metric.rjust(17) for metric in METRICS))
    for name, policy in policies.items():
        result = bulletuav.evaluate("crossing", policy, episodes=episodes, seed=1000, trust=True)
        estimates = result.estimates()
        print(name.ljust(10) + "".join(f"{estimates[metric].mean:17.2f}" for metric in METRICS))


def draw_flight(policy: str, path: Path) -> None:
    """Fly one episode in `bullet` and plot its tracks."""
    aviary = bulletuav.Aviary("crossing")
    pilot = find_policy(policy, trust=True)(aviary)
    recording = fly_episode(aviary, pilot, seed=1000)
    plot_tracks(recording, aviary.task.config.d_safe, "PPO crosses", path)
    aviary.close()


def main() -> None:
    """Train, compare with baselines, and plot one flight."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    train(args.steps, args.seed, args.out / "model")
    trained = f"ppo:{args.out / 'model.zip'}"
    compare({"ppo": trained, "straight": "straight", "orca": "orca"}, args.episodes)
    draw_flight(trained, args.out / "flight.png")
    print(f"model and picture are in {args.out}")


if __name__ == "__main__":
    main()
