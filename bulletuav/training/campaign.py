"""Several training runs, in processes, and how they tell of themselves together."""

import json
import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from pathlib import Path

from bulletuav.errors import as_int
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import STATE, Row

Learned = tuple[RunConfig, list[Row]]
TOLD = ("return", "success", "conflict", "collision", "completed")
LOOK = 1.0  # s, between looks at how far the runs are


class Campaign:
    """Runs, each in a folder of its own: `folder`/task/seed."""

    def __init__(self, configs: Sequence[RunConfig], folder: Path):
        self.configs, self._folder = list(configs), folder
        self.total = sum(config.steps for config in configs)

    def place(self, config: RunConfig) -> Path:
        """The folder of a run."""
        return self._folder / config.task / str(config.seed)

    def train(
        self, workers: int = 1, progress: Callable[[int], None] = lambda steps: None
    ) -> list[Learned]:
        """Train all, `workers` at once; finished ones are not trained again, others go on from their last checkpoint.

        `progress` is told the steps done so far by all. Raises what a run raises, and what the others have done since their
        last checkpoints is lost.
        """
        as_int("workers", workers, 1)
        context = multiprocessing.get_context("spawn")  # PyTorch's threads do not survive a fork
        others = set(multiprocessing.active_children())
        with ProcessPoolExecutor(
            workers, mp_context=context, initializer=_leave_interrupts
        ) as pool:
            try:
                futures = [
                    pool.submit(_train, config, self.place(config)) for config in self.configs
                ]
                while wait(futures, LOOK, FIRST_EXCEPTION).not_done and not any(
                    map(_failed, futures)
                ):
                    progress(sum(_steps(self.place(config)) for config in self.configs))
                for future in filter(_failed, futures):
                    future.result()  # raises what the run raised
            except BaseException:
                for process in set(multiprocessing.active_children()) - others:
                    process.kill()  # a stopped one hears nothing else
                raise
        progress(self.total)
        return [
            (config, future.result()) for config, future in zip(self.configs, futures, strict=True)
        ]


def _failed(future: Future) -> bool:
    return future.done() and future.exception() is not None


def _leave_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # they are for the process that asks


def _train(config: RunConfig, folder: Path) -> list[Row]:
    from bulletuav.training.trainer import train

    parent = multiprocessing.parent_process()

    def stay(steps: int) -> None:
        if parent is not None and not parent.is_alive():
            os._exit(
                1
            )  # it was killed: nobody waits for this run, and who resumes it wants the folder

    return train(config, folder, stay)


def _steps(folder: Path) -> int:
    """Steps until the last checkpoint of a run."""
    try:
        return int(json.loads((folder / STATE).read_text())["rows"][-1]["steps"])
    except (FileNotFoundError, ValueError):  # the run itself will complain of a damaged file
        return 0


def learning_table(runs: Sequence[Learned]) -> str:
    """Markdown: what each run took, on the way to its last evaluation, and what that found."""
    shown = [name for name in TOLD if any(not math.isnan(rows[-1][name]) for _, rows in runs)]
    headings = ["task", "algorithm", "seed", "steps", "minutes", "steps/s", *shown]
    lines = ["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    for config, rows in runs:
        last, seconds = rows[-1], sum(row["seconds"] for row in rows)
        found = ["-" if math.isnan(last[name]) else f"{last[name]:.2f}" for name in shown]
        pace = [
            f"{last['steps']:,.0f}",
            f"{seconds / 60:.1f}",
            f"{last['steps'] / max(seconds, 1e-9):,.0f}",
        ]
        lines.append(
            "| " + " | ".join([config.task, config.algo, str(config.seed), *pace, *found]) + " |"
        )
    return "\n".join(lines) + "\n"
