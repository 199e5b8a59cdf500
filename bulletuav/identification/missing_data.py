"""Holes in a log: rows, values and changes that are not there, and spikes."""

import numpy as np
from scipy.ndimage import median_filter

from bulletuav.identification.logs import OTHER, POSITION, QUATERNION, Log

MAX_ROW_INTERVAL = 0.1
"""Longest time between two rows, s"""
MAX_GAP = 0.1
"""Longest time without a value in a column, s: shorter ones are filled in"""
MIN_SAMPLE_RATE = 40.0
"""Fewest rows a second"""
MIN_DURATION = 5.0
"""Least duration of a log, s"""
MEDIAN_WINDOW = 9
"""Samples whose median tells where a spike stands out"""
POSITION_SPIKE, ATTITUDE_SPIKE = 0.03, 0.1
"""How far a spike stands out at least, m and rad"""


def log_error(log: Log, message: str) -> ValueError:
    """Make the error for a log, for the caller to raise."""
    return ValueError(f"{log.path}: {message}")


def check_times(log: Log) -> None:
    """Refuse times that do not go on evenly."""
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
            log, f"t has {1 / median:.1f} rows a second: at least {MIN_SAMPLE_RATE:g} are needed"
        )
    if time[-1] - time[0] < MIN_DURATION:
        raise log_error(
            log, f"it lasts {time[-1] - time[0]:.2f} s: at least {MIN_DURATION:g} s are needed"
        )


def fill_gaps(log: Log) -> Log:
    """Fill holes between neighbours, and refuse long ones."""
    columns = {}
    filled = {}
    for name, values in log.columns.items():
        good = np.isfinite(values)
        if not good.any():
            raise log_error(log, f"{name} has no numbers: map a column that has, or leave it out")
        columns[name] = values
        if good.all():
            continue
        # Edges of runs of missing values
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
    return Log(log.path, columns, filled)


def check_not_constant(log: Log) -> None:
    """Refuse columns that stay the same all the time."""
    fixed = ("vbat", "current", *OTHER)
    for name, values in log.columns.items():
        if name not in fixed and np.ptp(values) == 0:
            raise log_error(
                log,
                f"{name} does not change: it is {values[0]:g} in all {len(values)} rows; map the "
                f"column that was measured, or leave it out of the header",
            )


def remove_spikes(log: Log) -> Log:
    """Fill in positions and attitudes that jump away and back, as lost markers make them."""
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
    return Log(log.path, columns, filled)
