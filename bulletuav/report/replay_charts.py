"""What the plots of a replay show: lines over time, in groups."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bulletuav.analysis.recorded import READING, Recording
from bulletuav.report.payload import Payload

MAX_LINES = 64
"""Numbers of one info or reading up to which they are plotted"""
SEPARATION = 1
"""Place of the plot of separations, which has a line at d_safe"""


def add_charts(payload: Payload, recording: Recording, about: dict[str, Any]) -> list[Any]:
    """Add what is plotted to a payload.

    Args:
        payload: Where the numbers go to. It has the series "position", "rotors", and those of
            readings by the names that files give them.
        recording: The episode.
        about: What the recording's scene tells.

    Returns:
        The plots in their order: group, title, unit, and lines, each with its name, the series,
        and which of the `parts` numbers of a drone it is.
    """
    # Altitude is a part of the positions, which the page has already
    charts = [_chart("Flight", "altitude", "m", [""], "position", 3, [2])]
    # What was decided: rewards and infos, a series each
    for group, title, unit, values in _decision_series(recording, about):
        rows = values.reshape(*values.shape[:2], -1)
        width = rows.shape[2]
        series = f"chart {len(charts)}"
        payload.add_series(series, rows)
        names = [str(part) if width > 1 else "" for part in range(width)]
        charts.append(_chart(group, title, unit, names, series, width, range(width)))
    # Points have no rotors, and rows of zeros tell nothing
    if recording.scene["rotor_speed"].any():
        charts.append(_chart("Flight", "rotors, mean", "rad/s", [""], "rotors", 1, [0]))
    # Readings that are pictures or flags, or too many lines, are left out
    for name, labels in about["readings"].items():
        if recording.reading[name].dtype.kind == "b" or len(labels) > MAX_LINES:
            continue
        # One plot a unit, as axes have only one
        for unit in dict.fromkeys(unit for _, unit in labels):
            parts = [k for k, (_, own) in enumerate(labels) if own == unit]
            names = [labels[k][0] for k in parts]
            series = f"{READING}{name}"
            charts.append(_chart("Sensors", name, unit, names, series, len(labels), parts))
    charts[SEPARATION]["mark"] = about["d_safe"]
    return charts


def _chart(
    group: str,
    title: str,
    unit: str,
    names: Sequence[str],
    series: str,
    width: int,
    parts: Sequence[int],
) -> dict[str, Any]:
    """Tell a plot of some of the `width` numbers that a series has of each drone."""
    lines = [
        {"name": name, "series": series, "part": part, "parts": width}
        for name, part in zip(names, parts, strict=True)
    ]
    unit = "" if unit == "1" else unit
    return {"group": group, "title": title, "unit": unit, "lines": lines}


def _decision_series(
    recording: Recording, about: dict[str, Any]
) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield group, title, unit and numbers (T+1, N, ...) of what decisions tell."""
    yield "Flight", "separation", "m", prepend_missing_row(recording.separation)
    yield "Flight", "speed", "m/s", np.linalg.norm(recording.velocity, axis=-1)
    yield "Reward", "reward", "", prepend_missing_row(recording.reward)
    for name, values in recording.info.items():
        if values.dtype.kind not in "biuf" or not 0 < np.prod(values.shape[2:]) <= MAX_LINES:
            continue
        if name in about["shows"]:  # the label tells the unit
            yield "Flight", about["shows"][name], "", prepend_missing_row(values)
        elif name.startswith("reward/"):
            yield (
                "Reward",
                name.removeprefix("reward/").replace("_", " "),
                "",
                prepend_missing_row(values),
            )
        else:
            unit = about["units"].get(f"info/{name}", "")
            yield "Infos", name.replace("_", " "), unit, prepend_missing_row(values)


def prepend_missing_row(values: np.ndarray) -> np.ndarray:
    """Put a row without values before those of decisions, as states begin with the start."""
    return np.concatenate([np.full_like(values[:1], np.nan, dtype=float), values])
