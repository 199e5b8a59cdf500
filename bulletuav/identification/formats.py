"""Formats of flight logs, which are recognised by their first bytes."""

from collections.abc import Callable, Mapping
from pathlib import Path

from bulletuav.errors import require_available_memory, require_file
from bulletuav.identification import airsim_recording, ulog, usd_log
from bulletuav.identification.airsim_recording import read_airsim_recording
from bulletuav.identification.logs import ColumnSource, Log, read_log
from bulletuav.identification.rosbag_log import read_rosbag
from bulletuav.identification.ulog import read_ulog
from bulletuav.identification.usd_log import read_usd_log
from bulletuav.vehicle.airframe import Airframe

BAG_MAGICS = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0")
"""First bytes of bags of ROS 1 and of ROS 2"""
MEMORY_FACTOR = 4
"""Memory that a reader needs, in sizes of the file"""
Reader = Callable[[Path, Mapping[str, ColumnSource], Airframe], Log]


def read_flight_log(
    path: str | Path, sources: Mapping[str, ColumnSource], airframe: Airframe
) -> Log:
    """Read a flight log: CSV, ULog, ROS bag, Crazyflie's micro-SD log, or AirSim's recording.

    Args:
        path: The file, or the folder of a bag of ROS 2.
        sources: Sources of the columns that have other names or units in the file.
        airframe: Airframe of the log.

    Returns:
        The log.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file is damaged, or lacks columns.
        ImportError: If the format needs an extra that is not installed.
    """
    if isinstance(path, str | Path) and Path(path, "metadata.yaml").is_file():
        return read_rosbag(Path(path), sources, airframe)
    found = require_file("log", path, "pass the path of a CSV file or of another flight log")
    size = found.stat().st_size
    require_available_memory(f"the numbers of {found}", MEMORY_FACTOR * size, "cut the log")
    with found.open("rb") as file:
        start = file.read(64)
    reader = _find_reader(start)
    if reader is not None:
        return reader(found, sources, airframe)
    return read_log(found, sources, len(airframe.rotors))


def _find_reader(start: bytes) -> Reader | None:
    """Return the reader of a format by the first bytes of the file; None for CSV files."""
    if start.startswith(ulog.MAGIC):
        return read_ulog
    if start.startswith(usd_log.MAGIC):
        return read_usd_log
    if start.startswith(BAG_MAGICS):
        return read_rosbag
    first = start.decode(errors="replace").partition("\t")[0].strip()
    if b"\t" in start and first in (airsim_recording.VEHICLE, *airsim_recording.CLOCKS):
        return read_airsim_recording
    return None
