"""PPO teaches eight drones, which share one policy, to cross an airspace without conflict.

One sees the return rise in a table every 320,000 decisions: drones first learn to fly to their goals, then to make way. They
learn as points, which is fast; then they fly with all forces in `bullet`, beside two baselines that see the true state
(`straight` avoids nobody, `orca` is built for avoiding), and a picture shows one flight. Takes about 90 s on one core.

    python examples/ppo_crossing.py
    python examples/ppo_crossing.py --steps 500000 --seed 1 --out crossing
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

WEIGHTS = {  # those of the task divided by about 50, as networks like returns of the order of 1
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

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=2_000_000, help="decisions of all slots together"
    )
    parser.add_argument("--episodes", type=int, default=50, help="of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo_crossing"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

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
        rollout_buffer_class=LivingRollouts,  # drones leave at their goals; of slots without one nothing is learned
        policy_kwargs={
            "features_extractor_class": Symlog,
            "net_arch": [64, 64],
            "log_std_init": -1.0,
        },
        seed=args.seed,
        device="cpu",
        verbose=1,
    )
    model.learn(args.steps, log_interval=20)
    model.save(args.out / "model")
    env.close()

    trained = f"ppo:{args.out / 'model.zip'}"
    print("\n" + "in bullet".ljust(10) + "".join(metric.rjust(17) for metric in METRICS))
    for name, policy in {"ppo": trained, "straight": "straight", "orca": "orca"}.items():
        estimates = bulletuav.evaluate(
            "crossing", policy, episodes=args.episodes, seed=1000, trust=True
        ).estimates()
        print(name.ljust(10) + "".join(f"{estimates[metric].mean:17.2f}" for metric in METRICS))

    aviary = bulletuav.Aviary("crossing")
    recording = fly_episode(aviary, find_policy(trained, trust=True)(aviary), seed=1000)
    plot_tracks(recording, aviary.task.config.d_safe, "PPO crosses", args.out / "flight.png")
    aviary.close()
    print(f"model and picture are in {args.out}")
