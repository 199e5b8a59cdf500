"""Evaluation of a policy: many episodes, in batches and processes, to the same numbers however they are divided."""

import contextlib
import csv
import hashlib
import inspect
import io
import json
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.analysis.metrics import METRICS, Estimate, Meter, estimate
from bulletuav.analysis.recording import described
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.worker import portable
from bulletuav.errors import as_int, shown
from bulletuav.files import replace_file
from bulletuav.kernel import source_hash
from bulletuav.policies import PolicySource, PolicySpec, find_policy
from bulletuav.policies.base import Policy, check_action
from bulletuav.tasks import TaskSource
from bulletuav.version import __version__

BATCH = 10
"""Episodes flown at once; part of what an evaluation is, whatever the number of processes"""
MOST_EPISODES = 1_000_000
RUN, EPISODES = "run.json", "episodes.csv"
COLUMNS = ("episode", "seed", *METRICS)
Row = dict[str, float]


@dataclass(frozen=True)
class Evaluation:
    """What a policy did in some episodes.

    about  what was flown: task, policy, reads_swarm (whether it uses the true state instead of observations), episodes,
           seed, batch, options, version, fingerprint (of code, airframes and model)
    rows   the metrics of each episode by name (see `METRICS`), with "episode" and "seed"
    seconds, flight  wall time of the episodes that were flown now, which differs from run to run, and how long they are, s
    """

    about: dict[str, Any]
    rows: list[Row]
    seconds: float
    flight: float

    def estimates(self) -> dict[str, Estimate]:
        """Mean and 95 % confidence interval of each metric."""
        return self._estimates

    @cached_property
    def _estimates(self) -> dict[str, Estimate]:
        return {metric: estimate(metric, [row[metric] for row in self.rows]) for metric in METRICS}

    def save(self, folder: Path) -> Path:
        """Write `summary.json` beside the `run.json` and `episodes.csv` of the run."""
        path = folder / "summary.json"
        figures = {
            name: {key: None if np.isnan(value) else value for key, value in one._asdict().items()}
            for name, one in self.estimates().items()
        }
        replace_file(path, json.dumps({**self.about, "estimates": figures}, indent=2) + "\n")
        return path


@dataclass(frozen=True)
class Run:
    """What a worker needs to fly episodes."""

    task: TaskSource
    policy: PolicySource
    seed: int
    episodes: int
    options: dict[str, Any]
    trust: bool = False

    def batches(self) -> list[range]:
        """Episodes that fly together; episode e flies in tile e mod BATCH."""
        return [
            range(first, min(first + BATCH, self.episodes))
            for first in range(0, self.episodes, BATCH)
        ]

    def fly(self, batches: list[range]) -> Iterator[list[Row]]:
        """The metrics of each batch in turn."""
        if not batches:
            return
        aviary = Aviary(self.task, BATCH, **self.options)
        try:
            policy = find_policy(self.policy, self.task, self.trust)(aviary)
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
        return [
            {"episode": episode, "seed": self.seed + episode, **meter.row(k)}
            for k, episode in enumerate(batch)
        ]


def _untold(episodes: int) -> None:
    """Tell nobody."""


def evaluate(
    task: TaskSource,
    policy: PolicySource,
    episodes: int = 100,
    seed: int = 0,
    workers: int = 1,
    out: str | Path | None = None,
    progress: Callable[[int], None] | None = None,
    trust: bool = False,
    **options: Any,
) -> Evaluation:
    """Fly `episodes` of a task, episode e from seed + e, and take their metrics.

    `policy`: a name, the folder of a training run, a class, or "ppo:model.zip" (or sac, td3, dqn) for a stable-baselines3
    model, which can run code when it is read and needs `trust=True`; a run's policy sees what it learned with, unless
    options say otherwise, and takes no other action. `workers`: processes, which change nothing but the time. With `out`, a
    folder, finished batches of episodes are kept there, and a second call with the same arguments goes on where the first
    one was interrupted. `progress` is told how many more episodes are done. Options are those of `parallel_env`. Raises
    ValueError for what cannot be, also for an `out` that holds another run.
    """
    as_int("workers", workers, 1)
    if out is not None and (not isinstance(out, str | Path) or not str(out)):
        raise ValueError(
            f"out is {shown(out)}: the path of a folder, or None to keep nothing, is needed"
        )
    if progress is None:
        progress = _untold
    if not callable(progress):
        raise ValueError(
            f"progress is {shown(progress)}: a function of how many more episodes are done is needed"
        )
    pilot = find_policy(policy, task, trust)
    options = {**pilot.options, **options}
    run = Run(
        task,
        policy,
        as_int("seed", seed, 0),
        as_int("episodes", episodes, 1, MOST_EPISODES),
        options,
        trust,
    )
    if out is not None and callable(options.get("wind")):
        raise ValueError(
            "wind is a function, which a folder cannot tell from another one: evaluate it without out"
        )
    about = _about(run, pilot)
    begin = time.perf_counter()
    store, flight = _Store(None if out is None else Path(out), about), 0.0
    missing = [
        batch for batch in run.batches() if not all(episode in store.rows for episode in batch)
    ]
    progress(episodes - sum(map(len, missing)))
    for rows in _flown(run, missing, workers):
        store.add(rows)
        flight += sum(row["length"] for row in rows)
        progress(len(rows))
    rows = [store.rows[episode] for episode in range(episodes)]
    return Evaluation(about, rows, time.perf_counter() - begin, flight)


def _about(run: Run, pilot: PolicySpec) -> dict[str, Any]:
    plan = EnvSpec(run.task, BATCH, run.options)
    check_action(pilot.name, pilot.actions, plan.options.action)
    about = {
        "bulletuav": __version__,
        "task": plan.task.name,
        "policy": pilot.name,
        "reads_swarm": pilot.reads_swarm,
        "episodes": run.episodes,
        "seed": run.seed,
        "batch": BATCH,
        "fingerprint": _fingerprint(run, plan, pilot.model),
        "options": described(plan.options, plan.task.config),
    }
    return json.loads(json.dumps(about))


def _fingerprint(run: Run, plan: EnvSpec, model: Path | None) -> str:
    """Hash of what decides the results and has no value to compare: code, airframes, cities, a model's file."""
    digest = hashlib.sha256(source_hash().encode())
    for kind in (type(plan.task), run.policy):
        if inspect.isclass(kind):
            digest.update(kind.__qualname__.encode())
            with contextlib.suppress(
                OSError, TypeError
            ):  # the source of a class from an interactive session is not known
                digest.update(Path(inspect.getfile(kind)).read_bytes())
    if model is not None:
        digest.update(model.read_bytes())
    for airframe in plan.options.airframe:
        digest.update(repr(replace(airframe, urdf=Path())).encode())
    for solids in plan.task.layouts():
        for corners, _ in solids.faces:
            digest.update(corners.tobytes())
    digest.update(np.concatenate([plan.task.arena_low, plan.task.arena_high]).tobytes())
    return digest.hexdigest()[:16]


class _Store:
    """Rows of finished episodes, by episode, and the folder, if any, where they are kept."""

    def __init__(self, folder: Path | None, about: dict[str, Any]):
        """Raises ValueError where the folder holds another run, is damaged or cannot be written to."""
        self.rows: dict[int, Row] = {}
        self._folder = folder
        if folder is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / RUN).exists():
                self._load(folder, about)
            replace_file(folder / RUN, json.dumps(about, indent=2) + "\n")
            self.add([])
        except OSError as error:
            raise ValueError(
                f"{folder} cannot be a folder to write to: {error.strerror or error}"
            ) from None

    def _load(self, folder: Path, about: dict[str, Any]) -> None:
        with _damaged(folder / RUN):
            known = json.loads((folder / RUN).read_text())
            known["options"]  # of which the comparison is made
        _require_same(known, about, folder)
        with _damaged(folder / EPISODES), (folder / EPISODES).open(newline="") as file:
            table = csv.DictReader(file)
            if tuple(table.fieldnames or ()) != COLUMNS:
                raise ValueError(f"its columns are {shown(table.fieldnames)}")
            for row in table:
                numbers: Row = {name: float(row[name]) for name in COLUMNS}
                self.rows[int(row["episode"])] = numbers | {
                    name: int(row[name]) for name in ("episode", "seed")
                }

    def add(self, rows: list[Row]) -> None:
        """Keep the rows of a batch, on disk too, in the order of the episodes."""
        self.rows |= {int(row["episode"]): row for row in rows}
        if self._folder is None:
            return
        table = io.StringIO()
        writer = csv.DictWriter(table, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows[episode] for episode in sorted(self.rows))
        replace_file(self._folder / EPISODES, table.getvalue())


@contextlib.contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Name the file that cannot be read as what it should be."""
    try:
        yield
    except (
        ValueError,
        KeyError,
        TypeError,
        csv.Error,
    ) as error:  # no UTF-8 and no JSON are ValueErrors
        raise ValueError(
            f"{path.parent} holds a run that is damaged ({path.name}: {error!r}): delete it or choose another folder"
        ) from None


def _require_same(known: dict[str, Any], about: dict[str, Any], folder: Path) -> None:
    """Raise ValueError unless both tell of the same run, maybe of more or fewer episodes."""
    known, about = (
        {**one["options"], **one, "options": 0, "episodes": 0} for one in (known, about)
    )
    for name in about:
        if known.get(name) != about[name]:
            raise ValueError(
                f"{folder} holds another run: its {name} is {known.get(name)!r}, not {about[name]!r}; choose another folder"
            )


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
            process = multiprocessing.Process(
                target=_work, args=(theirs, run, batches[k::workers]), daemon=True
            )
            process.start()
            theirs.close()
            processes.append(process)
            pipes.append(mine)
        yield from _received(pipes)
    finally:
        for process in processes:
            process.kill()  # a stopped one hears nothing else
            process.join()


def _work(pipe: Connection, run: Run, batches: list[range]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the process that asks
    try:
        for rows in run.fly(batches):
            pipe.send(rows)
        pipe.send(None)
    except Exception as error:
        pipe.send(portable(error))


def _received(pipes: list[Connection]) -> Iterator[list[Row]]:
    open_pipes: list[Any] = list(pipes)
    while open_pipes:
        for pipe in wait(open_pipes):
            assert isinstance(pipe, Connection)
            try:
                answer = pipe.recv()
            except EOFError:
                raise RuntimeError(
                    "a worker process has died: memory may have run out; call again to go on"
                ) from None
            if isinstance(answer, Exception):
                raise answer
            if answer is None:
                open_pipes.remove(pipe)
            else:
                yield answer
