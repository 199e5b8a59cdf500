"""Episodes of an evaluation, flown in batches by one or several processes, reproducibly."""

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
from bulletuav.interrupts import block_interrupts
from bulletuav.policies import PolicySource, find_policy
from bulletuav.policies.base import Policy
from bulletuav.policies.mismatch import naming_task
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

BATCH = 10
"""Number of episodes flown together; fixed, so that results do not depend on the workers"""
MAX_DEATHS = 3
"""Number of processes that may die in the same batch before the evaluation fails"""
Row = dict[str, float]
"""Metrics of an episode by name, with "episode" and "seed" """
BatchResult = TypeVar("BatchResult")


@dataclass(frozen=True)
class EpisodeJob(ABC, Generic[BatchResult]):
    """Episodes to fly, as sent to each worker process; subclasses define the result of a batch.

    Attributes:
        task: Name or class of the task.
        policy: The policy.
        seed: Seed of episode 0; episode e has `seed` + e.
        episodes: Number of episodes.
        options: Options of the environment.
        trust: Whether the policy's file may run code when it is loaded.
    """

    task: TaskSource
    policy: PolicySource
    seed: int
    episodes: int
    options: dict[str, Any]
    trust: bool = False

    def batches(self) -> list[range]:
        """List the episodes of each batch; episode e is flown in world e mod `BATCH`."""
        return [
            range(first, min(first + BATCH, self.episodes))
            for first in range(0, self.episodes, BATCH)
        ]

    def fly(self, batches: Sequence[range]) -> Iterator[BatchResult]:
        """Yield the result of each batch in turn."""
        if not batches:
            return
        aviary = Aviary(self.task, BATCH, **self.options)
        try:
            policy = find_policy(self.policy, self.task, self.trust)(aviary)
            for batch in batches:
                yield self._fly_batch(aviary, policy, batch)
        finally:
            aviary.close()

    def fly_all(self, batches: Sequence[range]) -> list[BatchResult]:
        """Return the results of all batches."""
        return list(self.fly(batches))

    def start(self, aviary: Aviary, policy: Policy, batch: range) -> tuple[Observation, np.ndarray]:
        """Reset the worlds and the policy for a batch.

        Returns:
            First observations, and the mask of the worlds that fly, (BATCH,) bool: the last batch
            may have fewer episodes than the others.
        """
        worlds = np.arange(BATCH) < len(batch)
        observations = aviary.reset(worlds, [self.seed + batch.start + k for k in range(BATCH)])
        with naming_task(policy, aviary):
            policy.reset(worlds)
        return observations, worlds

    @abstractmethod
    def _fly_batch(self, aviary: Aviary, policy: Policy, batch: range) -> BatchResult:
        """Fly one batch and return its result."""


@dataclass(frozen=True)
class EvaluationJob(EpisodeJob[list[Row]]):
    """The episodes of an evaluation; see `EpisodeJob`.

    Attributes:
        metrics: Custom metrics in addition to the standard ones.
    """

    metrics: tuple[MetricSpec, ...] = ()

    def _fly_batch(self, aviary: Aviary, policy: Policy, batch: range) -> list[Row]:
        """Fly one batch and return the metrics of its episodes."""
        observations, worlds = self.start(aviary, policy, batch)
        meter = Meter(aviary, self.metrics)
        # Worlds whose episode has ended are idle until all have ended.
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
    run: EpisodeJob[BatchResult], batches: list[range], workers: int, ray: str | None = None
) -> Iterator[BatchResult]:
    """Yield the results of all batches as they finish.

    Args:
        run: The episodes.
        batches: The batches to fly.
        workers: Number of processes; it affects only the order of the results.
        ray: Address of a Ray cluster that flies the batches instead.

    Raises:
        RuntimeError: If several processes in turn have died in the same batch.
        ConnectionError: If the cluster cannot be reached.
    """
    if ray is not None and batches:
        from bulletuav.adapters.ray import map_on_cluster  # which needs an extra

        yield from map_on_cluster(ray, run.fly_all, batches)
        return
    workers = min(workers, len(batches))
    if workers <= 1:
        yield from run.fly(batches)
        return
    pool = _WorkerPool(run)
    try:
        # Each process takes every `workers`-th batch
        for k in range(workers):
            pool.start(batches[k::workers])
        yield from pool.results()
    # Also runs when the caller stops iterating.
    finally:
        pool.end()


class _Worker(NamedTuple):
    """A process that flies batches, and the batches whose results are pending, in order."""

    process: multiprocessing.Process
    batches: list[range]


class _WorkerPool:
    """Processes that fly batches; a process that dies is replaced, and its batches are repeated."""

    def __init__(self, run: EpisodeJob[Any]) -> None:
        self._run = run
        self._workers: dict[Connection, _Worker] = {}
        self._deaths: Counter[range] = Counter()

    def start(self, batches: list[range]) -> None:
        """Start a process that flies batches and sends results through its own pipe."""
        mine, theirs = multiprocessing.Pipe()
        process = multiprocessing.Process(
            target=_run_worker, args=(theirs, self._run, list(batches)), daemon=True
        )
        self._workers[mine] = _Worker(process, list(batches))
        with block_interrupts():
            process.start()
        theirs.close()

    def results(self) -> Iterator[Any]:
        """Yield the results of the processes as they arrive, until all are done.

        Raises:
            RuntimeError: If processes die repeatedly in the same batch.
        """
        while self._workers:
            for pipe in wait(list(self._workers)):
                assert isinstance(pipe, Connection)
                batches = self._workers[pipe].batches
                # The pipe of a killed process ends without the final None.
                try:
                    answer = pipe.recv()
                except (EOFError, OSError):
                    process = self._stop_worker(pipe)
                    if batches:
                        self._replace(process, batches)
                    continue
                if isinstance(answer, Exception):
                    raise answer
                if answer is None:
                    self._stop_worker(pipe)
                else:
                    del batches[0]
                    yield answer

    def end(self) -> None:
        """Kill the remaining processes."""
        for pipe in list(self._workers):
            self._stop_worker(pipe)

    def _stop_worker(self, pipe: Connection) -> multiprocessing.Process:
        """Kill a process, wait for its end, and close its pipe."""
        process = self._workers.pop(pipe).process
        pipe.close()
        # A process that could not start has no process id
        if process.pid is not None:
            # A suspended process would not react to SIGTERM.
            process.kill()
            process.join()
        return process

    def _replace(self, dead: multiprocessing.Process, batches: list[range]) -> None:
        """Start another process for the pending batches of a process that died."""
        batch = batches[0]
        self._deaths[batch] += 1
        first, last = batch[0], batch[-1]
        seeds = f"seeds {self._run.seed + first} to {self._run.seed + last}"
        text = f"episodes {first} to {last} ({seeds})"
        if self._deaths[batch] == MAX_DEATHS:
            raise RuntimeError(
                f"{MAX_DEATHS} worker processes in turn have died in {text}: memory may have run "
                f"out (take fewer workers), the task or the policy may end its process (fly these "
                f"seeds with workers=1 to see it), or the script lacks "
                f'`if __name__ == "__main__":`; batches that are kept in a folder are not flown '
                f"again"
            )
        warnings.warn(
            f"a worker process has died (exit code {dead.exitcode}): another flies {text} again",
            RuntimeWarning,
            stacklevel=2,
        )
        self.start(batches)


def _run_worker(pipe: Connection, run: EpisodeJob[Any], batches: list[range]) -> None:
    """Fly batches in a worker process; send their results and a final None, or the error."""
    # The parent process handles interrupts.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for result in run.fly(batches):
            pipe.send(result)
        pipe.send(None)
    except Exception as error:
        pipe.send(picklable(error))
