"""Intervals of means over rooms."""

from bulletuav.analysis.metrics.estimates import Estimate

MIN_ROOMS = 5
"""Minimum number of rooms of a confidence interval"""


def room_interval(one: Estimate) -> tuple[float, float] | tuple[None, None]:
    """Return the 95 % interval of a mean over rooms, without bounds below `MIN_ROOMS` rooms.

    The bootstrap of a few rooms claims more certainty than they give.
    """
    return (None, None) if one.episodes < MIN_ROOMS else (one.low, one.high)
