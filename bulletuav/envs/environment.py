"""Base classes of all environments: copies, thread safety, and observations by name."""

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
"""Key under which an environment stores the thread that is in one of its methods"""
Method = TypeVar("Method", bound=Callable[..., Any])


class Environment:
    """Environment that is copied by its arguments: pickle and deepcopy store these only.

    A copy is created from the same arguments and shares nothing with the original. It can be sent
    to other processes, and needs a reset. `copy.copy` would share the engine and raises TypeError.

    Attributes:
        made_from: Positional arguments and keyword arguments of the constructor.
    """

    made_from: tuple[tuple[Any, ...], dict[str, Any]]
    _busy: dict[str, tuple[int]]

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """Store copies of the arguments: the caller may modify lists and dicts later."""
        self = super().__new__(cls)
        self.made_from = (
            tuple(map(copy.copy, args)),
            {name: copy.copy(value) for name, value in kwargs.items()},
        )
        self._busy = {}
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the class and its arguments for pickle and `copy.deepcopy`."""
        return _recreate, (type(self), *self.made_from)

    def __copy__(self) -> NoReturn:
        """Raise TypeError."""
        raise TypeError(
            f"copy.copy of a {type(self).__name__} would share its engine: use copy.deepcopy for "
            f"one that is created from the same options"
        )


class Observer(Protocol):
    """Object that knows the labels of observations, such as an `ObservationBuilder`."""

    @property
    def labels(self) -> Iterable[Label]:
        """Labels of the numbers that one drone observes."""

    def split(self, observation: Observation) -> dict[str, np.ndarray]:
        """Split observations by the names of their blocks."""

    def space(self) -> Box | Dict:
        """Return the space of observations."""


class LabelledEnvironment(Environment):
    """Environment with labels of the numbers of its observations.

    Derived classes set `_observer` in their `__init__`.
    """

    _observer: Observer

    @property
    def observation_labels(self) -> list[Label]:
        """Name, unit and bounds of each number that one drone observes; a new list each time.

        Pictures have no labels. In the format "dict" the labels are those of all entries, in the
        order of the blocks.
        """
        return list(self._observer.labels)

    def split(self, observation: Observation) -> dict[str, np.ndarray]:
        """Split observations by the names of their blocks.

        Args:
            observation: Result of `reset` or `step` for one drone or several: (..., D) numbers, or
                a dict.

        Returns:
            Arrays (..., numbers of the block) by name, views of the argument. Pictures, and
            observations in the format "dict", are returned unchanged. If one agent commands N
            drones, the arrays are (..., N, numbers of the block), except for parts of the world.

        Raises:
            ValueError: If the size of the observation differs from the number of labels.
        """
        return self._observer.split(observation)


def in_plain_python(environment: Environment, methods: Iterable[str]) -> None:
    """Make methods of an environment run compiled functions as plain Python."""

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
        # An interrupt may follow any call, such as one that acquires a lock
        busy, me = self._busy, (threading.get_ident(),)
        # `setdefault` is atomic: only one of two threads finds its own mark
        try:
            if busy.setdefault(USER, me) != me:
                raise RuntimeError(
                    f"this {type(self).__name__} is in use by another thread: give each thread an "
                    f"environment of its own"
                )
            return method(self, *args, **kwargs)
        finally:
            # Nested calls leave the mark to the outermost one
            if USER in busy and busy[USER] is me:
                del busy[USER]

    return cast(Method, guarded)


exclusive = in_c(exclusive_plainly)


def _recreate(kind: type, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return kind(*args, **kwargs)
