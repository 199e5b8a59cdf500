"""Line-of-sight probability in a built-up area, from its statistics.

The probabilities are means over cities of a kind; for a specific city, use ray casting.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.city.statistics import Statistics


class Sigmoid(NamedTuple):
    """Parameters of `elevation_los`.

    Attributes:
        a: Centre, degrees.
        b: Slope, 1/degree.
    """

    a: float
    b: float


SIGMOIDS = {
    "suburban": Sigmoid(4.88, 0.43),
    "urban": Sigmoid(9.61, 0.16),
    "dense": Sigmoid(12.08, 0.11),
    "high_rise": Sigmoid(27.23, 0.08),
}
"""A. Al-Hourani, S. Kandeepan, S. Lardner, "Optimal LAP altitude for maximum coverage",
IEEE Wireless Communications Letters 3 (2014)"""

SURFACE_A = (
    (0.934, 0.230, -2.25e-3, 1.86e-5),
    (1.97e-2, 2.44e-3, 6.58e-6),
    (-1.24e-4, -3.34e-6),
    (2.73e-7,),
)
"""Coefficients of a: row i contains those of (alpha beta)^i gamma^j, j = 0, 1, ..."""
SURFACE_B = (
    (1.17, -7.56e-2, 1.98e-3, -1.78e-5),
    (-5.79e-3, 1.81e-4, -1.65e-6),
    (1.73e-5, -2.02e-7),
    (-2.00e-8,),
)
"""Coefficients of b, in the same order"""


def p1410_los(
    statistics: Statistics, distance: np.ndarray, transmitter: np.ndarray, receiver: float = 1.5
) -> np.ndarray:
    """Return the probability that no roof blocks the ray between two antennas.

    The ray passes an integer number of evenly spaced buildings, rounded down, and the roofs are
    compared at the centres of the buildings. The wall next to the receiver is not considered, so a
    city of blocks has fewer lines of sight.

    Args:
        statistics: Statistics of the built-up area.
        distance: Horizontal distance between the antennas, m.
        transmitter: Height of one antenna, m; broadcasts with `distance`.
        receiver: Height of the other antenna, m.

    Returns:
        Probabilities, in the broadcast shape.

    References:
        Rec. ITU-R P.1410; Al-Hourani et al., WCL 2014.
    """
    distance, transmitter = np.broadcast_arrays(distance, transmitter)
    # Number of passed buildings, and height of the ray above the centre of each
    density = np.sqrt(statistics.alpha * statistics.beta)
    count = np.floor(distance / 1000 * density)[..., None]
    passed = np.arange(count.max(initial=0))
    fraction = (passed + 0.5) / np.maximum(count, 1)
    fall = (transmitter - receiver)[..., None]
    height = transmitter[..., None] - fraction * fall
    # Rayleigh distribution of the roofs
    lower = 1 - np.exp(-(height**2) / (2 * statistics.gamma**2))
    chance: np.ndarray = np.where(passed < count, lower, 1.0).prod(axis=-1)
    return chance


def elevation_los(elevation: np.ndarray, sigmoid: Sigmoid) -> np.ndarray:
    """Return the line-of-sight probability at an elevation angle seen from the ground.

    Args:
        elevation: Degrees above the horizon, any shape.
        sigmoid: Parameters of the kind of area.

    References:
        Al-Hourani et al., WCL 2014, eq. 5.
    """
    decay = np.exp(-sigmoid.b * (np.asarray(elevation) - sigmoid.a))
    chance: np.ndarray = 1 / (1 + sigmoid.a * decay)
    return chance


def fitted_sigmoid(statistics: Statistics) -> Sigmoid:
    """Return the sigmoid parameters of custom statistics.

    References:
        Polynomial surfaces of Al-Hourani et al. (WCL 2014, table I).
    """
    density = statistics.alpha * statistics.beta
    gamma = statistics.gamma
    return Sigmoid(
        *(
            sum(
                coefficient * density**i * gamma**j
                for i, row in enumerate(surface)
                for j, coefficient in enumerate(row)
            )
            for surface in (SURFACE_A, SURFACE_B)
        )
    )
