"""Batches of worlds over several processes with shared arrays."""

import contextlib
import itertools
import multiprocessing
import os
import pickle
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from bulletuav.cores import count_cores
from bulletuav.envs.env_spec import MAX_WORLDS, EnvSpec
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.given_starts import split_worlds
from bulletuav.envs.reset_options import MASK, reset_options
from bulletuav.envs.shared_infos import SharedInfos, merge_infos, num_info_rows
from bulletuav.envs.snapshot import Snapshot, own_snapshot, require_snapshot
from bulletuav.envs.spaces import widest_action_space
from bulletuav.envs.vector import BatchAviary, BatchResults, as_autoreset_mode
from bulletuav.envs.worker import (
    POLL_TIME,
    BatchShard,
    SharedArrays,
    SharedLayout,
    by_shared_name,
    end_processes,
    poll_number,
    raise_first,
    run_worker,
)
from bulletuav.errors import as_bool, as_int, find_choice, finite, numbers_of
from bulletuav.interrupts import block_interrupts
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import VECTOR, Observation, copied

MAX_WORKERS = 256
TIMEOUT = 600.0
"""Maximum time of an answer, s: longer than any decision, and than the first compilation"""


class WorkerAviary(LabelledEnvironment):
    """A `BatchAviary` over several processes, with the same results to the bit.

    This process is one of them: it simulates the first worlds itself while the others simulate
    theirs. The number of processes does not change the results. Scripts without a main guard (`if
    __name__ == "__main__"`) need the start method "fork". Functions among the options (wind) are
    called with the worlds of one process at a time. In SAME_STEP the rows of worlds outside the
    masks of final entries are undefined.

    Attributes:
        num_envs: Number of worlds W.
        num_drones: Number of drones N of a world.
        autoreset_mode: When finished worlds are reset.
        observation_space: Observation space of one drone.
        action_space: Action space of one drone; see `BatchAviary`.
    """

    def __init__(
        self,
        task: TaskSource,
        num_envs: int,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        *,
        workers: int,
        start_method: str | None = None,
        timeout: float = TIMEOUT,
        copy: bool = True,
        **options: Any,
    ) -> None:
        """Start the processes.

        Args:
            task: See `BatchAviary`, like `num_envs`, `autoreset_mode` and the options.
            num_envs: Number of worlds W.
            autoreset_mode: When finished worlds are reset.
            workers: Number of processes, including this one.
            start_method: As in `multiprocessing`; None for Python's default.
            timeout: Seconds after which a process without an answer counts as lost.
            copy: See `BatchAviary`; False returns views of the memory that the processes share.
            **options: Options of the environment.

        Raises:
            ValueError: If an option is invalid.
            RuntimeError: If a process ends, or does not answer in time.
        """
        self.autoreset_mode = as_autoreset_mode(autoreset_mode)
        as_int("num_envs", num_envs, 1, MAX_WORLDS)
        self._spec = EnvSpec(task, num_envs, options)
        self._observer = self._spec.observer
        self.num_envs = self._spec.num_worlds
        self.num_drones = self._spec.options.num_drones
        _check_processes(workers, start_method, timeout)
        if workers > self.num_envs:
            raise ValueError(
                f"workers is {workers}: at most one for each of the {self.num_envs} worlds is "
                f"needed"
            )
        if (mode := self._spec.options.render_mode) not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {mode!r}: a live view needs workers=1")
        if (threads := self._spec.options.threads) > 1:
            raise ValueError(
                f"threads is {threads}, and workers is {workers}: worker processes have one thread "
                f"each; give one of the two"
            )
        if self._spec.options.debug:
            raise ValueError("debug is True: debuggers see one process, so it needs workers=1")
        self._timeout = float(timeout)
        self._copies = as_bool("copy", copy)
        # Polling for answers occupies a core, and uses up quotas
        self._poll_time = POLL_TIME if count_cores() >= workers else 0.0
        self.observation_space: Box | Dict = self._observer.space()
        self.action_space: Space[Any] = widest_action_space(self._spec.action)
        # The worlds of each process
        bounds = [self.num_envs * k // workers for k in range(workers + 1)]
        self._slices = [slice(*pair) for pair in itertools.pairwise(bounds)]
        # The worlds of this process; the other processes, and the finalizer that ends them
        self._shard: BatchShard | None = None
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        self._owner = os.getpid()
        self._finalizer = weakref.finalize(
            self, end_processes, self._owner, self._pipes, self._processes
        )
        self._started = False
        with self._closed_by_errors():
            self._start_workers(start_method, (task, self.autoreset_mode, options))
            raise_first(self._answers(range(1, workers)))

    def _start_workers(self, start_method: str | None, recipe: tuple[Any, ...]) -> None:
        """Allocate shared memory, start the processes, and create the worlds of this one."""
        context: Any = multiprocessing.get_context(start_method)
        shared = SharedArrays(context, self._layout())
        self._arrays = shared.views(0, self.num_envs)
        self._infos = SharedInfos(self._arrays["info"])
        for part in self._slices[1:]:
            self._start_worker(context, (self._poll_time, shared, part.start, part.stop, *recipe))
        self._shard = BatchShard(shared, 0, self._slices[0].stop, *recipe)

    def _start_worker(self, context: Any, arguments: tuple[Any, ...]) -> None:
        """Start a process with a pipe to it."""
        mine, theirs = context.Pipe()
        process = context.Process(target=run_worker, args=(theirs, *arguments), daemon=True)
        try:
            with block_interrupts():
                process.start()
        except (AssertionError, AttributeError, TypeError, pickle.PicklingError) as error:
            raise ValueError(
                f"a worker process cannot start: {error}; worker processes cannot have workers of "
                f"their own, and with start methods other than 'fork' options must be picklable "
                f"(no lambda)"
            ) from None
        theirs.close()
        self._pipes.append(mine)
        self._processes.append(process)

    @contextlib.contextmanager
    def _closed_by_errors(self) -> Iterator[None]:
        """End the processes on any exception, including an interrupt.

        Otherwise unread answers would be taken for those to later requests.
        """
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _layout(self) -> SharedLayout:
        """Return shape and type of the arrays that the processes share."""
        drones = (self.num_envs, self.num_drones)
        space = self.observation_space
        parts = by_shared_name(space.spaces if isinstance(space, Dict) else space)
        observed = {name: ((*drones, *(one.shape or ())), one.dtype) for name, one in parts.items()}
        return {
            "action": ((*drones, self._spec.action.low.shape[-1]), np.float64),
            **observed,
            "reward": (drones, np.float64),
            "terminated": (drones, bool),
            "truncated": (drones, bool),
            "alive": (drones, bool),
            "ended": ((self.num_envs,), bool),
            # Numbers of requests and answers of each process, at its first world
            "requests": ((self.num_envs,), np.int64),
            "answers": ((self.num_envs,), np.int64),
            "info": (
                (drones[0], num_info_rows(len(self._spec.task.weights)), drones[1]),
                np.float64,
            ),
        }

    def _request(self, method: str, keywords: dict[int, dict[str, Any]]) -> list[Any]:
        """Call a method in some of the processes, with arguments for each; return the answers."""
        shard = self._require_shard()
        with self._closed_by_errors():
            others = [k for k in keywords if k]
            for k in others:
                # A dead worker is detected by its missing answer
                with contextlib.suppress(OSError):
                    self._pipes[k - 1].send((method, keywords[k]))
                self._arrays["requests"][self._slices[k].start] += 1
            # This process simulates its own worlds meanwhile
            own = [shard.answer(method, keywords[0])] if 0 in keywords else []
            answers = [*own, *self._answers(others)]
        return raise_first(answers)

    def _require_shard(self) -> BatchShard:
        """Return the worlds of this process. Raises RuntimeError if there are none."""
        if self._shard is None or not self._finalizer.alive or os.getpid() != self._owner:
            raise RuntimeError("this environment is closed, or of another process: make a new one")
        return self._shard

    def _for_all(self, **keywords: Any) -> dict[int, dict[str, Any]]:
        """Return the same arguments for all processes."""
        return dict.fromkeys(range(len(self._slices)), keywords)

    def _answers(self, workers: Sequence[int]) -> list[Any]:
        """Wait for an answer of each worker, which may be an exception."""
        end = time.monotonic() + self._timeout
        answers: list[Any] = []
        try:
            for k in workers:
                left = max(0.0, end - time.monotonic())
                asked, given = (self._arrays[it][self._slices[k]] for it in ("requests", "answers"))
                # One more than requests: the first answer says that the worlds are ready
                is_there = poll_number(given, int(asked[0]) + 1, min(self._poll_time, left))
                if not is_there and not self._pipes[k - 1].poll(left):
                    # The process would not receive a request to end
                    self._processes[k - 1].kill()
                    raise RuntimeError(
                        f"worker process {k} has not answered for {self._timeout:g} s: it is "
                        f"stopped or stuck, or a decision takes longer (raise timeout); make a "
                        f"new environment"
                    )
                answers.append(self._pipes[k - 1].recv())
        except (EOFError, OSError):
            self.close()
            raise RuntimeError(
                "a worker process has died: memory may have run out, or the script lacks "
                '`if __name__ == "__main__":` around what makes the environment; make a new one'
            ) from None
        return answers

    def _observations(self) -> Observation:
        """Return the observations in the shared arrays; a copy by default."""
        if not isinstance(self.observation_space, Dict):
            seen = self._arrays["observation/"]
            return seen.copy() if self._copies else seen
        # Spaces sort their entries; observations have the order of the blocks
        observer = self._spec.observer
        order = (VECTOR, *observer.slices, *observer.images)
        names = filter(self.observation_space.spaces.__contains__, order)
        shown = {name: self._arrays[f"observation/{name}"] for name in names}
        return copied(shown) if self._copies else shown

    @property
    def alive(self) -> np.ndarray:
        """Drones whose episode is running, (W, N) bool."""
        return self._arrays["alive"].copy()

    @property
    def ended(self) -> np.ndarray:
        """Worlds whose episode ended in the last step, (W,) bool."""
        return self._arrays["ended"].copy()

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes; see `BatchAviary.reset`."""
        given = reset_options(options, MASK)
        mask = self._spec.mask(given.pop(MASK, None))
        seeds = self._spec.seeds(seed)
        sizes = (self._spec.options.num_drones, self.num_envs)
        split = {name: split_worlds(name, value, *sizes) for name, value in given.items()}
        keywords: dict[int, dict[str, Any]] = {}
        for k, part in enumerate(self._slices):
            own = None if seeds is None else seeds[part]
            # Values for all worlds, or the rows of this worker's worlds
            starts = {
                name: rows[0] if len(rows) == 1 else np.array(rows[part])
                for name, rows in split.items()
            }
            keywords[k] = {"seed": own, "options": {MASK: mask[part], **starts}}
        infos = merge_infos(self._slices, self._request("reset", keywords), self.num_envs)
        self._infos.set_types(infos)
        self._started = True
        return self._observations(), infos

    @exclusive
    def step(self, actions: np.ndarray) -> BatchResults:
        """Simulate one decision of all worlds; see `BatchAviary.step`."""
        if not self._started:
            raise RuntimeError("the worlds have not been started: call reset() first")
        choices = self._spec.action.choices is not None
        actions = numbers_of("actions are", actions)
        if choices:
            actions = actions[..., None]
        # All processes read their actions from the shared array, and clip them
        given = self._arrays["action"]
        if choices or actions.shape != given.shape or not np.isfinite(actions).all():
            actions = self._spec.actions(actions, self._arrays["alive"])
        given[:] = actions
        answers = self._request("step", self._for_all(choices=choices))
        infos = self._infos.read(answers, self._slices)
        rewards, *ends = (self._arrays[k].copy() for k in ("reward", "terminated", "truncated"))
        return self._observations(), rewards, *ends, infos  # type: ignore[return-value]

    @exclusive
    def set_condition(self, drones: Any = None, worlds: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `Aviary.set_condition`."""
        chosen = self._spec.indices(worlds)
        self._request_of_owners("set_condition", chosen, {"drones": drones, **changes})

    @exclusive
    def save_state(self, worlds: Any = None) -> Snapshot:
        """Save the complete state of worlds; see `Aviary.save_state`."""
        rows, saved = self._request_of_owners("save_state", self._spec.indices(worlds))
        for one in saved:
            one.require_whole()
        data = np.concatenate([one.data for one in saved])
        return own_snapshot(data[np.argsort(rows)], saved[0].form)

    @exclusive
    def load_state(self, snapshot: Snapshot, worlds: Any = None) -> Observation:
        """Restore a saved state; see `Aviary.load_state`."""
        chosen = self._spec.indices(worlds)
        require_snapshot(snapshot, Snapshot, len(chosen))
        # Checked here before any process writes
        self._require_shard().require_loadable(snapshot)
        self._request_of_owners("load_state", chosen, snapshot=snapshot)
        self._started = True
        return self._observations()

    @exclusive
    def state_hash(self, worlds: Any = None) -> tuple[str, ...]:
        """Compute a hash of the state of each world; see `Aviary.state_hash`."""
        rows, answers = self._request_of_owners("state_hash", self._spec.indices(worlds))
        hashes = [one for ones in answers for one in ones]
        return tuple(hashes[k] for k in np.argsort(rows))

    def _request_of_owners(
        self,
        method: str,
        worlds: np.ndarray,
        keywords: Mapping[str, Any] = MappingProxyType({}),
        snapshot: Snapshot | None = None,
    ) -> tuple[np.ndarray, list[Any]]:
        """Call a method in all processes, each with those of worlds (S,) that it has.

        Returns:
            (S,) indices into `worlds` in the order of the answers, and the answer of each process.
        """
        requests, order = {}, []
        for k, part in enumerate(self._slices):
            rows = np.flatnonzero((worlds >= part.start) & (worlds < part.stop))
            requests[k] = {"worlds": (worlds[rows] - part.start).tolist(), **keywords}
            if snapshot is not None:
                requests[k]["snapshot"] = snapshot[rows]
            order.append(rows)
        return np.concatenate(order), self._request(method, requests)

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state; see `BatchAviary.state`."""
        return np.concatenate(self._request("state", self._for_all()))

    @exclusive
    def render(self, world: int = 0) -> np.ndarray | None:
        """Render one world; see `BatchAviary.render`."""
        self._spec.require_world(world)
        k = next(k for k, part in enumerate(self._slices) if world < part.stop)
        (picture,) = self._request("render", {k: {"world": world - self._slices[k].start}})
        return cast(np.ndarray | None, picture)

    @exclusive
    def close(self) -> None:
        """End the processes. Further calls do nothing."""
        self._finalizer()
        if self._shard is not None:
            self._shard.close()


def _check_processes(workers: Any, start_method: Any, timeout: Any) -> None:
    """Raise ValueError for invalid arguments of processes."""
    as_int("workers", workers, 1, MAX_WORKERS)
    if start_method is not None:
        find_choice(
            "start_method", start_method, dict.fromkeys(multiprocessing.get_all_start_methods())
        )
    if finite("timeout", timeout) <= 0:
        raise ValueError(f"timeout is {timeout:g} s: it must be above 0")


def batch_env(
    task: TaskSource,
    num_envs: int,
    workers: int = 1,
    start_method: str | None = None,
    timeout: float = TIMEOUT,
    **options: Any,
) -> BatchAviary | WorkerAviary:
    """Create a batch of worlds of a task with automatic resets: arrays in, arrays out.

    Args:
        task: A name from `list_tasks()`, `module:Name`, or a task class.
        num_envs: Number of worlds.
        workers: Number of processes that share the worlds, to use as many cores; see
            `WorkerAviary`.
        start_method: Start method of processes, as in `multiprocessing`.
        timeout: Seconds after which a process without an answer counts as lost.
        **options: `autoreset_mode` of `BatchAviary`, and options of `parallel_env`.

    Returns:
        A `BatchAviary`, or with several workers a `WorkerAviary`, which behaves the same.

    Raises:
        ValueError: If an option is invalid; the message names the value and the remedy.
        RuntimeError: If a process ended, or did not answer in time.
    """
    _check_processes(workers, start_method, timeout)
    if workers == 1:
        return BatchAviary(task, num_envs, **options)
    return WorkerAviary(
        task, num_envs, workers=workers, start_method=start_method, timeout=timeout, **options
    )
