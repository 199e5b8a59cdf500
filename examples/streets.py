"""Train drones to fly through cities by lidar, without a map, with PPO of `fast_ppo.py`.

Drones observe velocity, goal, the distances to the arena's bounds and 16 ranges, and fly below the
roofs to goals 200 m away. Training uses three difficulties at once: regular and irregular cities,
broad and narrow streets, 3 to 8 drones, noise and wind. With `--stack` drones also observe each
range of half a second ago, by a custom sensor, `Earlier`.

Run it:

    python examples/streets.py
    python examples/streets.py --stack --out stacked

Takes 10 minutes on one core, and then evaluates at medium in `bullet`. Needs the extra `sb3`. The
output folder can be flown without PyTorch: `--policy FOLDER`.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fast_ppo import Plan, train

import bulletuav
from bulletuav.sensors import Label, Moment, Sensor, SensorSetup

TASK = "lidar_navigation"
WORLDS = {"easy": 40, "medium": 24, "hard": 15}
"""Number of worlds of each difficulty, so that each has the same number of drones"""
BATCHES = [{"task": TASK, "difficulty": name, "num_envs": count} for name, count in WORLDS.items()]
# Smaller than the default weights of the task, so that returns are of the order of 1
PAID = {"progress": 0.1, "goal": 3.0, "time": -0.01, "proximity": -0.02, "energy": -0.0002}
HITS = {"collision": -4.0, "conflict": -4.0, "out_of_bounds": -1.0, "warning": -0.1}
# Cities not used in evaluations, and aerodynamic forces at a third of the cost of `bullet`
CITIES = {"dynamics": "rigid_body", "num_layouts": 32, "city_seed": 77}
LEARN = {**CITIES, "weights": {**PAID, **HITS}}
STACK = {
    "sensors": ["streets:Earlier"],
    "observation": ["velocity", "goal", "battery", "room", "lidar", "earlier"],
}
AGO = 0.5  # s


class Earlier(Sensor):
    """Change of lidar ranges: ln((1 + r') / (1 + r)) of ranges r now and r' 0.5 s ago."""

    name = "earlier"

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...]]:
        """Return the label of each beam, with its bounds."""
        most = float(np.log1p(setup.max_range))
        names = [f"beam {azimuth:g} earlier" for azimuth, _ in setup.beams]
        return {"earlier": tuple(Label(name, "1", -most, most) for name in names)}

    def attach(self, setup: SensorSetup, engine: Any) -> None:
        """Allocate the buffer of past ranges, (W, N, decisions, B)."""
        super().attach(setup, engine)
        decisions = max(1, round(AGO / setup.period))
        self.past = np.zeros((*setup.shape, decisions, len(setup.beams)))

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Return the change since the oldest ranges, and store the present ones."""
        now = np.log1p(moment.readings["lidar"])
        fresh = moment.mask & (moment.steps == 0)[:, None]
        self.past[fresh] = now[fresh][:, None]
        change = self.past[:, :, 0] - now
        kept = np.concatenate([self.past[:, :, 1:], now[:, :, None]], axis=2)
        self.past[moment.mask] = kept[moment.mask]
        return {"earlier": change}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument(
        "--stack", action="store_true", help="also observe ranges of half a second ago"
    )
    parser.add_argument("--steps", type=int, default=16_000_000, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("streets"), help="folder for the policy")
    return parser.parse_args()


def main() -> None:
    """Train, save, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    options = {**LEARN, **STACK} if args.stack else LEARN
    plan = Plan(TASK, options, BATCHES, args.steps, rate=7e-4, width=128)
    train(plan, args.seed, central=False, folder=args.out, by="streets")
    result = bulletuav.evaluate(
        TASK, args.out, args.episodes, 1000, difficulty="medium", trust=True
    )
    found = result.estimates()["drone_success"]
    print(f"at medium {found.mean:.3f} ({found.low:.3f} to {found.high:.3f}) reach their goals")


if __name__ == "__main__":
    main()
