"""Train four drones with DQN to cross at right angles by seven discrete actions.

The actions are to stay, or to fly at maximum speed along an axis. All drones share one network and
one replay buffer. Prints success and conflicts before and after training, in `point_mass` and in
`bullet` with all forces. With the untrained network 0.12 of the drones reach their goals, with the
trained one about 0.8, and every seventh episode has a conflict. PPO with velocities achieves more
in the same time.

Run it:

    python examples/dqn_discrete.py
    python examples/dqn_discrete.py --steps 200000 --seed 1 --out dqn

Takes about 2 minutes on one core. Needs the extra `sb3`.
"""

import argparse
from pathlib import Path

import torch
from stable_baselines3 import DQN
from stable_baselines3.common.utils import LinearSchedule

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv, LivingReplay, Symlog

OPTIONS = {
    "num_drones": 4,
    "difficulty": "easy",
    "action": "discrete",
    "horizon": 200,
    "goal_radius": 5.0,
}
# Smaller than the default weights of the task, so that returns are of the order of 1
WEIGHTS = {
    "progress": 0.05,
    "goal": 2.0,
    "conflict": -3.0,
    "warning": -0.1,
    "collision": -5.0,
    "out_of_bounds": -5.0,
    "energy": 0.0,
    "time": -0.02,
}
METRICS = ("drone_success", "conflict", "conflicts", "goal_distance")


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=300_000, help="total decisions of all slots")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("dqn_discrete"), help="folder for the files"
    )
    return parser.parse_args()


def train(steps: int, seed: int, folder: Path) -> None:
    """Train in `point_mass`; save the model before and after training."""
    env = DroneVecEnv("crossing", num_worlds=16, dynamics="point_mass", weights=WEIGHTS, **OPTIONS)
    model = DQN(
        "MlpPolicy",
        env,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        buffer_size=100_000,
        # Drones leave at their goals; slots without a drone are dropped
        replay_buffer_class=LivingReplay,
        learning_starts=5_000,
        batch_size=256,
        gamma=0.97,
        train_freq=1,
        gradient_steps=8,  # for up to 64 new transitions
        target_update_interval=10_000,
        exploration_fraction=0.3,
        exploration_final_eps=0.02,
        policy_kwargs={"features_extractor_class": Symlog, "net_arch": [64, 64]},
        seed=seed,
        device="cpu",
        verbose=1,
    )
    model.save(folder / "untrained")
    model.learn(steps, log_interval=500)
    model.save(folder / "trained")
    env.close()


def evaluate(path: Path, dynamics: str, episodes: int) -> None:
    """Evaluate a saved model and print the means of its metrics."""
    result = bulletuav.evaluate(
        "crossing", f"dqn:{path}.zip", episodes, seed=1000, trust=True, dynamics=dynamics, **OPTIONS
    )
    estimates = result.estimates()
    numbers = ", ".join(f"{metric} {estimates[metric].mean:.2f}" for metric in METRICS)
    print(f"{path.name} in {dynamics}: {numbers}", flush=True)


def main() -> None:
    """Train and evaluate."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    train(args.steps, args.seed, args.out)
    evaluate(args.out / "untrained", "point_mass", args.episodes)
    evaluate(args.out / "trained", "point_mass", args.episodes)
    evaluate(args.out / "trained", "bullet", args.episodes)
    print(f"models are in {args.out}")


if __name__ == "__main__":
    main()
