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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fast_ppo import Agent, Worlds, save, swarm_features, train

import bulletuav
from bulletuav.policies.run import RunConfig
from bulletuav.sensors import Label, Moment, Sensor, SensorSetup

TASK = "lidar_navigation"
WORLDS = {"easy": 40, "medium": 24, "hard": 15}
"""Number of worlds of each difficulty, so that each has the same number of drones"""
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
MODEL = {
    "features": "swarm",
    "n_epochs": 4,
    "learning_rate": [7e-4, 0.0],
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -1.0},
}
CONFIG = RunConfig(TASK, steps=16_000_000, options=LEARN, model=MODEL)
AGO = 0.5  # s


class Batches:
    """Batches of worlds of several difficulties, whose drones are the rows of common arrays."""

    def __init__(self, parts: Sequence[Worlds]) -> None:
        self.parts = parts

    @property
    def seen(self) -> torch.Tensor:
        """Observations (M, ...)."""
        return torch.cat([part.seen for part in self.parts])

    def state(self) -> torch.Tensor:
        """Return no numbers (M, 0): the critic sees what the actor sees."""
        return torch.cat([part.state() for part in self.parts])

    def step(self, actions: torch.Tensor) -> torch.Tensor:
        """Step all worlds; see `Worlds.step`."""
        shares = actions.split([len(part.seen) for part in self.parts])
        return torch.cat([one.step(s) for one, s in zip(self.parts, shares, strict=True)], 1)


def make_batches(config: RunConfig, counts: Mapping[str, int], kind: Any = Worlds) -> Batches:
    """Make worlds of several difficulties, with their numbers."""
    return Batches(
        [
            kind(
                replace(
                    config,
                    worlds=count,
                    seed=config.seed + 10_000 * k,
                    options={**config.options, "difficulty": name},
                )
            )
            for k, (name, count) in enumerate(counts.items())
        ]
    )


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
    parser.add_argument("--steps", type=int, default=CONFIG.steps, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("streets"), help="folder for the policy")
    return parser.parse_args()


def main() -> None:
    """Train, save, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    options = {**LEARN, **STACK} if args.stack else LEARN
    config = replace(CONFIG, options=options, seed=args.seed, steps=args.steps)
    worlds = make_batches(config, WORLDS)
    env = worlds.parts[0].env
    agent = Agent(swarm_features(env, config), env.action_space.shape[0], config)
    train(agent, worlds, config)
    save(agent, config, args.out, "streets")
    result = bulletuav.evaluate(
        TASK, args.out, args.episodes, 1000, difficulty="medium", trust=True
    )
    found = result.estimates()["drone_success"]
    print(f"at medium {found.mean:.3f} ({found.low:.3f} to {found.high:.3f}) reach their goals")


if __name__ == "__main__":
    main()
