"""Fit damping, lag and inertia of roll and pitch to one half of ARPL's logs; judge on the other.

    python benchmarks/rates.py FOLDER

FOLDER is a clone of github.com/arplaboratory/data-driven-system-identification. Blocks of 5 s take
turns: the first, third, ... are fitted, the others are kept back. Prints the constants, and errors
of roll and pitch rates after 0.1, 0.2 and 0.5 s on the blocks kept back, with 95 % intervals of the
bootstrap over blocks, of each model and of the difference to the shipped constants.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from flight_data import arpl
from flight_data.predictors import NOW, Predictor
from flight_data.series import first_order_lag
from scipy.optimize import minimize

LAGS = (0.04, 0.05, 0.06, 0.065, 0.07, 0.08, 0.09, 0.1)
"""Lags of the motors that are tried, s"""
HORIZONS = (100, 200, 500)
"""Rows after which errors are reported"""
RESAMPLES = 2000
GIVEN = {
    "shipped": (3.0, 0.065, 1.68e-5),
    "shipped but inertia": (3.0, 0.065, 1.88e-5),
    "shipped but lag": (3.0, 0.05, 1.68e-5),
    "earlier fit to all blocks": (5.6, 0.05, 1.9e-5),
}
"""Constants that are judged without a fit: damping, 1/s, lag, s, and inertia, kg m^2"""


def with_constants(damping: float, lag: float, inertia: float) -> Predictor:
    """Return the shipped model with other constants of roll and pitch."""
    return replace(
        NOW,
        rate_damping=(damping, damping, NOW.rate_damping[2]),
        inertia=(inertia, inertia, NOW.inertia[2]),
        lag=lambda speeds, dt: first_order_lag(speeds, lag, dt),
    )


def unlikelihood(cuts: Sequence[arpl.Windows], predictor: Predictor) -> float:
    """Return the sum of n log(mean square) over windows of all lengths, as `likeliest_damping`."""
    total = 0.0
    for cut in cuts:
        bias = arpl.fitted_bias(predictor, cut)
        roll, pitch, _ = arpl.errors(cut, arpl.predict(predictor, cut, bias))
        total += len(cut.start) * np.log(roll**2 + pitch**2)
    return float(total)


def fit(logs: dict[str, arpl.Log], lengths: Sequence[int]) -> tuple[float, float, float]:
    """Fit damping, 1/s, lag, s, and inertia, kg m^2, to windows of the fitted half."""
    best = (np.inf, NOW.rate_damping[0], LAGS[0], NOW.inertia[0])
    for lag in LAGS:
        cuts = [arpl.windows(logs, with_constants(3.0, lag, 1.68e-5), n)[0] for n in lengths]

        def cost(theta: np.ndarray, lag: float = lag, cuts: list[arpl.Windows] = cuts) -> float:
            return unlikelihood(cuts, with_constants(np.exp(theta[0]), lag, np.exp(theta[1])))

        start = np.log([4.0, 1.75e-5])
        found = minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.05})
        damping, inertia = np.exp(found.x)
        best = min(best, (float(found.fun), float(damping), lag, float(inertia)))
    return best[1:]


def squares_of_blocks(
    logs: dict[str, arpl.Log], predictor: Predictor, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return squared errors of roll and pitch, summed over blocks kept back (B, 2), and counts."""
    fitted, kept = arpl.windows(logs, predictor, steps)
    predicted = arpl.predict(predictor, kept, arpl.fitted_bias(predictor, fitted))
    apart = (predicted - kept.end)[:, :2] ** 2
    blocks = np.unique(kept.block)
    return (
        np.stack([apart[kept.block == block].sum(axis=0) for block in blocks]),
        np.array([(kept.block == block).sum() for block in blocks]),
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Fit, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="clone of the data")
    logs = arpl.load_all(parser.parse_args(argv).folder)
    constants = dict(GIVEN)
    constants["fitted, 0.05 to 0.5 s"] = fit(logs, arpl.LENGTHS)
    for steps in HORIZONS:
        constants[f"fitted, {steps / 1000:g} s"] = fit(logs, (steps,))
    damped = arpl.likeliest_damping([arpl.windows(logs, NOW, n)[0] for n in arpl.LENGTHS], NOW)
    constants["damping fitted"] = (damped, 0.065, NOW.inertia[0])
    print("| constants | damping, 1/s | lag, s | inertia, kg m^2 |\n|---|---|---|---|")
    for name, (damping, lag, inertia) in constants.items():
        print(f"| {name} | {damping:.2f} | {lag:.3f} | {inertia:.3g} |")
    for steps in HORIZONS:
        print(f"\nafter {steps / 1000:g} s, roll / pitch, rad/s\n")
        print("| constants | error | 95 % | less than shipped by | 95 % |\n|---|---|---|---|---|")
        base = np.zeros((0, 2))
        for name, values in constants.items():
            squares, counts = squares_of_blocks(logs, with_constants(*values), steps)
            picks = np.random.default_rng(0).integers(0, len(counts), (RESAMPLES, len(counts)))
            picks = np.vstack([np.arange(len(counts)), picks])
            rms = np.sqrt(squares[picks].sum(axis=1) / counts[picks].sum(axis=1)[:, None])
            base = rms if not len(base) else base
            cells = []
            for column in (rms, base - rms):
                low, high = np.quantile(column[1:], (0.025, 0.975), axis=0)
                cells.append(" / ".join(f"{x:.2f}" for x in column[0]))
                ends = (f"{a:.2f} to {b:.2f}" for a, b in zip(low, high, strict=True))
                cells.append(" / ".join(ends))
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
