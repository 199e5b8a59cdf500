"""What must hold after each operation: clear errors, valid results, nothing left behind."""

import contextlib
import gc
import hashlib
import linecache
import multiprocessing
import os
import re
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
from gymnasium.spaces import Box, Dict, Discrete, Space

import bulletuav
from bulletuav.engine.calls import bullet

PACKAGE = str(Path(bulletuav.__file__).parent)
OWN = str(Path(__file__).parent)
OUTSIDE = ("gymnasium", "pettingzoo")
"""Libraries whose wrappers check by themselves"""
ERRORS = (ValueError, TypeError, RuntimeError, KeyError, OSError)
ENDING = 10.0
"""Time for processes to end, s"""
REMEDY = re.compile(
    r"need|must|choose|call |make |use |give|lower|at (least|most)|from .* to|did you mean|leave|"
    r"load it|raise|or more|name |cannot|has no|is no|are no|not |unknown|in use|takes|write|only|"
    r"too |take |overlap|twice"
)
MOST_CLIENTS = 64


class Broken(Exception):  # noqa: N818  # it is no error of the package's
    """An invariant does not hold."""


def require(holds: Any, what: str, *values: Any) -> None:
    """Raise Broken unless something holds; values take the places of {} in what is told."""
    if not holds:
        raise Broken(what.format(*values) if values else what)


def attempt(call: Callable[[], Any], must: bool | None = None) -> tuple[Any, Exception | None]:
    """Call something that may be refused by a clear error.

    Args:
        call: What is called.
        must: True where it has to be refused, False where it has to be done; None for either.

    Returns:
        What it gave, and None; or None, and the error.
    """
    try:
        value = call()
    except Broken:
        raise
    except Exception as error:
        require_clear(error)
        if must is False:
            raise Broken(f"refused what can be: {tell(error)}") from error
        return None, error
    require(must is not True, "took what cannot be")
    return value, None


def require_clear(error: BaseException) -> None:
    """Raise Broken unless an error was raised on purpose, and says what is wrong."""
    frames = traceback.extract_tb(error.__traceback__)
    last = frames[-1]
    if any(f"{os.sep}{one}{os.sep}" in last.filename for one in OUTSIDE):
        return  # wrappers of others, which assert what spaces say
    source = linecache.getline(last.filename, last.lineno or 0).strip()
    on_purpose = last.filename.startswith(PACKAGE) and source.startswith("raise")
    # Arguments that a function does not have
    calls = isinstance(error, TypeError) and "unexpected keyword argument" in str(error)
    clear = isinstance(error, ERRORS) and on_purpose
    clear = clear and not isinstance(error, IndexError | NotImplementedError | RecursionError)
    if not calls and not (clear and REMEDY.search(str(error))):
        raise Broken(f"no clear error: {tell(error)}") from error


def tell(error: BaseException) -> str:
    """Tell an error with the line that it comes from."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return f"{type(error).__name__} at {place}: {str(error)[:300]}"


def require_inside(space: Space[Any], value: Any, lead: tuple[int, ...] = ()) -> None:
    """Raise Broken unless observations (*lead, ...) are finite, of the type and in the bounds."""
    if isinstance(space, Dict):
        require(list(space.spaces) == sorted(value), "entries {} of {}", list(value), space)
        for name, one in space.spaces.items():
            require_inside(one, value[name], lead)
        return
    assert isinstance(space, Box)
    require(isinstance(value, np.ndarray), "an observation is {}", type(value))
    kind = value.dtype
    require(kind == space.dtype, "an observation is of {}, not {}", kind, space.dtype)
    require(value.shape == (*lead, *space.shape), "an observation has shape {}", value.shape)
    require(np.isfinite(value).all(), "an observation is not finite")
    within = (value >= space.low) & (value <= space.high)
    require(within.all(), "an observation is outside of its space: {}", value[~within][:5])


def require_flags(value: Any, shape: tuple[int, ...], what: str) -> None:
    """Raise Broken unless a mask is bools of a shape."""
    array = np.asarray(value)
    fits = array.dtype == bool and array.shape == shape
    require(fits, "{}: {}, {}", what, array.dtype, array.shape)


def require_rewards(value: Any, shape: tuple[int, ...]) -> None:
    """Raise Broken unless rewards are finite float64 of a shape."""
    array = np.asarray(value)
    fits = array.dtype == float and array.shape == shape
    require(fits, "rewards {}, {}", array.dtype, array.shape)
    require(np.isfinite(array).all(), "a reward is not finite")


def require_infos(infos: Mapping[str, Any], lead: tuple[int, ...]) -> None:
    """Raise Broken unless infos (*lead, ...) are numbers, and no NaN."""
    for name, value in infos.items():
        if name.startswith(("final", "_final")):
            continue
        array = np.asarray(value)
        require(array.shape[: len(lead)] == lead, "info {} has shape {}", name, array.shape)
        require(array.dtype.kind in "biuf", "info {} is of {}", name, array.dtype)
        require(not np.isnan(array).any(), "info {} is NaN", name)


def sample(space: Space[Any], rng: np.random.Generator) -> Any:
    """Draw an action: anywhere in its bounds, or at one of them."""
    if isinstance(space, Discrete):
        return int(rng.integers(space.n))
    if isinstance(space, Box):
        share = rng.random(space.shape) if rng.random() < 0.7 else rng.integers(0, 2, space.shape)
        return (space.low + share * (space.high - space.low)).astype(space.dtype)
    return rng.integers(space.nvec)


class Digest:
    """A hash of all that was told, in order."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, value: Any) -> None:
        """Add arrays, numbers, texts, and lists or dicts of them."""
        if isinstance(value, Mapping):
            for name in value:
                self.add(str(name))
                self.add(value[name])
        elif isinstance(value, list | tuple):
            for one in value:
                self.add(one)
        elif isinstance(value, str):
            self._hash.update(value.encode())
        else:
            array = np.asarray(value)
            if array.dtype.kind == "O":
                self._hash.update(type(value).__name__.encode())
            else:
                self._hash.update(f"{array.dtype.str}{array.shape}".encode())
                self._hash.update(np.ascontiguousarray(array).tobytes())

    def __str__(self) -> str:
        """Tell it in hexadecimal digits."""
        return self._hash.hexdigest()


def digest_of(value: Any) -> str:
    """Hash one value."""
    digest = Digest()
    digest.add(value)
    return str(digest)


class Resources(NamedTuple):
    """What a process holds.

    Attributes:
        descriptors: Open files.
        threads: Threads of Python.
        children: Processes that it started.
        clients: Clients of Bullet.
        shared: Its segments of shared memory.
    """

    descriptors: int
    threads: int
    children: int
    clients: int
    shared: int

    @classmethod
    def now(cls) -> "Resources":
        """Count them, once what nobody uses has gone, and what is ending has ended."""
        gc.collect()
        end = time.monotonic() + ENDING
        while _children() and time.monotonic() < end:
            multiprocessing.active_children()  # forgets those that have ended
            time.sleep(0.02)
        shared = Path("/dev/shm")
        return cls(
            sum(not _is_kept(path) for path in Path("/proc/self/fd").iterdir()),
            threading.active_count(),
            len(_children()),
            sum(bullet.getConnectionInfo(k)["isConnected"] for k in range(MOST_CLIENTS)),
            len(list(shared.glob(f"*-{os.getpid()}-*"))) if shared.is_dir() else 0,
        )


def _children() -> list[psutil.Process]:
    """List the processes that this one started, but for those that `multiprocessing` keeps."""
    found = []
    for one in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            text = " ".join(one.cmdline())
            serves = "multiprocessing.forkserver" in text and one.ppid() == os.getpid()
            if not serves and "multiprocessing.resource_tracker" not in text:
                found.append(one)
    return found


def _is_kept(descriptor: Path) -> bool:
    """Tell whether it is of memory that `multiprocessing` keeps for the next who asks."""
    try:
        return str(descriptor.readlink()).startswith("/dev/shm/pym-")
    except OSError:  # that of the listing itself
        return True


def resident() -> float:
    """Tell the memory that this process has, MB."""
    return float(psutil.Process().memory_info().rss) / 1e6
