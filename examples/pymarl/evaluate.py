"""Evaluate drones that train.py has trained, and random flight and standing still.

The first argument is a folder with `agent.th`, which the programs write with `save_model=True`. The
task is that of `bulletuav.yaml` next to this script. The network must be the programs' own, without
memory and agent numbers (`use_rnn`, `obs_agent_id` and `obs_last_action` are False), as in
`qmix.yaml`. Prints the means of the metrics over all episodes, with 95 % confidence intervals.

Run it:

    python examples/pymarl/train.py path/to/epymarl qmix with save_model=True
    python examples/pymarl/evaluate.py "results/models/RUN/STEPS" --episodes 100
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import yaml

import bulletuav
from bulletuav.policies.features import symlog

CONFIG = Path(__file__).parent / "bulletuav.yaml"
METRICS = ("success", "conflict", "collision", "return")
LAYERS = ("fc1", "rnn", "fc2")
"""Layers of the programs' agent; without memory "rnn" is a linear layer"""


def load_agent(folder: Path, compress: bool) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from observations (M, D) to the actions (M,) of highest value.

    Args:
        folder: Folder with `agent.th`.
        compress: Whether observations are compressed by `symlog`, as in training.

    Raises:
        ValueError: If the agent has other layers, such as those of a recurrent network.
    """
    state = torch.load(folder / "agent.th", map_location="cpu", weights_only=True)
    if set(state) != {f"{layer}.{part}" for layer in LAYERS for part in ("weight", "bias")}:
        raise ValueError(f"{folder}: layers are {sorted(state)}: train with use_rnn=False")
    weights = [state[f"{layer}.weight"].numpy().T for layer in LAYERS]
    biases = [state[f"{layer}.bias"].numpy() for layer in LAYERS]

    def act(observations: np.ndarray) -> np.ndarray:
        values = symlog(observations) if compress else observations
        if values.shape[1] != len(weights[0]):
            raise ValueError(
                f"{folder}: the agent takes {len(weights[0])} numbers, a drone observes "
                f"{values.shape[1]}: train with obs_agent_id=False and obs_last_action=False"
            )
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            values = np.maximum(values @ weight + bias, 0.0)
        return np.argmax(values @ weights[-1] + biases[-1], axis=1)

    return act


def stay(observations: np.ndarray) -> np.ndarray:
    """Return the action 0 (stay) for all drones."""
    return np.zeros(len(observations), dtype=int)


def main() -> None:
    """Evaluate the trained agent and both baselines, on equal seeds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("agent", type=Path, help="folder with agent.th")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1000, help="of the first episode")
    given = parser.parse_args()
    options = yaml.safe_load(CONFIG.read_text())["env_args"]
    task, compress = options.pop("map_name"), options.pop("symlog")
    policies = {"trained": load_agent(given.agent, compress), "random": "random", "stay": stay}
    for name, policy in policies.items():
        result = bulletuav.evaluate(task, policy, given.episodes, given.seed, **options)
        found = result.estimates()
        scores = ", ".join(
            f"{metric} {found[metric].mean:.3f} [{found[metric].low:.3f}, {found[metric].high:.3f}]"
            for metric in METRICS
        )
        print(f"{name}: {given.episodes} episodes from seed {given.seed}: {scores}")


if __name__ == "__main__":
    main()
