"""Compilation of the hot loops: `kernel`, `formula` and `elementwise` are numba's, with a cache that cannot go stale.

Numba stamps a cached function with its own source file only, so machine code that inlined a helper from another file
survives an edit of that helper. Here the cache lives in a folder named by a hash of every source file of the package:
any edit, upgrade or downgrade starts from an empty folder. Only the files right in `tasks/` do not count: a test holds that
no file with kernels imports one, and those in them bear numba's stamp.
"""

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_FOLDERS_KEPT = 8


def source_hash(package: Path = _PACKAGE, but: str | None = None) -> str:
    """Hash of the paths and contents of all Python files below `package`, but those right in the folder `but`."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(package.rglob("*.py")):
        if path.parent.relative_to(package).as_posix() == but:
            continue
        digest.update(
            path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0"
        )
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Folder for the compiled kernels of exactly these sources: below `NUMBA_CACHE_DIR`, else the user's cache folder.

    Where neither can be written to it is below the folder for temporary files, if nobody else can write there: what numba
    reads from its cache can run code.
    """
    chosen = (
        numba.config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    )
    spare = Path(tempfile.gettempdir(), f"bulletuav-{os.getuid() if hasattr(os, 'getuid') else ''}")
    candidates = [Path(chosen), spare]
    for base in candidates:
        folder = base / "bulletuav-kernels" / source_hash(but="tasks")
        with contextlib.suppress(OSError):
            if base == spare and not _is_private(spare):
                continue
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                _forget_old_folders(folder)
                return folder
    raise OSError(
        f"no writable folder for compiled kernels among {candidates}; set NUMBA_CACHE_DIR to one"
    )


def _is_private(folder: Path) -> bool:
    """Make a folder, and tell whether it is this user's alone."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.lstat()
    others_write = stat.S_IMODE(about.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
    return (
        stat.S_ISDIR(about.st_mode)
        and not others_write
        and (not hasattr(os, "getuid") or about.st_uid == os.getuid())
    )


def _forget_old_folders(current: Path) -> None:
    with contextlib.suppress(OSError):  # another process may be tidying too
        os.utime(current)
        others = [path for path in current.parent.iterdir() if path != current]
        for path in sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)[
            _FOLDERS_KEPT - 1 :
        ]:
            shutil.rmtree(path, ignore_errors=True)


_CACHE = cache_folder()


def kernel(function: Function) -> Function:
    """Compile `function`, a loop over arrays, with numba, cached on disk under the hash of the package's sources.

    Division by zero gives inf or NaN as in numpy; nothing is reordered (no fast-math), so results are reproducible.
    """
    return _compiled(function, forceinline=False)


def func(function: Function) -> Function:
    """Compile `function`, of one drone's numbers, like `kernel`; it becomes part of every kernel that calls it."""
    return _compiled(function, forceinline=True)


def elementwise(function: Function) -> Function:
    """Compile `function`, of numbers (in their order) to a number: kernels call it, and users with arrays that broadcast."""
    with _cached():
        return cast(Function, numba.vectorize(nopython=True, cache=True)(function))


def _compiled(function: Function, **options: bool) -> Function:
    with _cached():
        return cast(Function, numba.njit(cache=True, error_model="numpy", **options)(function))


@contextlib.contextmanager
def _cached() -> Iterator[None]:
    """What is compiled meanwhile keeps its machine code in the folder."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_CACHE)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before
