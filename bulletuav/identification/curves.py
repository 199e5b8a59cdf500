"""What was measured and what was predicted, side by side over time."""

from typing import NamedTuple

import numpy as np

from bulletuav.identification.errors import make_legs
from bulletuav.identification.identify import Prediction

MAX_PLOT_DURATION = 12.0
"""Duration that is shown, s"""
PLOTTED_QUANTITIES = (
    ("velocity east, m/s", "translation", 3),
    ("velocity north, m/s", "translation", 4),
    ("velocity up, m/s", "translation", 5),
    ("p, rad/s", "rotation", 3),
    ("q, rad/s", "rotation", 4),
    ("r, rad/s", "rotation", 5),
)
"""Label of a quantity, and where its error stands in `PredictionErrors`"""


class Curve(NamedTuple):
    """One quantity in the legs of a log.

    Attributes:
        label: What it is, with its unit.
        time: (L, picks) times, s.
        measured: (L, picks) what was measured.
        before: (L, picks) what was predicted with the airframe as it was.
        after: (L, picks) the same with the airframe as it is now.
    """

    label: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


def make_curves(prediction: Prediction) -> list[Curve]:
    """Return what to plot of one log.

    Args:
        prediction: Predictions in its windows; the first of them are shown.
    """
    flight = prediction.part.flight
    windows = prediction.part.windows
    guided, free = make_legs(flight, windows)
    found = []
    for label, field, column in PLOTTED_QUANTITIES:
        legs = guided if field == "translation" else free
        at = legs.start[:, None] + legs.stride * np.arange(1, legs.num_states + 1)
        values = flight.track.velocity if field == "translation" else flight.track.rates
        measured = values[at, column - 3]
        errors = [
            getattr(one, field)[..., column].reshape(at.shape)
            for one in (prediction.before, prediction.after)
        ]
        first = at[:, 0] * flight.dt < at[0, 0] * flight.dt + MAX_PLOT_DURATION
        time = flight.dt * at
        shown = (time, measured, measured + errors[0], measured + errors[1])
        found.append(Curve(label, *(part[first] for part in shown)))
    return found
