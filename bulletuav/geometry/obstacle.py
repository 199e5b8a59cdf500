"""Bodies that drones can hit and rays can see."""

import math
from dataclasses import dataclass

from bulletuav.errors import as_sequence, choose, finite, shown

SIZES = {"box": 3, "sphere": 1}
"""Kinds of obstacles, and how many numbers tell their size."""
LARGEST = 4096.0
"""Greatest edge or radius of an obstacle, m."""


@dataclass(frozen=True)
class Obstacle:
    """A body that stands or moves in a world, and that drones can hit.

    Attributes:
        kind: "box" or "sphere".
        size: Three edges of a box, or the radius of a sphere, m.
        colour: Red, green, blue and opacity, from 0 to 1.

    Raises:
        ValueError: The kind is unknown, or a number is out of its bounds.
    """

    kind: str
    size: tuple[float, ...]
    colour: tuple[float, float, float, float] = (0.55, 0.57, 0.62, 1.0)

    def __post_init__(self) -> None:
        choose("kind of obstacle", self.kind, SIZES)
        size = as_sequence("size of an obstacle", self.size, SIZES[self.kind])
        if min(finite("size of an obstacle", one, most=LARGEST) for one in size) <= 0:
            raise ValueError(
                f"size of an obstacle is {shown(self.size)}: metres above 0 are needed"
            )
        for share in as_sequence("colour", self.colour, 4):
            finite("colour of an obstacle", share, 0, 1)

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere, m."""
        return math.hypot(*self.size) / 2 if self.kind == "box" else self.size[0]
