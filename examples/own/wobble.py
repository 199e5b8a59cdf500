"""A custom metric: mean angular speed of the drones.

Run it:

    python examples/own/wobble.py
    cd examples/own && bulletuav evaluate hover --metric wobble:wobble --episodes 10
"""

import numpy as np

import bulletuav
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step


class wobble:  # noqa: N801  # its name on the command line
    """Mean angular speed of the drones over the episode, rad/s."""

    def __init__(self, aviary: Aviary) -> None:
        """Start the episodes of all worlds."""
        self.total = np.zeros(aviary.num_worlds)
        self.count = np.zeros(aviary.num_worlds)

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Update with one step; return the mean so far for each world, (W,)."""
        flown = aviary.alive | step.terminated | step.truncated
        rate = np.linalg.norm(aviary.swarm.rates, axis=-1)
        self.total += np.sum(rate, axis=1, where=flown)
        self.count += np.count_nonzero(flown, axis=1)
        return self.total / np.maximum(self.count, 1)


def main() -> None:
    """Compare two difficulties; `evaluate` checks the results of the metric."""
    for difficulty in ("easy", "hard"):
        result = bulletuav.evaluate(
            "hover", "straight", 10, metrics=(wobble,), action="velocity", difficulty=difficulty
        )
        mean, low, high, _ = result.estimates()["wobble"]
        print(f"{difficulty}: {mean:.3f} rad/s ({low:.3f} to {high:.3f})")


if __name__ == "__main__":
    main()
