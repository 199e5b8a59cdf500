"""bulletuav beside its peers, and beside its own floor: one interleaved run, per CPU-second, single-threaded, medians.

    python benchmarks/compare.py --out out/benchmark [--gym-pybullet-drones CHECKOUT]

Each simulator runs in a process and an environment of its own (made on the first run below `--environments`); a measurement
of bulletuav and the one it is compared with follow each other, `--rounds` times. Writes benchmark.md, .csv and .png.
"""

import argparse
import contextlib
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
from rich.console import Console
from rich.progress import Progress

matplotlib.use("Agg")
from matplotlib import pyplot

import bulletuav

HERE = Path(__file__).parent
ALWAYS = ("PyFlyt", "crazyflow", "VMAS")
PACKAGES = {
    "PyFlyt": ["PyFlyt==0.29.0"],
    "crazyflow": ["crazyflow==0.4.0"],
    "VMAS": ["torch==2.13.0", "vmas==1.5.2"],
    "gym-pybullet-drones": [
        "pybullet==3.2.7",
        "numpy==1.26.4",
        "gymnasium==1.2.2",
        "scipy",
        "matplotlib",
        "transforms3d",
        "pillow",
        "setuptools<81",
    ],
    "urbanmarl": ["torch==2.13.0", "torchrl==0.14.1", "matplotlib"],
}
ALONE = {
    "urbanmarl": ["urbanmarl==0.3.1"]
}  # without what they ask for: there are no versions of it that go together
SINGLE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
REAL_TIME_1000 = 1000 * 240  # drone-substeps a second


class Comparison(NamedTuple):
    """A case of bulletuav beside one of a peer; `unit` of both rates, `goal` of their ratio, if there is one."""

    title: str
    ours: str
    peer: str
    theirs: str
    unit: str
    goal: float | None = None


SUBSTEPS = "drone-substeps/s"
COMPARISONS = [
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
        1,
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
    Comparison("bullet, all forces, N = 1000", "bullet, 1000", "real time", "", SUBSTEPS, 1),
]


class Server:
    """A simulator in a process of its own; see peers/serve.py."""

    def __init__(self, python: Path | str, script: str, *arguments: str):
        command = [str(python), str(HERE / "peers" / script), *arguments]
        self._words = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed with the process
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            text=True,
            env=_environment(),
            cwd=tempfile.gettempdir(),  # some leave logs where they run
        )

    def rate(self, case: str, seconds: float) -> float:
        """Raises RuntimeError with the simulator's own words when it fails."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # from an ended process no answer comes either
            self._process.stdin.write(json.dumps({"case": case, "seconds": seconds}) + "\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": self._last_words()}
        if "error" in answer:
            raise RuntimeError(f"{case}: {answer['error']}")
        return answer["rate"]

    def _last_words(self) -> str:
        code = self._process.wait()
        self._words.seek(0)
        said = self._words.read().strip().splitlines()
        return f"its process ended with code {code}" + (f": {said[-1]}" if said else "")

    def close(self) -> None:
        """End the process."""
        self._words.close()
        self._process.kill()
        with contextlib.suppress(BrokenPipeError):
            self._process.communicate()


class Row(NamedTuple):
    """One line of the result: medians, and the median ratio."""

    title: str
    against: str
    unit: str
    ours: float
    theirs: float
    ratio: float
    goal: float | None

    @property
    def reached(self) -> bool | None:
        """Whether the ratio is at its goal."""
        return None if self.goal is None else self.ratio >= self.goal


def _environment(**more: str) -> dict[str, str]:
    return {**os.environ, **SINGLE_THREAD, **more}


def install(peer: str, folder: Path) -> Path:
    """The Python of the peer's environment, made where there is none."""
    python = folder / peer / "bin" / "python"
    done = folder / peer / "packages.txt"
    wanted = "\n".join(PACKAGES[peer] + ALONE.get(peer, []))
    if not done.exists() or done.read_text() != wanted:
        subprocess.run([sys.executable, "-m", "venv", folder / peer], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", *PACKAGES[peer]], check=True)
        if peer in ALONE:
            subprocess.run(
                [python, "-m", "pip", "install", "-q", "--no-deps", *ALONE[peer]], check=True
            )
        done.write_text(wanted)
    return python


def _servers(names: Sequence[str], folder: Path, checkout: Path | None) -> dict[str, Server]:
    """Those of the peers asked for, and two of bulletuav (one of them to be its own floor)."""
    servers = {"bulletuav": Server(sys.executable, "serve_bulletuav.py")}
    servers["the floor in C"] = Server(sys.executable, "serve_bulletuav.py")
    for name in names:
        script = f"serve_{name.lower().replace('-', '_')}.py"
        servers[name] = Server(
            install(name, folder),
            script,
            *([str(checkout)] if name == "gym-pybullet-drones" else []),
        )
    return servers


def measure(comparison: Comparison, servers: dict[str, Server], rounds: int, seconds: float) -> Row:
    """Both sides in turn, `rounds` times."""
    ours, theirs = [], []
    for _ in range(rounds):
        ours.append(servers["bulletuav"].rate(comparison.ours, seconds))
        against = servers.get(comparison.peer)
        theirs.append(
            against.rate(comparison.theirs, seconds) if against else float(REAL_TIME_1000)
        )
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return Row(
        comparison.title,
        f"{comparison.peer} ({comparison.theirs})" if comparison.theirs else comparison.peer,
        comparison.unit,
        statistics.median(ours),
        statistics.median(theirs),
        ratio,
        comparison.goal,
    )


def starts(rounds: int) -> dict[str, float]:
    """Seconds from nothing to the first step of `hover`, with warm and with cold caches of compiled kernels."""
    program = "import bulletuav\nenv = bulletuav.Aviary('hover')\nenv.reset(seeds=0)\nenv.step([[[0] * 4]])"
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, count in (("cold", 1), ("warm", rounds)):
            times = []
            for _ in range(count):
                begin = time.perf_counter()
                environment = _environment(NUMBA_CACHE_DIR=folder)
                subprocess.run(
                    [sys.executable, "-c", program], check=True, env=environment, cwd=folder
                )
                times.append(time.perf_counter() - begin)
            result[name] = statistics.median(times)
    return result


def write_csv(rows: list[Row], path: Path) -> None:
    """The numbers."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*Row._fields, "reached"])
        writer.writerows([*row, row.reached] for row in rows)


def table(rows: list[Row]) -> list[str]:
    """Lines of Markdown."""
    lines = [
        f"bulletuav {bulletuav.__version__}. Rates per CPU-second, one thread; ratio: median over interleaved rounds.",
        "",
        "| case | against | unit | bulletuav | the other | ratio | goal |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        goal = "" if row.goal is None else f"{row.goal:.3g} x "
        lines.append(
            f"| {row.title} | {row.against} | {row.unit} | {row.ours:.3g} | {row.theirs:.3g} | {row.ratio:.3g} x | {goal}|"
        )
    return lines


def report(rows: list[Row], words: list[str], out: Path, name: str) -> None:
    """The table with `words` below it, in `name`.md and printed; the numbers in `name`.csv."""
    out.mkdir(parents=True, exist_ok=True)
    write_csv(rows, out / f"{name}.csv")
    text = "\n".join([*table(rows), *words]) + "\n"
    (out / f"{name}.md").write_text(text)
    sys.stdout.write(text)


def write(rows: list[Row], started: dict[str, float], out: Path) -> None:
    """benchmark.md, also printed, .csv and .png."""
    words = (
        f"Import and first step: {started['warm']:.1f} s with warm caches (goal 2), {started['cold']:.1f} s with cold ones "
        "(goal 20)."
    )
    report(rows, ["", words], out, "benchmark")
    _plot(rows, out / "benchmark.png")


def _plot(rows: list[Row], path: Path) -> None:
    figure, axes = pyplot.subplots(figsize=(9, 0.45 * len(rows) + 1.2), layout="constrained")
    for place, row in enumerate(rows):
        axes.barh(place, row.ratio, color="#1b6ca8" if row.reached else "#c8553d", height=0.6)
        axes.plot([row.goal] * 2, [place - 0.4, place + 0.4], color="black", lw=2)
        axes.text(row.ratio * 1.08, place, f"{row.ratio:.3g}", va="center", fontsize=9)
    axes.set_yticks(
        range(len(rows)), [f"{row.title}\nagainst {row.against}" for row in rows], fontsize=8
    )
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.3, 3 * max(row.ratio for row in rows))
    axes.set_xlabel("times as fast (black: goal)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def measure_all(
    comparisons: Sequence[Comparison], servers: dict[str, Server], rounds: int, seconds: float
) -> list[Row]:
    """Those that do not fail, with progress shown; closes the servers."""
    console, rows = Console(stderr=True), []
    try:
        with Progress(console=console) as progress:
            for one in progress.track(comparisons, description="measuring"):
                try:
                    rows.append(measure(one, servers, rounds, seconds))
                except RuntimeError as error:
                    console.print(f"{one.title} against {one.peer} left out: {error}")
    finally:
        for server in servers.values():
            server.close()
    return rows


def make_parser(description: str | None, out: str) -> argparse.ArgumentParser:
    """The options that benchmarks against peers share."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, default=Path(out), metavar="DIR", help=f"folder for the files ({out})")
    environments = Path.home() / ".cache" / "bulletuav-peers"
    add(
        "--environments",
        type=Path,
        default=environments,
        metavar="DIR",
        help=f"where they are installed ({environments})",
    )
    add("--rounds", type=int, default=5, help="measurements of each case (5)")
    add("--seconds", type=float, default=1.0, help="CPU time of one measurement (1.0)")
    return parser


def parse(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, those of `make_parser` checked."""
    arguments = parser.parse_args(argv)
    if arguments.rounds < 1 or not arguments.seconds > 0:
        parser.error(
            f"--rounds {arguments.rounds}, --seconds {arguments.seconds:g}: numbers above 0 are needed"
        )
    return arguments


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    parser = make_parser(__doc__, "out/benchmark")
    add = parser.add_argument
    add(
        "--gym-pybullet-drones",
        type=Path,
        metavar="CHECKOUT",
        help="folder of its sources; left out without",
    )
    add(
        "--peers",
        nargs="*",
        default=list(ALWAYS),
        choices=ALWAYS,
        help="which of them (all); none when none is named",
    )
    arguments = parse(parser, argv)
    checkout = arguments.gym_pybullet_drones
    if checkout is not None and not (checkout / "gym_pybullet_drones").is_dir():
        parser.error(
            f"{checkout} is no checkout of gym-pybullet-drones: it has no folder gym_pybullet_drones"
        )
    names = [*arguments.peers, *([] if checkout is None else ["gym-pybullet-drones"])]
    servers = _servers(names, arguments.environments, checkout and checkout.resolve())
    comparisons = [one for one in COMPARISONS if one.peer in servers or not one.theirs]
    rows = measure_all(comparisons, servers, arguments.rounds, arguments.seconds)
    write(rows, starts(arguments.rounds), arguments.out)


if __name__ == "__main__":
    main()
