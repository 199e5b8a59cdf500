"""Measure decisions of few and many substeps, and what one decision is made of.

    python benchmarks/decisions.py --out out/decisions [--gym-pybullet-drones CHECKOUT]

Draws decisions a CPU-second against substeps for 1, 10 and 100 drones in the PettingZoo form, and
where the time of one goes. Writes decisions.csv, decisions.png and parts.png, and adds a line to
`docs/results/speed_history.csv` with `--history`.
"""

import csv
import datetime
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from compare import make_parser, parse
from rich.progress import track
from simulators import Server, install

matplotlib.use("Agg")
import sys

from matplotlib import pyplot

import bulletuav
from bulletuav.compiled.program import run_calls

RATES = (240, 48, 30, 10)
"""Decisions a second of simulated time, at 240 substeps a second"""
DRONES = (1, 10, 100)
PEERS = {"bare": "o", "all forces": "s"}
"""Cases of gym-pybullet-drones, with their marks"""
HISTORY = Path(__file__).parents[1] / "docs" / "results" / "speed_history.csv"
COLOURS = ("#1b6ca8", "#c8553d", "#5a8f3c")
FLIGHT = ("advance", "start_decision", "surface_below")
"""Compiled functions that are the flight"""


def measure(
    ours: Server, theirs: Server | None, rounds: int, seconds: float
) -> list[tuple[str, int, int, float]]:
    """Measure all cases in turn; returns rows of case, drones, decisions a second, and rate."""
    rows = []
    for drones, hz in track([(n, hz) for n in DRONES for hz in RATES], description="measuring"):
        cases = {"bulletuav": (ours, f"PettingZoo, {drones}, {hz} Hz")}
        if theirs is not None:
            cases |= {name: (theirs, f"{name}, {drones}, {hz} Hz") for name in PEERS}
        rates: dict[str, list[float]] = {name: [] for name in cases}
        for _ in range(rounds):
            for name, (server, case) in cases.items():
                rates[name].append(server.rate(case, seconds))
        rows += [(name, drones, hz, statistics.median(rates[name])) for name in cases]
    return rows


def per_call(call: Callable[[], object]) -> float:
    """Measure a call, us of CPU time: the least of several means."""
    times = []
    for _ in range(20):
        begin = time.process_time()
        for _ in range(200):
            call()
        times.append((time.process_time() - begin) / 200 * 1e6)
    return min(times)


def parts(dynamics: str) -> dict[str, float]:
    """Measure the parts of a decision of one drone at 240 Hz, us."""
    options = {"decision_hz": 240, "horizon": 10**9, "action": "hover_rpm"}
    env = bulletuav.parallel_env("hover", dynamics=dynamics, max_distance=1000.0, **options)
    env.reset(seed=0)
    actions = {"drone_0": np.zeros(4, dtype=np.float32)}
    env.step(actions)
    aviary = env.aviary
    whole = per_call(lambda: env.step(actions))
    core = per_call(aviary.decide)
    program = aviary.program

    def took(rows: np.ndarray) -> float:
        return per_call(lambda: run_calls(rows, 0))

    empty = took(program.table[:0].copy())
    calls = {"flight": 0.0, "other stages": 0.0}
    for k, name in enumerate(program.names):
        kind = "flight" if name in FLIGHT else "other stages"
        calls[kind] += took(program.table[k : k + 1].copy()) - empty
    env.close()
    around = core - sum(calls.values())
    return calls | {"around the program": around, "agents' dictionaries": whole - core}


def draw(rows: list[tuple[str, int, int, float]], path: Path) -> None:
    """Draw rates against substeps."""
    figure, axes = pyplot.subplots(figsize=(8, 5), layout="constrained")
    for drones, colour in zip(DRONES, COLOURS, strict=True):
        for name in ("bulletuav", *PEERS):
            own = [(240 // hz, rate) for one, n, hz, rate in rows if (one, n) == (name, drones)]
            if own:
                ours = name == "bulletuav"
                label = f"{'bulletuav' if ours else f'gym-pybullet-drones, {name}'}, N = {drones}"
                style = {"lw": 2.5} if ours else {"lw": 1, "ls": "--", "marker": PEERS[name]}
                axes.loglog(*zip(*own, strict=True), color=colour, label=label, **style)
    axes.set_xticks([240 // hz for hz in RATES], [str(240 // hz) for hz in RATES])
    axes.minorticks_off()
    axes.set_xlabel("substeps of a decision, at 240 Hz")
    axes.set_ylabel("decisions / CPU-second")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def draw_parts(made: dict[str, dict[str, float]], path: Path) -> None:
    """Draw what a decision is made of, as bars."""
    figure, axes = pyplot.subplots(figsize=(8, 1.8), layout="constrained")
    colours = ("#1b6ca8", "#8fb8d8", "#e0b46c", "#c8553d")
    for place, times in enumerate(made.values()):
        left = 0.0
        for (name, took), colour in zip(times.items(), colours, strict=True):
            label = name if place == 0 else None
            axes.barh(place, took, left=left, color=colour, label=label, height=0.6)
            axes.text(left + took / 2, place, f"{took:.1f}", ha="center", va="center", fontsize=8)
            left += took
    axes.set_yticks(range(len(made)), list(made))
    axes.set_xlabel("us of a decision of one drone, one substep")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, draw."""
    parser = make_parser(__doc__, "out/decisions")
    parser.add_argument("--gym-pybullet-drones", type=Path, metavar="CHECKOUT")
    parser.add_argument("--history", action="store_true", help=f"add a line to {HISTORY.name}")
    given = parse(parser, argv)
    checkout, name = given.gym_pybullet_drones, "gym-pybullet-drones"
    ours, theirs = Server(sys.executable, "serve_bulletuav.py"), None
    if checkout is not None:
        python = install(name, given.environments)
        theirs = Server(python, "serve_gym_pybullet_drones.py", str(checkout))
    rows = measure(ours, theirs, given.rounds, given.seconds)
    given.out.mkdir(parents=True, exist_ok=True)
    with open(given.out / "decisions.csv", "w", newline="") as file:
        csv.writer(file).writerows([("case", "drones", "decisions_hz", "rate"), *rows])
    draw(rows, given.out / "decisions.png")
    draw_parts({one: parts(one) for one in ("bullet", "rigid_body")}, given.out / "parts.png")
    if given.history:
        own = {f"{n} x {hz} Hz": f"{rate:.4g}" for one, n, hz, rate in rows if one == "bulletuav"}
        today = datetime.datetime.now(datetime.UTC).date().isoformat()
        new = not HISTORY.exists()
        with open(HISTORY, "a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["date", "version", *own])
            writer.writerow([today, bulletuav.__version__, *own.values()])
    for row in rows:
        sys.stdout.write(f"{row[0]}, {row[1]} drones, {row[2]} Hz: {row[3]:.4g} decisions/s\n")


if __name__ == "__main__":
    main()
