"""Recordings of AirSim (airsim_rec.txt), in NED and FRD axes.

Source: https://microsoft.github.io/AirSim/modify_recording_data.
"""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bulletuav.errors import read_file, shown
from bulletuav.identification.logs import POSITION, ColumnSource, Log, parse_rows
from bulletuav.identification.series import Series, convert_attitude, convert_columns, merge_series
from bulletuav.vehicle.airframe import Airframe

VEHICLE, IMAGE = "VehicleName", "ImageFile"
CLOCKS = ("TimeStamp", "Timestamp(ms)")
"""Names of the column of times, ms; older versions have the second one"""
ADVICE = (
    "AirSim records no rotor speeds by default: add them to getRecordFileLine, as AirSim's page on "
    "modified recordings shows, and map them by --map w1=COLUMN and so on, rad/s"
)


def read_airsim_recording(
    path: Path, sources: Mapping[str, ColumnSource], airframe: Airframe
) -> Log:
    """Read a recording of AirSim.

    Args:
        path: The file.
        sources: Sources of --map, for columns that were added to the recording.
        airframe: Airframe of the log.

    Returns:
        The log.

    Raises:
        ValueError: If the file is damaged, has several vehicles, or lacks columns.
    """
    lines = read_file(path).splitlines()
    header = [name.strip() for name in lines[0].split("\t")]
    rows = list(csv.reader(lines[1:], delimiter="\t", quoting=csv.QUOTE_NONE))
    if VEHICLE in header:
        k = header.index(VEHICLE)
        vehicles = sorted({row[k] for row in rows if len(row) > k})
        if len(vehicles) > 1:
            raise ValueError(
                f"{path} has {len(vehicles)} vehicles, {shown(vehicles)}: keep the rows of one"
            )
    clock = next((name for name in CLOCKS if name in header), None)
    if clock is None:
        raise ValueError(f"{path} has no column {CLOCKS[0]}: record it again")
    places = {name: k for k, name in enumerate(header) if name not in (VEHICLE, IMAGE, "")}
    table = parse_rows(path, rows, len(header), places)
    time = 1e-3 * table.pop(clock)
    if not np.isfinite(time).all():
        raise ValueError(f"{path}: {clock} is missing in a row: delete the row")
    series = Series("airsim_rec", time, table, {})
    names = ("POS_Y", "POS_X", "POS_Z")
    converted = convert_columns(series, POSITION, names, (1.0, 1.0, -1.0))
    converted |= convert_attitude(series, ("Q_W", "Q_X", "Q_Y", "Q_Z"))
    notes = [name for name in (VEHICLE, IMAGE) if name in header]
    merged = series._replace(converted=converted)
    return merge_series(path, [merged], sources, airframe, ADVICE, notes)
