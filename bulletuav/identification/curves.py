"""Measured and predicted time series of a log, for plots."""

from typing import NamedTuple

import numpy as np

from bulletuav.identification.errors import aligned_track, make_legs
from bulletuav.identification.identify import Prediction

MAX_PLOT_DURATION = 12.0
"""Maximum duration of a plot, s"""
PLOTTED_QUANTITIES = (
    ("velocity east, m/s", "translation", 3),
    ("velocity north, m/s", "translation", 4),
    ("velocity up, m/s", "translation", 5),
    ("p, rad/s", "rotation", 3),
    ("q, rad/s", "rotation", 4),
    ("r, rad/s", "rotation", 5),
)
"""Label of each quantity, the field of `PredictionErrors` and the column with its error"""


class Curve(NamedTuple):
    """One quantity over the legs of a log: measured, and predicted before and after the fit.

    Attributes:
        label: Name of the quantity with its unit.
        time: Times, (L, num_states), s.
        measured: Measured values, (L, num_states).
        before: Predictions of the initial airframe, (L, num_states).
        after: Predictions of the fitted airframe, (L, num_states).
    """

    label: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


def make_curves(prediction: Prediction) -> list[Curve]:
    """Return the time series to plot for one log.

    Args:
        prediction: Predictions in the log's windows, of which the first `MAX_PLOT_DURATION` are
            used.

    Returns:
        A curve for each of `PLOTTED_QUANTITIES`.
    """
    flight = prediction.part.flight
    windows = prediction.part.windows
    guided, free = make_legs(flight, windows)
    found = []
    for label, field, column in PLOTTED_QUANTITIES:
        legs = guided if field == "translation" else free
        at = legs.start[:, None] + legs.stride * np.arange(1, legs.num_states + 1)
        name = "velocity" if field == "translation" else "rates"
        measured, predicted = [], []
        for errors, own in (
            (prediction.before, prediction.log_parameters_before),
            (prediction.after, prediction.log_parameters),
        ):
            values = getattr(aligned_track(flight, own), name)[at, column - 3]
            measured.append(values)
            predicted.append(values + getattr(errors, field)[..., column].reshape(at.shape))
        first = at[:, 0] * flight.dt < at[0, 0] * flight.dt + MAX_PLOT_DURATION
        time = flight.dt * at
        shown = (time, measured[-1], *predicted)
        found.append(Curve(label, *(part[first] for part in shown)))
    return found
