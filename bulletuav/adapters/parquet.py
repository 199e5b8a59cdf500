"""Reading and writing of transitions as Parquet tables; needs the extra `dataset`."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.errors import missing_extra, reason_of
from bulletuav.files import whole_file
from bulletuav.parsing import parse_json

try:
    import pyarrow as pa
    from pyarrow import parquet
except ImportError:
    raise missing_extra("writing a dataset", "dataset") from None

ABOUT = b"bulletuav"
"""Key of the metadata of this package in a file"""


def write_table(columns: Mapping[str, Any], about: Any, path: Path) -> None:
    """Write columns as one compressed Parquet file.

    Args:
        columns: Arrays (K,) or (K, numbers); or a tuple (indices, rows, K) for a column that is
            null at all other indices.
        about: Metadata of the file, a JSON value.
        path: The file.

    Raises:
        OSError: If the file cannot be written.
    """
    table = pa.table({name: _column(values) for name, values in columns.items()})
    metadata = {ABOUT: json.dumps(about).encode()}
    with whole_file(path) as part:
        parquet.write_table(table.replace_schema_metadata(metadata), part, compression="zstd")


def read_about(path: Path) -> Any:
    """Read the metadata of a file.

    Raises:
        ValueError: If the file is damaged.
    """
    try:
        return parse_json(parquet.read_schema(path).metadata[ABOUT], f"{path}, its schema,")
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is damaged ({reason_of(error)}): delete it, and collect again"
        ) from None


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Read all columns as arrays; null rows of a column of lists are dropped.

    Raises:
        ValueError: If the file is damaged.
    """
    try:
        table = parquet.read_table(path)
        table.validate(full=True)
        return {name: _array(table[name].combine_chunks()) for name in table.column_names}
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is damaged ({reason_of(error)}): delete it, and collect again"
        ) from None


def _column(values: Any) -> pa.Array:
    """Convert an array, or sparse rows (indices, rows, count), to a column."""
    if isinstance(values, tuple):
        at, rows, count = values
        place = np.full(count, -1)
        place[at] = np.arange(len(at))
        return _column(rows).take(pa.array(place, mask=place < 0))
    if values.ndim == 2:
        flat = pa.array(np.ascontiguousarray(values).reshape(-1))
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return pa.array(values)


def _array(column: Any) -> np.ndarray:
    if pa.types.is_fixed_size_list(column.type):
        flat: np.ndarray = column.drop_null().flatten().to_numpy(zero_copy_only=False)
        return flat.reshape(-1, column.type.list_size)
    array: np.ndarray = column.to_numpy(zero_copy_only=False)
    return array
