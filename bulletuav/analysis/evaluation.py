"""Evaluation of a policy over many episodes, reproducible for any division of the work."""

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
INFO_DESCRIPTION = "info of the task at the end, mean over drones"
"""Description of a column that comes from the infos of a task"""


@dataclass(frozen=True)
class Evaluation:
    """Results of a policy over several episodes.

    Attributes:
        about: Description of the run: "bulletuav" (its version), "task", "policy", "reads_swarm"
            (whether the policy uses the true state instead of observations), "episodes", "seed",
            "batch", "metrics" (custom ones), "options", "fingerprint" (of code, airframes and
            model), and "call" (arguments of `evaluate` as a Python literal, None where they were
            objects).
        rows: Metrics of each episode by name, with "episode" and "seed"; NaN for missing values.
        seconds: Wall time of the episodes that were flown by this call, s; differs from run to run.
        flight: Simulated duration of those episodes, s.
        metrics: Description of each metric by name: the standard ones (`METRICS`), custom ones, and
            the infos that the task adds.
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
        """Return `estimates` for JSON, with None instead of NaN."""
        return {
            name: {key: None if np.isnan(value) else value for key, value in one._asdict().items()}
            for name, one in self.estimates().items()
        }

    def save(self, folder: Path) -> Path:
        """Write `summary.json`, with a seal, next to the `run.json` and `episodes.csv` of the run.

        Args:
            folder: Folder of the run.

        Returns:
            The path of the file.
        """
        path = folder / "summary.json"
        files = hash_files(folder, (RUN, EPISODES))
        content = {**self.about, "estimates": self.figures(), "hash": self.hash, "files": files}
        replace_file(path, json.dumps(add_seal(content), indent=2) + "\n")
        return path


def _ignore_progress(episodes: int) -> None:
    """Ignore the progress (the default callback)."""


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
    """Evaluate a policy over many episodes of a task.

    Args:
        task: Name or class of the task.
        policy: Name of a policy, folder of a training run, policy class, or "ppo:model.zip" (or
            sac, td3, dqn) for a model of stable-baselines3; by default the task's baseline. If the
            policy cannot output the task's default action, and no action is requested, its first
            supported action is used. The policy of a training run observes what it was trained on,
            unless options say otherwise, and takes no other action.
        episodes: Number of episodes; episode e has the seed `seed` + e.
        seed: Seed of the first episode.
        workers: Number of processes; it only affects the speed. A process that dies is replaced,
            and its episodes are flown again.
        out: Folder where finished batches of episodes are stored. A second call with the same
            arguments resumes an interrupted one.
        progress: Callback that receives the number of newly finished episodes.
        trust: Whether to load models that can run code on loading, as "ppo:model.zip" can.
        metrics: Custom metrics in addition to the standard ones: functions, classes or objects as
            described in `bulletuav.analysis.metrics.custom`, their names, or `module:Name`.
        piece: Piece of the episodes to fly, such as "2/8", the second of eight. It is stored in its
            own folder within `out`, where a call without a piece, or `bulletuav merge`, joins all.
        ray: Address of a Ray cluster that flies the episodes, such as "auto"; needs the extra
            `ray`.
        **options: Options of `parallel_env`.

    Returns:
        The metrics of all episodes.

    Raises:
        ValueError: If an argument is invalid, or `out` holds another run.
        FileNotFoundError: If the file of the policy does not exist.
        RuntimeError: If several processes in turn have died in the same episodes.
        ConnectionError: If the Ray cluster cannot be reached.
    """
    # Validate the arguments of the call first, then those of the run.
    as_int("workers", workers, 1)
    if out is not None and (not isinstance(out, str | Path) or not str(out)):
        raise ValueError(
            f"out is {shown(out)}: the path of a folder, or None to keep nothing, is needed"
        )
    part = None if piece is None else parse_piece(piece)
    if part is not None and out is None:
        raise ValueError(
            f"piece is {shown(piece)} without out: pass the folder that all pieces write to"
        )
    if ray is not None and (not isinstance(ray, str) or not ray):
        raise ValueError(f"ray is {shown(ray)}: the address of a cluster is needed, such as 'auto'")
    if progress is None:
        progress = _ignore_progress
    if not callable(progress):
        raise ValueError(
            f"progress is {shown(progress)}: "
            "a function of the number of newly finished episodes is needed"
        )
    # Complete the options with those that the policy requires, such as its action
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
            "wind is a function, which cannot be stored in a folder: evaluate without out"
        )
    # `merge` repeats the evaluation from this text
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
    """Fly the batches of a run, or of a piece of it, that are not stored in its folder."""
    begin = time.perf_counter()
    # Batches are flown as a whole: a batch that lacks an episode is flown again.
    batches = run.batches()
    if piece is not None and out is not None:
        batches, out = piece.select(batches), piece.folder(out)
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
        # Infos that the task reports in some episodes only are NaN in the others.
        rows=[row | {name: np.nan for name in descriptions if name not in row} for row in rows],
        seconds=time.perf_counter() - begin,
        flight=flight,
        metrics=descriptions,
    )


def _describe_metrics(metrics: tuple[MetricSpec, ...], rows: list[Row]) -> dict[str, str]:
    """Return the descriptions of all columns of the rows, except "episode" and "seed"."""
    descriptions = METRICS | {metric.name: metric.about for metric in metrics}
    for row in rows:
        infos = [name for name in row if name not in descriptions and name not in ROW_LABELS]
        descriptions |= dict.fromkeys(infos, INFO_DESCRIPTION)
    return descriptions
