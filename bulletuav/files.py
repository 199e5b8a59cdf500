"""Files that are written as a whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from bulletuav.errors import printable


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Give a place to write to; what is there in the end becomes the file.

    An error or an interrupt leaves the file as it was, and nothing beside it.

    Args:
        path: The file to write or to replace.

    Yields:
        A file beside it with the same ending, which tells libraries what format to write.

    Raises:
        OSError: It cannot be written, such as for a full disk; the message names the file.
    """
    # Within one folder a file replaces another one at a stroke. Others may write the same one now.
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
    """Write a text file as a whole or, when interrupted, not at all.

    Raises:
        OSError: It cannot be written; the message names the file.
    """
    with whole_file(path) as part:
        part.write_text(printable(text), encoding="utf-8")
