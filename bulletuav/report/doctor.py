"""Report on this installation: versions, what is active, what is missing and how to get it."""

import importlib.metadata
import importlib.util
import os
import platform
from typing import NamedTuple

from bulletuav.engine.engine import ENGINE_VERSION, EXTENSION, Engine
from bulletuav.engine.screen import require_screen
from bulletuav.errors import install
from bulletuav.kernel import cache_folder
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.version import __version__

PACKAGES = ("pybullet", "numpy", "numba", "scipy", "gymnasium", "pettingzoo", "matplotlib")
EXTRAS = {"shapely": "city", "imageio_ffmpeg": "video", "stable_baselines3": "sb3"}
"""Extras of the package by a module that each of them installs"""
SLOW = "not active, bullet flies several times slower"


class Finding(NamedTuple):
    """One line of the report.

    Attributes:
        subject: What was examined, such as "C extension".
        state: Its version, place or condition.
        remedy: How to get what is missing; empty where nothing is.
    """

    subject: str
    state: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Examine this installation.

    Returns:
        Everything that `bulletuav doctor` prints, in that order.
    """
    system = f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    packages = [Finding(name, importlib.metadata.version(name)) for name in PACKAGES]
    return [
        Finding("bulletuav", __version__),
        Finding("Python", system),
        *packages,
        Finding("engine", f"Bullet API {ENGINE_VERSION}"),
        _extension(),
        Finding("compiled kernels", str(cache_folder())),
        _screen(),
        *(_extra(module, extra) for module, extra in EXTRAS.items()),
    ]


def _extension() -> Finding:
    """Tell whether the engine really takes the C extension, not only whether it is there."""
    if EXTENSION.library is None:
        return Finding("C extension", SLOW, EXTENSION.missing)
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240)
    active = engine.port is not None
    engine.close()
    if not active:
        return Finding("C extension", SLOW, "the installed pybullet refuses it")
    return Finding("C extension", "active")


def _screen() -> Finding:
    """Tell whether a window that shows flights can be opened."""
    try:
        require_screen()
    except RuntimeError as error:
        return Finding("window", "not available", str(error))
    return Finding("window", "available")


def _extra(module: str, extra: str) -> Finding:
    """Tell whether an extra is installed, by a module of it, without importing that."""
    if importlib.util.find_spec(module) is None:
        return Finding(f"extra {extra}", "missing", install(extra))
    return Finding(f"extra {extra}", "installed")
