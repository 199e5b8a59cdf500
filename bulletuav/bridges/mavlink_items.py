"""Mission items: supported commands, positions, and validation of a mission."""

import math
from collections.abc import Collection, Sequence

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES, Site
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_protocol import RefusedError

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 19, 20, 21, 22
LOITER_TURNS, LOITER_TO_ALTITUDE, VTOL_TAKEOFF, VTOL_LAND = 18, 31, 84, 85
DELAY, JUMP, CHANGE_SPEED, LAND_START, VTOL_TRANSITION = 93, 177, 178, 189, 3000
HOVER_POSITIONS = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, LAND, TAKEOFF)
POSITION_COMMANDS = (*HOVER_POSITIONS, LOITER_TURNS, LOITER_TO_ALTITUDE, VTOL_TAKEOFF, VTOL_LAND)
"""Commands of items with a position"""
SUPPORTED_COMMANDS = (*HOVER_POSITIONS, RETURN, DELAY, JUMP, CHANGE_SPEED)
"""Commands of items that all vehicles support"""
WING_COMMANDS = (*SUPPORTED_COMMANDS, LOITER_TURNS, LOITER_TO_ALTITUDE, LAND_START)
"""Commands of items that aircraft with wings support"""
VTOL_COMMANDS = (*WING_COMMANDS, VTOL_TAKEOFF, VTOL_LAND, VTOL_TRANSITION)
"""Commands of items that VTOLs support"""
UNSUPPORTED, UNSUPPORTED_FRAME, INVALID_PARAM1, INVALID_PARAM5_X, DENIED = 3, 2, 6, 10, 14
INVALID_PARAM3 = 8
"""Error codes of a MISSION_ACK (MAV_MISSION_RESULT)"""
Position = tuple[float, float, float]


LOITER_COMMANDS = (LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, LOITER_TO_ALTITUDE)
"""Commands of items with the radius of a circle"""


def read_item_radius(item: MissionItem) -> float:
    """Return the radius of one of the `LOITER_COMMANDS`, m: negative for anticlockwise, 0 if unset.

    The radius is parameter 2 of `LOITER_TO_ALTITUDE`, and parameter 3 of the others.
    """
    radius = item.params[1 if item.command == LOITER_TO_ALTITUDE else 2]
    return radius if math.isfinite(radius) else 0.0


class MissionError(RefusedError):
    """Error for an invalid mission.

    Attributes:
        code: Error code in the MISSION_ACK.
    """

    def __init__(self, text: str, code: int) -> None:
        """Initialise with a text for a STATUSTEXT, and the error code."""
        super().__init__(text)
        self.code = code


def compute_item_position(item: MissionItem, site: Site, current: Sequence[float]) -> Position:
    """Compute the position of an item.

    Args:
        item: Item with one of the `POSITION_COMMANDS`. Take-offs and landings at latitude and
            longitude 0, or without them, are at the vehicle's present horizontal position.
        site: Start position of the vehicle.
        current: (3,) present position of the vehicle, m.

    Returns:
        The position, m.

    Raises:
        RefusedError: If the position is invalid.
    """
    is_at_vehicle = item.x == item.y == 0 or not math.isfinite(item.x + item.y)
    if is_at_vehicle and item.command in (TAKEOFF, LAND, VTOL_TAKEOFF, VTOL_LAND):
        altitude = item.z + (site.altitude if item.frame in RELATIVE_FRAMES else 0.0)
        height = site.start[2] + altitude - site.altitude
        if not math.isfinite(height):
            raise RefusedError("altitude is not a finite number")
        return current[0], current[1], height
    return site.from_global(item.frame, item.x, item.y, item.z)


def check_mission(
    items: Sequence[MissionItem],
    site: Site,
    fence: Geofence,
    max_distance: float,
    commands: Collection[int] = SUPPORTED_COMMANDS,
    min_radius: float = 0.0,
) -> None:
    """Validate a mission.

    Args:
        items: Items of the mission.
        site: Start position of the vehicle.
        fence: Geofence.
        max_distance: Maximum distance of the first position from home, m (MIS_DIST_1WP); 0 or less
            for no limit.
        commands: Commands of items that the vehicle supports.
        min_radius: Radius of the smallest loiter, m.

    Raises:
        MissionError: If an item is not supported, or breaches the geofence.
    """
    is_first = True
    for number, item in enumerate(items):
        if item.command not in commands:
            raise MissionError(f"item {number}: command {item.command} unknown", UNSUPPORTED)
        if item.command == JUMP and item.params[0] not in range(len(items)):
            raise MissionError(f"item {number}: jump to no item", INVALID_PARAM1)
        if item.command in LOITER_COMMANDS and 0 < abs(read_item_radius(item)) < min_radius:
            reason = f"item {number}: radius below {min_radius:.0f} m"
            raise MissionError(reason, INVALID_PARAM3)
        # Commands without a position have neither frame nor fence to check
        if item.command not in POSITION_COMMANDS:
            continue
        if item.frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
            raise MissionError(f"item {number}: frame {item.frame} unknown", UNSUPPORTED_FRAME)
        try:
            position = compute_item_position(item, site, site.start)
            fence.require_inside(f"item {number} is", position)
        except RefusedError as error:
            raise MissionError(str(error), INVALID_PARAM5_X) from None
        # As in PX4: a distant first waypoint suggests a mission for another site
        if is_first and 0 < max_distance < math.dist(position[:2], site.start[:2]):
            raise MissionError("first item is beyond MIS_DIST_1WP", INVALID_PARAM5_X)
        is_first = False
