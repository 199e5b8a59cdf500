"""Charts of a replay: grouped time series."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bulletuav.analysis.recorded import READING, Recording
from bulletuav.report.payload import Payload

MAX_LINES = 64
"""Maximum size of an info or reading that is plotted"""
SEPARATION = 1
"""Index of the chart of separations, which has a line at d_safe"""


def add_charts(payload: Payload, recording: Recording, about: dict[str, Any]) -> list[Any]:
    """Add the series of all charts to a payload.

    Args:
        payload: The payload. It must contain the series "position", "rotors" and those of aircraft
            with wings, and those of readings by their names in files.
        recording: The episode.
        about: Constant part of the recording's scene.

    Returns:
        The charts in order: group, title, unit, and lines, each with its name, series, and index
        among the `parts` numbers of a drone.
    """
    # Altitude is a component of the positions, which the payload already contains
    charts = [_chart("Flight", "altitude", "m", [""], "position", 3, [2])]
    # Data of decisions: rewards and infos, a series each
    for group, title, unit, values in _decision_series(recording, about):
        rows = values.reshape(*values.shape[:2], -1)
        width = rows.shape[2]
        series = f"chart {len(charts)}"
        payload.add_series(series, rows)
        names = [str(part) if width > 1 else "" for part in range(width)]
        charts.append(_chart(group, title, unit, names, series, width, range(width)))
    # Point-mass dynamics have no rotors, only zeros
    if recording.scene["rotor_speed"].any():
        charts.append(_chart("Flight", "rotors, mean", "rad/s", [""], "rotors", 1, [0]))
    if "deflection" in recording.scene:
        charts += _wing_charts(recording, about)
    # Skip flags and readings with too many numbers
    for name, labels in about["readings"].items():
        if recording.reading[name].dtype.kind == "b" or len(labels) > MAX_LINES:
            continue
        # One chart per unit, as a chart has one axis
        for unit in dict.fromkeys(unit for _, unit in labels):
            parts = [k for k, (_, own) in enumerate(labels) if own == unit]
            names = [labels[k][0] for k in parts]
            series = f"{READING}{name}"
            charts.append(_chart("Sensors", name, unit, names, series, len(labels), parts))
    charts[SEPARATION]["mark"] = about["d_safe"]
    return charts


def _wing_charts(recording: Recording, about: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the charts of aircraft with wings."""
    yield _chart("Flight", "airspeed", "m/s", [""], "airspeed", 1, [0])
    if recording.scene["rotor_speed"].any():
        yield _chart("Flight", "forward rotors, mean", "rad/s", [""], "forward rotors", 1, [0])
        width = recording.scene["deflection"].shape[2]
        named = {tuple(one["surfaces"]) for one in about["airframes"] if one.get("surfaces")}
        names = named.pop() if len(named) == 1 else [str(part) for part in range(width)]
        yield _chart("Flight", "control surfaces", "rad", names, "deflection", width, range(width))


def _chart(
    group: str,
    title: str,
    unit: str,
    names: Sequence[str],
    series: str,
    width: int,
    parts: Sequence[int],
) -> dict[str, Any]:
    """Describe a chart of some of the `width` numbers per drone of a series."""
    lines = [
        {"name": name, "series": series, "part": part, "parts": width}
        for name, part in zip(names, parts, strict=True)
    ]
    unit = "" if unit == "1" else unit
    return {"group": group, "title": title, "unit": unit, "lines": lines}


def _decision_series(
    recording: Recording, about: dict[str, Any]
) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yield group, title, unit and numbers (T+1, N, ...) of the data of decisions."""
    yield "Flight", "separation", "m", prepend_missing_row(recording.separation)
    yield "Flight", "speed", "m/s", np.linalg.norm(recording.velocity, axis=-1)
    yield "Reward", "reward", "", prepend_missing_row(recording.reward)
    for name, values in recording.info.items():
        if values.dtype.kind not in "biuf" or not 0 < np.prod(values.shape[2:]) <= MAX_LINES:
            continue
        if name in about["shows"]:  # the label contains the unit
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
    """Prepend a row of NaN to data of decisions, as states have an additional first row."""
    return np.concatenate([np.full_like(values[:1], np.nan, dtype=float), values])
