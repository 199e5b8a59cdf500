"""What this installation has: versions, what is active, what is missing and how to get it."""

import importlib.metadata
import importlib.util
import os
import platform
from typing import NamedTuple

from bulletuav.engine.engine import ENGINE_VERSION, EXTENSION, Engine
from bulletuav.engine.screen import require_screen
from bulletuav.errors import install
from bulletuav.kernel import cache_folder
from bulletuav.vehicle.airframe import load_airframe
from bulletuav.version import __version__

PACKAGES = (
    "pybullet",
    "numpy",
    "numba",
    "scipy",
    "gymnasium",
    "pettingzoo",
    "matplotlib",
)
"""Packages that are always there, whose versions are told"""
EXTRAS = {
    "shapely": "city",
    "imageio_ffmpeg": "video",
    "stable_baselines3": "sb3",
}
"""Modules that come with extras, and the names of the extras"""
SLOW = "not active, bullet flies several times slower"


class Finding(NamedTuple):
    """One line of the report.

    Attributes:
        subject: What was looked at.
        state: How it is.
        remedy: How to get it; empty where nothing is missing.
    """

    subject: str
    state: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Examine everything that `bulletuav doctor` prints."""
    python = f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    return [
        Finding("bulletuav", __version__),
        Finding("Python", python),
        *(Finding(name, importlib.metadata.version(name)) for name in PACKAGES),
        Finding("engine", f"Bullet API {ENGINE_VERSION}"),
        _extension(),
        Finding("compiled kernels", str(cache_folder())),
        _screen(),
        *(_extra(module, extra) for module, extra in EXTRAS.items()),
    ]


def _extra(module: str, extra: str) -> Finding:
    """Tell whether an extra is installed."""
    if importlib.util.find_spec(module) is not None:
        return Finding(f"extra {extra}", "installed")
    return Finding(f"extra {extra}", "missing", install(extra))


def _extension() -> Finding:
    """Tell whether the engine really takes the extension, not only whether it is there."""
    if EXTENSION.library is None:
        return Finding("C extension", SLOW, EXTENSION.missing)
    # One that was built for another engine is there, but refused.
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240)
    active = engine.port is not None
    engine.close()
    if not active:
        return Finding("C extension", SLOW, "the installed pybullet refuses it")
    return Finding("C extension", "active")


def _screen() -> Finding:
    """Tell whether there is a screen for the live view."""
    try:
        require_screen()
    except RuntimeError as error:
        return Finding("live view", "not available", str(error))
    return Finding("live view", "available")
