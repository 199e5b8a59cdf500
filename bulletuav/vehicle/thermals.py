"""Thermals: columns of rising air in the convective layer, with sinking air between them.

The model is Allen's. Its updrafts have the size and mean velocity of measurements in the convective
layer, a bell-shaped velocity across the column, and sinking air around them that returns their
flux. Each point feels the nearest thermal only. Thermals stay where they are: no wind carries or
tilts them (our choice), and the air moves vertically only.

References:
    M. J. Allen, Updraft Model for Development of Autonomous Soaring Uninhabited Air Vehicles, AIAA
    2006-1510 (NTRS 20060004052).
    D. H. Lenschow, P. L. Stephens, The role of thermals in the convective boundary layer,
    Boundary-Layer Meteorology 19 (1980): size, strength and number of thermals.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.compiled.functions import PI, power, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.errors import as_instance, as_int, as_sequence, finite

SHAPES = np.array(
    [
        [1.5352, 2.5826, -0.0113, -0.1950],
        [1.5265, 3.6054, -0.0176, -0.1265],
        [1.4866, 4.8356, -0.0320, -0.0818],
        [1.2042, 7.7904, 0.0848, -0.0445],
        [0.8816, 13.9720, 0.3404, -0.0216],
        [0.7067, 23.9940, 0.5689, -0.0099],
        [0.6189, 42.7965, 0.7157, -0.0033],
    ]
)
"""Constants k1 to k4 of the velocity across a thermal, for ratios of inner to outer radius of 0.14,
0.25, ... 0.80, as in the computer code that is the appendix of Allen's report.
"""
MIN_RATIO, RATIO_STEP = 0.14, 0.11
"""First ratio of `SHAPES`, and the step to the next one."""
MIN_RADIUS = 10.0
"""Minimum outer radius, m."""
TOP = 1.0 / 1.1
"""Height at which thermals end, as a fraction of the convective layer's depth: their mean velocity
is 0 there, and would be negative above.
"""
MAX_RADIUS_RATIO = 0.0765
"""Maximum outer radius, as a fraction of the convective layer's depth."""
MAX_THERMALS = 1000
"""Maximum number of thermals of a world."""
CROSSED = 1.2
"""Thermals that a straight flight of the length of the layer's depth crosses (Lenschow and
Stephens)."""


@dataclass(frozen=True)
class Thermals:
    """Thermals of a world.

    Attributes:
        strength: Convective velocity scale w*, m/s.
        depth: Depth of the convective layer z_i, m: thermals end at 10/11 of it.
        side: Side of the square around the world's origin in which thermals are drawn, m. Air that
            rises in it sinks in it.
        count: Number of thermals, which are drawn in each episode; None for the number of Lenschow
            and Stephens.
        centres: Positions (x, y) of thermals that are not drawn, m; None to draw them.
    """

    strength: float = 2.5
    depth: float = 1400.0
    side: float = 3000.0
    count: int | None = None
    centres: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        for name, least, most in (
            ("strength", 0.1, 10.0),
            ("depth", 100.0, 5000.0),
            ("side", 100.0, 100_000.0),
        ):
            value = finite(f"thermals: {name}", getattr(self, name), least, most)
            object.__setattr__(self, name, value)
        if self.count is not None:
            object.__setattr__(
                self, "count", as_int("thermals: count", self.count, 1, MAX_THERMALS)
            )
        if self.centres is not None:
            if self.count is not None:
                raise ValueError(
                    f"thermals has centres and a count of {self.count}: leave out count, which is "
                    f"the number of thermals that are drawn"
                )
            given = as_sequence("thermals: centres", self.centres, most=MAX_THERMALS)
            places = [as_sequence("thermals: a centre", one, 2) for one in given]
            kept = tuple(
                (finite("thermals: x of a centre", x), finite("thermals: y of a centre", y))
                for x, y in places
            )
            object.__setattr__(self, "centres", kept)
            if not kept:
                raise ValueError("thermals: centres is empty: give a centre, or None to draw them")
        radius = max(MAX_RADIUS_RATIO * self.depth, MIN_RADIUS)
        if not self.number * math.pi * radius * radius < 0.5 * self.area:
            raise ValueError(
                f"thermals: {self.number} thermals of up to {radius:.3g} m cover more than half of "
                f"a square of {self.side:g} m: use fewer, a larger side or a smaller depth"
            )

    @property
    def area(self) -> float:
        """Area of the square in which the thermals are, m^2."""
        return self.side * self.side

    @property
    def number(self) -> int:
        """Number of thermals."""
        if self.centres is not None:
            return len(self.centres)
        if self.count is not None:
            return self.count
        # A flight of length L crosses 2 r L / side^2 of each thermal of radius r
        radius = thermal_radius(0.5, self.depth)
        crossed = CROSSED / self.depth * self.area / (2.0 * radius)
        return min(max(round(crossed), 1), MAX_THERMALS)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Return the centres (C, 2) of an episode, m."""
        if self.centres is not None:
            return np.array(self.centres)
        return self.side * (rng.random((self.number, 2)) - 0.5)


def as_thermals(given: Any) -> Thermals | None:
    """Check and convert the option `thermals`.

    Args:
        given: Thermals, a dict of their attributes, or None.

    Returns:
        The thermals, None for None.

    Raises:
        ValueError: If the value is none of these, or an attribute is unknown or invalid.
    """
    return None if given is None else as_instance("thermals", Thermals, given)


@func
def thermal_radius(ratio: float, depth: float) -> float:
    """Return the outer radius of a thermal, m.

    Args:
        ratio: Height divided by the depth of the convective layer, from 0 to 1.
        depth: Depth of the convective layer, m.
    """
    mean = 0.102 * power(ratio, 1.0 / 3.0) * (1.0 - 0.25 * ratio) * depth
    return max(mean, MIN_RADIUS)


@func
def updraft_velocity(
    distance: float, height: float, strength: float, depth: float, number: int, area: float
) -> float:
    """Return the vertical velocity of the air at a distance from the nearest thermal, m/s.

    Args:
        distance: Horizontal distance from the centre of the thermal, m.
        height: Height above the ground, m.
        strength: Convective velocity scale w*, m/s.
        depth: Depth of the convective layer, m.
        number: Number of thermals.
        area: Horizontal area in which they are, m^2.
    """
    ratio = height / depth
    if ratio <= 0.0 or ratio >= TOP:
        return 0.0
    # Mean velocity over the column
    mean = power(ratio, 1.0 / 3.0) * (1.0 - 1.1 * ratio) * strength
    outer = thermal_radius(ratio, depth)
    inner_ratio = min(0.0011 * outer + 0.14, 0.8)
    inner = inner_ratio * outer
    # The mean of a frustum of this height and these radii is that velocity
    peak = 3.0 * mean * (1.0 - inner_ratio) / (1.0 - inner_ratio * inner_ratio * inner_ratio)
    place = distance / outer
    k = min(int((inner_ratio - MIN_RATIO) / RATIO_STEP + 0.5), SHAPES.shape[0] - 1)
    k1, k2, k3, k4 = SHAPES[k, 0], SHAPES[k, 1], SHAPES[k, 2], SHAPES[k, 3]
    bell = max(1.0 / (1.0 + power(k1 * abs(place + k3), k2)) + k4 * place, 0.0)
    # Downdraft around the column in the upper half of the layer
    sinking = min(max(2.5 * (ratio - 0.5), 0.0), 1.0)
    ring = 0.0
    if distance > inner and place < 2.0:
        ring = min(sinking * (PI / 6.0) * sin(PI * place), 0.0)
    velocity: float = bell * peak + ring * mean
    # Sinking air between the thermals
    covered = number * PI * outer * outer
    between = -covered * mean * (1.0 - sinking) / (area - covered)
    if distance > inner:
        velocity = velocity * (1.0 - between / peak) + between
    return velocity


@kernel
def add_thermals(
    centres: np.ndarray,
    position: np.ndarray,
    strength: float,
    depth: float,
    area: float,
    wind: np.ndarray,
) -> None:
    """Add the vertical velocity of the air at given positions to the wind.

    Args:
        centres: (W, C, 2) centres of the thermals of each world, m.
        position: (W, N, 3) positions, m.
        strength: Convective velocity scale w*, m/s.
        depth: Depth of the convective layer, m.
        area: Horizontal area in which the thermals are, m^2.
        wind: (W, N, 3) wind, m/s, to which the updrafts are added in place.
    """
    number = centres.shape[1]
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            nearest = math.inf
            for c in range(number):
                x = position[w, i, 0] - centres[w, c, 0]
                y = position[w, i, 1] - centres[w, c, 1]
                nearest = min(nearest, x * x + y * y)
            distance, height = math.sqrt(nearest), position[w, i, 2]
            wind[w, i, 2] += updraft_velocity(distance, height, strength, depth, number, area)
