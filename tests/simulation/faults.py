"""Faults: interrupts, other threads and processes, workers that die, disks that are full."""

import os
import pickle
import resource
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bulletuav
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.policies import find_policy

from .airspace import Space
from .at_work import Turn, operation
from .faces import Core, Curriculum, Team, Turns, Workers
from .forms import pick
from .invariants import PACKAGE, attempt, digest_of, require, tell
from .operations import compare, fly, has, hash_of, ready, restart

FILES = ("trajectory.npz", "trajectory.csv", "run.json")


def interrupted(call: Callable[[], Any], after: int) -> bool:
    """Call something, and interrupt it where Python would: at a call or a return in the package.

    Args:
        call: What is called.
        after: How many calls and returns come before the interrupt.

    Returns:
        Whether it was interrupted; it may have been done before.
    """
    left = after

    def profile(frame: Any, event: str, _: Any) -> None:
        nonlocal left
        if event not in ("call", "c_return") or not frame.f_code.co_filename.startswith(PACKAGE):
            return
        left -= 1
        if left < 0:
            sys.setprofile(None)
            raise KeyboardInterrupt

    sys.setprofile(profile)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.setprofile(None)
    return False


@operation(2.0)
def interrupt(turn: Turn) -> str:
    """Interrupt a step or a reset: afterwards it flies on or says why not, and a reset mends it."""
    if not ready(turn):
        return "no start"
    face, rng = turn.face, turn.rng
    after = int(10 ** rng.uniform(0.0, 3.0))
    action, which = face.act(rng), pick(rng, ("step", "reset", "look"))
    calls = {
        "step": lambda: face.step(action),
        "reset": lambda: face.reset(seed=1),
        "look": lambda: hash_of(face),
    }
    turn.sim.notes = f"{which} interrupted after {after}"
    cut = interrupted(calls[which], after)
    if isinstance(face, Workers | Turns | Curriculum):
        # What they do now depends on how far they came, and they say so
        attempt(lambda: face.step(action))
        attempt(lambda: face.reset(seed=1))
        turn.drop()
        return "cut" if cut else "ok"
    other: list[Any] = []
    before = face.note()
    actions = face.act(rng) if not face.is_over() else None
    thread = threading.Thread(target=lambda: other.append(_outcome(lambda: face.step(actions))))
    thread.start()
    thread.join()
    value, error = other[0]
    if error is None and actions is not None:
        face.check_step(value, before)
    if error is not None:
        attempt(lambda: _raise(error), must=True)
        require("another thread" not in str(error), f"a lock stays closed: {error}")
    restart(face, seed=1)
    compare(turn)
    turn.sim.digest.add(restart(face, seed=2))
    return "cut" if cut else "ok"


def _outcome(call: Callable[[], Any]) -> tuple[Any, Exception | None]:
    try:
        return call(), None
    except Exception as error:
        return None, error


def _raise(error: Exception) -> None:
    raise error


@operation(1.0)
def threads(turn: Turn) -> str:
    """Call from another thread: valid while nobody is in, refused while somebody is."""
    if not ready(turn):
        return "no start"
    face, env = turn.face, turn.face.plain
    results: list[Any] = []

    def inside(call: Callable[[], Any]) -> tuple[Any, Exception | None]:
        thread = threading.Thread(target=lambda: results.append(_outcome(call)))
        thread.start()
        thread.join()
        return results.pop()

    action = face.act(turn.rng)
    before = hash_of(face)
    calls = {"step": lambda: face.step(action)}
    for name in ("reset", "state", "state_hash", "save_state", "render", "close"):
        if has(env, name):
            calls[name] = getattr(env, name)
    env._busy["user"] = (threading.get_ident(),)  # as it is within a method
    try:
        for name, call in calls.items():
            _, error = inside(call)
            refused = isinstance(error, RuntimeError) and "another thread" in str(error)
            require(refused, f"{name} of {type(env).__name__} while another thread is in: {error}")
    finally:
        env._busy.clear()
    require(hash_of(face) == before, "a refused call changed the state")
    noted = face.note()
    value, error = inside(lambda: face.step(action))
    require(error is None, f"from another thread: {error!r}")
    face.check_step(value, noted)
    turn.sim.digest.add(value)
    return "ok"


@operation(0.3)
def fork(turn: Turn) -> str:
    """Fork: a child flies as the parent does, or gets a clear error, and the parent flies on."""
    if not ready(turn):
        return "no start"
    face = turn.face
    action = face.act(turn.rng)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            try:
                value, error = attempt(lambda: face.step(action))
                told = (None if error else digest_of(value), str(error))
            except BaseException as error:
                told = ("broken", tell(error))
            os.write(writer, pickle.dumps(told))
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        told = stream.read()
    os.waitpid(child, 0)
    require(told, "a child died")
    theirs, error = pickle.loads(told)
    mine = digest_of(fly(face, action))
    require(theirs in (mine, None), f"a child flies otherwise than its parent: {error}")
    turn.sim.digest.add(mine)
    return "ok" if theirs else "refused"


@operation(1.0)
def kill(turn: Turn) -> str:
    """Kill a worker: a clear error, and no process is left."""
    face = turn.face
    if not isinstance(face, Workers) or not ready(turn):
        return "skipped"
    processes = face.env._processes
    action = face.act(turn.rng)
    os.kill(pick(turn.rng, processes).pid, signal.SIGKILL)
    _, error = attempt(lambda: face.step(action), must=True)
    require(isinstance(error, RuntimeError), f"a worker died: {error!r}")
    for process in processes:
        process.join(10.0)
        require(not process.is_alive(), "a process is left")
    _, error = attempt(lambda: face.reset(seed=0), must=True)
    require("closed" in str(error), f"after a worker died: {error}")
    turn.drop()
    return "RuntimeError"


@contextmanager
def limited(most: int) -> Iterator[None]:
    """Let no file grow beyond some bytes, as if the disk were full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "the folder for temporary files")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@operation(0.5)
def record(turn: Turn) -> str:
    """Record, save, load; and save again on a full disk: an OSError, and all files are whole."""
    face, rng = turn.face, turn.rng
    if not isinstance(face, Core):
        return "skipped"
    policy, error = attempt(lambda: find_policy("random", face.form.task)(face.env))
    if error is not None:
        return type(error).__name__
    flown, error = attempt(lambda: fly_episode(face.env, policy, 3))
    if error is not None:
        return type(error).__name__
    face.started = True
    with tempfile.TemporaryDirectory(dir=turn.sim.folder) as place:
        folder, empty = Path(place, "full"), Path(place, "empty")
        folder.mkdir()
        empty.mkdir()
        paths = save(flown, face.env, "random", 3, folder)
        require([path.name for path in paths] == list(FILES), f"written: {paths}")
        again = load(folder)
        require(digest_of(flown.arrays()) == digest_of(again.arrays()), "it is read otherwise")
        sizes = [path.stat().st_size for path in paths]
        for where in (folder, empty):
            with limited(int(rng.integers(max(sizes)))):
                _, error = attempt(lambda to=where: save(flown, face.env, "random", 3, to))
            require(isinstance(error, OSError), f"a full disk: {error!r}")
            require(str(where) in str(error), f"the error names no file: {error}")
            for path in where.iterdir():
                require(path.name in FILES, f"{path.name} is left")
                whole = path.stat().st_size == sizes[FILES.index(path.name)]
                require(whole, f"{path.name} is half a file")
        turn.sim.digest.add(flown.arrays())
    return "ok"


@operation(0.1)
def evaluate(turn: Turn) -> str:
    """Evaluate for one episode, also on a full disk."""
    face = turn.face
    if isinstance(face, Space | Team):
        return "skipped"
    options = {**face.form.options, "horizon": 3}
    options.pop("seed", None)
    call = (face.form.task, "random", 1, int(turn.rng.integers(9)))
    result, error = attempt(lambda: bulletuav.evaluate(*call, **options))
    turn.sim.digest.add(
        str(error) if error else [list(map(str, row.items())) for row in result.rows]
    )
    if error is not None:
        return type(error).__name__
    with tempfile.TemporaryDirectory(dir=turn.sim.folder) as place:
        with limited(int(turn.rng.integers(300))):
            _, error = attempt(lambda: bulletuav.evaluate(*call, out=place, **options))
        if error is not None:
            require(isinstance(error, OSError | ValueError), f"a full disk: {error!r}")
        left = [path.name for path in Path(place).rglob(".part*")]
        require(not left, f"{left} is left")
        if isinstance(error, OSError):
            again, _ = attempt(lambda: bulletuav.evaluate(*call, out=place, **options), must=False)
            rows = [[str(row) for row in one.rows] for one in (again, result)]
            require(rows[0] == rows[1], "after a full disk an evaluation gives other numbers")
    return "ok"
