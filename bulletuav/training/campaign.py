"""Several training runs, in processes, and the table of what they learned."""

import contextlib
import json
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
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import STATE, WALL, Row

Learned = tuple[RunConfig, list[Row]]
"""A run and its learning curve"""
TOLD = ("return", "success", "conflict", "collision", "completed")
"""Metrics of the table"""
LOOK = 1.0
"""Time between looks at how far the runs are, s"""


class Campaign:
    """Training runs, each in a folder of its own: `folder`/task/seed.

    Attributes:
        configs: The runs.
        total: Steps of all together.
    """

    def __init__(self, configs: Sequence[RunConfig], folder: Path, mlflow: bool = False) -> None:
        """Plan a campaign.

        Args:
            configs: The runs, each of another task or seed.
            folder: Where their folders are, or will be.
            mlflow: Whether MLflow is told, too.
        """
        self.configs = list(configs)
        self.total = sum(config.steps for config in configs)
        self._folder = folder
        self._mlflow = mlflow

    def place(self, config: RunConfig) -> Path:
        """Return the folder of a run."""
        return self._folder / config.task / str(config.seed)

    def train(
        self,
        workers: int = 1,
        progress: Callable[[int], None] = lambda steps: None,
        told: Callable[[str], None] = lambda text: None,
    ) -> list[Learned]:
        """Train all runs.

        Finished ones are not trained again, others go on from their last checkpoint. Where one
        raises, what the others have done since their last checkpoints is lost.

        Args:
            workers: Processes, of which each trains one run at a time.
            progress: Told the steps done so far by all.
            told: Told in words what the last evaluation of each run found.

        Returns:
            The runs with their learning curves.

        Raises:
            Exception: Whatever a run raises.
        """
        with processes(workers) as pool:
            futures = [
                pool.submit(train_in_process, config, self.place(config), self._mlflow)
                for config in self.configs
            ]
            self._watch(futures, progress, told)
        progress(self.total)
        return [
            (config, future.result()) for config, future in zip(self.configs, futures, strict=True)
        ]

    def _watch(
        self,
        futures: Sequence[Future[list[Row]]],
        progress: Callable[[int], None],
        told: Callable[[str], None],
    ) -> None:
        """Tell the progress until all runs are done, or raise what one of them raised."""
        while wait(futures, LOOK, FIRST_EXCEPTION).not_done and not any(map(_failed, futures)):
            last = [_last(self.place(config)) for config in self.configs]
            told(self._words(last))
            progress(sum(int(row["steps"]) for row in last if row))
        for future in filter(_failed, futures):
            future.result()

    def _words(self, last: Sequence[Row]) -> str:
        """Say what the last evaluation of each run found, of those that have one."""
        return "; ".join(
            f"{config.task} {config.seed}: evaluated return {row['return']:.4g}, success "
            f"{row['success']:.2f}"
            for config, row in zip(self.configs, last, strict=True)
            if row
        )


@contextlib.contextmanager
def processes(workers: int) -> Iterator[Executor]:
    """Begin processes that train; they are killed where anything is raised.

    Args:
        workers: How many.

    Yields:
        What runs `train_in_process`.

    Raises:
        ValueError: `workers` is no number of processes.
        RuntimeError: A process has died.
    """
    as_int("workers", workers, 1)
    # PyTorch's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_leave_interrupts) as pool:
        try:
            yield pool
        except BaseException as error:
            # A process that is stopped would not hear anything milder.
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            if isinstance(error, BrokenProcessPool):
                raise RuntimeError(
                    "a worker process has died: memory may have run out (take fewer workers); call "
                    "again, and each run continues from its last checkpoint"
                ) from None
            raise


def _failed(future: Future[Any]) -> bool:
    """Tell whether a run ended with an error."""
    return future.done() and future.exception() is not None


def _leave_interrupts() -> None:
    """Leave interrupts to the process that asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def train_in_process(config: RunConfig, folder: Path, mlflow: bool = False) -> list[Row]:
    """Train one run in a process of `processes`; see `bulletuav.training.trainer.train`."""
    from bulletuav.training.trainer import train

    parent = multiprocessing.parent_process()

    def end_with_parent(steps: int) -> None:
        # Once the parent was killed nobody waits for this run, and who resumes it wants the folder.
        if parent is not None and not parent.is_alive():
            os._exit(1)

    return train(config, folder, end_with_parent, mlflow=mlflow)


def _last(folder: Path) -> Row:
    """Read the last row of a run's curve; an empty one where there is none."""
    # A damaged file is for the run itself to complain of.
    try:
        row: Row = json.loads((folder / STATE).read_text())["rows"][-1]
    except (FileNotFoundError, ValueError):
        return {}
    return row


def wall_time(rows: Sequence[Row]) -> str:
    """Say how much wall time a run took, and what for.

    Args:
        rows: Its learning curve.
    """
    seconds = {name: sum(row[name] for row in rows) for name in WALL}
    whole = sum(row["seconds"] for row in rows)
    parts = ", ".join(f"{name} {100 * one / whole:.0f} %" for name, one in seconds.items())
    return f"{whole / 60:.1f} minutes: {parts}"


def learning_table(runs: Sequence[Learned], scores: Sequence[Evaluation]) -> str:
    """Write a table of runs: what each took, and the score of its final policy.

    Args:
        runs: The runs with their learning curves.
        scores: The evaluation of the final policy of each.

    Returns:
        The table in markdown. Minutes and speed are of wall time, with evaluations.
    """
    estimates = [score.estimates() for score in scores]
    # Metrics that at least one run has
    shown = [name for name in TOLD if any(found[name].episodes for found in estimates)]
    headings = [
        "task",
        "algorithm",
        "seed",
        "steps",
        "minutes",
        *WALL,
        "steps/s",
        "difficulty",
        "dynamics",
        "scored in",
        *shown,
    ]
    lines = [_line(headings), "|---" * len(headings) + "|"]
    # One row a run, by its final policy
    for (config, rows), score, estimate in zip(runs, scores, estimates, strict=True):
        last = rows[-1]
        # Rows tell the time since the one before; a clock may not have gone on
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
                    *(f"{100 * sum(row[name] for row in rows) / seconds:.0f} %" for name in WALL),
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
    """Write a row of a table."""
    return "| " + " | ".join(cells) + " |"
