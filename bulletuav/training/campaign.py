"""Several training runs in parallel processes, and the table of their results."""

import contextlib
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_EXCEPTION,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from bulletuav.analysis.evaluation import Evaluation
from bulletuav.errors import as_int
from bulletuav.interrupts import block_interrupts
from bulletuav.parsing import read_json
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import STATE, WALL_COLUMNS, Row, number_rows

TrainedRun = tuple[RunConfig, list[Row]]
"""Settings and learning curve of a run"""
TABLE_METRICS = ("return", "success", "conflict", "collision", "completed")
"""Metrics in the table of results"""
POLL_PERIOD = 1.0
"""Polling period of the progress of the runs, s"""


class Campaign:
    """Training runs, each in its own folder: `folder`/task/seed.

    Attributes:
        configs: Settings of the runs.
        total: Total number of steps of all runs.
    """

    def __init__(
        self, configs: Sequence[RunConfig], folder: Path, tracker: str | None = None
    ) -> None:
        """Make a campaign.

        Args:
            configs: Settings of the runs, which differ in task or seed.
            folder: Parent folder of the runs.
            tracker: Name of an experiment tracker, see `bulletuav.training.trainer.train`.
        """
        self.configs = list(configs)
        self.total = sum(config.steps for config in configs)
        self._folder = folder
        self._tracker = tracker

    def run_folder(self, config: RunConfig) -> Path:
        """Return the folder of a run."""
        return self._folder / config.task / str(config.seed)

    def train(
        self,
        workers: int = 1,
        progress: Callable[[int], None] = lambda steps: None,
        note: Callable[[str], None] = lambda text: None,
    ) -> list[TrainedRun]:
        """Train all runs.

        Finished runs are not trained again; others resume from their last checkpoint. If a run
        raises an error, the other runs lose the progress since their last checkpoints.

        Args:
            workers: Number of processes; each trains one run at a time.
            progress: Called with the number of finished steps of all runs.
            note: Called with a text of the last evaluation of each run.

        Returns:
            Settings and learning curve of each run.

        Raises:
            Exception: Any error of a run.
        """
        with training_processes(workers) as pool:
            with block_interrupts():
                futures = [
                    pool.submit(train_in_process, config, self.run_folder(config), self._tracker)
                    for config in self.configs
                ]
            self._watch(futures, progress, note)
        progress(self.total)
        return [
            (config, future.result()) for config, future in zip(self.configs, futures, strict=True)
        ]

    def _watch(
        self,
        futures: Sequence[Future[list[Row]]],
        progress: Callable[[int], None],
        note: Callable[[str], None],
    ) -> None:
        """Report the progress until all runs are done, or raise the error of a failed run."""
        while wait(futures, POLL_PERIOD, FIRST_EXCEPTION).not_done and not any(
            map(_failed, futures)
        ):
            last = [_last(self.run_folder(config)) for config in self.configs]
            note(self._describe_progress(last))
            progress(sum(int(row["steps"]) for row in last if row))
        for future in filter(_failed, futures):
            future.result()

    def _describe_progress(self, last: Sequence[Row]) -> str:
        """Return a text with return and success of the last evaluation of each run."""
        return "; ".join(
            f"{config.task} {config.seed}: evaluated return {row['return']:.4g}, success "
            f"{row['success']:.2f}"
            for config, row in zip(self.configs, last, strict=True)
            if row
        )


@contextlib.contextmanager
def training_processes(workers: int) -> Iterator[Executor]:
    """Start a pool of training processes, which are killed if the block raises an error.

    Args:
        workers: Number of processes.

    Yields:
        The executor, for `train_in_process`.

    Raises:
        ValueError: If `workers` is not an integer of at least 1.
        RuntimeError: If a process has died.
    """
    as_int("workers", workers, 1)
    # PyTorch's threads do not survive a fork
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupts) as pool:
        try:
            yield pool
        except BaseException as error:
            # Only SIGKILL ends a process that is stopped
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            if isinstance(error, BrokenProcessPool):
                raise RuntimeError(
                    "a worker process has died: memory may have run out (take fewer workers); call "
                    "again, and each run continues from its last checkpoint"
                ) from None
            raise


def _failed(future: Future[Any]) -> bool:
    """Return True if a run has ended with an error."""
    return future.done() and future.exception() is not None


def _ignore_interrupts() -> None:
    """Ignore interrupts in a worker: the parent process handles them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def train_in_process(config: RunConfig, folder: Path, tracker: str | None = None) -> list[Row]:
    """Train one run in a worker process; see `bulletuav.training.trainer.train`."""
    from bulletuav.training.trainer import train

    parent = multiprocessing.parent_process()

    def end_with_parent(steps: int) -> None:
        # If the parent was killed, exit and release the folder, so that the run can be resumed
        if parent is not None and not parent.is_alive():
            os._exit(1)

    return train(config, folder, end_with_parent, tracker=tracker)


def _last(folder: Path) -> Row:
    """Read the last row of the learning curve of a run; empty if there is none."""
    # The run itself reports a damaged file
    try:
        return number_rows(read_json(folder / STATE)["rows"])[-1]
    except (ValueError, LookupError, TypeError):
        return {}


def describe_wall_time(rows: Sequence[Row]) -> str:
    """Return a text with the wall time of a run, and its fractions by activity.

    Args:
        rows: Learning curve of the run.
    """
    seconds = {name: sum(row[name] for row in rows) for name in WALL_COLUMNS}
    whole = sum(row["seconds"] for row in rows)
    parts = ", ".join(f"{name} {100 * one / whole:.0f} %" for name, one in seconds.items())
    return f"{whole / 60:.1f} minutes: {parts}"


def learning_table(runs: Sequence[TrainedRun], scores: Sequence[Evaluation]) -> str:
    """Return a table of runs with their cost and the scores of their final policies.

    Args:
        runs: Settings and learning curve of each run.
        scores: Evaluation of the final policy of each run.

    Returns:
        The table in markdown. Minutes and steps/s are of wall time, including evaluations.
    """
    estimates = [score.estimates() for score in scores]
    # Metrics with a value in at least one run
    shown = [name for name in TABLE_METRICS if any(found[name].episodes for found in estimates)]
    headings = [
        "task",
        "algorithm",
        "seed",
        "steps",
        "minutes",
        *WALL_COLUMNS,
        "steps/s",
        "difficulty",
        "dynamics",
        "scored in",
        *shown,
    ]
    lines = [_line(headings), "|---" * len(headings) + "|"]
    # One row for each run
    for (config, rows), score, estimate in zip(runs, scores, estimates, strict=True):
        last = rows[-1]
        # Each row has the time since the previous row, which may be 0
        seconds = max(sum(row["seconds"] for row in rows), 1e-9)
        means = [estimate[name].mean for name in shown]
        found = ["-" if math.isnan(mean) else f"{mean:.2f}" for mean in means]
        conditions = score.conditions
        lines.append(
            _line(
                [
                    config.task,
                    config.algo,
                    str(config.seed),
                    f"{last['steps']:,.0f}",
                    f"{seconds / 60:.1f}",
                    *(
                        f"{100 * sum(row[name] for row in rows) / seconds:.0f} %"
                        for name in WALL_COLUMNS
                    ),
                    f"{last['steps'] / seconds:,.0f}",
                    conditions.difficulty,
                    conditions.dynamics,
                    conditions.flown,
                    *found,
                ]
            )
        )
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
