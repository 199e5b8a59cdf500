"""Reading of ROS bags: numbers of the messages of some topics, as columns.

It needs the extra `mcap`, but no ROS installation.
"""

import dataclasses
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.errors import missing_extra, reason_of

try:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise missing_extra("reading ROS bags", "mcap") from None

MAX_ARRAY, MAX_NESTING, MAX_MESSAGES = 16, 8, 5_000_000
"""Maximum length of arrays, depth of nested messages, and number of messages"""
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
"""Fields of the time stamp of a message"""


class TopicTable(NamedTuple):
    """Numbers of the messages of one topic.

    Attributes:
        topic: Name of the topic.
        kind: Message type, such as nav_msgs/msg/Odometry.
        received: Times (n,) at which the messages were recorded, s.
        stamps: Times (n,) in the headers of the messages, s; None without them.
        columns: Numbers (n,) by TOPIC.FIELD; NaN where a message lacks one.
    """

    topic: str
    kind: str
    received: np.ndarray
    stamps: np.ndarray | None
    columns: dict[str, np.ndarray]


def read_topics(
    path: Path, kinds: Collection[str], topics: Collection[str]
) -> tuple[list[TopicTable], list[str]]:
    """Read topics of a bag of ROS 1 (.bag) or ROS 2 (a folder, .mcap or .db3).

    Args:
        path: The file or folder.
        kinds: Message types whose topics are read.
        topics: Names of further topics to read.

    Returns:
        The topics, by name, and the names of topics and fields that were not read.

    Raises:
        ValueError: If the bag is damaged, or has message types without definitions.
    """
    try:
        return _read(path, kinds, topics)
    # rosbags raises many types of errors for damaged files
    except Exception as error:
        raise ValueError(
            f"{path} cannot be read as a ROS bag ({reason_of(error)}): check it with 'ros2 bag "
            f"info' or 'rosbag check', or record it again"
        ) from None


def _read(
    path: Path, kinds: Collection[str], topics: Collection[str]
) -> tuple[list[TopicTable], list[str]]:
    rows: dict[str, list[dict[str, float]]] = {}
    times: dict[str, list[int]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [one for one in reader.connections if one.msgtype in kinds or one.topic in topics]
        kind_of = {one.topic: one.msgtype for one in wanted}
        rest = sorted({one.topic for one in reader.connections} - kind_of.keys())
        if wanted and sum(one.msgcount for one in wanted) > MAX_MESSAGES:
            raise ValueError(f"more than {MAX_MESSAGES} messages")
        skipped: set[str] = set()
        for connection, nanoseconds, data in reader.messages(wanted) if wanted else ():
            message, topic = reader.deserialize(data, connection.msgtype), connection.topic
            row: dict[str, float] = {}
            for name, value in _flatten(message):
                if value is None:
                    skipped.add(f"{topic}.{name}")
                else:
                    row[name] = value
            rows.setdefault(topic, []).append(row)
            times.setdefault(topic, []).append(nanoseconds)
    tables = [_make_table(topic, kind_of[topic], times[topic], rows[topic]) for topic in rows]
    tables.sort(key=lambda table: table.topic)
    return tables, [*rest, *sorted(skipped)]


def _make_table(
    topic: str, kind: str, times: list[int], rows: list[dict[str, float]]
) -> TopicTable:
    """Return the columns of a topic."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    values = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    stamps = None
    if all(name in values for name in STAMP):
        seconds, nanoseconds = (values.pop(name) for name in STAMP)
        stamps = seconds + 1e-9 * nanoseconds if seconds.any() else None
    columns = {f"{topic}.{name}": column for name, column in values.items()}
    return TopicTable(topic, kind, 1e-9 * np.array(times, float), stamps, columns)


def _flatten(message: Any) -> Iterator[tuple[str, float | None]]:
    """Yield the names and values of all numbers of a message, None for long arrays."""
    waiting = [("", message, 0)]
    while waiting:
        prefix, value, depth = waiting.pop()
        if dataclasses.is_dataclass(value) and depth < MAX_NESTING:
            waiting += [
                (
                    f"{prefix}.{field.name}" if prefix else field.name,
                    getattr(value, field.name),
                    depth + 1,
                )
                for field in reversed(dataclasses.fields(value))
                if not field.name.startswith("__")
            ]
        elif isinstance(value, np.ndarray | list | tuple):
            if len(value) > MAX_ARRAY:
                yield prefix, None
            else:
                waiting += [(f"{prefix}[{k}]", one, depth + 1) for k, one in enumerate(value)]
        elif isinstance(value, int | float | np.number | np.bool_):
            yield prefix, float(value)
