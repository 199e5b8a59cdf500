"""Flight logs of PX4 (ULog).

Source: https://docs.px4.io/main/en/dev_log/ulog_file_format.html. Positions and velocities of PX4
are in NED, rates and specific forces in FRD body axes.
"""

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bulletuav.identification.logs import (
    FORCE,
    POSITION,
    RATES,
    VELOCITY,
    ColumnSource,
    Log,
)
from bulletuav.identification.series import (
    Converted,
    Series,
    convert_attitude,
    convert_columns,
    convert_motors,
    merge_series,
    order_rotors,
)
from bulletuav.vehicle.airframe import Airframe

MAGIC = b"ULog\x01\x12\x35"
HEADER_SIZE = 16
MAX_FIELDS, MAX_NESTING, MAX_MESSAGE_SIZE = 4096, 8, 65535
"""Maximum number of fields of a format, of nested formats, and size of a message, bytes"""
MAX_EXPANDED = 4 * MAX_MESSAGE_SIZE
"""Maximum number of fields of all formats of a file, with those of nested formats"""
APPENDED = 1
"""Incompatible flag of logs with appended data, the only one of the format"""
TYPES = {
    "int8_t": "<i1",
    "uint8_t": "<u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
    "bool": "?",
    "char": "S1",
}
"""NumPy types by those of the format"""
CORNERS = ((1, -1), (-1, 1), (1, 1), (-1, -1))
"""Signs of x (forward) and y (left) of PX4's motors 1 to 4 in a quadrotor x"""
ADVICE = (
    "log vehicle_local_position, vehicle_attitude and actuator_outputs (PX4: SDLOG_PROFILE with "
    "high rate), or map columns by --map NAME=TOPIC.FIELD"
)


class UlogField(NamedTuple):
    """A number in a message: its name, NumPy type and offset in bytes."""

    name: str
    kind: str
    offset: int


def read_ulog(path: Path, sources: Mapping[str, ColumnSource], airframe: Airframe) -> Log:
    """Read a log of PX4.

    Positions are relative to the start of PX4's estimator: z is above the start. Motors are those
    of `actuator_outputs`, or of `actuator_motors`, if the airframe has a PWM map; otherwise the
    measured speeds of `esc_status`. Motors of a quadrotor are in the order of PX4's quadrotor x.

    Args:
        path: The file.
        sources: Sources of --map, by names TOPIC.FIELD; instance k of a topic is TOPIC_k.
        airframe: Airframe of the log.

    Returns:
        The log.

    Raises:
        ValueError: If the file is damaged, or topics are missing.
    """
    try:
        reader = _Reader(path.read_bytes())
        all_series = [_convert(series, airframe) for series in reader.series()]
    except (struct.error, UnicodeDecodeError, IndexError, KeyError) as error:
        raise ValueError(f"{path} is a damaged ULog file ({error}): copy it again") from None
    except ValueError as error:
        raise ValueError(f"{path} is a damaged ULog file: {error}; copy it again") from None
    rank = {topic: k for k, topic in enumerate(PRIORITY)}
    all_series.sort(key=lambda series: rank.get(series.topic, len(rank)))
    return merge_series(path, all_series, sources, airframe, ADVICE, reader.notes)


class _Reader:
    """Messages of a ULog file.

    Attributes:
        notes: What could not be read.
    """

    def __init__(self, data: bytes) -> None:
        self._data, self.notes = data, list[str]()
        self._formats: dict[str, list[tuple[str, int, str]]] = {}
        self._topics: dict[int, str] = {}
        self._kinds: dict[int, str] = {}
        self._layouts: dict[str, tuple[list[UlogField], int]] = {}
        self._num_expanded = 0
        self._places: dict[int, list[tuple[int, int]]] = {}
        if len(data) < HEADER_SIZE or not data.startswith(MAGIC):
            raise ValueError("its header is incomplete")
        self._ignored = dict[str, int]()
        start, ends = HEADER_SIZE, [len(data)]
        # Flags are the first message; offsets of appended data cut a message of a crashed logger
        if data[start + 2 : start + 3] == b"B":
            size = struct.unpack_from("<H", data, start)[0]
            flags = struct.unpack_from("<8s8s3Q", data, start + 3)
            if any(flags[1][1:]) or flags[1][0] & ~APPENDED:
                raise ValueError(f"incompatible flags {flags[1].hex()}, of a later version")
            start += 3 + size
            offsets = [offset for offset in flags[2:] if flags[1][0] & APPENDED and offset]
            if offsets != sorted(offsets) or not all(start <= one <= len(data) for one in offsets):
                raise ValueError(f"appended data at {offsets}, outside of the file")
            ends = [*offsets, len(data)]
        for end in ends:
            self._scan(start, end)
            start = end

    def _scan(self, start: int, end: int) -> None:
        """Read the messages of a part of the file."""
        data = self._data
        while start + 3 <= end:
            size, kind = data[start] | data[start + 1] << 8, data[start + 2 : start + 3]
            stop = start + 3 + size
            if stop > end:
                break
            if kind == b"D":
                number = data[start + 3] | data[start + 4] << 8
                self._places[number].append((start + 5, stop))
            elif kind == b"F":
                self._add_format(data[start + 3 : stop].decode())
            elif kind == b"A":
                instance, number = struct.unpack_from("<BH", data, start + 3)
                self._add_topic(instance, number, data[start + 6 : stop])
            start = stop
        if start < end:
            self.notes.append(f"the last {end - start} bytes, an incomplete message")

    def _add_format(self, text: str) -> None:
        """Parse a format: NAME:TYPE FIELD;TYPE[COUNT] FIELD; and so on."""
        name, _, rest = text.partition(":")
        fields = []
        for part in rest.split(";"):
            if not part:
                continue
            kind, _, field = part.partition(" ")
            kind, bracket, count = kind.partition("[")
            number = int(count.removesuffix("]")) if bracket else 0
            if not field or not 0 <= number <= MAX_MESSAGE_SIZE:
                raise ValueError(f"the format of {name} has the field {part!r}")
            fields.append((kind, number, field))
        if not 0 < len(fields) <= MAX_FIELDS:
            raise ValueError(f"the format of {name} has {len(fields)} fields")
        self._formats[name] = fields

    def _add_topic(self, instance: int, number: int, name: bytes) -> None:
        kind = name.decode()
        if number in self._topics:
            raise ValueError(f"message {number} is subscribed twice")
        self._topics[number] = f"{kind}_{instance}" if instance else kind
        self._kinds[number], self._places[number] = kind, []

    def _layout(self, kind: str) -> tuple[list[UlogField], int]:
        """Return the numbers of a format, and the size of a message, bytes."""
        if kind in self._layouts:
            return self._layouts[kind]
        fields, size = list[UlogField](), 0
        waiting = [(0, kind, "")]
        # Nested formats are expanded in order, with a stack instead of recursion
        while waiting:
            depth, one, prefix = waiting.pop()
            self._num_expanded += 1
            is_large = size > MAX_MESSAGE_SIZE or self._num_expanded > MAX_EXPANDED
            if depth > MAX_NESTING or is_large:
                raise ValueError(f"the format of {kind} is too large")
            if one in TYPES:
                dtype = np.dtype(TYPES[one])
                fields.append(UlogField(prefix, TYPES[one], size))
                size += dtype.itemsize
                continue
            if one not in self._formats:
                raise ValueError(f"{kind} has the unknown type {one!r}")
            inner = []
            for type_name, count, field in self._formats[one]:
                name = f"{prefix}.{field}" if prefix else field
                # Texts and padding are not numbers
                if type_name in TYPES and (type_name == "char" or field.startswith("_padding")):
                    inner += [(depth + 1, type_name, "")] * max(count, 1)
                elif not count:
                    inner.append((depth + 1, type_name, name))
                elif count <= MAX_FIELDS:
                    inner += [(depth + 1, type_name, f"{name}[{k}]") for k in range(count)]
                else:
                    raise ValueError(f"{kind}.{name} has {count} entries")
                if len(inner) + len(waiting) > MAX_MESSAGE_SIZE:
                    raise ValueError(f"the format of {kind} is too large")
            waiting += inner[::-1]
        # Trailing padding is not logged
        while fields and not fields[-1].name:
            size = fields.pop().offset
        self._layouts[kind] = [field for field in fields if field.name], size
        return self._layouts[kind]

    def series(self) -> Iterator[Series]:
        """Yield the columns of each topic that has messages."""
        for number, topic in self._topics.items():
            places = self._places[number]
            if not places:
                continue
            fields, size = self._layout(self._kinds[number])
            if not fields or any(stop - start < size for start, stop in places):
                raise ValueError(f"messages of {topic} do not fit to its format")
            dtype = np.dtype(
                {
                    "names": [field.name for field in fields],
                    "formats": [field.kind for field in fields],
                    "offsets": [field.offset for field in fields],
                    "itemsize": size,
                }
            )
            joined = b"".join(self._data[start : start + size] for start, _ in places)
            rows = np.frombuffer(joined, dtype)
            names = [field.name for field in fields]
            if "timestamp" not in names:
                raise ValueError(f"{topic} has no timestamp")
            columns = {
                f"{topic}.{name}": rows[name].astype(np.float64)
                for name in names
                if not name.endswith("timestamp")
            }
            yield Series(topic, 1e-6 * rows["timestamp"].astype(np.float64), columns, {})


PRIORITY = (
    "vehicle_local_position",
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "vehicle_acceleration",
    "sensor_combined",
    "battery_status",
    "actuator_outputs",
    "actuator_motors",
    "esc_status",
)
"""Topics that are read; the first one with a quantity provides it"""


def _convert(series: Series, airframe: Airframe) -> Series:
    """Convert the quantities of a topic."""
    topic, order = series.topic, order_rotors(airframe, CORNERS)
    found: dict[str, Converted] = {}

    def vector(names: tuple[str, ...], fields: tuple[str, ...], factors: tuple[int, ...]) -> None:
        found.update(
            convert_columns(series, names, [f"{topic}.{field}" for field in fields], factors)
        )

    if topic == "vehicle_local_position":
        vector(POSITION, ("y", "x", "z"), (1, 1, -1))
        vector(VELOCITY, ("vy", "vx", "vz"), (1, 1, -1))
    elif topic == "vehicle_attitude":
        found |= convert_attitude(series, [f"{topic}.q[{k}]" for k in range(4)])
    elif topic == "vehicle_angular_velocity":
        vector(RATES, ("xyz[0]", "xyz[1]", "xyz[2]"), (1, -1, -1))
    elif topic == "vehicle_acceleration":
        vector(FORCE, ("xyz[0]", "xyz[1]", "xyz[2]"), (1, -1, -1))
    elif topic == "sensor_combined":
        vector(RATES, ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"), (1, -1, -1))
        fields = ("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]")
        vector(FORCE, fields, (1, -1, -1))
    elif topic == "battery_status":
        vector(("vbat",), ("voltage_v",), (1,))
        vector(("current",), ("current_a",), (1,))
        # PX4 logs -1 for a current that is not measured
        if "current" in found and found["current"].values.min() < 0:
            del found["current"]
    elif topic in ("actuator_outputs", "actuator_motors"):
        field = "output" if topic == "actuator_outputs" else "control"
        found |= convert_motors(series, "pwm", [f"{topic}.{field}[{k}]" for k in range(12)], order)
    elif topic == "esc_status":
        names = [f"{topic}.esc[{k}].esc_rpm" for k in range(8)]
        measured = convert_motors(series, "rpm", names, order)
        # Without telemetry of the motor controllers all speeds are 0
        if all(one.values.any() for one in measured.values()):
            found |= measured
    return series._replace(converted=found)
