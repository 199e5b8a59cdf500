"""Diagnosis of the installation: versions, active features, missing ones and their remedies."""

import importlib.metadata
import os
import platform
import re
from typing import NamedTuple

from numba import config

from bulletuav.compiled.folders import cache_folder
from bulletuav.compiled.shipped import CODE, native_mark
from bulletuav.dynamics import DEFAULT_DYNAMICS
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.engine.engine import EXTENSION, Engine
from bulletuav.engine.screen import require_screen
from bulletuav.errors import install
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.version import __version__

PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "pettingzoo", "matplotlib")
REQUIREMENT = re.compile(r"([\w.-]+)(?:\[([\w.-]+)\])?.*extra == ['\"]([\w.-]+)['\"]")
"""A requirement of the metadata: package, its extra, and our extra that needs it"""
WITHOUT_BULLET = (
    "not installed: dynamics, rays, contacts and camera 'bullet', and rendered pictures of whole "
    f"worlds are not available; the default is {DEFAULT_DYNAMICS}"
)
EXTRA = "extra "
"""Prefix of the subjects of extras"""
SLOW_ENGINE = "not active, bullet flies several times slower"


class Finding(NamedTuple):
    """One line of the diagnosis.

    Attributes:
        subject: Examined component, such as "C extension".
        state: Its version, path or state.
        remedy: How to install a missing component; empty if nothing is missing.
    """

    subject: str
    state: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Examine this installation.

    Returns:
        All findings of `bulletuav doctor`, in printing order.
    """
    system = f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    packages = [Finding(name, importlib.metadata.version(name)) for name in PACKAGES]
    return [
        Finding("bulletuav", __version__),
        Finding("Python", system),
        _bullet(),
        *packages,
        _extension(),
        Finding("machine code", describe_code()),
        Finding("compiled kernels", str(cache_folder())),
        _screen(),
        *_extras(),
    ]


def _bullet() -> Finding:
    """Examine PyBullet, which is optional."""
    if HAS_BULLET:
        return Finding("pybullet", importlib.metadata.version("pybullet"))
    return Finding("pybullet", WITHOUT_BULLET, install("bullet"))


def describe_code() -> str:
    """Describe which machine code flies, and for which processor numba compiles other code."""
    if CODE is not None:
        return f"that of the package, for {CODE.name}; numba compiles all other code for it, too"
    if config.CPU_NAME is not None:
        return f"compiled when needed, for NUMBA_CPU_NAME={config.CPU_NAME}"
    if native_mark().is_file():
        return "compiled for this processor, by bulletuav compile --native"
    return "compiled for this processor when needed, or all of it by bulletuav compile"


def _extension() -> Finding:
    """Check whether the engine uses the C extension, not only whether it exists."""
    if EXTENSION.library is None:
        return Finding("C extension", SLOW_ENGINE, EXTENSION.missing)
    if not HAS_BULLET:
        return Finding("C extension", "installed, not used without pybullet")
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240)
    active = bool(engine.ports)
    engine.close()
    if not active:
        return Finding(
            "C extension", SLOW_ENGINE, "the installed pybullet is not compatible with it"
        )
    return Finding("C extension", "active")


def _screen() -> Finding:
    """Check whether a window can be opened."""
    try:
        require_screen()
    except RuntimeError as error:
        return Finding("window", "not available", str(error))
    return Finding("window", "available")


def _extras() -> list[Finding]:
    """List the extras declared by the installed metadata, with the packages of each."""
    try:
        about = importlib.metadata.metadata("bulletuav")
    except importlib.metadata.PackageNotFoundError:
        return [Finding("extras", "unknown: bulletuav runs from a folder, not installed")]
    needed: dict[str, list[str]] = {extra: [] for extra in about.get_all("Provides-Extra") or ()}
    joined: dict[str, list[str]] = {extra: [] for extra in needed}
    for line in about.get_all("Requires-Dist") or ():
        if found := REQUIREMENT.match(line):
            package, part, extra = found.groups()
            if package == "bulletuav":
                joined[extra].append(part)
            else:
                needed[extra].append(package)
    return [_extra(extra, needed, joined) for extra in sorted(needed)]


def _extra(extra: str, needed: dict[str, list[str]], joined: dict[str, list[str]]) -> Finding:
    """Examine the packages of an extra, including those of extras that it includes.

    Args:
        extra: Name of the extra.
        needed: Packages of each extra.
        joined: Extras that each extra includes.
    """
    subject = EXTRA + extra
    versions = {package: _version(package) for package in needed[extra]}
    absent = [package for package, version in versions.items() if version is None]
    lacking = [part for part in joined[extra] if _extra(part, needed, joined).remedy]
    if absent or lacking:
        return Finding(subject, f"missing: {', '.join([*absent, *lacking])}", install(extra))
    parts = [f"{package} {version}" for package, version in versions.items()]
    return Finding(subject, ", ".join([*joined[extra], *parts]))


def _version(package: str) -> str | None:
    """Return the installed version of a package, or None if it is missing."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
