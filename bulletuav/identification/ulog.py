"""Flight logs of PX4 (ULog), which pyulog reads in a subprocess.

Source: https://docs.px4.io/main/en/dev_log/ulog_file_format.html. Positions and velocities of PX4
are in NED, rates and specific forces in FRD body axes.
"""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.errors import GIB, missing_extra
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

MAGIC = b"ULog"
CHILD = Path(__file__).with_name("ulog_child.py")
"""Program of the subprocess"""
MAX_SECONDS = 60.0
"""Time limit of the subprocess, s"""
MIN_MEMORY, MEMORY_FACTOR = GIB // 2, 8
"""Memory limit of the subprocess: a minimum, bytes, and what is added in sizes of the file"""
CORNERS = ((1, -1), (-1, 1), (1, 1), (-1, -1))
"""Signs of x (forward) and y (left) of PX4's motors 1 to 4 in a quadrotor x"""
ADVICE = (
    "log vehicle_local_position, vehicle_attitude and actuator_outputs (PX4: SDLOG_PROFILE with "
    "high rate), or map columns by --map NAME=TOPIC.FIELD"
)


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
        ImportError: If pyulog is not installed.
    """
    read, notes = _read_series(path)
    all_series = [_convert(series, airframe) for series in read]
    rank = {topic: k for k, topic in enumerate(PRIORITY)}
    all_series.sort(key=lambda series: rank.get(series.topic, len(rank)))
    return merge_series(path, all_series, sources, airframe, ADVICE, notes)


def _read_series(path: Path) -> tuple[list[Series], list[str]]:
    """Read the topics of a log in a subprocess, and notes on what could not be read."""
    if importlib.util.find_spec("pyulog") is None:
        raise missing_extra("reading logs of PX4", "ulog")
    limit = MIN_MEMORY + MEMORY_FACTOR * path.stat().st_size
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(CHILD), str(path), str(limit)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=MAX_SECONDS,
            # OpenBLAS reserves memory for each thread, and Python's own allocator repeats calls
            # that fail at the limit
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                "OPENBLAS_NUM_THREADS": "1",
                "PYTHONMALLOC": "malloc",
            },
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"{path} takes pyulog more than {MAX_SECONDS:g} s: cut the log") from None
    line, _, body = done.stdout.partition(b"\n")
    answer: dict[str, Any] = {"error": f"pyulog ended with {done.returncode}"}
    if line:
        answer = json.loads(line)
    if "error" in answer:
        raise ValueError(f"{path} is a damaged ULog file ({answer['error']}): copy it again")
    found, place = [], 0
    for topic, names, count in answer["topics"]:
        table = np.frombuffer(body, count=len(names) * count, offset=place).reshape(-1, count)
        place += table.nbytes
        rows = dict(zip(names, table, strict=True))
        columns = {
            f"{topic}.{name}": row for name, row in rows.items() if not name.endswith("timestamp")
        }
        found.append(Series(topic, 1e-6 * rows["timestamp"], columns, {}))
    return found, answer["notes"]


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
