"""A geofence: where a MAVLink vehicle may be."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_protocol import RefusedError

POLYGON_INCLUSION, POLYGON_EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = range(5001, 5005)
"""Commands of the items of which fences are made"""
FENCE_COMMANDS = (POLYGON_INCLUSION, POLYGON_EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION)
Point = tuple[float, float]


class MissionItem(NamedTuple):
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
    params: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    autocontinue: bool


class FenceArea(NamedTuple):
    """A polygon or a circle, on the plane.

    Attributes:
        keeps_in: Whether the vehicle is to stay inside; else outside.
        points: Corners, or a circle's centre, m, east and north.
        radius: Of a circle, m.
    """

    is_inclusion: bool
    points: tuple[Point, ...]
    radius: float = 0.0

    def contains(self, x: float, y: float) -> bool:
        """Tell whether a point is inside."""
        if len(self.points) == 1:
            (center,) = self.points
            return math.dist(center, (x, y)) <= self.radius
        inside = False
        # A ray to the east crosses the edges of what a point is in an odd number of times.
        for (ax, ay), (bx, by) in zip(self.points, self.points[1:] + self.points[:1], strict=True):
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                inside = not inside
        return inside


class Geofence:
    """Areas that were uploaded, and distances from home that parameters tell."""

    def __init__(self, site: Site, values: Mapping[str, float]) -> None:
        """Begin without areas.

        Args:
            site: Where the vehicle's coordinates begin.
            values: Of the parameters.
        """
        self._site, self._values = site, values
        self._areas: tuple[FenceArea, ...] = ()

    def set_items(self, items: Sequence[MissionItem]) -> None:
        """Replace the areas.

        Raises:
            RefusedError: Items make no areas; those from before stay.
        """
        areas, k = [], 0
        while k < len(items):
            count = 1
            if items[k].command in (POLYGON_INCLUSION, POLYGON_EXCLUSION):
                number = items[k].params[0]
                count = int(number) if 3 <= number <= len(items) - k else 0
            areas.append(self._make_area(items[k : k + count]))
            k += count
        self._areas = tuple(areas)

    def _make_area(self, items: Sequence[MissionItem]) -> FenceArea:
        """Make an area of its items, which are of one kind."""
        if not items or len({(item.command, item.params[0]) for item in items}) > 1:
            raise RefusedError("fence: each vertex tells how many there are, at least 3")
        first = items[0]
        positions = [self._site.from_global(item.frame, item.x, item.y, 0.0) for item in items]
        is_inclusion = first.command in (POLYGON_INCLUSION, CIRCLE_INCLUSION)
        points = tuple((x, y) for x, y, _ in positions)
        if len(points) > 1:
            return FenceArea(is_inclusion, points)
        if not first.params[0] > 0:
            raise RefusedError("fence: a circle needs a radius above 0")
        return FenceArea(is_inclusion, points, first.params[0])

    def find_breach(self, position: Sequence[float]) -> str | None:
        """Tell why a place (3,), m, is not allowed, or None where it is."""
        x, y, z = position
        start, limits = self._site.start, self._values
        distance = math.dist(start[:2], (x, y))
        if 0 < limits["GF_MAX_HOR_DIST"] < distance:
            return f"outside GF_MAX_HOR_DIST of {limits['GF_MAX_HOR_DIST']:g} m"
        if 0 < limits["GF_MAX_VER_DIST"] < z - start[2]:
            return f"outside GF_MAX_VER_DIST of {limits['GF_MAX_VER_DIST']:g} m"
        inclusive = [area for area in self._areas if area.is_inclusion]
        if inclusive and not any(area.contains(x, y) for area in inclusive):
            return "outside the fence"
        if any(area.contains(x, y) for area in self._areas if not area.is_inclusion):
            return "in a forbidden area of the fence"
        return None

    def require_inside(self, what: str, position: Sequence[float]) -> None:
        """Refuse a place that is not allowed.

        Raises:
            RefusedError: It is not.
        """
        reason = self.find_breach(position)
        if reason is not None:
            raise RefusedError(f"{what} {reason}")
