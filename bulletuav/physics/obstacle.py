"""Bodies that drones can hit and rays can see."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Obstacle:
    """`kind` "box" (size: three edges, m) or "sphere" (size: radius, m); colour red, green, blue, alpha from 0 to 1."""

    kind: str
    size: tuple[float, ...]
    colour: tuple[float, float, float, float] = (0.55, 0.57, 0.62, 1.0)

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere, m."""
        return math.hypot(*self.size) / 2 if self.kind == "box" else self.size[0]
