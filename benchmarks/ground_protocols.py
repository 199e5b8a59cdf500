"""Errors of the law of the ground effect by several protocols, with intervals over flights.

    python benchmarks/ground_protocols.py FOLDER

FOLDER is a clone of github.com/aerorobotics/neural-swarm. Prints errors on the flights that were
kept back, in % of the thrust: of single samples without a ground effect, and of the law as single
samples and as means of bins of height, with 95 % intervals of the bootstrap over flights. Samples
near touches of the ground are left out or not, and the accelerometer is averaged over 50 ms or not.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from flight_data import ground, model
from flight_data.series import split

RESAMPLES = 2000
PROTOCOLS = {
    "touches left out, averaged (docs)": (None, False),
    "touches left out": (1, False),
    "all samples, averaged": (None, True),
    "all samples": (1, True),
}
"""Rows of the average, and whether touches are kept"""


def main(argv: Sequence[str] | None = None) -> None:
    """Judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="clone of the data")
    _, kept = split(ground.logs(parser.parse_args(argv).folder))
    print("| protocol | number | no ground effect | samples | 95 % | bins | 95 % |")
    print("|---|---|---|---|---|---|---|")
    for name, (rows, with_touches) in PROTOCOLS.items():
        flights = [ground.samples([path], rows, with_touches) for path in kept]
        samples, binned = [], []
        picks = np.random.default_rng(0).integers(0, len(flights), (RESAMPLES, len(flights)))
        none = np.concatenate([share for _, share in flights])
        apart = [share - model.ground_effect(height) for height, share in flights]
        places = [np.digitize(height, ground.HEIGHTS) - 1 for height, _ in flights]
        count = len(ground.HEIGHTS) - 1
        squares = np.array([np.sum(one**2) for one in apart])
        sums = np.stack([np.bincount(p, a, count) for p, a in zip(places, apart, strict=True)])
        numbers = np.stack([np.bincount(p, minlength=count) for p in places])
        for pick in np.vstack([np.arange(len(flights)), picks]):
            total = numbers[pick].sum(axis=0)
            samples.append(100.0 * np.sqrt(squares[pick].sum() / total.sum()))
            seen = total > 0
            means = sums[pick].sum(axis=0)[seen] / total[seen]
            binned.append(100.0 * np.sqrt(np.mean(means**2)))
        cells = [f"{len(none)}", f"{100.0 * np.sqrt(np.mean(none**2)):.2f}"]
        for values in (samples, binned):
            low, high = np.quantile(values[1:], (0.025, 0.975))
            cells += [f"{values[0]:.2f}", f"{low:.2f} to {high:.2f}"]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
