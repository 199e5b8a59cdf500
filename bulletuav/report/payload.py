"""Arrays and texts in one compact block of bytes, which the pages of replays read.

Series are rounded to one in 65,534 of their range, and kept as differences from row to row, which
compress well. `web/payload.js` is the reader.
"""

import base64
import json
import zlib
from typing import Any

import numpy as np

QUANTIZATION_STEPS = 65534
"""Steps between the least and the greatest value of a series"""
NO_VALUE = 65535
"""Code of what is no finite number"""
MAX_VALUE = 1e30
"""Numbers farther from 0 count as infinite, as single precision ends at 3e38"""
TYPES = {"f4": "<f4", "u4": "<u4", "u2": "<u2", "u1": "|u1"}
"""Types of numbers in the block, with NumPy's names of them"""


class Payload:
    """Collects arrays by name."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._arrays: dict[str, dict[str, Any]] = {}
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, name: str, values: np.ndarray, kind: str) -> None:
        """Add an array as it is.

        Args:
            name: Its name.
            values: Any shape.
            kind: Type of its numbers, one of `TYPES`.
        """
        told = np.ascontiguousarray(values, TYPES[kind])
        self._arrays[name] = {"at": self._size, "length": told.size, "kind": kind}
        # Typed arrays begin at multiples of their numbers' size.
        data = told.tobytes()
        data += bytes(-len(data) % 4)
        self._parts.append(data)
        self._size += len(data)

    def add_series(self, name: str, values: np.ndarray) -> None:
        """Add numbers over time, rounded.

        Args:
            name: Their name.
            values: (R, ...) one row for each time. Those that are not finite have no value.
        """
        rows = len(values)
        table = np.asarray(values, dtype=float).reshape(rows, -1).T
        known = np.isfinite(table) & (np.abs(table) < MAX_VALUE)
        low = np.where(known, table, np.inf).min(axis=1, initial=np.inf)
        high = np.where(known, table, -np.inf).max(axis=1, initial=-np.inf)
        some = low <= high
        low, high = np.where(some, low, 0.0), np.where(some, high, 0.0)
        step = (high - low) / QUANTIZATION_STEPS
        share = np.where(known, table - low[:, None], 0.0) / np.where(step > 0, step, 1.0)[:, None]
        codes = np.where(known, np.rint(share), NO_VALUE).astype("<u2")
        change = np.diff(codes, axis=1, prepend=np.zeros((len(codes), 1), "<u2"))
        self.add(f"{name} codes", change, "u2")
        self.add(f"{name} low", low, "f4")
        self.add(f"{name} step", step, "f4")

    def text(self, about: dict[str, Any]) -> str:
        """Write everything as text: base64 of what zlib compressed.

        Args:
            about: What else there is to tell, as JSON can hold it.
        """
        head = json.dumps({**about, "arrays": self._arrays}, allow_nan=False).encode()
        head += b" " * (-len(head) % 4)
        block = len(head).to_bytes(4, "little") + head + b"".join(self._parts)
        return base64.b64encode(zlib.compress(block, 9)).decode()
