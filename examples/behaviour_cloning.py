"""Behaviour cloning: train a network to imitate `orca` from a dataset of its flights.

Flights of four drones that cross at right angles are recorded as tables. A network is fitted from
observations to actions by least squares. Then the clone is evaluated. Prints success and conflicts
of a random policy, the clone and `orca` over the same episodes. `orca` reads the true state of all
drones, the clone only the observation of each drone; it reaches nearly as many goals.

Run it:

    python examples/behaviour_cloning.py
    python examples/behaviour_cloning.py --flights 200 --epochs 40 --out flights

Takes about a minute on one core. Needs the extras `dataset` and `sb3`.
"""

import argparse
import itertools
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from rich.progress import track

import bulletuav
from bulletuav.analysis.dataset import collect

TASK = "crossing"
OPTIONS = {
    "num_drones": 4,
    "difficulty": "easy",
    "dynamics": "point_mass",
    # Without the drone's own velocity, from which the previous action can be inferred: the clone
    # would learn to repeat it (P. de Haan, D. Jayaraman and S. Levine, "Causal confusion", 2019)
    "observation": ("goal", "neighbours"),
}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=600, help="episodes to learn from")
    parser.add_argument("--epochs", type=int, default=20, help="passes over the dataset")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder of the dataset (default: temporary)")
    return parser.parse_args()


def read(folder: Path) -> tuple[torch.Tensor, torch.Tensor]:
    """Read observations (K, D) and actions (K, A) of all drones."""
    table = pq.read_table(folder / "parquet", columns=["observation", "action"])
    return tuple(
        torch.from_numpy(np.array(table[name].to_pylist(), dtype=np.float32))
        for name in ("observation", "action")
    )


def symlog(numbers: torch.Tensor) -> torch.Tensor:
    """Return the symlog of numbers, which compresses large distances."""
    return numbers.sign() * numbers.abs().log1p()


class Clone(torch.nn.Module):
    """Network from observations in physical units to actions from -1 to 1."""

    def __init__(self, observations: torch.Tensor, actions: torch.Tensor) -> None:
        super().__init__()
        shown = symlog(observations)
        # Constant numbers carry no information
        self.mean, self.spread = shown.mean(0), shown.std(0).clamp(min=1e-3)
        sizes = (observations.shape[1], 128, 128, actions.shape[1])
        layers = [torch.nn.Linear(*pair) for pair in itertools.pairwise(sizes)]
        self.layers = torch.nn.Sequential(
            layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2], torch.nn.Tanh()
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return actions (K, A) of observations (K, D)."""
        return self.layers(((symlog(observations) - self.mean) / self.spread).clamp(-5, 5))

    def policy(self, rows: np.ndarray) -> np.ndarray:
        """Return the actions of each row of observations, as arrays."""
        with torch.no_grad():
            return self(torch.from_numpy(np.asarray(rows, dtype=np.float32))).numpy()


def learn(observations: torch.Tensor, actions: torch.Tensor, epochs: int, seed: int) -> Clone:
    """Fit a network by least squares."""
    torch.manual_seed(seed)
    clone = Clone(observations, actions)
    optimiser = torch.optim.Adam(clone.parameters(), lr=1e-3)
    for _ in track(range(epochs), "learning"):
        for chosen in torch.randperm(len(actions)).split(512):
            loss = ((clone(observations[chosen]) - actions[chosen]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    print(f"square error of an action {loss.item():.4f}")
    return clone


def main() -> None:
    """Record flights, train the clone and compare."""
    arguments = parse_arguments()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as place:
        folder = arguments.out or Path(place)
        collect(TASK, "orca", arguments.flights, arguments.seed, out=folder, **OPTIONS)
        observations, actions = read(folder)
    print(f"{len(actions)} decisions of {arguments.flights} flights")
    clone = learn(observations, actions, arguments.epochs, arguments.seed)
    # Seeds outside the dataset
    first = arguments.seed + arguments.flights
    for name, policy in (("random", "random"), ("clone", clone.policy), ("orca", "orca")):
        found = bulletuav.evaluate(
            TASK, policy, arguments.episodes, first, action="velocity", **OPTIONS
        ).estimates()
        arrived, conflict = found["drone_success"], found["conflict"]
        print(
            f"{name}: {arrived.mean:.2f} ({arrived.low:.2f} to {arrived.high:.2f}) of the drones "
            f"at their goals, conflicts in {conflict.mean:.2f} of the flights"
        )


if __name__ == "__main__":
    main()
