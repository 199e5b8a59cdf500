"""Train with a curriculum: from four crossing drones to eight with noisy positions.

The stage depends on the success rate of the last episodes: up when 80 % of the drones reached their
goals without conflict, down below 20 %. Prints a line for each change of stage, and regularly the
number of decisions, the stage and the success rate. One network is used in all stages, as it
observes the nearest three drones.

With seed 0 the last stage begins after 1.7 million decisions. After training, 0.93 (stage 0) to
0.99 (stage 3) of the drones succeed in `bullet`.

Run it:

    python examples/curriculum.py
    python examples/curriculum.py --steps 500000 --seed 1 --out stages

Takes about 2 minutes on one core. Needs the extra `sb3`.
"""

import argparse
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv, LivingRollouts, Symlog
from bulletuav.envs.curriculum import Curriculum

# A conflict ends the episode of the drone without success
COMMON = {"conflict_ends": "drone", "randomization": {}}
STAGES = [
    {"num_drones": 4},
    {"num_drones": 6},
    {"num_drones": 8},
    {"num_drones": 8, "randomization": {"gps_noise": (0.5, 1.5)}},
]
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


class Report(BaseCallback):
    """Callback that prints a line at each change of stage and every 20 rollouts."""

    def __init__(self, curriculum: Curriculum):
        super().__init__()
        self.curriculum = curriculum
        self.stage = 0
        self.rollouts = 0

    def _on_step(self) -> bool:
        stage = self.curriculum.stage
        if stage != self.stage:
            direction = "up" if stage > self.stage else "down"
            print(f"{self.num_timesteps:9,} decisions: {direction} to stage {stage}", flush=True)
            self.stage = stage
        return True

    def _on_rollout_end(self) -> None:
        self.rollouts += 1
        if self.rollouts % 20 == 0:
            success = self.curriculum.success_rate
            print(
                f"{self.num_timesteps:9,} decisions: at stage {self.stage}, success {success:.2f}",
                flush=True,
            )


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=4_000_000,
        help="total decisions of all slots, including empty slots",
    )
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("curriculum"), help="folder for the files")
    return parser.parse_args()


def train(steps: int, seed: int, path: Path) -> None:
    """Train in `point_mass` through the stages and save the model."""
    curriculum = Curriculum(len(STAGES), up=0.8, down=0.2, window=64)
    env = DroneVecEnv(
        "crossing", 32, STAGES, curriculum, dynamics="point_mass", weights=WEIGHTS, **COMMON
    )
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=2048,
        n_epochs=5,
        learning_rate=LinearSchedule(1e-3, 1e-5, 1.0),
        gamma=0.99,
        gae_lambda=0.95,
        # Stages with fewer drones have empty slots, which are dropped
        rollout_buffer_class=LivingRollouts,
        policy_kwargs={
            "features_extractor_class": Symlog,
            "net_arch": [64, 64],
            "log_std_init": -1.0,
        },
        seed=seed,
        device="cpu",
    )
    model.learn(steps, callback=Report(curriculum))
    model.save(path)
    env.close()


def evaluate(policy: str, stage: int, episodes: int) -> None:
    """Evaluate the policy in a stage, in `bullet`, and print success and conflicts."""
    options = {**COMMON, **STAGES[stage]}
    result = bulletuav.evaluate("crossing", policy, episodes, seed=1000, trust=True, **options)
    estimates = result.estimates()
    print(
        f"stage {stage} in bullet: success of drones {estimates['drone_success'].mean:.2f}, "
        f"episodes with conflict {estimates['conflict'].mean:.2f}"
    )


def main() -> None:
    """Train, then evaluate in every stage."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    train(args.steps, args.seed, args.out / "model")
    for stage in range(len(STAGES)):
        evaluate(f"ppo:{args.out / 'model.zip'}", stage, args.episodes)
    print(f"the model is in {args.out}")


if __name__ == "__main__":
    main()
