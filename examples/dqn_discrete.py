"""DQN with seven actions for four drones, which share one network: stay, or full speed along an axis.

They cross at right angles and learn from what all of them remember. One sees success and conflicts of the untrained network
and of the trained one, as points and in `bullet` with all forces: 0.12 of the drones reach their goals before, about 0.8
after, and there is a conflict in every seventh flight; PPO with velocities comes further in the time. Takes about 2 minutes
on one core.

    python examples/dqn_discrete.py
    python examples/dqn_discrete.py --steps 200000 --seed 1 --out dqn
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


def examine(path: Path, dynamics: str, episodes: int) -> None:
    result = bulletuav.evaluate(
        "crossing", f"dqn:{path}.zip", episodes, seed=1000, trust=True, dynamics=dynamics, **OPTIONS
    )
    numbers = ", ".join(f"{metric} {result.estimates()[metric].mean:.2f}" for metric in METRICS)
    print(f"{path.name} in {dynamics}: {numbers}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=300_000, help="decisions of all slots together"
    )
    parser.add_argument("--episodes", type=int, default=50, help="of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("dqn_discrete"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    env = DroneVecEnv("crossing", num_worlds=16, dynamics="point_mass", weights=WEIGHTS, **OPTIONS)
    model = DQN(
        "MlpPolicy",
        env,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        buffer_size=100_000,
        replay_buffer_class=LivingReplay,  # drones leave at their goals; slots without one are not remembered
        learning_starts=5_000,
        batch_size=256,
        gamma=0.97,
        train_freq=1,
        gradient_steps=8,  # for up to 64 new transitions
        target_update_interval=10_000,
        exploration_fraction=0.3,
        exploration_final_eps=0.02,
        policy_kwargs={"features_extractor_class": Symlog, "net_arch": [64, 64]},
        seed=args.seed,
        device="cpu",
        verbose=1,
    )
    model.save(args.out / "untrained")
    model.learn(args.steps, log_interval=500)
    model.save(args.out / "trained")
    env.close()

    for name in ("untrained", "trained"):
        examine(args.out / name, "point_mass", args.episodes)
    examine(args.out / "trained", "bullet", args.episodes)
    print(f"models are in {args.out}")
