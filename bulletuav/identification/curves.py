"""What was measured and what was predicted, side by side over time."""

from typing import NamedTuple

import numpy as np

from bulletuav.identification.errors import legs_of
from bulletuav.identification.identify import Prediction

LONGEST = 12.0
"""Duration that is shown, s"""
SHOWN = (
    ("velocity east, m/s", "moved", 3),
    ("velocity north, m/s", "moved", 4),
    ("velocity up, m/s", "moved", 5),
    ("p, rad/s", "turned", 3),
    ("q, rad/s", "turned", 4),
    ("r, rad/s", "turned", 5),
)
"""Label of a quantity, and where its error stands in `Errors`"""


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


def curves(prediction: Prediction) -> list[Curve]:
    """Return what to plot of one log.

    Args:
        prediction: Predictions in its windows; the first of them are shown.
    """
    flight = prediction.part.flight
    windows = prediction.part.windows
    guided, free = legs_of(flight, windows)
    found = []
    for label, field, column in SHOWN:
        legs = guided if field == "moved" else free
        at = legs.start[:, None] + legs.every * np.arange(1, legs.picks + 1)
        values = flight.track.velocity if field == "moved" else flight.track.rates
        measured = values[at, column - 3]
        errors = [
            getattr(one, field)[..., column].reshape(at.shape)
            for one in (prediction.before, prediction.after)
        ]
        first = at[:, 0] * flight.dt < at[0, 0] * flight.dt + LONGEST
        time = flight.dt * at
        shown = (time, measured, measured + errors[0], measured + errors[1])
        found.append(Curve(label, *(part[first] for part in shown)))
    return found
