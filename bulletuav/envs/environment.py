"""What all environment classes share: they are pickled as what they were made from, and flown by one thread at a time."""

import copy
import functools
import threading
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

Method = TypeVar("Method", bound=Callable[..., Any])


class Environment:
    """A recipe when it is pickled or deep-copied: the copy is made anew from the same arguments, and begins with a reset.

    So copies share nothing, and travel to other processes; nothing of an episode goes with them. `copy.copy`, which would
    share the engine, is refused.
    """

    _made_from: tuple[tuple[Any, ...], dict[str, Any]]
    _busy: threading.RLock

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """Note the arguments, each as it is now: lists and dicts may change in the caller's hands."""
        self = super().__new__(cls)
        self._made_from = (
            tuple(map(copy.copy, args)),
            {name: copy.copy(value) for name, value in kwargs.items()},
        )
        self._busy = threading.RLock()
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and `copy.deepcopy`."""
        return _made, (type(self), *self._made_from)

    def __copy__(self) -> NoReturn:
        """Raise TypeError."""
        raise TypeError(
            f"copy.copy of a {type(self).__name__} would share its engine: use copy.deepcopy for one that is made anew from "
            f"the same options"
        )


def exclusive(method: Method) -> Method:
    """Let a method of an `Environment` raise RuntimeError while another thread is in one of them."""

    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        if not self._busy.acquire(blocking=False):
            raise RuntimeError(
                f"this {type(self).__name__} is in use by another thread: give each thread an environment of its own"
            )
        try:
            return method(self, *args, **kwargs)
        finally:
            self._busy.release()

    return guarded  # type: ignore[return-value]


def _made(kind: type, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return kind(*args, **kwargs)
