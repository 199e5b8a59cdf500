"""Evaluation of a policy: many episodes, to the same numbers however they are divided."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.description import describe_flights
from bulletuav.analysis.episodes import BATCH, EvaluationJob, Row, fly_batches
from bulletuav.analysis.metrics import (
    METRICS,
    ROW_LABELS,
    Estimate,
    MetricSource,
    MetricSpec,
    estimate,
    find_metrics,
)
from bulletuav.analysis.pieces import WorkPiece, parse_piece
from bulletuav.analysis.results_folder import (
    COLUMNS,
    EPISODES,
    RUN,
    ResultsFolder,
)
from bulletuav.analysis.seals import add_seal, format_call, hash_files, hash_rows
from bulletuav.errors import as_int, shown
from bulletuav.files import replace_file
from bulletuav.policies import PolicySource, find_policy
from bulletuav.tasks import TaskSource, find_task

__all__ = [
    "BATCH",
    "COLUMNS",
    "EPISODES",
    "RUN",
    "Evaluation",
    "Row",
    "evaluate",
]

MAX_EPISODES = 1_000_000
INFO_DESCRIPTION = "info of the task at the end, mean of the drones"
"""What a number is that a task tells by itself"""


@dataclass(frozen=True)
class Evaluation:
    """What a policy did in some episodes.

    Attributes:
        about: What was flown: "bulletuav" (its version), "task", "policy", "reads_swarm" (whether
            it uses the true state instead of observations), "episodes", "seed", "batch",
            "metrics" (of users), "options", "fingerprint" (of code, airframes and model), and
            "call" (arguments of `evaluate` as a Python literal, None where they were objects).
        rows: Metrics of each episode by name, with "episode" and "seed"; NaN for what it has not.
        seconds: Wall time of the episodes that were flown now, s; differs from run to run.
        flight: Duration of those episodes, s.
        metrics: What each metric is, by name: the standard ones (`METRICS`), those of users, and
            the infos that the task adds by itself.
    """

    about: dict[str, Any]
    rows: list[Row]
    seconds: float
    flight: float
    metrics: dict[str, str] = field(default_factory=lambda: dict(METRICS))

    @property
    def conditions(self) -> Conditions:
        """Task, difficulty, dynamics, episodes and seeds, which are named with each score."""
        return Conditions.of(self.about)

    def estimates(self) -> dict[str, Estimate]:
        """Return the mean and 95 % confidence interval of each metric by name."""
        return self._estimates

    @cached_property
    def _estimates(self) -> dict[str, Estimate]:
        return {
            metric: estimate(metric, [row[metric] for row in self.rows]) for metric in self.metrics
        }

    @cached_property
    def hash(self) -> str:
        """Hash of all rows, to the last bit."""
        return hash_rows(self.rows)

    def figures(self) -> dict[str, dict[str, float | None]]:
        """Return `estimates` as JSON can tell them: it has no NaN."""
        return {
            name: {key: None if np.isnan(value) else value for key, value in one._asdict().items()}
            for name, one in self.estimates().items()
        }

    def save(self, folder: Path) -> Path:
        """Write `summary.json`, sealed, beside the `run.json` and `episodes.csv` of the run.

        Args:
            folder: That of the run.

        Returns:
            The path of the file.
        """
        path = folder / "summary.json"
        files = hash_files(folder, (RUN, EPISODES))
        told = {**self.about, "estimates": self.figures(), "hash": self.hash, "files": files}
        replace_file(path, json.dumps(add_seal(told), indent=2) + "\n")
        return path


def _ignore_progress(episodes: int) -> None:
    """Tell nobody."""


def evaluate(
    task: TaskSource,
    policy: PolicySource | None = None,
    episodes: int = 100,
    seed: int = 0,
    workers: int = 1,
    out: str | Path | None = None,
    progress: Callable[[int], None] | None = None,
    trust: bool = False,
    metrics: Sequence[MetricSource] = (),
    piece: WorkPiece | str | None = None,
    ray: str | None = None,
    **options: Any,
) -> Evaluation:
    """Fly many episodes of a task and measure them.

    Args:
        task: What is flown: a name or a class.
        policy: Who flies: a name, the folder of a training run, a class, or "ppo:model.zip" (or
            sac, td3, dqn) for a model of stable-baselines3. When left out it is the task's own
            baseline. Where it cannot give the task's own action, and none is asked, it gives the
            first that it can. The policy of a run sees what it learned with, unless options say
            otherwise, and takes no other action.
        episodes: How many; episode e begins from `seed` + e.
        seed: Seed of the first episode.
        workers: Processes, which change nothing but the time. One that dies is replaced, and its
            episodes are flown again.
        out: Folder where finished batches of episodes are kept. A second call with the same
            arguments goes on where the first one was interrupted.
        progress: Told how many more episodes are done.
        trust: Whether a model may be read that can run code meanwhile, as "ppo:model.zip" can.
        metrics: What is measured beside the standard metrics: functions, classes or objects as
            told in `bulletuav.analysis.metrics.custom`, their names, or `module:Name`.
        piece: Which part of the episodes to fly, such as "2/8", the second of eight. It is kept in
            a folder of its own in `out`, where a call without a piece, or `bulletuav merge`,
            collects all.
        ray: Address of a Ray cluster that flies them, such as "auto"; needs the extra `ray`.
        **options: Those of `parallel_env`.

    Returns:
        The metrics of all episodes.

    Raises:
        ValueError: An argument is none that can be, or `out` holds another run.
        FileNotFoundError: The policy's file is not there.
        RuntimeError: Three processes in turn have died in the same episodes.
        ConnectionError: No Ray cluster answers.
    """
    # What only this call needs is checked first, then what makes the run.
    as_int("workers", workers, 1)
    if out is not None and (not isinstance(out, str | Path) or not str(out)):
        raise ValueError(
            f"out is {shown(out)}: the path of a folder, or None to keep nothing, is needed"
        )
    part = None if piece is None else parse_piece(piece)
    if part is not None and out is None:
        raise ValueError(f"piece is {shown(piece)} without out: give the folder that all write to")
    if ray is not None and (not isinstance(ray, str) or not ray):
        raise ValueError(f"ray is {shown(ray)}: the address of a cluster is needed, such as 'auto'")
    if progress is None:
        progress = _ignore_progress
    if not callable(progress):
        raise ValueError(
            f"progress is {shown(progress)}: "
            "a function of how many more episodes are done is needed"
        )
    # The policy may ask for options, such as its action
    chosen = find_task(task).baseline if policy is None else policy
    pilot = find_policy(chosen, task, trust)
    options = pilot.complete(task, options)
    run = EvaluationJob(
        task=task,
        policy=chosen,
        seed=as_int("seed", seed, 0),
        episodes=as_int("episodes", episodes, 1, MAX_EPISODES),
        options=options,
        trust=trust,
        metrics=find_metrics(metrics),
    )
    if out is not None and callable(run.options.get("wind")):
        raise ValueError(
            "wind is a function, which a folder cannot tell from another one: "
            "evaluate it without out"
        )
    # The text by which `merge` asks for the same again
    flown = {"task": task, "policy": chosen, "seed": seed, "metrics": list(metrics)}
    call = format_call({**flown, "options": options})
    return _evaluate(
        run,
        describe_flights(run, pilot, call, run.metrics),
        None if out is None else Path(out),
        part,
        progress,
        lambda batches: fly_batches(run, batches, workers, ray),
    )


def _evaluate(
    run: EvaluationJob,
    about: dict[str, Any],
    out: Path | None,
    piece: WorkPiece | None,
    progress: Callable[[int], None],
    fly: Callable[[list[range]], Iterator[list[Row]]],
) -> Evaluation:
    """Fly the batches of a run, or of a piece of it, that are not in its folder yet."""
    begin = time.perf_counter()
    # Batches fly as a whole: one that lacks an episode is flown again.
    batches = run.batches()
    if piece is not None and out is not None:
        batches, out = piece.share(batches), piece.folder(out)
    folder = ResultsFolder(out, about)
    missing = [batch for batch in batches if not all(episode in folder.rows for episode in batch)]
    progress(sum(map(len, batches)) - sum(map(len, missing)))
    flight = 0.0
    for rows in fly(missing):
        folder.add(rows)
        flight += sum(row["length"] for row in rows)
        progress(len(rows))
    rows = [folder.rows[episode] for batch in batches for episode in batch]
    descriptions = _describe_metrics(run.metrics, rows)
    return Evaluation(
        about=about,
        # Infos that a task told in some episodes alone are NaN in the others.
        rows=[row | {name: np.nan for name in descriptions if name not in row} for row in rows],
        seconds=time.perf_counter() - begin,
        flight=flight,
        metrics=descriptions,
    )


def _describe_metrics(metrics: tuple[MetricSpec, ...], rows: list[Row]) -> dict[str, str]:
    """Tell what each number of the rows is, but for "episode" and "seed"."""
    descriptions = METRICS | {metric.name: metric.about for metric in metrics}
    for row in rows:
        infos = [name for name in row if name not in descriptions and name not in ROW_LABELS]
        descriptions |= dict.fromkeys(infos, INFO_DESCRIPTION)
    return descriptions
