"""From four drones that cross to eight with noisy positions: difficulty follows success.

One sees a line for every stage that is reached (or given up again), and regularly between: decisions so far, stage, and the
share of the last episodes' drones that came to their goals without conflict, which decides. One network flies all stages, as
it observes the nearest three drones. With seed 0 the last stage begins after 1.7 million decisions, and in the end from 0.93
(stage 0) to 0.99 (stage 3) of the drones succeed in `bullet`. Takes about 2 minutes on one core.

    python examples/curriculum.py
    python examples/curriculum.py --steps 500000 --seed 1 --out stages
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

COMMON = {"conflict_ends": "drone", "randomization": {}}  # who conflicts does not succeed
STAGES = [
    {"num_drones": 4},
    {"num_drones": 6},
    {"num_drones": 8},
    {"num_drones": 8, "randomization": {"gps_noise": (0.5, 1.5)}},
]
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
    """A line at each change of stage and every 20 rollouts."""

    def __init__(self, curriculum: Curriculum):
        super().__init__()
        self.curriculum, self.stage, self.rollouts = curriculum, 0, 0

    def _on_step(self) -> bool:
        if self.curriculum.stage != self.stage:
            where = "up" if self.curriculum.stage > self.stage else "down"
            print(
                f"{self.num_timesteps:9,} decisions: {where} to stage {self.curriculum.stage}",
                flush=True,
            )
            self.stage = self.curriculum.stage
        return True

    def _on_rollout_end(self) -> None:
        self.rollouts += 1
        if self.rollouts % 20 == 0:
            rate = self.curriculum.success_rate
            print(
                f"{self.num_timesteps:9,} decisions: at stage {self.stage}, success {rate:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=4_000_000,
        help="decisions of all slots, those without a drone too",
    )
    parser.add_argument("--episodes", type=int, default=50, help="of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("curriculum"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    rule = Curriculum(len(STAGES), up=0.8, down=0.2, window=64)
    env = DroneVecEnv(
        "crossing", 32, STAGES, rule, dynamics="point_mass", weights=WEIGHTS, **COMMON
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
        rollout_buffer_class=LivingRollouts,  # stages with fewer drones leave slots empty
        policy_kwargs={
            "features_extractor_class": Symlog,
            "net_arch": [64, 64],
            "log_std_init": -1.0,
        },
        seed=args.seed,
        device="cpu",
    )
    model.learn(args.steps, callback=Report(rule))
    model.save(args.out / "model")
    env.close()

    for stage, options in enumerate(STAGES):
        policy = f"ppo:{args.out / 'model.zip'}"
        result = bulletuav.evaluate(
            "crossing", policy, args.episodes, seed=1000, trust=True, **{**COMMON, **options}
        ).estimates()
        print(
            f"stage {stage} in bullet: success of drones {result['drone_success'].mean:.2f}",
            end=", ",
        )
        print(f"episodes with conflict {result['conflict'].mean:.2f}")
    print(f"the model is in {args.out}")
