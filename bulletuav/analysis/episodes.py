"""Episodes of an evaluation: flown in batches, by one process or several, to the same numbers."""

import multiprocessing
import signal
import warnings
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from bulletuav.analysis.metrics import Meter, MetricSpec
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.worker import picklable
from bulletuav.interrupts import kept_from_children
from bulletuav.policies import PolicySource, find_policy
from bulletuav.policies.base import Policy
from bulletuav.policies.mismatch import naming_task
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

BATCH = 10
"""Episodes flown at once; part of what an evaluation is, whatever the number of processes"""
MAX_DEATHS = 3
"""Processes that may die in the same batch before the evaluation ends"""
Row = dict[str, float]
"""Metrics of an episode by name, with "episode" and "seed" """
Result = TypeVar("Result")


@dataclass(frozen=True)
class Flights(ABC, Generic[Result]):
    """Everything that a process needs to fly episodes, and what it makes of a batch of them.

    Attributes:
        task: What is flown.
        policy: Who flies.
        seed: Seed of episode 0; episode e has `seed` + e.
        episodes: How many there are.
        options: Options of the environment.
        trust: Whether the policy's file may run code when it is read.
    """

    task: TaskSource
    policy: PolicySource
    seed: int
    episodes: int
    options: dict[str, Any]
    trust: bool = False

    def batches(self) -> list[range]:
        """List the episodes that fly together; episode e flies in world e mod `BATCH`."""
        return [
            range(first, min(first + BATCH, self.episodes))
            for first in range(0, self.episodes, BATCH)
        ]

    def fly(self, batches: Sequence[range]) -> Iterator[Result]:
        """Yield the result of each batch in turn."""
        if not batches:
            return
        aviary = Aviary(self.task, BATCH, **self.options)
        try:
            policy = find_policy(self.policy, self.task, self.trust)(aviary)
            for batch in batches:
                yield self._flown(aviary, policy, batch)
        finally:
            aviary.close()

    def fly_all(self, batches: Sequence[range]) -> list[Result]:
        """Return the results of all batches."""
        return list(self.fly(batches))

    def start(
        self,
        aviary: Aviary,
        policy: Policy,
        batch: range,
    ) -> tuple[Observation, np.ndarray]:
        """Start a batch.

        Returns:
            First observations, and the worlds that fly, (BATCH,) bool: the last batch may be
            smaller than others.
        """
        worlds = np.arange(BATCH) < len(batch)
        observations = aviary.reset(worlds, [self.seed + batch.start + k for k in range(BATCH)])
        with naming_task(policy, aviary):
            policy.reset(worlds)
        return observations, worlds

    @abstractmethod
    def _flown(
        self,
        aviary: Aviary,
        policy: Policy,
        batch: range,
    ) -> Result:
        """Fly one batch."""


@dataclass(frozen=True)
class Run(Flights[list[Row]]):
    """The episodes of an evaluation; see `Flights`.

    Attributes:
        metrics: What is measured beside the standard metrics.
    """

    metrics: tuple[MetricSpec, ...] = ()

    def _flown(
        self,
        aviary: Aviary,
        policy: Policy,
        batch: range,
    ) -> list[Row]:
        """Measure the episodes of a batch."""
        observations, worlds = self.start(aviary, policy, batch)
        meter = Meter(aviary, self.metrics)
        # Worlds whose episode has ended stand still until all have.
        while aviary.alive[worlds].any():
            flown = aviary.alive & worlds[:, None]
            with naming_task(policy, aviary):
                action = policy.act(observations, aviary.swarm)
            step = aviary.step(action)
            meter.record(step, flown)
            observations = step.observations
        return [
            {"episode": episode, "seed": self.seed + episode, **meter.row(k)}
            for k, episode in enumerate(batch)
        ]


def fly_batches(
    run: Flights[Result],
    batches: list[range],
    workers: int,
    ray: str | None = None,
) -> Iterator[Result]:
    """Yield the results of all batches as they come.

    Args:
        run: What is flown.
        batches: Those of its batches that are to be flown.
        workers: Processes that fly them, which change the order of the batches alone.
        ray: Address of a Ray cluster that flies them instead.

    Raises:
        RuntimeError: Several processes in turn have died in the same batch.
        ConnectionError: No cluster answers.
    """
    if ray is not None and batches:
        from bulletuav.adapters.ray import spread  # which needs an extra

        yield from spread(ray, run.fly_all, batches)
        return
    workers = min(workers, len(batches))
    if workers <= 1:
        yield from run.fly(batches)
        return
    crew = _Crew(run)
    try:
        # Each process takes every `workers`-th batch
        for k in range(workers):
            crew.start(batches[k::workers])
        yield from crew.results()
    # Also when the caller stops in between.
    finally:
        crew.end()


class _Worker(NamedTuple):
    """A process that flies batches, and those whose results are still to come, in their order."""

    process: multiprocessing.Process
    batches: list[range]


class _Crew:
    """Processes that fly batches; one that dies is replaced, and flies again what is missing."""

    def __init__(self, run: Flights[Any]) -> None:
        self._run = run
        self._workers: dict[Connection, _Worker] = {}
        self._deaths: Counter[range] = Counter()

    def start(self, batches: list[range]) -> None:
        """Start a process that flies batches, and sends results through a pipe of its own."""
        mine, theirs = multiprocessing.Pipe()
        process = multiprocessing.Process(
            target=_work, args=(theirs, self._run, list(batches)), daemon=True
        )
        self._workers[mine] = _Worker(process, list(batches))
        with kept_from_children():
            process.start()
        theirs.close()

    def results(self) -> Iterator[Any]:
        """Yield results of whichever process has some, until all are done.

        Raises:
            RuntimeError: Processes die again and again in the same batch.
        """
        while self._workers:
            for pipe in wait(list(self._workers)):
                assert isinstance(pipe, Connection)
                batches = self._workers[pipe].batches
                # A pipe ends before its None where its process was killed.
                try:
                    answer = pipe.recv()
                except (EOFError, OSError):
                    process = self._leave(pipe)
                    if batches:
                        self._replace(process, batches)
                    continue
                if isinstance(answer, Exception):
                    raise answer
                if answer is None:
                    self._leave(pipe)
                else:
                    del batches[0]
                    yield answer

    def end(self) -> None:
        """Kill the processes that are left."""
        for pipe in list(self._workers):
            self._leave(pipe)

    def _leave(self, pipe: Connection) -> multiprocessing.Process:
        """Wait until a process has ended, and close its pipe."""
        process = self._workers.pop(pipe).process
        pipe.close()
        # One that could not start has no number
        if process.pid is not None:
            # A process that is stopped would not hear anything milder.
            process.kill()
            process.join()
        return process

    def _replace(self, dead: multiprocessing.Process, batches: list[range]) -> None:
        """Start another process for what one that died has not flown."""
        batch = batches[0]
        self._deaths[batch] += 1
        first, last = batch[0], batch[-1]
        seeds = f"seeds {self._run.seed + first} to {self._run.seed + last}"
        said = f"episodes {first} to {last} ({seeds})"
        if self._deaths[batch] == MAX_DEATHS:
            raise RuntimeError(
                f"{MAX_DEATHS} worker processes in turn have died in {said}: memory may have run "
                f"out (take fewer workers), the task or the policy may end its process (fly these "
                f"seeds with workers=1 to see it), or the script lacks "
                f'`if __name__ == "__main__":`; batches that are kept in a folder are not flown '
                f"again"
            )
        warnings.warn(
            f"a worker process has died (exit code {dead.exitcode}): another flies {said} again",
            RuntimeWarning,
            stacklevel=2,
        )
        self.start(batches)


def _work(
    pipe: Connection,
    run: Flights[Any],
    batches: list[range],
) -> None:
    """Fly batches in a process of its own; send their results, None at the end, or the error."""
    # An interrupt is for the process that asks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for result in run.fly(batches):
            pipe.send(result)
        pipe.send(None)
    except Exception as error:
        pipe.send(picklable(error))
