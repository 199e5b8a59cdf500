"""Geofence of a MAVLink vehicle, and the mission items by which clients upload it."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_protocol import RefusedError

POLYGON_INCLUSION, POLYGON_EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = range(5001, 5005)
"""Commands of fence items (MAV_CMD_NAV_FENCE_...)"""
FENCE_COMMANDS = (POLYGON_INCLUSION, POLYGON_EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION)
Point = tuple[float, float]


class MissionItem(NamedTuple):
    """Item of a mission or of a geofence, as clients upload it.

    Attributes:
        frame: MAVLink frame.
        command: Command, or kind of fence area.
        params: (4,) parameters; NaN if unset.
        x, y: Latitude and longitude, deg, in global frames.
        z: Altitude, m.
        autocontinue: Whether to continue with the next item automatically.
    """

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    autocontinue: bool


class FenceArea(NamedTuple):
    """Polygon or circle in the horizontal plane.

    Attributes:
        is_inclusion: Whether the vehicle must stay inside; otherwise it must stay outside.
        points: Vertices of a polygon, or centre of a circle, east and north, m.
        radius: Radius of a circle, m.
    """

    is_inclusion: bool
    points: tuple[Point, ...]
    radius: float = 0.0

    def contains(self, x: float, y: float) -> bool:
        """Return True if a point is inside the area."""
        if len(self.points) == 1:
            (center,) = self.points
            return math.dist(center, (x, y)) < self.radius
        inside = False
        # Ray casting: a ray from an inside point crosses the edges an odd number of times
        for (ax, ay), (bx, by) in zip(self.points, self.points[1:] + self.points[:1], strict=True):
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                inside = not inside
        return inside


class Geofence:
    """Geofence: uploaded areas, and maximum distances from home as parameters."""

    def __init__(self, site: Site, values: Mapping[str, float]) -> None:
        """Initialise without areas.

        Args:
            site: Start position of the vehicle.
            values: Values of the parameters.
        """
        self._site, self._values = site, values
        self._areas: tuple[FenceArea, ...] = ()

    def set_items(self, items: Sequence[MissionItem]) -> None:
        """Replace the areas by uploaded items.

        Raises:
            RefusedError: If the items do not form valid areas. The previous areas remain.
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
        """Make an area of its items, which must be of one kind."""
        if not items or len({(item.command, item.params[0]) for item in items}) > 1:
            raise RefusedError("fence: need 3 or more vertices with equal counts")
        first = items[0]
        is_circle = first.command in (CIRCLE_INCLUSION, CIRCLE_EXCLUSION)
        is_inclusion = first.command in (POLYGON_INCLUSION, CIRCLE_INCLUSION)
        if is_circle and not first.params[0] >= 0:
            raise RefusedError("fence: a circle needs a radius of 0 or more")
        # As in PX4, a circle of radius 0 contains nothing, wherever it is
        if is_circle and first.params[0] == 0:
            return FenceArea(is_inclusion, ((0.0, 0.0),))
        positions = [self._site.from_global(item.frame, item.x, item.y, 0.0) for item in items]
        points = tuple((x, y) for x, y, _ in positions)
        if len(points) > 1:
            return FenceArea(is_inclusion, points)
        return FenceArea(is_inclusion, points, first.params[0])

    def find_breach(self, position: Sequence[float]) -> str | None:
        """Return the reason why a position (3,), m, breaches the fence, or None if it does not."""
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
            return "in an exclusion area of the fence"
        return None

    def require_inside(self, what: str, position: Sequence[float]) -> None:
        """Check that a position does not breach the fence.

        Args:
            what: Start of the error message, such as "setpoint is".
            position: (3,) position, m.

        Raises:
            RefusedError: If the position breaches the fence.
        """
        reason = self.find_breach(position)
        if reason is not None:
            raise RefusedError(f"{what} {reason}")
