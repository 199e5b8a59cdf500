"""Logs whose topics have clocks of their own, merged into one table of columns."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bulletuav.earth import attitude_to_enu
from bulletuav.errors import suggest_names
from bulletuav.identification.logs import (
    COMMANDS,
    EULER,
    FORCE,
    MAX_HINT_LENGTH,
    QUATERNION,
    RATES,
    VELOCITY,
    ColumnSource,
    Log,
    select_columns,
)
from bulletuav.identification.missing_data import MAX_GAP
from bulletuav.vehicle.airframe import Airframe

SLOW_NAMES = ("vbat", "current")
"""Quantities that change slowly, so that longer gaps are interpolated"""
MAX_SLOW_GAP = 2.0
"""Maximum time between values of `SLOW_NAMES`, s"""


class Converted(NamedTuple):
    """A quantity that a reader converted.

    Attributes:
        values: (n,) in the units and axes of `identification.logs`.
        columns: Names of the columns of the file from which it was computed.
    """

    values: np.ndarray
    columns: tuple[str, ...]


class Series(NamedTuple):
    """Columns of one topic, on its own clock.

    Attributes:
        topic: Name of the topic.
        time: (n,) s.
        columns: Columns (n,) of the file by name, as --map names them.
        converted: Quantities by the names of `identification.logs.NAMES`.
    """

    topic: str
    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    converted: Mapping[str, Converted]


def convert_columns(
    series: Series, names: Sequence[str], columns: Sequence[str], factors: Sequence[float]
) -> dict[str, Converted]:
    """Convert columns of a series by factors; return nothing if one of them is missing."""
    if not all(column in series.columns for column in columns):
        return {}
    return {
        name: Converted(factor * series.columns[column], (column,))
        for name, column, factor in zip(names, columns, factors, strict=True)
    }


def convert_attitude(series: Series, columns: Sequence[str]) -> dict[str, Converted]:
    """Convert a quaternion w, x, y, z from FRD body axes to NED into this package's axes."""
    if not all(column in series.columns for column in columns):
        return {}
    rows = np.stack([series.columns[column] for column in columns], axis=1)
    turned = np.full_like(rows, np.nan)
    good = np.isfinite(rows).all(axis=1)
    turned[good] = attitude_to_enu(rows[good], scalar_first=True)
    return {
        name: Converted(values, tuple(columns))
        for name, values in zip(QUATERNION, turned.T, strict=True)
    }


def order_rotors(airframe: Airframe, corners: Sequence[tuple[int, int]]) -> list[int]:
    """Return the index in the log of each rotor of an airframe.

    Args:
        airframe: The airframe.
        corners: Signs of x (forward) and y (left) of the motors of the log, in its order.

    Returns:
        An index for each rotor; in the order of the log if the rotors are not one in each corner.
    """
    own = [(1 if x > 0 else -1, 1 if y > 0 else -1) for x, y, _ in airframe.rotors]
    if sorted(own) != sorted(corners):
        return list(range(len(own)))
    return [list(corners).index(corner) for corner in own]


def convert_motors(
    series: Series, kind: str, columns: Sequence[str], order: Sequence[int]
) -> dict[str, Converted]:
    """Convert the columns of motors, in the order of the log, into commands of a kind."""
    if not all(k < len(columns) for k in order):
        return {}
    names = [f"{kind}{r + 1}" for r in range(len(order))]
    return convert_columns(series, names, [columns[k] for k in order], [1.0] * len(order))


def merge_series(
    path: Path,
    all_series: Iterable[Series],
    sources: Mapping[str, ColumnSource],
    airframe: Airframe,
    advice: str,
    notes: Sequence[str] = (),
) -> Log:
    """Merge the topics of a log on the clock of its attitude.

    Motor commands are held between their values, and other quantities are interpolated. Values in
    gaps of more than `MAX_GAP` are missing.

    Args:
        path: The file.
        all_series: The series; the first one that has a quantity provides it.
        sources: Sources of --map, which replace those of the series.
        airframe: Airframe of the log.
        advice: What to do if a quantity is missing, for the message.
        notes: What else the file has and is not used.

    Returns:
        The log, with the columns that were used and not used.

    Raises:
        ValueError: If a quantity is missing; the message lists the columns of the file.
    """
    listed = list(all_series)
    converted: dict[str, tuple[Series, Converted]] = {}
    columns: dict[str, tuple[Series, np.ndarray]] = {}
    for series in listed:
        for name, one in series.converted.items():
            converted.setdefault(name, (series, one))
        for column, values in series.columns.items():
            columns.setdefault(column, (series, values))
    _drop_other_commands(converted, sources, airframe)
    _drop_constant(converted)
    for name, source in sources.items():
        if name == "t":
            raise ValueError(f"{path}: --map t: this format has its own clock: omit it")
        if source.column not in columns:
            raise ValueError(
                f"{path}: --map {name}={source.column}: there is no such column; "
                f"{suggest_names(source.column, columns)}"
            )
        series, values = columns[source.column]
        scaled = source.factor * values + source.offset
        converted[name] = (series, Converted(scaled, (source.column,)))
    present = ", ".join(columns if len(listed) == 1 else (series.topic for series in listed))
    unread = f"; not read: {', '.join(notes)[:MAX_HINT_LENGTH]}" if notes else ""
    advice = (
        f"The log has {present[:MAX_HINT_LENGTH] or 'no topics that are read'}: {advice}{unread}"
    )
    names = select_columns(path, ["t", *converted, *columns], {}, len(airframe.rotors), advice)
    used = {name: converted[name] for name in names if name != "t"}
    time = _find_clock(path, used)
    table = {name: _resample(name, *used[name], time) for name in used}
    used_columns = {column for _, one in used.values() for column in one.columns}
    return Log(
        path,
        {"t": time - time[0], **table},
        {},
        {name: ", ".join(one.columns) for name, (_, one) in used.items()},
        (*_find_unused(listed, used_columns), *notes),
    )


def _drop_other_commands(
    converted: dict[str, tuple[Series, Converted]],
    sources: Mapping[str, ColumnSource],
    airframe: Airframe,
) -> None:
    """Keep the commands of one kind: that of --map, or the best one for the airframe."""
    mapped = [kind for kind in COMMANDS if f"{kind}1" in sources]
    found = [kind for kind in COMMANDS if f"{kind}1" in converted]
    # Commands show the lag of the motors, which measured speeds do not
    if airframe.pwm is not None and "pwm" in found:
        found = ["pwm"]
    kept = mapped or found[:1]
    for kind in COMMANDS:
        for name in [name for name in converted if name.rstrip("0123456789") == kind]:
            if kind not in kept:
                del converted[name]


def _drop_constant(converted: dict[str, tuple[Series, Converted]]) -> None:
    """Drop optional quantities that were not measured, so that all values are equal."""
    for group in (VELOCITY, RATES, FORCE):
        values = [converted[name][1].values for name in group if name in converted]
        if values and all((one == one[:1]).all() for one in values):
            for name in group:
                converted.pop(name, None)


def _find_clock(path: Path, used: Mapping[str, tuple[Series, Converted]]) -> np.ndarray:
    """Return the times of the attitude within those of all other series."""
    attitude = next(name for name in (*QUATERNION, *EULER) if name in used)
    time = np.unique(used[attitude][0].time)
    for series, _ in used.values():
        if not len(series.time):
            raise ValueError(f"{path}: {series.topic} has no rows: log it, or map another column")
        time = time[(time >= series.time.min()) & (time <= series.time.max())]
    if len(time) < 2:
        topics = ", ".join(sorted({series.topic for series, _ in used.values()}))
        raise ValueError(f"{path}: the topics {topics} have no time in common: log them together")
    return time


def _resample(name: str, series: Series, one: Converted, time: np.ndarray) -> np.ndarray:
    """Return the values of a quantity at other times, NaN in gaps."""
    own, order = np.unique(series.time, return_index=True)
    values = one.values[order]
    good = np.isfinite(values)
    own, values = own[good], values[good]
    if len(own) < 2:
        return np.full(len(time), np.nan)
    before = np.clip(np.searchsorted(own, time, side="right") - 1, 0, len(own) - 1)
    after = np.minimum(before + 1, len(own) - 1)
    is_held = name.rstrip("0123456789") in COMMANDS
    found: np.ndarray = values[before] if is_held else np.interp(time, own, values)
    limit = MAX_SLOW_GAP if name in SLOW_NAMES else MAX_GAP
    # Logs at exactly 10 rows a second have intervals that are rounded to slightly more
    is_gap = (own[after] - own[before] > 1.05 * limit) & (own[before] != time)
    found[is_gap] = np.nan
    return found


def _find_unused(listed: Iterable[Series], used: set[str]) -> list[str]:
    """Return the topics, or columns of topics in use, that are not used."""
    unused = []
    for series in listed:
        rest = [column for column in series.columns if column not in used]
        unused += [series.topic] if len(rest) == len(series.columns) else rest
    return unused
