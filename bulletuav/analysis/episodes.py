"""Episodes of an evaluation: flown in batches, by one process or several, to the same numbers."""

import multiprocessing
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np

from bulletuav.analysis.metrics import Meter, MetricSpec
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.worker import portable
from bulletuav.policies import PolicySource, find_policy
from bulletuav.policies.base import Policy
from bulletuav.tasks import TaskSource

BATCH = 10
"""Episodes flown at once; part of what an evaluation is, whatever the number of processes"""
Row = dict[str, float]
"""Metrics of an episode by name, with "episode" and "seed" """


@dataclass(frozen=True)
class Run:
    """Everything that a process needs to fly episodes.

    Attributes:
        task: What is flown.
        policy: Who flies.
        seed: Seed of episode 0; episode e has `seed` + e.
        episodes: How many there are.
        options: Options of the environment.
        trust: Whether the policy's file may run code when it is read.
        metrics: What is measured beside the standard metrics.
    """

    task: TaskSource
    policy: PolicySource
    seed: int
    episodes: int
    options: dict[str, Any]
    trust: bool = False
    metrics: tuple[MetricSpec, ...] = ()

    def batches(self) -> list[range]:
        """List the episodes that fly together; episode e flies in world e mod `BATCH`."""
        return [
            range(first, min(first + BATCH, self.episodes))
            for first in range(0, self.episodes, BATCH)
        ]

    def fly(self, batches: list[range]) -> Iterator[list[Row]]:
        """Yield the rows of each batch in turn."""
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
        """Fly one batch."""
        # The last batch may be smaller: then the other worlds are not started.
        worlds = np.arange(BATCH) < len(batch)
        observations = aviary.reset(worlds, [self.seed + batch.start + k for k in range(BATCH)])
        policy.reset(worlds)
        meter = Meter(aviary, self.metrics)
        # Worlds whose episode has ended stand still until all have.
        while aviary.alive[worlds].any():
            flown = aviary.alive & worlds[:, None]
            step = aviary.step(policy.act(observations, aviary.swarm))
            meter.record(step, flown)
            observations = step.observations
        return [
            {"episode": episode, "seed": self.seed + episode, **meter.row(k)}
            for k, episode in enumerate(batch)
        ]


def fly_batches(run: Run, batches: list[range], workers: int) -> Iterator[list[Row]]:
    """Yield the rows of all batches as they come.

    Args:
        run: What is flown.
        batches: Those of its batches that are to be flown.
        workers: Processes that fly them, which change the order of the batches alone.

    Raises:
        RuntimeError: A process has died.
    """
    workers = min(workers, len(batches))
    if workers <= 1:
        yield from run.fly(batches)
        return
    processes: list[multiprocessing.Process] = []
    pipes: list[Connection] = []
    try:
        # Each process takes every `workers`-th batch, and sends rows through a pipe of its own.
        for k in range(workers):
            mine, theirs = multiprocessing.Pipe()
            share = batches[k::workers]
            process = multiprocessing.Process(target=_work, args=(theirs, run, share), daemon=True)
            process.start()
            theirs.close()
            processes.append(process)
            pipes.append(mine)
        yield from _received(pipes)
    # Also when the caller stops in between.
    finally:
        for process in processes:
            # A process that is stopped would not hear anything milder.
            process.kill()
            process.join()


def _work(pipe: Connection, run: Run, batches: list[range]) -> None:
    """Fly batches in a process of its own, and send their rows, None at the end, or the error."""
    # An interrupt is for the process that asks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for rows in run.fly(batches):
            pipe.send(rows)
        pipe.send(None)
    except Exception as error:
        pipe.send(portable(error))


def _received(pipes: list[Connection]) -> Iterator[list[Row]]:
    """Yield rows of whichever process has some, until all are done."""
    open_pipes: list[Any] = list(pipes)
    while open_pipes:
        for pipe in wait(open_pipes):
            assert isinstance(pipe, Connection)
            # A pipe ends before its None where its process was killed.
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
