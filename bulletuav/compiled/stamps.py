"""Hashes of source files and their imports, which invalidate cached machine code.

Numba invalidates cached machine code only when the function's own file changes, not when a helper
in another file does. Here the hash covers all files that the function's file imports.
"""

import functools
import hashlib
import os
import re
from pathlib import Path

import llvmlite
import numba

PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(
    PACKAGE.name.encode() + rb"\.?([\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|[^\n]*))?"
)
"""Pattern of imports of the package; matches in strings or comments do no harm"""


@functools.cache
def stamp_of(file: str) -> str:
    """Hash a file and all files of the package that it imports, directly or indirectly.

    Args:
        file: Path of the file.

    Returns:
        16 hexadecimal digits of a hash that includes the versions of numba and llvmlite, and does
        not depend on where the package is.
    """
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    seen = {file}
    waiting = [file]
    while waiting:
        new = _imported(waiting.pop()) - seen
        seen |= new
        waiting.extend(new)
    for name, one in sorted((_name(one), one) for one in seen):
        digest.update(name.encode() + _hash(one))
    return digest.hexdigest()[:16]


@functools.cache
def _name(file: str) -> str:
    """Name a file, independent of the folder of the package."""
    path = Path(file)
    return path.relative_to(PACKAGE).as_posix() if PACKAGE in path.parents else path.name


@functools.cache
def _source(file: str) -> bytes:
    return Path(file).read_bytes()


@functools.cache
def _hash(file: str) -> bytes:
    return hashlib.sha256(_source(file)).digest()


@functools.cache
def _imported(file: str) -> frozenset[str]:
    """Return the files of the package that a file imports, at module level or elsewhere."""
    modules = _modules()
    found: set[str] = set()
    for module, names in _IMPORT.findall(_source(file)):
        home = module.decode()
        members = [f"{home}.{name}".lstrip(".") for name in re.findall(r"\w+", names.decode())]
        found.update(modules[one] for one in (home, *members) if one in modules)
    return frozenset(found)


@functools.cache
def _modules() -> dict[str, str]:
    """Return the files of the package by module name, except the package's own `__init__`."""
    modules = {}
    for folder, _, files in os.walk(PACKAGE):
        home = Path(folder).relative_to(PACKAGE).parts
        for name in files:
            own = () if name == "__init__.py" else (name.removesuffix(".py"),)
            modules[".".join((*home, *own))] = os.path.join(folder, name)
    modules.pop("", None)
    return modules
