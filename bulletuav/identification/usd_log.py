"""Logs of the micro-SD card deck of Crazyflies.

Source: https://www.bitcraze.io/documentation/repository/crazyflie-firmware/master/functional-areas/
(micro-SD card deck), versions 1 and 2 of its binary format.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from bulletuav.identification.logs import (
    EULER,
    FORCE,
    POSITION,
    QUATERNION,
    RATES,
    VELOCITY,
    ColumnSource,
    Log,
)
from bulletuav.identification.series import (
    Converted,
    Series,
    convert_columns,
    convert_motors,
    merge_series,
    order_rotors,
)
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

MAGIC = b"\xbc"
CHECKSUM_SIZE = 4
MAX_VARIABLES = 1024
"""Maximum number of variables of an event"""
TYPES = {
    "b": "<i1",
    "B": "<u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "l": "<i4",
    "L": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "e": "<f2",
    "f": "<f4",
    "d": "<f8",
}
"""NumPy types by the letters of the format"""
CLOCKS: Mapping[int, tuple[np.dtype, float]] = {
    1: (np.dtype("<u4"), 1e-3),
    2: (np.dtype("<u8"), 1e-6),
}
"""Type of time stamps and their unit, s, by the version of the format"""
FIXED_FREQUENCY = "fixedFrequency"
"""Event of the variables of the configuration file, whose columns have no prefix"""
CORNERS = ((1, -1), (-1, -1), (-1, 1), (1, 1))
"""Signs of x (forward) and y (left) of motors M1 to M4"""
ADVICE = (
    "log stateEstimate.x, y, z, qx, qy, qz, qw, gyro.x, y, z and motor.m1 to m4 at 100 Hz or more "
    "(config.txt of the deck), or map variables by --map NAME=VARIABLE"
)


class LogEvent(NamedTuple):
    """Kind of event: its name, and the NumPy type of its variables."""

    name: str
    dtype: np.dtype


def read_usd_log(path: Path, sources: Mapping[str, ColumnSource], airframe: Airframe) -> Log:
    """Read a log of a Crazyflie's micro-SD card deck.

    Args:
        path: The file.
        sources: Sources of --map. Names are those of variables, such as gyro.x; for events other
            than fixedFrequency with the event in front, such as estPosition.x.
        airframe: Airframe of the log.

    Returns:
        The log.

    Raises:
        ValueError: If the file is damaged, or variables are missing.
    """
    data = path.read_bytes()
    try:
        all_series = list(_read_events(data))
    except (struct.error, IndexError, ValueError) as error:
        raise ValueError(
            f"{path} is a damaged log of a micro-SD card deck: {error}; copy it again"
        ) from None
    all_series = [_convert(series, airframe) for series in all_series]
    return merge_series(path, all_series, sources, airframe, ADVICE)


def _read_events(data: bytes) -> Iterator[Series]:
    """Yield the variables of each kind of event."""
    version, num_kinds = struct.unpack_from("<HH", data, 1)
    if version not in CLOCKS:
        raise ValueError(f"its version is {version}: 1 or 2 is needed")
    (checksum,) = struct.unpack("<I", data[-CHECKSUM_SIZE:])
    end = len(data) - CHECKSUM_SIZE
    if crc32(data[:end]) != checksum:
        raise ValueError("its checksum does not match, as after a loss of power")
    clock, unit = CLOCKS[version]
    events, start = {}, 5
    for _ in range(num_kinds):
        number, event, start = _read_event(data, start, clock)
        events[number] = event
    places: dict[int, list[bytes]] = {number: [] for number in events}
    while start < end:
        (number,) = struct.unpack_from("<H", data, start)
        if number not in events:
            raise ValueError(f"byte {start} has the unknown event {number}")
        stop = start + 2 + events[number].dtype.itemsize
        if stop > end:
            raise ValueError("its last event is incomplete")
        places[number].append(data[start + 2 : stop])
        start = stop
    for number, event in events.items():
        rows = np.frombuffer(b"".join(places[number]), event.dtype)
        prefix = "" if event.name == FIXED_FREQUENCY else f"{event.name}."
        names = (event.dtype.names or ())[1:]
        columns = {f"{prefix}{name}": rows[name].astype(np.float64) for name in names}
        yield Series(event.name, unit * rows["timestamp"].astype(np.float64), columns, {})


def _read_event(data: bytes, start: int, clock: np.dtype) -> tuple[int, LogEvent, int]:
    """Read a kind of event; return its number, the event and the next byte."""
    (number,) = struct.unpack_from("<H", data, start)
    name, start = _read_text(data, start + 2)
    (count,) = struct.unpack_from("<H", data, start)
    if count > MAX_VARIABLES:
        raise ValueError(f"the event {name} has {count} variables: at most {MAX_VARIABLES}")
    start += 2
    fields = [("timestamp", clock)]
    for _ in range(count):
        variable, start = _read_text(data, start)
        # A variable is a name with the letter of its type, such as gyro.x(f)
        kind = variable[-2:-1]
        if variable[-3:-2] != "(" or variable[-1:] != ")" or kind not in TYPES:
            raise ValueError(f"the variable {variable!r} has no known type")
        fields.append((variable[:-3], np.dtype(TYPES[kind])))
    return number, LogEvent(name, np.dtype(fields)), start


def _read_text(data: bytes, start: int) -> tuple[str, int]:
    """Read a text that ends with a zero byte; return it and the next byte."""
    stop = data.index(b"\0", start, start + 256)
    return data[start:stop].decode(), stop + 1


def _convert(series: Series, airframe: Airframe) -> Series:
    """Convert the variables of an event."""
    found: dict[str, Converted] = {}
    degree = math.pi / 180

    def vector(names: tuple[str, ...], columns: str, factors: tuple[float, ...]) -> None:
        if not any(name in found for name in names):
            found.update(convert_columns(series, names, columns.split(), factors))

    vector(POSITION, "stateEstimate.x stateEstimate.y stateEstimate.z", (1, 1, 1))
    vector(POSITION, "stateEstimateZ.x stateEstimateZ.y stateEstimateZ.z", (1e-3,) * 3)
    turn = "stateEstimate.qx stateEstimate.qy stateEstimate.qz stateEstimate.qw"
    vector(QUATERNION, turn, (1, 1, 1, 1))
    if not found.keys() & set(QUATERNION):
        # The firmware's pitch is positive when the nose is up
        turn = "stateEstimate.roll stateEstimate.pitch stateEstimate.yaw"
        vector(EULER, turn, (degree, -degree, degree))
    vector(VELOCITY, "stateEstimate.vx stateEstimate.vy stateEstimate.vz", (1, 1, 1))
    vector(VELOCITY, "stateEstimateZ.vx stateEstimateZ.vy stateEstimateZ.vz", (1e-3,) * 3)
    vector(RATES, "gyro.x gyro.y gyro.z", (degree,) * 3)
    vector(FORCE, "acc.x acc.y acc.z", (STANDARD_GRAVITY,) * 3)
    vector(("vbat",), "pm.vbat", (1,))
    order = order_rotors(airframe, CORNERS)
    for kind, pattern in (("pwm", "motor.m{}"), ("pwm", "pwm.m{}_pwm"), ("rpm", "rpm.m{}")):
        if f"{kind}1" not in found:
            names = [pattern.format(k) for k in range(1, 5)]
            found |= convert_motors(series, kind, names, order)
    return series._replace(converted=found)
