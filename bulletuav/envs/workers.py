"""The batched face over several processes: each flies some of the worlds, arrays are shared."""

import contextlib
import itertools
import multiprocessing
import os
import pickle
import time
import weakref
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from bulletuav.envs.env_spec import MOST_WORLDS, EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import widest_action_space
from bulletuav.envs.vector import BatchAviary, autoreset, reset_mask
from bulletuav.envs.worker import Shared, named, work
from bulletuav.errors import as_int, choose, finite
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

PATIENCE = 5.0  # s, for all workers to end
MOST_WORKERS = 256
TIMEOUT = 600.0  # s, for an answer: longer than any decision, and than compiling for a first one


def _finish(owner: int, pipes: list[Connection], processes: list) -> None:
    if os.getpid() != owner:  # a copy of the owner, made by a fork
        return
    for pipe in pipes:
        with contextlib.suppress(OSError):  # it may have ended already
            pipe.send(None)
    end = time.monotonic() + PATIENCE
    for process in processes:
        process.join(max(0.0, end - time.monotonic()))
        process.kill()  # also one that is stopped


class WorkerAviary(Environment):
    """What `BatchAviary` is, flown by `workers` processes: same arrays in, the same bits out, whatever their number.

    Without a main guard (`if __name__ == "__main__"`) scripts need the start method "fork". Functions among the options
    (wind) see the worlds of one process at a time. In SAME_STEP the rows of worlds outside the masks of final entries are
    undefined.
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
        **options: Any,
    ):
        """Start the processes.

        Args:
            task: As of `BatchAviary`, like `num_envs`, `autoreset_mode` and the options.
            num_envs: Worlds.
            autoreset_mode: What happens when an episode is over.
            workers: Processes.
            start_method: Of the processes, by default Python's own.
            timeout: Seconds after which a process without an answer counts as lost.
            options: Of the environment.

        Raises:
            ValueError: Options cannot be.
            RuntimeError: A process ends, or does not answer in time.
        """
        self.autoreset_mode = autoreset(autoreset_mode)
        self._plan = plan = EnvSpec(task, as_int("num_envs", num_envs, 1, MOST_WORLDS), options)
        self.num_envs, self.num_drones = plan.num_worlds, plan.options.num_drones
        _check_processes(workers, start_method, timeout)
        if workers > self.num_envs:
            raise ValueError(
                f"workers is {workers}: at most one for each of the {self.num_envs} worlds is needed"
            )
        if plan.options.render_mode == "human":
            raise ValueError("render_mode is 'human': a live view needs workers=1")
        self._timeout = float(timeout)
        self.observation_space: Box | Dict = plan.observer.space()
        self.action_space: Space = widest_action_space(plan.action)
        context: Any = multiprocessing.get_context(start_method)
        shared = Shared(context, self._layout())
        self._arrays = shared.arrays(0, self.num_envs)
        bounds = [self.num_envs * k // workers for k in range(workers + 1)]
        self._parts = [slice(*pair) for pair in itertools.pairwise(bounds)]
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        self._finalizer = weakref.finalize(self, _finish, os.getpid(), self._pipes, self._processes)
        self._started = False
        with self._closed_by_errors():
            for part in self._parts:
                self._start(
                    context, (shared, part.start, part.stop, (task, self.autoreset_mode), options)
                )
            _raised(self._answers(list(range(workers))))

    def _start(self, context: Any, arguments: tuple) -> None:
        mine, theirs = context.Pipe()
        process = context.Process(target=work, args=(theirs, *arguments), daemon=True)
        try:
            process.start()
        except (AssertionError, AttributeError, TypeError, pickle.PicklingError) as error:
            raise ValueError(
                f"a worker process cannot start: {error}; processes that are workers themselves have none, and with start "
                f"methods other than 'fork' options must be what pickle can take (no lambda)"
            ) from None
        theirs.close()
        self._pipes.append(mine)
        self._processes.append(process)

    @contextlib.contextmanager
    def _closed_by_errors(self) -> Iterator[None]:
        """End the processes on anything that would leave answers unread, an interrupt too: none may be taken for another."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _layout(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        drones = (self.num_envs, self.num_drones)
        space = self.observation_space
        parts = named(space.spaces if isinstance(space, Dict) else space)
        return {
            "action": ((*drones, self._plan.action.low.shape[-1]), np.float64),
            **{name: ((*drones, *(one.shape or ())), one.dtype) for name, one in parts.items()},
            "reward": (drones, np.float64),
            "terminated": (drones, bool),
            "truncated": (drones, bool),
            "alive": (drones, bool),
            "ended": ((self.num_envs,), bool),
        }

    def _ask(self, method: str, keywords: dict[int, dict[str, Any]]) -> list[Any]:
        """What the workers of `keywords` answer."""
        if not self._finalizer.alive:
            raise RuntimeError("this environment is closed: make a new one")
        with self._closed_by_errors():
            for k, mine in keywords.items():
                with contextlib.suppress(OSError):  # from a dead worker no answer comes either
                    self._pipes[k].send((method, mine))
            answers = self._answers(list(keywords))
        return _raised(answers)

    def _all(self, **keywords: Any) -> dict[int, dict[str, Any]]:
        return dict.fromkeys(range(len(self._parts)), keywords)

    def _answers(self, workers: list[int]) -> list[Any]:
        """One of each worker, its error among them."""
        end, answers = time.monotonic() + self._timeout, []
        try:
            for k in workers:
                if not self._pipes[k].poll(max(0.0, end - time.monotonic())):
                    self._processes[k].kill()  # which is not asked to end, as it would not hear it
                    raise RuntimeError(
                        f"worker process {k} has not answered for {self._timeout:g} s: it is stopped or stuck, or "
                        f"a decision takes longer (raise timeout); make a new environment"
                    )
                answers.append(self._pipes[k].recv())
        except (EOFError, OSError):
            self.close()
            raise RuntimeError(
                'a worker process has died: memory may have run out, or the script lacks `if __name__ == "__main__":` '
                "around what makes the environment; make a new one"
            ) from None
        return answers

    def _observations(self) -> Observation:
        if isinstance(self.observation_space, Dict):
            return {
                name: self._arrays[f"observation/{name}"].copy()
                for name in self.observation_space.spaces
            }
        return self._arrays["observation/"].copy()

    @property
    def alive(self) -> np.ndarray:
        """(W, N) bool: drones whose episode goes on."""
        return self._arrays["alive"].copy()

    @property
    def ended(self) -> np.ndarray:
        """(W,) worlds whose episode ended in the last step."""
        return self._arrays["ended"].copy()

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As `BatchAviary.reset`."""
        mask = self._plan.mask(reset_mask(options))
        seeds = self._plan.seeds(seed)
        infos = self._ask(
            "reset",
            {
                k: {
                    "seed": None if seeds is None else seeds[part],
                    "options": {"reset_mask": mask[part]},
                }
                for k, part in enumerate(self._parts)
            },
        )
        self._started = True
        return self._observations(), _merged(self._parts, infos, self.num_envs)

    @exclusive
    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """As `BatchAviary.step`."""
        if not self._started:
            raise RuntimeError("the worlds have not been started: call reset() first")
        choices = self._plan.action.choices is not None
        actions = np.asarray(actions)[..., None] if choices else np.asarray(actions)
        self._arrays["action"][:] = self._plan.actions(actions, self._arrays["alive"])
        infos = self._ask("step", self._all(choices=choices))
        reward, terminated, truncated = (
            self._arrays[name].copy() for name in ("reward", "terminated", "truncated")
        )
        return (
            self._observations(),
            reward,
            terminated,
            truncated,
            _merged(self._parts, infos, self.num_envs),
        )

    @exclusive
    def state(self) -> np.ndarray:
        """(W, 17 N) float32 global state; see `Aviary.state`."""
        return np.concatenate(self._ask("state", self._all()))

    @exclusive
    def render(self, world: int = 0) -> np.ndarray | None:
        """A picture (height, width, 3) uint8 of one world with render_mode "rgb_array"."""
        self._plan.require_world(world)
        k = next(k for k, part in enumerate(self._parts) if world < part.stop)
        return self._ask("render", {k: {"world": world - self._parts[k].start}})[0]

    @exclusive
    def close(self) -> None:
        """End the processes; a second call does nothing."""
        self._finalizer()


def _raised(answers: list[Any]) -> list[Any]:
    """The answers; the first error among them is raised."""
    for answer in answers:
        if isinstance(answer, Exception):
            raise answer
    return answers


def _merged(parts: list[slice], infos: list[dict[str, Any]], num_envs: int) -> dict[str, Any]:
    """One dict of the infos of `parts`; worlds of parts that lack an entry (final ones) get zeros."""
    merged: dict[str, Any] = {}
    for name in dict.fromkeys(name for info in infos for name in info):
        given = [
            (part, info[name]) for part, info in zip(parts, infos, strict=True) if name in info
        ]
        first = given[0][1]
        if isinstance(first, dict):
            merged[name] = _merged(
                [part for part, _ in given], [value for _, value in given], num_envs
            )
            continue
        merged[name] = np.zeros((num_envs, *first.shape[1:]), dtype=first.dtype)
        for part, value in given:
            merged[name][part] = value
    return merged


def _check_processes(workers: Any, start_method: Any, timeout: Any) -> None:
    """Raise ValueError for processes that cannot be."""
    as_int("workers", workers, 1, MOST_WORKERS)
    if start_method is not None:
        choose("start_method", start_method, dict.fromkeys(multiprocessing.get_all_start_methods()))
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
    """`num_envs` worlds of the task that reset themselves; see `BatchAviary` and, for the options, `parallel_env`.

    `workers` above 1 spreads them over processes (`start_method` as in `multiprocessing`), for as many cores: see
    `WorkerAviary`. A process that has not answered for `timeout` seconds is given up, with a RuntimeError.
    """
    _check_processes(workers, start_method, timeout)
    if workers == 1:
        return BatchAviary(task, num_envs, **options)
    return WorkerAviary(
        task, num_envs, workers=workers, start_method=start_method, timeout=timeout, **options
    )
