"""Stamps of source files, by which stored machine code cannot go stale.

Numba stamps what it stores with the function's own file alone. So it survives an edit of a helper
in another file. Here the stamp covers all files that the function's file imports.
"""

import functools
import hashlib
import os
import re
from pathlib import Path

import numba

PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(
    PACKAGE.name.encode() + rb"\.?([\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|[^\n]*))?"
)
"""What names a module of the package; that it may stand in a text does no harm"""


@functools.cache
def stamp_of(file: str) -> str:
    """Hash a file, all files that it imports of its package, and those that they import.

    Args:
        file: Path of the file.

    Returns:
        16 hexadecimal digits, with the version of numba in them.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    seen = {file}
    waiting = [file]
    while waiting:
        new = _imported(waiting.pop()) - seen
        seen |= new
        waiting.extend(new)
    for one in sorted(seen):
        digest.update(_hash(one))
    return digest.hexdigest()[:16]


@functools.cache
def _source(file: str) -> bytes:
    return Path(file).read_bytes()


@functools.cache
def _hash(file: str) -> bytes:
    return hashlib.sha256(_source(file)).digest()


@functools.cache
def _imported(file: str) -> frozenset[str]:
    """List the files of our package that a file imports, in whatever place of it."""
    modules = _modules()
    found: set[str] = set()
    for module, names in _IMPORT.findall(_source(file)):
        home = module.decode()
        members = [f"{home}.{name}".lstrip(".") for name in re.findall(r"\w+", names.decode())]
        found.update(modules[one] for one in (home, *members) if one in modules)
    return frozenset(found)


@functools.cache
def _modules() -> dict[str, str]:
    """List the files of our package by the names of their modules in it, but its first."""
    modules = {}
    for folder, _, files in os.walk(PACKAGE):
        home = Path(folder).relative_to(PACKAGE).parts
        for name in files:
            own = () if name == "__init__.py" else (name.removesuffix(".py"),)
            modules[".".join((*home, *own))] = os.path.join(folder, name)
    modules.pop("", None)
    return modules
