"""What the items of a mission ask for: places, speeds, times."""

import math
from collections.abc import Sequence

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES, Site
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_protocol import RefusedError

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 19, 20, 21, 22
DELAY, CHANGE_SPEED = 93, 178
POSITION_COMMANDS = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, LAND, TAKEOFF)
"""Items that tell a place"""
SUPPORTED_COMMANDS = (*POSITION_COMMANDS, RETURN, DELAY, CHANGE_SPEED)
"""Items that are supported"""
UNSUPPORTED, UNSUPPORTED_FRAME, INVALID_PARAM5_X, DENIED = 3, 2, 10, 14
"""How a mission is answered that cannot be taken"""
Position = tuple[float, float, float]


class MissionError(RefusedError):
    """A mission that cannot be taken.

    Attributes:
        code: How MAVLink says so.
    """

    def __init__(self, text: str, code: int) -> None:
        """Tell why."""
        super().__init__(text)
        self.code = code


def compute_item_position(item: MissionItem, site: Site, current: Sequence[float]) -> Position:
    """Tell where an item is.

    Args:
        item: One of `POSITION_COMMANDS`. Take-offs and landings at latitude and longitude 0, or without
            them, are where the vehicle is.
        site: Where the vehicle's coordinates begin.
        present: (3,) where the vehicle is, m.

    Returns:
        The place, m.

    Raises:
        RefusedError: It cannot be.
    """
    is_at_vehicle = item.x == item.y == 0 or not math.isfinite(item.x + item.y)
    if is_at_vehicle and item.command in (TAKEOFF, LAND):
        altitude = item.z + (site.altitude if item.frame in RELATIVE_FRAMES else 0.0)
        height = site.start[2] + altitude - site.altitude
        if not math.isfinite(height):
            raise RefusedError("an altitude is no number")
        return current[0], current[1], height
    return site.from_global(item.frame, item.x, item.y, item.z)


def check_mission(
    items: Sequence[MissionItem], site: Site, fence: Geofence, max_distance: float
) -> None:
    """Check a mission before it is taken.

    Args:
        items: The mission.
        site: Where the vehicle's coordinates begin.
        fence: Where the vehicle may be.
        farthest: How far from home the first place may be, m; 0 or less for anywhere.

    Raises:
        MissionError: An item is not supported, or beyond the fence.
    """
    is_first = True
    for number, item in enumerate(items):
        if item.command not in SUPPORTED_COMMANDS:
            raise MissionError(f"item {number}: command {item.command} unknown", UNSUPPORTED)
        # Commands without a place need no frame and no fence
        if item.command not in POSITION_COMMANDS:
            continue
        if item.frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
            raise MissionError(f"item {number}: frame {item.frame} unknown", UNSUPPORTED_FRAME)
        try:
            position = compute_item_position(item, site, site.start)
            fence.require_inside(f"item {number} is", position)
        except RefusedError as error:
            raise MissionError(str(error), INVALID_PARAM5_X) from None
        # As PX4 does: a first place far away is likely of another mission
        if is_first and 0 < max_distance < math.dist(position[:2], site.start[:2]):
            raise MissionError("first item is beyond MIS_DIST_1WP", INVALID_PARAM5_X)
        is_first = False
