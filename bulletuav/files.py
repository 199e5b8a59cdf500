"""Atomic writing of files: a file is replaced completely or stays unchanged."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from bulletuav.errors import printable_text


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to a file, and rename it to the file at the end.

    After an error or an interrupt the file is unchanged, and the temporary file is deleted.

    Args:
        path: The file to create or to replace.

    Yields:
        The temporary path, with the same extension as the file: libraries choose the format by it.

    Raises:
        OSError: If the file cannot be written, as on a full disk. The message contains the path.
    """
    # Renaming within one folder is atomic. The process id keeps concurrent writers apart.
    path = Path(path)
    part = path.with_name(f".part-{os.getpid()}-{path.name}")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise OSError(f"{path} cannot be written: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)


def replace_file(path: str | Path, text: str) -> None:
    """Write a text file atomically, in UTF-8.

    Raises:
        OSError: If the file cannot be written. The message contains the path.
    """
    with whole_file(path) as part:
        part.write_text(printable_text(text), encoding="utf-8")
