"""Missing data in logs: gaps between rows, missing values, constant columns, and spikes."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from bulletuav.identification.logs import OTHER, POSITION, QUATERNION, Log

MAX_ROW_INTERVAL = 0.1
"""Maximum time between two rows, s"""
MAX_GAP = 0.1
"""Maximum duration of missing values in a column, s; shorter gaps are interpolated"""
MIN_SAMPLE_RATE = 40.0
"""Minimum sample rate, Hz"""
MIN_DURATION = 5.0
"""Minimum duration of a log, s"""
MEDIAN_WINDOW = 9
"""Window length of the median filter that detects spikes, samples"""
POSITION_SPIKE, ATTITUDE_SPIKE = 0.03, 0.1
"""Minimum deviation of a spike from the median, m and rad"""


def log_error(log: Log, message: str) -> ValueError:
    """Return a ValueError whose message names the log."""
    return ValueError(f"{log.path}: {message}")


def check_times(log: Log) -> None:
    """Raise ValueError if times are missing, do not increase, or are not in seconds."""
    time = log.time
    if len(time) < 2 or not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time))) if len(time) else 0
        raise log_error(log, f"t is missing in row {row + 2}: every row needs its time")
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        row = int(back[0])
        raise log_error(
            log,
            f"t does not increase: {time[row]:.6f} is followed by {time[row + 1]:.6f} in row "
            f"{row + 3} ({len(back)} times in all): sort the rows, and drop those that are twice",
        )
    median = float(np.median(steps))
    if median > 0.5:
        unit = "us" if median > 500 else "ms"
        raise log_error(
            log, f"t grows by {median:g} a row: seconds are needed; pass --map t=COLUMN*{unit}"
        )
    wide = int(np.argmax(steps))
    if steps[wide] > MAX_ROW_INTERVAL:
        raise log_error(
            log,
            f"t has a gap of {steps[wide]:.3f} s after {time[wide] - time[0]:.3f} s of the log "
            f"(t = {time[wide]:.3f}, {int((steps > MAX_ROW_INTERVAL).sum())} gaps in all): at most "
            f"{MAX_ROW_INTERVAL:g} s are possible; cut the log there into two files",
        )
    if median > 1 / MIN_SAMPLE_RATE:
        raise log_error(
            log,
            f"t has {1 / median:.1f} rows a second: at least {MIN_SAMPLE_RATE:g} are needed; "
            f"record faster, such as by SDLOG_PROFILE of PX4, a RecordInterval of at most "
            f"{1 / MIN_SAMPLE_RATE:g} s of AirSim, or a higher rate of the topics",
        )
    if time[-1] - time[0] < MIN_DURATION:
        raise log_error(
            log, f"the log lasts {time[-1] - time[0]:.2f} s: at least {MIN_DURATION:g} s are needed"
        )


def fill_gaps(log: Log) -> Log:
    """Interpolate short gaps in each column; raise ValueError for long ones."""
    columns = {}
    filled = {}
    for name, values in log.columns.items():
        good = np.isfinite(values)
        if not good.any():
            raise log_error(log, f"{name} has no numbers: map another column, or leave it out")
        columns[name] = values
        if good.all():
            continue
        # First and last rows of each run of missing values
        edge = np.diff(np.concatenate([[0], ~good, [0]]).astype(int))
        begin, end = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1
        time = log.time
        last = np.minimum(end + 1, len(time) - 1)
        length = time[last] - time[np.maximum(begin - 1, 0)]
        worst = int(np.argmax(length))
        if length[worst] > MAX_GAP:
            raise log_error(
                log,
                f"{name} has no numbers for {length[worst]:.3f} s from row {begin[worst] + 2} on "
                f"(t = {time[begin[worst]]:.3f}): at most {MAX_GAP:g} s can be filled in; "
                f"cut that part off",
            )
        columns[name] = np.interp(time, time[good], values[good])
        filled[name] = int((~good).sum())
    return replace(log, columns=columns, filled=filled)


def check_not_constant(log: Log) -> None:
    """Raise ValueError for a measured column that never changes."""
    fixed = ("vbat", "current", *OTHER)
    for name, values in log.columns.items():
        if name not in fixed and np.ptp(values) == 0:
            raise log_error(
                log,
                f"{name} does not change: it is {values[0]:g} in all {len(values)} rows; map the "
                f"column that was measured, or leave it out of the header",
            )


def remove_spikes(log: Log) -> Log:
    """Interpolate positions and attitudes over spikes, such as those of lost markers."""
    columns = dict(log.columns)
    filled = dict(log.filled)
    for names, threshold in ((POSITION, POSITION_SPIKE), (QUATERNION, ATTITUDE_SPIKE / 2)):
        values = log.stack(names)
        off = np.linalg.norm(
            values - median_filter(values, (MEDIAN_WINDOW, 1), mode="nearest"), axis=1
        )
        bad = off > threshold
        if bad.any() and not bad.all():
            for name in names:
                columns[name] = np.interp(log.time, log.time[~bad], columns[name][~bad])
            filled[names[0]] = filled.get(names[0], 0) + int(bad.sum())
    return replace(log, columns=columns, filled=filled)
