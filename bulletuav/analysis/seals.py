"""Hashes of results, and seals of the files that tell of them."""

import ast
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.errors import shown

SEAL = "seal"
"""Entry of a sealed file that hashes all the others"""
CODE_NAME = re.compile(r"[A-Za-z_][\w.]*:\w")
"""Beginning of a name that leads to code or to a pickled model, such as `mine:Policy`"""
ARGUMENTS = {"task", "policy", "seed", "metrics", "num_worlds", "options"}
"""Names that calls in files have"""
RESERVED_ARGUMENTS = ARGUMENTS - {"num_worlds"} | {
    "episodes",
    "workers",
    "trust",
    "out",
    "progress",
    "piece",
    "ray",
}
"""Names of arguments, beside options, of the functions that repeat a call"""


def hash_bytes(parts: Iterable[bytes]) -> str:
    """Hash bytes, one part after the other: 32 hexadecimal digits of BLAKE2b."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def hash_arrays(arrays: Mapping[str, np.ndarray]) -> str:
    """Hash arrays with their names, types and shapes, in the order of their names."""
    parts = []
    for name, array in sorted(arrays.items()):
        parts += [repr((name, array.dtype.str, array.shape)).encode(), array.tobytes()]
    return hash_bytes(parts)


def hash_rows(rows: Iterable[Mapping[str, float]]) -> str:
    """Hash the numbers of rows with their names, to the last bit."""
    return hash_bytes(
        repr(sorted((name, float(value)) for name, value in row.items())).encode() for row in rows
    )


def hash_files(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Hash the bytes of those files of a folder that are there, by their names."""
    there = [name for name in names if (folder / name).exists()]
    return {name: hash_bytes([(folder / name).read_bytes()]) for name in there}


def add_seal(told: Mapping[str, Any]) -> dict[str, Any]:
    """Add a seal to what a JSON file is to tell."""
    return {**told, SEAL: compute_seal(told)}


def compute_seal(told: Mapping[str, Any]) -> str:
    """Hash all entries but the seal, as JSON writes them."""
    rest = {name: value for name, value in told.items() if name != SEAL}
    return hash_bytes([json.dumps(rest, sort_keys=True).encode()])


def format_call(call: Mapping[str, Any]) -> str | None:
    """Write the arguments of a call as a Python literal.

    Returns:
        The text, or None where some of them are objects, which no text tells.
    """
    text = repr(dict(call))
    try:
        return text if ast.literal_eval(text) == call else None
    except (ValueError, SyntaxError):
        return None


def parse_call(text: Any, trust: bool, path: str | Path = "the file") -> dict[str, Any]:
    """Read what `format_call` wrote.

    Args:
        text: The text, from a file.
        trust: Whether names in it may lead to code.
        path: The file, or its folder, for the message.

    Raises:
        ValueError: It is no such text, or names code that is not trusted.
    """
    if text is None:
        raise ValueError(
            f"{path} cannot be flown again: its task, policy or options were Python objects, "
            "which no file holds"
        )
    # Literals alone: reading the text runs nothing of it
    try:
        call = ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        call = None
    options = call.get("options") if isinstance(call, dict) else None
    if (
        not isinstance(options, dict)
        or not all(isinstance(name, str) for name in options)
        or set(options) & RESERVED_ARGUMENTS
        or not set(call) <= ARGUMENTS
        or "task" not in call
    ):
        raise ValueError(f"{path} has no call that could be flown again: {shown(text)}")
    # Names may lead to modules or pickled models, which run code when loaded
    for name in _iterate_strings(call):
        if not trust and CODE_NAME.match(name):
            raise ValueError(
                f"{path} names {shown(name)}, which is code or a model that can run code: "
                f"say --trust if you know its maker"
            )
    found: dict[str, Any] = call
    return found


def _iterate_strings(value: Any) -> Iterable[str]:
    """Yield all texts within a literal."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, one in value.items():
            yield from (*_iterate_strings(name), *_iterate_strings(one))
    elif isinstance(value, list | tuple | set):
        for one in value:
            yield from _iterate_strings(one)
