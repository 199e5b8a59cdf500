"""Import of modules on first use, by one thread at a time.

Numba has circular imports: if two threads import different modules of it for the first time,
Python gives one of them a module that is not complete.
"""

import importlib
import os
import threading
from typing import Any

_lock = threading.RLock()


def import_name(module: str, name: str) -> Any:
    """Import a module, and return a name of it; other threads wait."""
    with _lock:
        return getattr(importlib.import_module(module), name)


def _renew_lock() -> None:
    """Replace the lock in a forked process, which has no thread that would release it."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)
