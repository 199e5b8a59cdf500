"""Train a chaser and an evader against each other by PPO, in turns.

In each round the chaser trains against the frozen evader of the previous round, and then the evader
against the new chaser. Both observe only what their task defines: opponents in sight. After each
round both are evaluated against scripted opponents, and against each other.

Run it:

    python examples/self_play.py
    python examples/self_play.py --rounds 10 --steps 100000 --seed 1 --out duel

Takes about 10 minutes on one core. Needs the extra `sb3`.
"""

import argparse
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO

import bulletuav
from bulletuav.adapters.self_play import CentralTeamAviary

# One against one in `point_mass`: a slower evader, and a small arena
OPTIONS = {
    "num_drones": 2,
    "dynamics": "point_mass",
    "difficulty": "easy",
    "area": 60.0,
    "ceiling": 30.0,
    "height": (8.0, 22.0),
    "evader_speed": 0.8,
    "normalise": True,
    "num_neighbours": 1,
    # A dense reward of the distance, and a smaller one of the capture
    "weights": {"capture": 8.0, "closing": 0.5},
}
Rows = Callable[[np.ndarray], np.ndarray]


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3, help="number of training rounds")
    parser.add_argument(
        "--steps", type=int, default=30_000, help="decisions of each side in a round"
    )
    parser.add_argument("--episodes", type=int, default=50, help="episodes of an evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("self_play"), help="folder for the files")
    return parser.parse_args()


def make_learner(env: CentralTeamAviary, seed: int) -> PPO:
    """Return a model for the team of an environment."""
    settings = {"net_arch": [64, 64], "log_std_init": -0.5}
    return PPO("MlpPolicy", env, n_steps=1024, policy_kwargs=settings, seed=seed, device="cpu")


def frozen(model: PPO) -> Rows:
    """Return the present policy of a model as a function; later training does not change it."""
    file = io.BytesIO()
    model.policy.save(file)
    file.seek(0)
    policy = type(model.policy).load(file)

    def fly(rows: np.ndarray) -> np.ndarray:
        return policy.predict(rows, deterministic=True)[0]

    return fly


def captured(chaser: str | Rows, evader: str | Rows, episodes: int) -> float:
    """Return the fraction of episodes in which the evader was captured."""
    versus = bulletuav.Versus(chasers=chaser, evaders=evader)
    result = bulletuav.evaluate("pursuit_evasion", versus, episodes, seed=1000, **OPTIONS)
    return result.estimates()["captured"].mean


def main() -> None:
    """Train both in turns, and evaluate them after each round."""
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # networks this small are no faster on more

    arenas = [
        bulletuav.team_env("pursuit_evasion", team, opponent, central=True, **OPTIONS)
        for team, opponent in (("chasers", "wander"), ("evaders", "lead"))
    ]
    chaser, evader = (make_learner(env, args.seed) for env in arenas)
    for k in range(args.rounds):
        chaser.learn(args.steps, reset_num_timesteps=False)
        arenas[1].opponents = frozen(chaser)
        evader.learn(args.steps, reset_num_timesteps=False)
        arenas[0].opponents = frozen(evader)
        pairs = {
            "against wander": (frozen(chaser), "wander"),
            "against flee": (frozen(chaser), "flee"),
            "evader, against lead": ("lead", frozen(evader)),
            "both": (frozen(chaser), frozen(evader)),
        }
        shares = (f"{name} {captured(*one, args.episodes):.2f}" for name, one in pairs.items())
        print(f"round {k + 1}: captured: {', '.join(shares)}")
    chaser.save(args.out / "chaser")
    evader.save(args.out / "evader")
    for env in arenas:
        env.close()
    print(f"models are in {args.out}")


if __name__ == "__main__":
    main()
