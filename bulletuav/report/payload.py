"""Payload of the pages of replays: arrays and metadata in one compact block of bytes.

Series are quantized to 16 bits over their range and stored as differences between rows, which
compress well. `web/payload.js` is the reader.
"""

import base64
import json
import zlib
from typing import Any

import numpy as np

QUANTIZATION_STEPS = 65534
"""Number of steps between the minimum and the maximum of a series"""
NO_VALUE = 65535
"""Code of a value that is not finite"""
MAX_VALUE = 1e30
"""Magnitude above which numbers count as infinite; single precision ends at 3e38"""
TYPES = {"f4": "<f4", "u4": "<u4", "u2": "<u2", "u1": "|u1"}
"""Types of numbers in the block, with NumPy's names"""


class Payload:
    """Collects named arrays."""

    def __init__(self) -> None:
        """Create an empty payload."""
        self._arrays: dict[str, dict[str, Any]] = {}
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, name: str, values: np.ndarray, kind: str) -> None:
        """Add an array without quantization.

        Args:
            name: Name of the array.
            values: Numbers of any shape.
            kind: Type of the numbers in the block, one of `TYPES`.
        """
        array = np.ascontiguousarray(values, TYPES[kind])
        self._arrays[name] = {"at": self._size, "length": array.size, "kind": kind}
        # JavaScript's typed arrays must start at multiples of their item size.
        data = array.tobytes()
        data += bytes(-len(data) % 4)
        self._parts.append(data)
        self._size += len(data)

    def add_series(self, name: str, values: np.ndarray) -> None:
        """Add a time series, quantized.

        Args:
            name: Name of the series.
            values: One row for each time, (R, ...). Numbers that are not finite count as missing.
        """
        rows = len(values)
        table = np.asarray(values, dtype=float).reshape(rows, -1).T
        known = np.isfinite(table) & (np.abs(table) < MAX_VALUE)
        low = np.where(known, table, np.inf).min(axis=1, initial=np.inf)
        high = np.where(known, table, -np.inf).max(axis=1, initial=-np.inf)
        has_values = low <= high
        low, high = np.where(has_values, low, 0.0), np.where(has_values, high, 0.0)
        step = (high - low) / QUANTIZATION_STEPS
        steps = np.where(known, table - low[:, None], 0.0) / np.where(step > 0, step, 1.0)[:, None]
        codes = np.where(known, np.rint(steps), NO_VALUE).astype("<u2")
        change = np.diff(codes, axis=1, prepend=np.zeros((len(codes), 1), "<u2"))
        self.add(f"{name} codes", change, "u2")
        self.add(f"{name} low", low, "f4")
        self.add(f"{name} step", step, "f4")

    def text(self, about: dict[str, Any]) -> str:
        """Return the payload as text: base64 of a zlib-compressed block.

        Args:
            about: Metadata, which must be valid JSON.
        """
        head = json.dumps({**about, "arrays": self._arrays}, allow_nan=False).encode()
        head += b" " * (-len(head) % 4)
        block = len(head).to_bytes(4, "little") + head + b"".join(self._parts)
        return base64.b64encode(zlib.compress(block, 9)).decode()
