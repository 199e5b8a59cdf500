"""Evaluation of a policy: many episodes, in batches and processes, to the same numbers however they are divided."""

import csv
import io
import json
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.plan import Plan
from bulletuav.errors import whole
from bulletuav.metrics import METRICS, Estimate, Meter, estimate
from bulletuav.policies import PolicySource, find_policy
from bulletuav.policies.base import Policy, check_action
from bulletuav.record import described
from bulletuav.tasks import TaskSource
from bulletuav.version import __version__

BATCH = 10
"""Episodes flown at once; part of what an evaluation is, whatever the number of processes"""
COLUMNS = ("episode", "seed", *METRICS)
Row = dict[str, float]


@dataclass(frozen=True)
class Evaluation:
    """What a policy did in some episodes.

    about  what was flown: task, policy, reads_swarm (whether it uses the true state instead of observations), episodes,
           seed, batch, options, version
    rows   the metrics of each episode by name (see `METRICS`), with "episode" and "seed"
    seconds, flight  wall time of the episodes that were flown now, which differs from run to run, and how long they are, s
    """

    about: dict[str, Any]
    rows: list[Row]
    seconds: float
    flight: float

    def estimates(self) -> dict[str, Estimate]:
        """Mean and 95 % confidence interval of each metric."""
        return {metric: estimate(metric, [row[metric] for row in self.rows]) for metric in METRICS}

    def save(self, folder: Path) -> Path:
        """Write `summary.json` beside the `run.json` and `episodes.csv` of the run."""
        path = folder / "summary.json"
        figures = {
            name: {key: None if np.isnan(value) else value for key, value in one._asdict().items()}
            for name, one in self.estimates().items()
        }
        path.write_text(json.dumps({**self.about, "estimates": figures}, indent=2) + "\n")
        return path


@dataclass(frozen=True)
class Run:
    """What a worker needs to fly episodes."""

    task: TaskSource
    policy: PolicySource
    seed: int
    episodes: int
    options: dict[str, Any]

    def batches(self) -> list[range]:
        """Episodes that fly together; episode e flies in tile e mod BATCH."""
        return [range(first, min(first + BATCH, self.episodes)) for first in range(0, self.episodes, BATCH)]

    def fly(self, batches: list[range]) -> Iterator[list[Row]]:
        """The metrics of each batch in turn."""
        if not batches:
            return
        aviary = Aviary(self.task, BATCH, **self.options)
        try:
            policy = find_policy(self.policy)(aviary)
            for batch in batches:
                yield self._episodes(aviary, policy, batch)
        finally:
            aviary.close()

    def _episodes(self, aviary: Aviary, policy: Policy, batch: range) -> list[Row]:
        worlds = np.arange(BATCH) < len(batch)
        observations = aviary.reset(worlds, [self.seed + batch.start + k for k in range(BATCH)])
        policy.reset(worlds)
        meter = Meter(aviary)
        while aviary.alive[worlds].any():
            flown = aviary.alive & worlds[:, None]
            step = aviary.step(policy.act(observations, aviary.swarm))
            meter.record(step, flown)
            observations = step.observations
        return [{"episode": episode, "seed": self.seed + episode, **meter.row(k)} for k, episode in enumerate(batch)]


def evaluate(
    task: TaskSource,
    policy: PolicySource,
    episodes: int = 100,
    seed: int = 0,
    workers: int = 1,
    out: str | Path | None = None,
    progress: Callable[[int], None] = lambda episodes: None,
    **options: Any,
) -> Evaluation:
    """Fly `episodes` of a task, episode e from seed + e, and take their metrics.

    `policy`: a name, "ppo:model.zip" (or sac, td3, dqn) for a stable-baselines3 model, or a class; `workers`: processes,
    which change nothing but the time. With `out`, a folder, finished episodes are kept there as they come, and a second call
    with the same arguments goes on where the first one was interrupted. `progress` is told how many more episodes are done.
    Options are those of `parallel_env`. Raises ValueError for what cannot be, also for an `out` that holds another run.
    """
    run = Run(task, policy, whole("seed", seed, 0), whole("episodes", episodes, 1), options)
    about = _about(run)
    begin = time.perf_counter()
    with _Store(None if out is None else Path(out), about) as store:
        missing = [batch for batch in run.batches() if not all(episode in store.rows for episode in batch)]
        progress(episodes - sum(map(len, missing)))
        flight = 0.0
        for rows in _flown(run, missing, whole("workers", workers, 1)):
            store.add(rows)
            flight += sum(row["length"] for row in rows)
            progress(len(rows))
        store.sort()
        rows = [store.rows[episode] for episode in range(episodes)]
        return Evaluation(about, rows, time.perf_counter() - begin, flight)


def _about(run: Run) -> dict[str, Any]:
    plan = Plan(run.task, BATCH, run.options)
    policy = find_policy(run.policy)
    check_action(policy.name, policy.actions, plan.options.action)
    about = {
        "bulletuav": __version__,
        "task": plan.task.name,
        "policy": policy.name,
        "reads_swarm": policy.reads_swarm,
        "episodes": run.episodes,
        "seed": run.seed,
        "batch": BATCH,
        "options": described(plan.options, plan.task.config),
    }
    return json.loads(json.dumps(about))


class _Store:
    """Rows of finished episodes, by episode, and their file."""

    def __init__(self, folder: Path | None, about: dict[str, Any]):
        """Raises ValueError where the folder holds another run or cannot be written to."""
        self.rows: dict[int, Row] = {}
        self._file: Any = io.StringIO() if folder is None else self._opened(folder, about)
        self._writer = csv.DictWriter(self._file, COLUMNS)
        self._writer.writeheader()
        self.add(list(self.rows.values()))

    def _opened(self, folder: Path, about: dict[str, Any]) -> Any:
        known, table = folder / "run.json", folder / "episodes.csv"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if known.exists():
                _require_same(json.loads(known.read_text()), about, folder)
                self.rows = _read(table)
            known.write_text(json.dumps(about, indent=2) + "\n")
            return table.open("w", newline="")  # anew, without what an interruption left of a line
        except OSError as error:
            raise ValueError(f"{folder} cannot be a folder to write to: {error.strerror}") from None

    def add(self, rows: list[Row]) -> None:
        """Keep the rows of a batch, on disk too."""
        self.rows |= {int(row["episode"]): row for row in rows}
        self._writer.writerows(rows)
        self._file.flush()

    def sort(self) -> None:
        """Write the file anew in the order of the episodes, whichever came first."""
        self._file.seek(0)
        self._file.truncate()
        self._writer.writeheader()
        self.add([self.rows[episode] for episode in sorted(self.rows)])

    def __enter__(self) -> "_Store":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _require_same(known: dict[str, Any], about: dict[str, Any], folder: Path) -> None:
    """Raise ValueError unless both tell of the same run, maybe of more or fewer episodes."""
    known, about = ({**one, **one.get("options", {}), "options": 0, "episodes": 0} for one in (known, about))
    for name in about:
        if known.get(name) != about[name]:
            raise ValueError(
                f"{folder} holds another run: its {name} is {known.get(name)!r}, not {about[name]!r}; choose another folder"
            )


def _read(path: Path) -> dict[int, Row]:
    """Complete rows of the table, by episode."""
    if not path.exists():
        return {}
    text = path.read_text()
    lines = text[: text.rfind("\n") + 1].splitlines()  # an interruption may have torn the last one
    numbers = [{name: float(text) for name, text in row.items()} for row in csv.DictReader(lines)]
    return {int(row["episode"]): {**row, "episode": int(row["episode"]), "seed": int(row["seed"])} for row in numbers}


def _flown(run: Run, batches: list[range], workers: int) -> Iterator[list[Row]]:
    """The rows of all batches as they come, from so many processes."""
    workers = min(workers, len(batches))
    if workers <= 1:
        yield from run.fly(batches)
        return
    processes, pipes = [], []
    try:
        for k in range(workers):
            mine, theirs = multiprocessing.Pipe()
            process = multiprocessing.Process(target=_work, args=(theirs, run, batches[k::workers]), daemon=True)
            process.start()
            theirs.close()
            processes.append(process)
            pipes.append(mine)
        yield from _received(pipes)
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _work(pipe: Connection, run: Run, batches: list[range]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that asks
    try:
        for rows in run.fly(batches):
            pipe.send(rows)
        pipe.send(None)
    except Exception as error:
        pipe.send(error if type(error) in (ValueError, RuntimeError, ImportError) else RuntimeError(repr(error)))


def _received(pipes: list[Connection]) -> Iterator[list[Row]]:
    open_pipes: list[Any] = list(pipes)
    while open_pipes:
        for pipe in wait(open_pipes):
            assert isinstance(pipe, Connection)
            try:
                answer = pipe.recv()
            except EOFError:
                raise RuntimeError("a worker process has died: memory may have run out; call again to go on") from None
            if isinstance(answer, Exception):
                raise answer
            if answer is None:
                open_pipes.remove(pipe)
            else:
                yield answer
