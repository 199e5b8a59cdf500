"""Statistics of a built-up area by ITU-R P.1410, and their measurement in a city."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from bulletuav.city.model import City
from bulletuav.errors import finite

MAX_VALUES = {"alpha": math.inf, "beta": 1e6, "gamma": 500.0}
"""Maximum values; beyond these, buildings are smaller than drones or exceed the airspace"""


@dataclass(frozen=True)
class Statistics:
    """Building density and height statistics of an area (Recommendation ITU-R P.1410).

    Attributes:
        alpha: Built-up fraction of the ground, in (0, 1).
        beta: Buildings per km^2.
        gamma: Mode of the heights, m: heights h have the Rayleigh density h / gamma^2 exp(-h^2 / (2
            gamma^2)).

    Raises:
        ValueError: If a number is out of bounds.
    """

    alpha: float
    beta: float
    gamma: float

    def __post_init__(self) -> None:
        given = dataclasses.asdict(self)
        for name, value in given.items():
            checked = finite(name, value, most=MAX_VALUES[name])
            object.__setattr__(self, name, checked)
        if not 0 < self.alpha < 1:
            raise ValueError(
                f"alpha is {given['alpha']!r}: "
                f"the built-up fraction of the ground must be between 0 and 1"
            )
        for name, unit in (("beta", "buildings per km^2"), ("gamma", "m")):
            if getattr(self, name) <= 0:
                raise ValueError(
                    f"{name} is {given[name]!r}: a positive number of {unit} is needed"
                )

    @property
    def pitch(self) -> float:
        """Side of the square block of one building in a regular grid, m."""
        return 1000 / math.sqrt(self.beta)

    @property
    def width(self) -> float:
        """Side of a square building in a regular grid, m (Al-Hourani et al., GLOBECOM 2014)."""
        return self.pitch * math.sqrt(self.alpha)

    @property
    def street(self) -> float:
        """Width of a street in a regular grid, m."""
        return self.pitch - self.width

    @property
    def mean_height(self) -> float:
        """Mean of the Rayleigh distribution, m."""
        return self.gamma * math.sqrt(math.pi / 2)


KINDS = {
    "suburban": Statistics(0.1, 750, 8),
    "urban": Statistics(0.3, 500, 15),
    "dense": Statistics(0.5, 300, 20),
    "high_rise": Statistics(0.5, 300, 50),
}
"""J. Holis and P. Pechac, "Elevation dependent shadowing model for mobile communications via high
altitude platforms in built-up areas", IEEE Trans. Antennas Propag. 56 (2008), table I"""


def parameters(city: City) -> tuple[float, float, float]:
    """Measure alpha, beta (buildings per km^2) and gamma (m) of a city.

    gamma is the maximum-likelihood estimate, 0 without buildings.
    """
    heights = city.heights
    density = len(heights) / (city.sides / 1000).prod()
    scale = math.sqrt((heights**2).sum() / (2 * max(len(heights), 1)))
    return city.coverage, float(density), scale


def realised(city: City, target: Statistics | None = None) -> dict[str, tuple[float, float]]:
    """Compare the statistics of a city with target statistics.

    The scale of heights is the maximum-likelihood estimate. With a target there are two more rows.
    The p-value is that of the Kolmogorov-Smirnov test of the heights against the target's Rayleigh
    distribution. The street width is a median: the width of a street is twice the distance from the
    midpoint between two crossings to the nearest wall, at most two blocks.

    Args:
        city: The city.
        target: Statistics that the city was generated for, if any.

    Returns:
        Realised and target value (NaN without a target) by the name of each statistic, with its
        unit.
    """
    heights = city.heights
    share, density, scale = parameters(city)
    # Estimates from the city
    found = {
        "built-up share": share,
        "buildings per km2": density,
        "Rayleigh scale of heights, m": scale,
        "mean height, m": float(heights.mean()),
        "greatest height, m": float(heights.max()),
    }
    if target is None:
        return {name: (value, math.nan) for name, value in found.items()}

    # Side of a block with one building, m; no street is wider than two blocks
    block = math.sqrt(city.sides.prod() / len(heights))
    # Midpoints between crossings, where the walls are nearest
    middles = city.streets.nodes[city.streets.edges].mean(axis=1)
    widths = 2 * city.clearance(middles, block)
    found["width of streets, m"] = float(np.median(widths))

    from scipy import stats  # lazy: slow to import

    test = stats.kstest(heights, stats.rayleigh(scale=target.gamma).cdf)
    found["KS test of heights, p"] = float(test.pvalue)
    # Same order as `found`; NaN if the target does not define the value
    aims = [
        target.alpha,
        target.beta,
        target.gamma,
        target.mean_height,
        math.nan,
        target.street,
        math.nan,
    ]
    return {name: (value, aim) for (name, value), aim in zip(found.items(), aims, strict=True)}
