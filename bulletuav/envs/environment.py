"""Behaviour that all environment classes share: copies, threads, and observations by name."""

import copy
import functools
import threading
from collections.abc import Callable, Iterable
from typing import Any, NoReturn, Protocol, TypeVar, cast

import numpy as np
from gymnasium.spaces import Box, Dict

from bulletuav.compiled.dispatcher import plain_kernels
from bulletuav.envs.agents import in_c
from bulletuav.sensors.base import Label
from bulletuav.tasks.observations.observer import Observation

USER = "user"
"""Where an environment notes the thread that is in one of its methods"""
Method = TypeVar("Method", bound=Callable[..., Any])


class Environment:
    """An environment that copies as a recipe: pickle and deepcopy keep its arguments only.

    A copy is made anew from the same arguments, so it shares nothing with the original. It
    travels to other processes, and begins with a reset. `copy.copy` would share the engine and is
    refused.

    Attributes:
        made_from: The arguments that it was made from: positional ones, and others by name.
    """

    made_from: tuple[tuple[Any, ...], dict[str, Any]]
    _busy: dict[str, tuple[int]]

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """Note the arguments, each as it is now: the caller may change lists and dicts later."""
        self = super().__new__(cls)
        self.made_from = (
            tuple(map(copy.copy, args)),
            {name: copy.copy(value) for name, value in kwargs.items()},
        )
        self._busy = {}
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Tell pickle and `copy.deepcopy` how a copy is made."""
        return _make_again, (type(self), *self.made_from)

    def __copy__(self) -> NoReturn:
        """Raise TypeError."""
        raise TypeError(
            f"copy.copy of a {type(self).__name__} would share its engine: use copy.deepcopy for "
            f"one that is made anew from the same options"
        )


class Observer(Protocol):
    """What knows the labels of observations, such as an `ObservationBuilder`."""

    @property
    def labels(self) -> Iterable[Label]:
        """Labels of the numbers that one drone observes."""

    def split(self, observation: Observation) -> dict[str, np.ndarray]:
        """Split observations by the names of their blocks."""

    def space(self) -> Box | Dict:
        """Make the space of observations."""


class LabelledEnvironment(Environment):
    """An environment with labels of the numbers of its observations.

    Derived classes set `_observer` in their `__init__`.
    """

    _observer: Observer

    @property
    def observation_labels(self) -> list[Label]:
        """Name, unit and bounds of each number that one drone observes; a new list each time.

        Pictures have no labels. In the format "dict" these are the numbers of all entries, in the
        order of the blocks.
        """
        return list(self._observer.labels)

    def split(self, observation: Observation) -> dict[str, np.ndarray]:
        """Split observations by the names of their blocks.

        Args:
            observation: What `reset` or `step` gave of one drone or of several: (..., D) numbers,
                or a dict.

        Returns:
            Arrays (..., numbers of the block) by name, views of the given one. Pictures, and
            observations in the format "dict", come back as they are. Where one agent commands N
            drones, the arrays are (..., N, numbers of the block), but for parts of the world.

        Raises:
            ValueError: The observation has another number of numbers than there are labels.
        """
        return self._observer.split(observation)


def in_plain_python(environment: Environment, methods: Iterable[str]) -> None:
    """Run compiled functions that methods of an environment call as plain Python."""

    def plainly(method: Method) -> Method:
        @functools.wraps(method)
        def run(*args: Any, **kwargs: Any) -> Any:
            with plain_kernels():
                return method(*args, **kwargs)

        return cast(Method, run)

    for name in methods:
        setattr(environment, name, plainly(getattr(environment, name)))


def exclusive_plainly(method: Method) -> Method:
    """Make a method of an `Environment` raise RuntimeError while another thread is in one."""

    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        # An interrupt may come right after any call, so also after one that takes a lock
        busy, me = self._busy, (threading.get_ident(),)
        # `setdefault` is atomic: of two threads one finds itself
        try:
            if busy.setdefault(USER, me) != me:
                raise RuntimeError(
                    f"this {type(self).__name__} is in use by another thread: give each thread an "
                    f"environment of its own"
                )
            return method(self, *args, **kwargs)
        finally:
            # A call within a call leaves the mark to the outer one
            if USER in busy and busy[USER] is me:
                del busy[USER]

    return cast(Method, guarded)


exclusive = in_c(exclusive_plainly)


def _make_again(kind: type, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Make a copy from the arguments of the original."""
    return kind(*args, **kwargs)
