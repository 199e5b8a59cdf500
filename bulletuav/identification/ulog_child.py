"""Subprocess that reads a log of PX4 with pyulog, started by `ulog.read_ulog`.

A malformed log can cause pyulog to exhaust the memory, or never to finish. This file is executed by
its path, with limits.

The process writes one line of JSON to standard output: `error`, a text, or `topics`, with name,
columns and number of rows of each, and `notes`. Then follow the columns of all topics, float64.
"""

import gc
import io
import json
import os
import sys
from typing import BinaryIO

import numpy as np

from bulletuav.geometry.coacd_child import end_with_parent, limit_memory


class CutFile(io.FileIO):
    """A file that remembers whether its end cuts a header of 3 bytes or a message."""

    is_cut = False

    def read(self, size: int | None = -1, /) -> bytes:
        """Read as a file does."""
        data = super().read(-1 if size is None else size) or b""
        self.is_cut = len(data) < (size or 0) and (size != 3 or bool(data))
        return data


def write_topics(path: str, answer: BinaryIO) -> None:
    """Write the topics of the log at `path` to a stream."""
    from pyulog import ULog

    topics, notes, columns = [], [], []
    with CutFile(path) as file:
        log = ULog(file)
        if file.is_cut:
            notes.append("an incomplete message at its end")
    if log.file_corruption:
        notes.append("damaged messages")
    for one in log.data_list:
        topic = f"{one.name}_{one.multi_id}" if one.multi_id else one.name
        if "timestamp" not in one.data:
            raise ValueError(f"{topic} has no timestamp")
        names = [
            field.field_name
            for field in one.field_data
            if field.type_str != "char" and "_padding" not in field.field_name
        ]
        columns += [one.data[name] for name in names]
        topics.append((topic, names, len(one.data["timestamp"])))
    answer.write(json.dumps({"topics": topics, "notes": notes}).encode() + b"\n")
    for column in columns:
        answer.write(column.astype(np.float64).tobytes())


if __name__ == "__main__":
    end_with_parent()
    # Redirect pyulog's prints to standard error, as standard output carries the topics
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    limit_memory(int(sys.argv[2]))
    # A log has no reference cycles, and a malformed one many objects
    gc.disable()
    reason = ""
    try:
        write_topics(sys.argv[1], pipe)
    except (MemoryError, SystemError):  # the interpreter raises SystemError, too, out of memory
        reason = "its messages need too much memory"
    except Exception as error:  # pyulog raises many types for malformed logs
        reason = f"{type(error).__name__}: {error}"
    if reason:
        pipe.write(json.dumps({"error": reason[:500]}).encode() + b"\n")
    pipe.flush()
