"""Measure bulletuav beside its peers and its own floor: per CPU-second, one thread, medians.

    python benchmarks/compare.py --out out/benchmark [--gym-pybullet-drones CHECKOUT]
        [--drone-swarm CHECKOUT]

Each simulator runs in a process and an environment of its own. Environments are made on the first
run, below `--environments`. A measurement of bulletuav and one of its peer follow each other,
`--rounds` times. Writes benchmark.md, benchmark.csv and benchmark.png.
"""

import argparse
import csv
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding as llvm
import matplotlib
from rich.console import Console
from rich.progress import Progress
from simulators import PACKAGES, Server, install, single_thread_variables

matplotlib.use("Agg")
from matplotlib import pyplot

import bulletuav
from bulletuav.compiled.shipped import target_features

ALWAYS = ("PyFlyt", "crazyflow", "VMAS")
"""Peers that are installed from the package registry"""
CHECKOUTS = {"gym-pybullet-drones": "gym_pybullet_drones", "drone_swarm": "drone_swarm"}
"""Peers that are taken from a folder of their sources, and what is in it"""
REAL_TIME_1000 = 1000 * 240
"""Drone-substeps a second of 1,000 drones in real time"""


class Comparison(NamedTuple):
    """A case of bulletuav beside one of a peer.

    Attributes:
        title: What is compared.
        ours: Name of the case in peers/serve_bulletuav.py.
        peer: The other simulator, or what else sets the pace.
        theirs: Name of the case in the peer's script; empty where nothing is measured.
        unit: Unit of both rates.
        goal: The least ratio that is aimed at, if there is one.
    """

    title: str
    ours: str
    peer: str
    theirs: str
    unit: str
    goal: float | None = None


SUBSTEPS, DECISIONS = "drone-substeps/s", "decisions/s"
PICTURES = "colours, depths and labels of 8 drones' cameras, 128 x 128, no buildings"


def _short(ours: str, drones: int, hz: int, bare: float, everything: float) -> list[Comparison]:
    """Compare decisions of few substeps, with the goals against bare and all forces."""
    title = f"{ours}, all forces, N = {drones}, decisions at {hz} Hz"
    case = f"{ours}, {hz} Hz" if ours == "Gymnasium" else f"{ours}, {drones}, {hz} Hz"
    theirs = {f"bare, {drones}, {hz} Hz": bare, f"all forces, {drones}, {hz} Hz": everything}
    return [
        Comparison(title, case, "gym-pybullet-drones", name, DECISIONS, goal)
        for name, goal in theirs.items()
    ]


COMPARISONS = [
    *_short("Airspace", 1, 240, 4, 10),
    *_short("Airspace", 1, 48, 5, 18),
    *_short("Airspace", 10, 240, 10, 40),
    *_short("Gymnasium", 1, 240, 4, 10),
    *_short("PettingZoo", 1, 240, 4, 10),
    *_short("PettingZoo", 1, 48, 5, 18),
    *_short("PettingZoo", 1, 30, 5, 18),
    *_short("PettingZoo", 10, 240, 10, 40),
    *_short("PettingZoo", 10, 48, 10, 60),
    Comparison(
        "bullet, all forces, N = 10",
        "bullet, 10",
        "gym-pybullet-drones",
        "all forces, 10",
        SUBSTEPS,
        50,
    ),
    Comparison(
        "bullet, all forces, N = 10, against bare PYB",
        "bullet, 10",
        "gym-pybullet-drones",
        "bare, 10",
        SUBSTEPS,
        8,
    ),
    Comparison(
        "bullet, all forces, N = 100",
        "bullet, 100",
        "gym-pybullet-drones",
        "all forces, 100",
        SUBSTEPS,
        200,
    ),
    Comparison("bullet, all forces, N = 10", "bullet, 10", "PyFlyt", "quadx, 10", SUBSTEPS, 60),
    Comparison("bullet, all forces, N = 100", "bullet, 100", "PyFlyt", "quadx, 100", SUBSTEPS, 60),
    Comparison(
        "PettingZoo environment",
        "crossing, 8",
        "PyFlyt",
        "pettingzoo hover, 10",
        "agent-substeps/s",
        40,
    ),
    Comparison(
        "rigid_body, PID, all forces, 64 x 8",
        "rigid_body with PID, 64 x 8",
        "crazyflow",
        "no contacts, 64 x 8",
        SUBSTEPS,
        2,
    ),
    Comparison(
        "the same, contacts on",
        "rigid_body with PID, 64 x 8",
        "crazyflow",
        "contacts, 64 x 8",
        SUBSTEPS,
        20,
    ),
    Comparison(
        "points, 64 x 8",
        "crossing of points, 64 x 8",
        "VMAS",
        "navigation, 64 x 8",
        "agent-decisions/s",
        15,
    ),
    *(
        Comparison(
            f"random rotor speeds up to {percent} %, rigid_body, 64 x 8",
            f"random rotors, {percent} %",
            "drone_swarm",
            f"{precision}, {percent} %",
            "agent-decisions/s",
            goal,
        )
        for precision, goal in (("single", 0.85), ("double", None))
        for percent in (10, 100)
    ),
    Comparison(
        "reset of 10 drones", "reset, 10", "gym-pybullet-drones", "reset, 10", "resets/s", 100
    ),
    Comparison("reset of 10 drones", "reset, 10", "PyFlyt", "reset, 10", "resets/s", 100),
    Comparison("reset of 10 drones", "reset, 10", "crazyflow", "reset, 10", "resets/s", 100),
    Comparison("reset of 10 drones", "reset, 10", "VMAS", "reset, 10", "resets/s", 100),
    Comparison(
        "bullet, all forces, 64 x 8",
        "bullet, 64 x 8",
        "the floor in C",
        "floor, 64 x 8",
        SUBSTEPS,
        1 / 1.5,
    ),
    *(
        Comparison(PICTURES, "pictures, 8", peer, "pictures, 8", "pictures/s")
        for peer in ("gym-pybullet-drones", "PyFlyt")
    ),
    Comparison("bullet, all forces, N = 1000", "bullet, 1000", "real time", "", SUBSTEPS, 1),
]


class Row(NamedTuple):
    """One line of the result.

    Attributes:
        title: What is compared.
        against: The peer and its case.
        unit: Unit of both rates.
        ours: Median rate of bulletuav.
        theirs: Median rate of the peer.
        ratio: Median of the ratios of the rounds.
        goal: The least ratio that is aimed at, if there is one.
    """

    title: str
    against: str
    unit: str
    ours: float
    theirs: float
    ratio: float
    goal: float | None

    @property
    def reached(self) -> bool | None:
        """Whether the ratio is at its goal; None where there is no goal."""
        return None if self.goal is None else self.ratio >= self.goal


def _servers(names: Sequence[str], folder: Path, checkouts: dict[str, Path]) -> dict[str, Server]:
    """Start the peers asked for, and bulletuav twice, the second time to be its own floor."""
    servers = {
        "bulletuav": Server(sys.executable, "serve_bulletuav.py"),
        "the floor in C": Server(sys.executable, "serve_bulletuav.py"),
    }
    for name in (*names, *checkouts):
        script = f"serve_{name.lower().replace('-', '_')}.py"
        python = install(name, folder) if name in PACKAGES else sys.executable
        arguments = [str(checkouts[name])] if name in checkouts else []
        servers[name] = Server(python, script, *arguments)
    return servers


def measure(comparison: Comparison, servers: dict[str, Server], rounds: int, seconds: float) -> Row:
    """Measure both sides in turn.

    Args:
        comparison: What to compare.
        servers: Simulators by name; a peer that is not among them is real time.
        rounds: How often each side is measured.
        seconds: CPU time of one measurement.
    """
    ours, theirs = [], []
    against = servers.get(comparison.peer)
    for _ in range(rounds):
        ours.append(servers["bulletuav"].rate(comparison.ours, seconds))
        if against is None:
            theirs.append(float(REAL_TIME_1000))
        else:
            theirs.append(against.rate(comparison.theirs, seconds))
    ratios = [our / their for our, their in zip(ours, theirs, strict=True)]
    case = f" ({comparison.theirs})" if comparison.theirs else ""
    return Row(
        title=comparison.title,
        against=comparison.peer + case,
        unit=comparison.unit,
        ours=statistics.median(ours),
        theirs=statistics.median(theirs),
        ratio=statistics.median(ratios),
        goal=comparison.goal,
    )


def starts(rounds: int) -> dict[str, float]:
    """Measure how long a process takes from its start to the first step of `hover`.

    Args:
        rounds: How often it is measured with a warm cache; with a cold one it is once.

    Returns:
        Medians in s, with "cold" and with "warm" caches of compiled kernels.
    """
    program = """
import bulletuav
env = bulletuav.Aviary('hover')
env.reset(seeds=0)
env.step([[[0] * 4]])
"""
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        # The first process fills the cache that the others find.
        variables = single_thread_variables(NUMBA_CACHE_DIR=folder)
        for name, count in (("cold", 1), ("warm", rounds)):
            times = []
            for _ in range(count):
                begin = time.perf_counter()
                subprocess.run(
                    [sys.executable, "-c", program], check=True, env=variables, cwd=folder
                )
                times.append(time.perf_counter() - begin)
            result[name] = statistics.median(times)
    return result


def write_csv(rows: list[Row], path: Path) -> None:
    """Write the numbers of all rows."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*Row._fields, "reached"])
        writer.writerows([*row, row.reached] for row in rows)


def name_processor() -> str:
    """Return the processor's name, and the vectors of bulletuav's code, which ratios depend on."""
    model = llvm.get_host_cpu_name()
    vectors = "AVX-512" if "+avx512f" in target_features().split(",") else "AVX2 or less"
    return f"{model} (code for {vectors})"


def table(rows: list[Row]) -> list[str]:
    """Lay out the rows as lines of Markdown."""
    lines = [
        f"bulletuav {bulletuav.__version__} on {name_processor()}. "
        "Rates per CPU-second, one thread; ratio: median over interleaved rounds.",
        "",
        "| case | against | unit | bulletuav | the other | ratio | goal |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        goal = "" if row.goal is None else f"{row.goal:.3g} x "
        rates = f"{row.ours:.3g} | {row.theirs:.3g} | {row.ratio:.3g} x"
        lines.append(f"| {row.title} | {row.against} | {row.unit} | {rates} | {goal}|")
    return lines


def report(rows: list[Row], notes: list[str], out: Path, name: str) -> None:
    """Write and print the results.

    Args:
        rows: The results.
        notes: Lines of Markdown below the table.
        out: Folder for the files; it is made if it is not there.
        name: Of the files: `name`.md, which is printed, too, and `name`.csv.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_csv(rows, out / f"{name}.csv")
    text = "\n".join([*table(rows), *notes]) + "\n"
    (out / f"{name}.md").write_text(text)
    sys.stdout.write(text)


def write(rows: list[Row], started: dict[str, float], out: Path) -> None:
    """Write benchmark.md, which is printed, too, benchmark.csv and benchmark.png."""
    note = (
        f"Import and first step: {started['warm']:.1f} s with warm caches (goal 2), "
        f"{started['cold']:.1f} s with cold ones (goal 20)."
    )
    report(rows, ["", note], out, "benchmark")
    _plot(rows, out / "benchmark.png")


def _plot(rows: list[Row], path: Path) -> None:
    """Draw the ratios as bars, with the goals as black lines.

    Bars are blue where the goal is reached, red where it is missed, and grey where there is none.
    """
    colors = {True: "#1b6ca8", False: "#c8553d", None: "#8a8a8a"}
    figure, axes = pyplot.subplots(figsize=(9, 0.45 * len(rows) + 1.2), layout="constrained")
    for place, row in enumerate(rows):
        axes.barh(place, row.ratio, color=colors[row.reached], height=0.6)
        if row.goal is not None:
            axes.plot([row.goal] * 2, [place - 0.4, place + 0.4], color="black", lw=2)
        axes.text(row.ratio * 1.08, place, f"{row.ratio:.3g}", va="center", fontsize=9)
    axes.set_yticks(
        range(len(rows)), [f"{row.title}\nagainst {row.against}" for row in rows], fontsize=8
    )
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xscale("log")
    axes.set_xlim(0.3, 3 * max(row.ratio for row in rows))
    axes.set_xlabel("times as fast (black: goal)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def measure_all(
    comparisons: Sequence[Comparison], servers: dict[str, Server], rounds: int, seconds: float
) -> list[Row]:
    """Make all comparisons with progress shown, leave out those that fail, close the servers."""
    console = Console(stderr=True)
    rows = []
    try:
        with Progress(console=console) as progress:
            for comparison in progress.track(comparisons, description="measuring"):
                try:
                    rows.append(measure(comparison, servers, rounds, seconds))
                except RuntimeError as error:
                    case = f"{comparison.title} against {comparison.peer}"
                    console.print(f"{case} left out: {error}")
    finally:
        for server in servers.values():
            server.close()
    return rows


def make_parser(description: str | None, out: str) -> argparse.ArgumentParser:
    """Make a parser with the options that benchmarks against peers share."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path(out), metavar="DIR", help=f"folder for the files ({out})"
    )
    environments = Path.home() / ".cache" / "bulletuav-peers"
    parser.add_argument(
        "--environments",
        type=Path,
        default=environments,
        metavar="DIR",
        help=f"folder where peers are installed ({environments})",
    )
    parser.add_argument("--rounds", type=int, default=5, help="measurements of each case (5)")
    parser.add_argument(
        "--seconds", type=float, default=1.0, help="CPU time of one measurement (1.0)"
    )
    return parser


def parse(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse arguments, and check those of `make_parser`."""
    arguments = parser.parse_args(argv)
    if arguments.rounds < 1 or not arguments.seconds > 0:
        parser.error(
            f"--rounds {arguments.rounds}, --seconds {arguments.seconds:g}: "
            "numbers above 0 are needed"
        )
    return arguments


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    parser = make_parser(__doc__, "out/benchmark")
    for peer in CHECKOUTS:
        parser.add_argument(
            f"--{peer.replace('_', '-')}",
            dest=peer,
            type=Path,
            metavar="CHECKOUT",
            help="folder of its sources; without it this peer is left out",
        )
    parser.add_argument(
        "--peers",
        nargs="*",
        default=list(ALWAYS),
        choices=ALWAYS,
        help="which peers (all); none when none is named",
    )
    arguments = parse(parser, argv)
    checkouts = {peer: path for peer in CHECKOUTS if (path := vars(arguments)[peer]) is not None}
    for peer, path in checkouts.items():
        if not (path / CHECKOUTS[peer]).is_dir():
            parser.error(f"{path} is no checkout of {peer}: it has no folder {CHECKOUTS[peer]}")
        checkouts[peer] = path.resolve()
    servers = _servers(arguments.peers, arguments.environments, checkouts)
    # Comparisons with real time have no peer to be there.
    comparisons = [
        comparison
        for comparison in COMPARISONS
        if comparison.peer in servers or not comparison.theirs
    ]
    rows = measure_all(comparisons, servers, arguments.rounds, arguments.seconds)
    write(rows, starts(arguments.rounds), arguments.out)


if __name__ == "__main__":
    main()
