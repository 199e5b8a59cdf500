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

PACKAGES = ("pybullet", "numpy", "numba", "scipy", "gymnasium", "pettingzoo", "matplotlib")
EXTRAS = {"shapely": "city", "imageio_ffmpeg": "video", "stable_baselines3": "sb3"}


class Finding(NamedTuple):
    """One line of the report: `remedy` is empty where nothing is missing."""

    subject: str
    state: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Everything that `bulletuav doctor` prints."""
    findings = [
        Finding("bulletuav", __version__),
        Finding(
            "Python",
            f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores",
        ),
        *(Finding(name, importlib.metadata.version(name)) for name in PACKAGES),
        Finding("engine", f"Bullet API {ENGINE_VERSION}"),
        _extension(),
        Finding("compiled kernels", str(cache_folder())),
        _screen(),
    ]
    for module, extra in EXTRAS.items():
        found = importlib.util.find_spec(module) is not None
        findings.append(
            Finding(f"extra {extra}", "installed")
            if found
            else Finding(f"extra {extra}", "missing", install(extra))
        )
    return findings


def _extension() -> Finding:
    """Whether the engine really takes the extension, not only whether it is there."""
    if EXTENSION.library is None:
        return Finding(
            "C extension", "not active, bullet flies several times slower", EXTENSION.missing
        )
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240)
    active = engine.port is not None
    engine.close()
    if not active:
        return Finding(
            "C extension",
            "not active, bullet flies several times slower",
            "the installed pybullet refuses it",
        )
    return Finding("C extension", "active")


def _screen() -> Finding:
    try:
        require_screen()
    except RuntimeError as error:
        return Finding("live view", "not available", str(error))
    return Finding("live view", "available")
