"""Hashes of results, and seals of the JSON files that describe them."""

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
"""Entry of a sealed file that holds the hash of all other entries"""
CODE_NAME = re.compile(r"[A-Za-z_][\w.]*:\w")
"""Beginning of a name that refers to code or to a pickled model, such as `mine:Policy`"""
ARGUMENTS = {"task", "policy", "seed", "metrics", "num_worlds", "options"}
"""Arguments of calls in files"""
RESERVED_ARGUMENTS = ARGUMENTS - {"num_worlds"} | {
    "episodes",
    "workers",
    "trust",
    "out",
    "progress",
    "piece",
    "ray",
}
"""Arguments of the functions that repeat a call, besides options"""


def hash_bytes(parts: Iterable[bytes]) -> str:
    """Hash bytes in sequence with BLAKE2b, to 32 hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def hash_arrays(arrays: Mapping[str, np.ndarray]) -> str:
    """Hash arrays with their names, types and shapes, sorted by name."""
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
    """Hash the bytes of a folder's files that exist, by their names."""
    there = [name for name in names if (folder / name).exists()]
    return {name: hash_bytes([(folder / name).read_bytes()]) for name in there}


def add_seal(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the contents of a JSON file with a seal."""
    return {**content, SEAL: compute_seal(content)}


def compute_seal(content: Mapping[str, Any]) -> str:
    """Hash all entries but the seal, as JSON."""
    rest = {name: value for name, value in content.items() if name != SEAL}
    return hash_bytes([json.dumps(rest, sort_keys=True).encode()])


def format_call(call: Mapping[str, Any]) -> str | None:
    """Format the arguments of a call as a Python literal.

    Returns:
        The text, or None if some arguments are objects that no literal can represent.
    """
    text = repr(dict(call))
    try:
        return text if ast.literal_eval(text) == call else None
    except (ValueError, SyntaxError):
        return None


def parse_call(text: Any, trust: bool, path: str | Path = "the file") -> dict[str, Any]:
    """Parse the text of `format_call`.

    Args:
        text: The text, from a file.
        trust: Whether names in it may refer to code.
        path: The file or its folder, for messages.

    Returns:
        The arguments.

    Raises:
        ValueError: If the text is not such a literal, or refers to code that is not trusted.
    """
    if text is None:
        raise ValueError(
            f"{path} cannot be flown again: its task, policy or options were Python objects, "
            "which cannot be stored in a file, or it had too many changes by set_condition"
        )
    # Only literals are evaluated, so that no code of the file runs
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
        raise ValueError(f"{path} has no valid call to fly again: {shown(text)}")
    require_trusted(call, trust, path)
    found: dict[str, Any] = call
    return found


def require_trusted(value: Any, trust: bool, path: str | Path) -> None:
    """Raise ValueError if a value of a file names code, and the file is not trusted."""
    # Names may refer to modules or pickled models, which run code when loaded
    for name in _iterate_strings(value):
        if not trust and CODE_NAME.match(name):
            raise ValueError(
                f"{path} names {shown(name)}, which is code or a model that can run code: "
                f"pass --trust if you trust its author"
            )


def _iterate_strings(value: Any) -> Iterable[str]:
    """Yield all strings within a literal."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, one in value.items():
            yield from (*_iterate_strings(name), *_iterate_strings(one))
    elif isinstance(value, list | tuple | set):
        for one in value:
            yield from _iterate_strings(one)
