"""Statistics of a built-up area by ITU-R P.1410, and what a city has of them."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from bulletuav.city.model import City
from bulletuav.errors import finite

MOST = {"alpha": math.inf, "beta": 1e6, "gamma": 500.0}
"""Beyond it buildings are smaller than a drone, or reach out of a world's airspace"""


@dataclass(frozen=True)
class Statistics:
    """How densely and how high an area is built (Recommendation ITU-R P.1410).

    Attributes:
        alpha: Built-up share of the ground, in (0, 1).
        beta: Buildings per km^2.
        gamma: Most frequent height, m: heights h have the Rayleigh density
            h / gamma^2 exp(-h^2 / (2 gamma^2)).

    Raises:
        ValueError: A number cannot be.
    """

    alpha: float
    beta: float
    gamma: float

    def __post_init__(self) -> None:
        given = dataclasses.asdict(self)
        for name, value in given.items():
            checked = finite(name, value, most=MOST[name])
            object.__setattr__(self, name, checked)
        if not 0 < self.alpha < 1:
            raise ValueError(
                f"alpha is {given['alpha']!r}: "
                f"the built-up share of the ground lies between 0 and 1"
            )
        for name, unit in (("beta", "buildings per km^2"), ("gamma", "m")):
            if getattr(self, name) <= 0:
                raise ValueError(
                    f"{name} is {given[name]!r}: a positive number of {unit} is needed"
                )

    @property
    def pitch(self) -> float:
        """Side of the square block that one building has in a regular grid, m."""
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
    """Measure alpha, beta (buildings per km^2) and gamma (m) of a city; gamma is 0 of none.

    gamma is the estimate of greatest likelihood.
    """
    heights = city.heights
    density = len(heights) / (city.sides / 1000).prod()
    scale = math.sqrt((heights**2).sum() / (2 * max(len(heights), 1)))
    return city.coverage, float(density), scale


def realised(city: City, target: Statistics | None = None) -> dict[str, tuple[float, float]]:
    """Compare what a city has with what was aimed at.

    The scale of heights is the estimate of greatest likelihood. With a target there are two more
    rows. The p-value is that of the Kolmogorov-Smirnov test of the heights against the target's
    Rayleigh distribution. The width of streets is a median: one is as wide as twice the way from
    its middle, halfway between two crossings, to the nearest wall, and at most two blocks.

    Args:
        city: The city.
        target: Statistics that it was made for, if any.

    Returns:
        By the name of each statistic, with its unit: what the city has, and what was aimed at
        (NaN without a target).
    """
    heights = city.heights
    share, density, scale = parameters(city)
    # The city alone: what its parameters are by estimate
    found = {
        "built-up share": share,
        "buildings per km2": density,
        "Rayleigh scale of heights, m": scale,
        "mean height, m": float(heights.mean()),
        "greatest height, m": float(heights.max()),
    }
    if target is None:
        return {name: (value, math.nan) for name, value in found.items()}

    # Side of a block that holds one building, m; no street can be wider than two
    block = math.sqrt(city.sides.prod() / len(heights))
    # Halfway between crossings, where the walls are nearest
    middles = city.streets.nodes[city.streets.edges].mean(axis=1)
    widths = 2 * city.clearance(middles, block)
    found["width of streets, m"] = float(np.median(widths))

    from scipy import stats  # which takes longer to import than everything else

    test = stats.kstest(heights, stats.rayleigh(scale=target.gamma).cdf)
    found["KS test of heights, p"] = float(test.pvalue)
    # The same order as `found`; what the target does not tell is NaN
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
