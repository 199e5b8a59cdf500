"""Judge the laws of flight by real flights: positions, rates, wake, ground effect.

    python benchmarks/truth.py FOLDER --out out/truth

FOLDER holds clones, by repository name: github.com/syediu/nanobench-iros2026,
github.com/arplaboratory/data-driven-system-identification, github.com/aerorobotics/neural-swarm.
Every law is judged on flights to which it was fitted and on flights that were kept back. Writes
truth.md and pictures to --out, and figures with their sources to flight_data/measured.json.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flight_data import arpl, ground, model, nanobench, neural_swarm, pairs, pictures, predictors
from flight_data.series import commit, split

from bulletuav.vehicle.airframe import STANDARD_GRAVITY

MEASURED = Path(__file__).parent / "flight_data" / "measured.json"
HALVES = ("fit", "kept")
UNITS = {
    "positions": "m and m/s: horizontal position, velocity, vertical position, velocity",
    "drag_moment": "m/s and mN m",
    "rates": "rad/s: roll, pitch, yaw; 1/s: damping of roll and pitch, by the fitted half alone",
    "rates_soon": "rad/s: roll, pitch, yaw",
    "wake": "m, grams and mN m; upper is the thrust of the upper drone",
    "ground_effect": "m and shares of the thrust; errors in %",
}


@dataclass(frozen=True)
class Table:
    """Errors of one test: columns with units and goals, and rows of both halves by predictor."""

    title: str
    columns: tuple[str, ...]
    goals: tuple[float | None, ...]
    rows: dict[str, dict[str, list[float]]]

    def markdown(self) -> str:
        """Return the table as Markdown: errors on the half kept back, and in brackets the other."""
        lines = [f"## {self.title}", "", "| | " + " | ".join(self.columns) + " |"]
        lines.append("|---" * (len(self.columns) + 1) + "|")
        for name, halves in self.rows.items():
            cells = [
                f"{k:.3g} ({f:.3g})" for k, f in zip(halves["kept"], halves["fit"], strict=True)
            ]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        if any(self.goals):
            goals = ["" if goal is None else f"{goal:g}" for goal in self.goals]
            lines.append("| goal | " + " | ".join(goals) + " |")
        return "\n".join(lines)


def source(
    folder: Path, licence: str, fitted: Sequence[str], kept: Sequence[str]
) -> dict[str, Any]:
    """Tell where figures come from, and the flights of both halves."""
    about = {"repository": folder.name, "commit": commit(folder), "licence": licence}
    return {**about, "fit": list(fitted), "kept": list(kept)}


def judge_positions(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge predictions of position and velocity."""
    flights, refused = nanobench.load_all(folder)
    halves = dict(zip(HALVES, split(flights), strict=True))
    rows: dict[str, dict[str, list[float]]] = {"constant velocity": {}}
    for half, its in halves.items():
        for predictor in predictors.PREDICTORS:
            cut = nanobench.windows(its, predictor)
            told = nanobench.predict(predictor, cut)
            rows.setdefault(predictor.name, {})[half] = nanobench.errors(cut, *told)
        rows["constant velocity"][half] = nanobench.errors(cut, *nanobench.constant_velocity(cut))
    pictures.positions(out / "positions.png", cut, told)
    table = Table(
        "NanoBench: errors after 0.5 s",
        ("horizontal, m", "horizontal, m/s", "vertical, m", "vertical, m/s"),
        (0.015, 0.053, 0.015, 0.056),
        rows,
    )
    names = [[flight.name for flight in its] for its in halves.values()]
    about = source(folder, nanobench.LICENCE, *names)
    return table, {"source": about, "refused": refused, "errors": rows}


def judge_drag_moment(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge the moment by which moving air tips a drone."""
    flights, _ = nanobench.load_all(folder)
    rows: dict[str, dict[str, list[float]]] = {"none": {}}
    measured = {}
    for half, its in zip(HALVES, split(flights), strict=True):
        velocity, flown, told = nanobench.tilting_moments(its, predictors.NOW)
        for name, law in (("none", np.zeros_like(told)), ("now", told)):
            rows.setdefault(name, {})[half] = nanobench.moment_errors(velocity, flown, law)
        measured[half] = nanobench.moment_bins(velocity, flown)
    pictures.drag_moment(out / "drag_moment.png", measured)
    columns = ("samples", "bins")
    table = Table("NanoBench: moment of the drag, mN m", columns, (None, None), rows)
    return table, {"errors": rows, "bins": measured}


def rate_errors(
    logs: dict[str, arpl.Log], steps: int
) -> tuple[dict[str, dict[str, list[float]]], tuple[arpl.Windows, np.ndarray]]:
    """Return errors of body rates after some rows, and the last windows with what was told."""
    rows: dict[str, dict[str, list[float]]] = {"constant rates": {}, "rates of 0": {}}
    for predictor in predictors.PREDICTORS:
        halves = arpl.windows(logs, predictor, steps)
        bias = arpl.fitted_bias(predictor, halves[0])
        for half, cut in zip(HALVES, halves, strict=True):
            told = arpl.predict(predictor, cut, bias)
            rows.setdefault(predictor.name, {})[half] = arpl.errors(cut, told)
            rows["constant rates"][half] = arpl.errors(cut, cut.start)
            rows["rates of 0"][half] = arpl.errors(cut, np.zeros_like(cut.start))
    return rows, (cut, told)


def judge_rates_soon(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge predictions of body rates before disturbances add up."""
    rows, _ = rate_errors(arpl.load_all(folder), arpl.SOON)
    columns = ("roll", "pitch", "yaw")
    table = Table("ARPL: rates after 0.1 s, rad/s", columns, (None, None, None), rows)
    return table, {"errors": rows}


def judge_rates(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge predictions of body rates."""
    logs = arpl.load_all(folder)
    rows, (cut, told) = rate_errors(logs, arpl.STEPS)
    pictures.rates(out / "rates.png", cut, told)
    goals = (1.9, 1.8, 0.65)
    table = Table("ARPL: rates after 0.5 s, rad/s", ("roll", "pitch", "yaw"), goals, rows)
    names = [f"blocks {which} of {', '.join(logs)}" for which in ("1, 3, ...", "2, 4, ...")]
    about = source(folder, arpl.LICENCE, [names[0]], [names[1]])
    lengths = {"0.1 and 0.5 s": (arpl.SOON, arpl.STEPS), "0.05 to 0.5 s": arpl.LENGTHS}
    damping = {
        name: arpl.likeliest_damping(
            [arpl.windows(logs, predictors.NOW, steps)[0] for steps in chosen], predictors.NOW
        )
        for name, chosen in lengths.items()
    }
    return table, {"source": about, "errors": rows, "likeliest_damping": damping}


def judge_wake(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge laws of the wake."""
    runs = pairs.runs(folder)
    rows: dict[str, dict[str, list[float]]] = {}
    felt_by = {half: pairs.samples(its) for half, its in zip(HALVES, split(runs), strict=True)}
    for half, felt in felt_by.items():
        nothing = np.zeros_like(felt.push)
        theirs = predictors.downwash_of_gym_pybullet_drones(felt.distance, felt.drop)
        before = predictors.downwash_before(felt.distance, felt.drop)
        laws = {
            "no wake": (nothing, nothing),
            "gym-pybullet-drones": (theirs / STANDARD_GRAVITY * 1e3, nothing),
            "before": (before / STANDARD_GRAVITY * 1e3, nothing),
            "now": pairs.now(felt),
        }
        for name, law in laws.items():
            rows.setdefault(name, {})[half] = pairs.errors(felt, *law)
    columns = ("push, g, samples", "push, g, bins", "moment, mN m, samples", "moment, mN m, bins")
    table = Table("Wake on the lower of a pair", columns, (1.35, 0.65, None, None), rows)
    measured = {half: pairs.bins(felt) for half, felt in felt_by.items()}
    pictures.wake(out / "wake.png", measured["fit"] + measured["kept"])
    names = [[f"{a.parent.name}/{a.name}+{b.name}" for a, b in its] for its in split(runs)]
    about = source(folder, neural_swarm.LICENCE, *names)
    return table, {"source": about, "errors": rows, "bins": measured}


def judge_ground(folder: Path, out: Path) -> tuple[Table, dict[str, Any]]:
    """Judge laws of the ground effect."""
    paths = ground.logs(folder)
    rows: dict[str, dict[str, list[float]]] = {}
    measured = {}
    for half, its in zip(HALVES, split(paths), strict=True):
        height, share = ground.samples(its)
        laws = {
            "no ground effect": np.zeros_like(height),
            "Cheeseman and Bennett": predictors.ground_effect_of_gain(height, 1.0),
            "gym-pybullet-drones, before": predictors.ground_effect_of_gain(height, 11.37),
            "now": model.ground_effect(height),
        }
        for name, law in laws.items():
            rows.setdefault(name, {})[half] = ground.errors(height, share, law)
        measured[half] = ground.bins(height, share)
    pictures.ground_effect(out / "ground_effect.png", measured)
    columns = ("samples", "bins")
    table = Table("Ground effect, % of thrust", columns, (2.5, 0.9), rows)
    names = [[f"{path.parent.name}/{path.name}" for path in its] for its in split(paths)]
    about = source(folder, neural_swarm.LICENCE, *names)
    return table, {"source": about, "errors": rows, "bins": measured}


def rounded(value: Any) -> Any:
    """Round all numbers within to five significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def main(argv: Sequence[str] | None = None) -> None:
    """Judge, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of the clones")
    parser.add_argument("--out", type=Path, default=Path("out/truth"), help="folder of results")
    parser.add_argument("--measured", type=Path, default=MEASURED, help="file of the figures")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    tests = {
        "positions": (judge_positions, nanobench.REPOSITORY),
        "drag_moment": (judge_drag_moment, nanobench.REPOSITORY),
        "rates_soon": (judge_rates_soon, arpl.REPOSITORY),
        "rates": (judge_rates, arpl.REPOSITORY),
        "wake": (judge_wake, neural_swarm.REPOSITORY),
        "ground_effect": (judge_ground, neural_swarm.REPOSITORY),
    }
    texts: list[str] = []
    figures: dict[str, Any] = {"units": UNITS}
    for name, (judge, repository) in tests.items():
        table, figures[name] = judge(arguments.folder / repository, arguments.out)
        texts.append(table.markdown())
        print(texts[-1] + "\n", flush=True)
    head = (
        "Errors on the half of the flights kept back; in brackets on the half that was fitted.\n\n"
    )
    (arguments.out / "truth.md").write_text(head + "\n\n".join(texts) + "\n")
    arguments.measured.write_text(json.dumps(rounded(figures), indent=1) + "\n")


if __name__ == "__main__":
    main()
