"""A geofence: where a MAVLink vehicle may be."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bulletuav.bridges.mavlink_places import Site
from bulletuav.bridges.mavlink_wire import RefusedError

INSIDE_POLYGON, OUTSIDE_POLYGON, INSIDE_CIRCLE, OUTSIDE_CIRCLE = range(5001, 5005)
"""Commands of the items of which fences are made"""
FENCE_ITEMS = (INSIDE_POLYGON, OUTSIDE_POLYGON, INSIDE_CIRCLE, OUTSIDE_CIRCLE)
Flat = tuple[float, float]


class Item(NamedTuple):
    """An item of a mission or of a fence, as clients upload it.

    Attributes:
        frame: MAVLink's frame.
        command: What to do, or what part of a fence it is.
        numbers: (4,) parameters; NaN for left out.
        x, y: Latitude and longitude, deg, in frames of the Earth.
        z: Altitude, m.
        goes_on: Whether the next item follows by itself.
    """

    frame: int
    command: int
    numbers: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    goes_on: bool


class Area(NamedTuple):
    """A polygon or a circle, on the plane.

    Attributes:
        keeps_in: Whether the vehicle is to stay inside; else outside.
        points: Corners, or a circle's centre, m, east and north.
        radius: Of a circle, m.
    """

    keeps_in: bool
    points: tuple[Flat, ...]
    radius: float = 0.0

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a point is inside."""
        if len(self.points) == 1:
            (middle,) = self.points
            return math.dist(middle, (x, y)) <= self.radius
        inside = False
        # A ray to the east crosses the edges of what a point is in an odd number of times.
        for (ax, ay), (bx, by) in zip(self.points, self.points[1:] + self.points[:1], strict=True):
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                inside = not inside
        return inside


class Fence:
    """Areas that were uploaded, and distances from home that parameters tell."""

    def __init__(self, site: Site, values: Mapping[str, float]) -> None:
        """Begin without areas.

        Args:
            site: Where the vehicle's coordinates begin.
            values: Of the parameters.
        """
        self._site, self._values = site, values
        self._areas: tuple[Area, ...] = ()

    def take(self, items: Sequence[Item]) -> None:
        """Replace the areas.

        Raises:
            RefusedError: Items make no areas; those from before stay.
        """
        areas, k = [], 0
        while k < len(items):
            count = 1
            if items[k].command in (INSIDE_POLYGON, OUTSIDE_POLYGON):
                number = items[k].numbers[0]
                count = int(number) if 3 <= number <= len(items) - k else 0
            areas.append(self._area(items[k : k + count]))
            k += count
        self._areas = tuple(areas)

    def _area(self, items: Sequence[Item]) -> Area:
        """Make an area of its items, which are of one kind."""
        if not items or len({(one.command, one.numbers[0]) for one in items}) > 1:
            raise RefusedError("fence: each vertex tells how many there are, at least 3")
        first = items[0]
        places = [self._site.of_global(one.frame, one.x, one.y, 0.0) for one in items]
        keeps_in = first.command in (INSIDE_POLYGON, INSIDE_CIRCLE)
        points = tuple((x, y) for x, y, _ in places)
        if len(points) > 1:
            return Area(keeps_in, points)
        if not first.numbers[0] > 0:
            raise RefusedError("fence: a circle needs a radius above 0")
        return Area(keeps_in, points, first.numbers[0])

    def refusal(self, place: Sequence[float]) -> str | None:
        """Tell why a place (3,), m, is not allowed, or None where it is."""
        x, y, z = place
        begin, most = self._site.start, self._values
        flat = math.dist(begin[:2], (x, y))
        if 0 < most["GF_MAX_HOR_DIST"] < flat:
            return f"outside GF_MAX_HOR_DIST of {most['GF_MAX_HOR_DIST']:g} m"
        if 0 < most["GF_MAX_VER_DIST"] < z - begin[2]:
            return f"outside GF_MAX_VER_DIST of {most['GF_MAX_VER_DIST']:g} m"
        inclusive = [area for area in self._areas if area.keeps_in]
        if inclusive and not any(area.holds(x, y) for area in inclusive):
            return "outside the fence"
        if any(area.holds(x, y) for area in self._areas if not area.keeps_in):
            return "in a forbidden area of the fence"
        return None

    def check(self, what: str, place: Sequence[float]) -> None:
        """Refuse a place that is not allowed.

        Raises:
            RefusedError: It is not.
        """
        reason = self.refusal(place)
        if reason is not None:
            raise RefusedError(f"{what} {reason}")
