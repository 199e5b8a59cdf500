"""Train rows of the leaderboard, fly them, and write its tables: docs/benchmarks/leaderboard.md.

    python benchmarks/leaderboard.py
    python benchmarks/leaderboard.py --rows crossing-ppo-0 crossing-orca_observed --out again
    python benchmarks/leaderboard.py --evaluate

leaderboard.yaml decides all rows. A row is a policy in a task: a baseline, or one that an algorithm
has learned with a seed. It is made as a whole or not at all. So the same command goes on where it
was interrupted, and a row whose settings have changed is made again. Finished rows are no part of
the repository: `python tools/results.py fetch --all` restores them before others are added. With
--evaluate finished rows fly again without training, after a change of what is measured.
A row flies again by `bulletuav verify docs/results/leaderboard/rows/crossing-ppo-0`.
Needs the extra `sb3`.
"""

import argparse
import contextlib
import csv
import importlib
import io
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from leaderboard_rows import ROWS, Row, list_rows, read_told
from leaderboard_tables import write_tables
from safetensors.numpy import save_file

from bulletuav.adapters.sb3 import single_thread
from bulletuav.analysis.evaluation import Evaluation, evaluate
from bulletuav.analysis.metrics import METRICS
from bulletuav.analysis.seals import add_seal, format_call, hash_files
from bulletuav.commands.progress import show_progress
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.errors import unknown
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.policies.neural_network import ACTORS, HIGH, LOW, read_weights
from bulletuav.policies.run import (
    ALGORITHMS,
    CHECKPOINTS,
    CONFIG,
    CURVE,
    POLICY,
    RunConfig,
    read_settings,
    whole_number,
)
from bulletuav.report.verification import ROW, ROW_POLICY
from bulletuav.tasks import find_task
from bulletuav.training.campaign import training_processes
from bulletuav.training.store import EVALUATION_SEED
from bulletuav.training.trainer import train

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "examples"))
OUT = HERE.parent / "docs" / "results" / "leaderboard"
MANIFEST = OUT.parent / "manifest.json"
"""List of the raw results, by `tools/results.py`"""
WORK = "work"
"""Folder of the rows that are being made, in that of the leaderboard"""


def make(row: Row, out: Path, trains: bool = True) -> None:
    """Make a row: train where it is learned, evaluate, and keep it.

    Args:
        row: The row.
        out: Folder of the leaderboard.
        trains: Whether to train; else the policy and the times of the finished row are kept.
    """
    single_thread()
    work, settings = out / WORK / row.name, row.settings
    place, before = out / ROWS / row.name, work / "before"
    # A call that was killed between the two moves below left the old row aside
    if before.exists() and not place.exists():
        before.rename(place)
    # What an interrupted call left would make times that are too short
    shutil.rmtree(work, ignore_errors=True)
    kept = work / "row"
    kept.mkdir(parents=True)
    clocks = [_clocks()]
    if row.seed is not None and trains:
        _train(row, work / "run")
        _keep(work / "run", kept)
    elif row.seed is not None:
        for name in (CONFIG, POLICY, CURVE):
            shutil.copyfile(place / name, kept / name)
    clocks.append(_clocks())
    # Learned policies are told by their place in the row
    pilot = row.policy if row.seed is None else ROW_POLICY
    if "against" in settings:
        pilot = f"{pilot} vs {settings['against']}"
    asked = {
        "task": row.task,
        "policy": pilot,
        "seed": whole_number(settings["evaluation"]["seed"]),
        "metrics": settings.get("metrics", []),
    }
    result = evaluate(
        **{**asked, "policy": pilot.replace(ROW_POLICY, str(kept))},
        episodes=settings["evaluation"]["episodes"],
        **settings["options"],
    )
    asked["options"] = settings["options"]
    clocks.append(_clocks())
    record = _record(row, asked, result, clocks, kept)
    if not trains:
        former = read_told(out, row) or {}
        for kind in ("wall_seconds", "cpu_seconds"):
            record[kind]["training"] = former[kind]["training"]
    replace_file(kept / ROW, json.dumps(add_seal(record), indent=1) + "\n")
    place.parent.mkdir(exist_ok=True)
    # Nothing is deleted before the new row stands
    with contextlib.suppress(FileNotFoundError):
        place.rename(before)
    kept.rename(place)
    shutil.rmtree(work)


def _clocks() -> tuple[float, float]:
    """Read wall and CPU time, s."""
    return time.perf_counter(), time.process_time()


def _record(
    row: Row,
    asked: dict[str, Any],
    result: Evaluation,
    clocks: Sequence[tuple[float, float]],
    kept: Path,
) -> dict[str, Any]:
    """Return the record of a row: settings, times, estimates, hashes of flights and files."""
    about = result.about
    spent = {
        kind: {
            what: round(clocks[k + 1][place] - clocks[k][place], 2)
            for k, what in enumerate(("training", "evaluation"))
        }
        for place, kind in enumerate(("wall_seconds", "cpu_seconds"))
    }
    return {
        **row._asdict(),
        # Those that it flies against may read more
        "reads_swarm": row.seed is None and find_policy(row.policy, row.task).reads_swarm,
        "bulletuav": about["bulletuav"],
        "episodes": about["episodes"],
        **spent,
        "estimates": result.figures(),
        "hash": result.hash,
        "call": format_call(asked),
        "files": hash_files(kept, (CONFIG, POLICY, CURVE)),
    }


def _train(row: Row, folder: Path) -> None:
    """Train a row: its settings, policy and curve come into the folder."""
    settings = row.settings
    options = {**settings["options"], "weights": _weights(row.task, settings)}
    steps = whole_number(settings["steps"])
    drones = EnvSpec(row.task, 1, options).options.num_drones
    worlds = max(1, settings["slots"] // drones)
    by, model = settings["by"], settings["model"]
    if by in ALGORITHMS:
        config = RunConfig(
            row.task,
            by,
            row.seed or 0,
            steps,
            worlds,
            {**options, **({"action": "discrete"} if by == "dqn" else {})},
            model={"features": "swarm", **model},
            evaluations=settings["points"]["count"],
            episodes=settings["points"]["episodes"],
            evaluation=settings["options"],
        )
        train(config, folder)
        return
    curve = Curve(row, steps, folder)
    team = importlib.import_module("team_critics")
    plan = team.Plan(row.task, options, worlds, steps, **model)
    team.train(by, plan, row.seed, folder, curve)
    curve(steps, None)


def _weights(task: str, settings: Mapping[str, Any]) -> dict[str, float]:
    """Scale the task's own reward, as networks like returns of the order of 1."""
    own = {
        name: weight[1] if isinstance(weight, tuple) else weight
        for name, weight in find_task(task).reward.items()
    }
    return {name: settings["scale"] * weight for name, weight in own.items() if weight}


class Curve:
    """The learning curve of an example: evaluations at equal shares of the training."""

    def __init__(self, row: Row, steps: int, folder: Path) -> None:
        self._row, self._steps, self._folder = row, steps, folder
        self._rows: list[dict[str, float]] = []
        self._since = time.perf_counter()

    def __call__(self, steps: int, keep: Callable[[Path], None] | None) -> None:
        """Evaluate what is learned, where it is time; without `keep` it is in the folder."""
        settings = self._row.settings
        if keep and steps * settings["points"]["count"] < self._steps * (len(self._rows) + 1):
            return
        place = self._folder
        if keep:
            place = self._folder / CHECKPOINTS / f"{len(self._rows) + 1:03d}"
            keep(place)
        elif self._rows and self._rows[-1]["steps"] >= steps:
            return
        begin = time.perf_counter()
        result = evaluate(
            self._row.task,
            str(place),
            settings["points"]["episodes"],
            EVALUATION_SEED,
            **settings["options"],
        )
        now = time.perf_counter()
        wall = {"seconds": now - self._since, "evaluation": now - begin}
        found = {name: result.estimates()[name].mean for name in METRICS}
        self._rows.append({"steps": steps, **wall, **found})
        self._since = now
        text = io.StringIO()
        writer = csv.DictWriter(text, list(self._rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self._rows)
        replace_file(self._folder / CURVE, text.getvalue())


def _keep(run: Path, place: Path) -> None:
    """Copy a run's settings and curve, and of its policy what acts."""
    for name in (CONFIG, CURVE):
        shutil.copyfile(run / name, place / name)
    algo = RunConfig.read(run / CONFIG).algo
    acts = (*ACTORS[algo].layers, ACTORS[algo].features, LOW, HIGH)
    weights = read_weights(run / POLICY)
    save_file(
        {name: array for name, array in weights.items() if name.startswith(acts)}, place / POLICY
    )


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", nargs="+", metavar="ROW", help="rows to make (default: all)")
    parser.add_argument("--workers", type=int, default=1, help="rows at once (1)")
    parser.add_argument(
        "--config",
        type=Path,
        default=HERE / "leaderboard.yaml",
        metavar="FILE",
        help="what decides the rows (benchmarks/leaderboard.yaml)",
    )
    parser.add_argument(
        "--out", type=Path, default=OUT, metavar="DIR", help="folder (docs/results/leaderboard)"
    )
    parser.add_argument("--tables", action="store_true", help="write the tables alone")
    parser.add_argument("--again", action="store_true", help="make rows that are there again")
    parser.add_argument(
        "--evaluate", action="store_true", help="fly rows that are there again, without training"
    )
    return parser.parse_args(argv)


def chosen(rows: Sequence[Row], names: Sequence[str] | None) -> list[Row]:
    """Choose rows by their names; raise ValueError for names that none has."""
    known = {row.name: row for row in rows}
    for name in names or ():
        if name not in known:
            raise unknown("row", name, list(known))
    return [known[name] for name in names or known]


def require_rows(out: Path) -> None:
    """Raise SystemExit if recorded rows were not fetched: tables would be written without them."""
    if out.resolve() != OUT or not MANIFEST.exists():
        return
    listed = json.loads(MANIFEST.read_text())["files"]
    folders = [OUT.parents[2] / folder for folder, files in listed.items() if ROW in files]
    names = {folder.name for folder in folders if not (folder / ROW).exists()}
    if names:
        raise SystemExit(
            f"{len(names)} finished rows are not in {out}, such as {min(names)}: restore them with "
            "python tools/results.py fetch --all, or choose another folder with --out"
        )


def main(argv: Sequence[str] | None = None) -> None:
    """Make what is missing, and write the tables after each row."""
    arguments = parse(argv)
    out = arguments.out
    require_rows(out)
    record = read_settings(arguments.config, "settings of a leaderboard")
    rows = list_rows(record)
    scores = {task: one.get("score", "return") for task, one in record["tasks"].items()}
    asked = [] if arguments.tables else chosen(rows, arguments.rows)
    flown = [row for row in asked if read_told(out, row) is not None]
    if arguments.evaluate:
        todo = flown
    else:
        todo = [row for row in asked if arguments.again or row not in flown]
    with show_progress("leaderboard", len(todo), "rows") as report:
        report(0)
        made = _made(todo, out, arguments.workers, not arguments.evaluate)
        for done, name in enumerate(made, 1):
            report.note(name)
            report(done)
            write_tables(rows, scores, out)
    write_tables(rows, scores, out)


def _made(rows: Sequence[Row], out: Path, workers: int, trains: bool) -> Iterator[str]:
    """Make rows, in processes where these are several; give the names of those that are done."""
    if workers == 1:
        for row in rows:
            make(row, out, trains)
            yield row.name
        return
    with training_processes(workers) as pool:
        futures = {pool.submit(make, row, out, trains): row.name for row in rows}
        for future in as_completed(futures):
            future.result()
            yield futures[future]


if __name__ == "__main__":
    main()
