"""The folder in which compiled kernels are kept for later runs."""

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from pathlib import Path

from numba import config

_FOLDERS_KEPT = 8


def cache_folder() -> Path:
    """Create the cache folder for the compiled kernels of this installation of the package.

    The folder is in `NUMBA_CACHE_DIR`, or else in the user's cache folder. If that is not writable,
    it is in the folder for temporary files, in a subfolder that only this user can write to: numba
    executes code that it reads from its cache.

    Raises:
        OSError: If no folder is writable.
    """
    chosen = config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    user = os.getuid() if hasattr(os, "getuid") else ""
    spare = Path(tempfile.gettempdir(), f"bulletuav-{user}")
    candidates = [Path(chosen), spare]
    installation = hashlib.sha256(os.fsencode(Path(__file__).parents[1])).hexdigest()[:16]
    for base in candidates:
        folder = base / "bulletuav-kernels" / installation
        with contextlib.suppress(OSError):
            # Other users may write to the folder for temporary files, but not to our subfolder.
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
    """Create a folder, and check whether only this user can write to it."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.lstat()
    others_write = stat.S_IMODE(about.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
    is_ours = not hasattr(os, "getuid") or about.st_uid == os.getuid()
    return stat.S_ISDIR(about.st_mode) and not others_write and is_ours


def _forget_old_folders(current: Path) -> None:
    """Remove the folders of other installations, except the most recently used ones."""
    # Another process may remove the same folders at the same time.
    with contextlib.suppress(OSError):
        os.utime(current)
        others = [path for path in current.parent.iterdir() if path != current]
        newest_first = sorted(others, key=lambda path: path.stat().st_mtime, reverse=True)
        for path in newest_first[_FOLDERS_KEPT - 1 :]:
            shutil.rmtree(path, ignore_errors=True)
