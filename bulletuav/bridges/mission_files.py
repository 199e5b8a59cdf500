"""Mission files of ground stations: QGroundControl's plans, and waypoint files.

Sources: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html and
https://mavlink.io/en/file_formats/#mission_plain_text_file.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES, Site
from bulletuav.bridges.mavlink_fence import (
    CIRCLE_EXCLUSION,
    CIRCLE_INCLUSION,
    POLYGON_EXCLUSION,
    POLYGON_INCLUSION,
    MissionItem,
)
from bulletuav.bridges.mavlink_items import (
    CHANGE_SPEED,
    JUMP,
    LAND,
    POSITION_COMMANDS,
    SUPPORTED_COMMANDS,
    TAKEOFF,
    WAYPOINT,
    compute_item_position,
)
from bulletuav.earth import Origin
from bulletuav.errors import as_sequence, finite, naming, read_file, require_file, shown
from bulletuav.parsing import parse_json, parse_number

MAX_FILE_SIZE, MAX_ITEMS, MAX_FENCE_POINTS = 10_000_000, 10_000, 2_000
"""Maximum size of a file, bytes, and numbers of items and of points of a geofence"""
WAYPOINT_HEADER = "QGC WPL"
NUM_COLUMNS = 12
"""Number of columns of a waypoint file"""
TERRAIN_FRAMES = (10, 11)
"""MAVLink frames with the altitude above the terrain"""
MISSION_FRAME = 2
"""Frame of items without a position (MAV_FRAME_MISSION)"""
NO_CHANGE = MissionItem(MISSION_FRAME, CHANGE_SPEED, (0.0, -1.0, -1.0, 0.0), 0.0, 0.0, 0.0, True)
"""Item without an effect, which replaces items that cannot be flown"""
REPLACED_COMMANDS = {
    18: (WAYPOINT, "LOITER_TURNS is flown as a waypoint, without circles"),
    31: (WAYPOINT, "LOITER_TO_ALT is flown as a waypoint"),
    82: (WAYPOINT, "SPLINE_WAYPOINT is flown on a straight leg"),
    84: (TAKEOFF, "VTOL_TAKEOFF is flown as a take-off"),
    85: (LAND, "VTOL_LAND is flown as a landing"),
}
"""Commands that are flown as other ones, and notes about them"""
COMMAND_NAMES = {
    94: "PAYLOAD_PLACE",
    112: "CONDITION_DELAY",
    114: "CONDITION_DISTANCE",
    115: "CONDITION_YAW",
    179: "DO_SET_HOME",
    181: "DO_SET_RELAY",
    183: "DO_SET_SERVO",
    189: "DO_LAND_START",
    195: "DO_SET_ROI_LOCATION",
    197: "DO_SET_ROI_NONE",
    200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI",
    203: "DO_DIGICAM_CONTROL",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    207: "DO_FENCE_ENABLE",
    211: "DO_GRIPPER",
    530: "SET_CAMERA_MODE",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
}
"""Names of frequent commands that are not flown (MAV_CMD)"""
Position3 = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Mission:
    """Mission of a file, in the form that a MAVLink vehicle flies.

    Attributes:
        path: The file.
        home: Latitude and longitude, deg, and altitude, m, of the start on the ground.
        items: Items by their MAVLink sequence number, from 0 on. Items that cannot be flown are
            replaced by items without an effect.
        fence: Items of the geofence.
        speed: Speed of the legs, m/s; None if the file has none.
        notes: What the file has and is not flown, or not as the file says.
    """

    path: Path
    home: Position3
    items: tuple[MissionItem, ...]
    fence: tuple[MissionItem, ...]
    speed: float | None
    notes: tuple[str, ...]

    def waypoints(self) -> np.ndarray:
        """Compute the positions of all items that have one, in local axes about home.

        Returns:
            (M, 3) east, north and up of home, m. Take-offs and landings without coordinates are
            above the position before.
        """
        origin = Origin(*self.home)
        site, place, found = Site.from_start(origin, np.zeros(3)), (0.0, 0.0, 0.0), []
        for item in self.items:
            if item.command in POSITION_COMMANDS:
                place = compute_item_position(item, site, place)
                found.append(place)
        return np.array(found).reshape(-1, 3)


def read_mission(path: str | Path, home: Sequence[float] | None = None) -> Mission:
    """Read a mission: a plan of QGroundControl (JSON), or a waypoint file ("QGC WPL 110").

    Args:
        path: The file.
        home: Latitude, longitude (deg) and altitude (m) of the start; by default those of the file.
            In a waypoint file, home is item 0, if this is a waypoint in frame 0.

    Returns:
        The mission.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file is damaged, or has no home or no item that can be flown. The message
            contains the file, the value and a remedy.
    """
    found = require_file("mission", path, "pass a .plan or .waypoints file of a ground station")
    if found.stat().st_size > MAX_FILE_SIZE:
        raise ValueError(
            f"{found} has {found.stat().st_size} bytes: at most {MAX_FILE_SIZE} are read; split "
            f"the mission"
        )
    text = read_file(found)
    with naming(found):
        start = None if home is None else _check_home("home", home)
        if text.lstrip().startswith(WAYPOINT_HEADER):
            return _read_waypoint_file(found, text, start)
        if not text.lstrip().startswith("{"):
            raise ValueError(
                f"neither a plan of QGroundControl (JSON) nor a waypoint file, which begins with "
                f"'{WAYPOINT_HEADER} 110': it begins with {shown(text[:20])}"
            )
        return _read_plan(found, parse_json(text, str(found)), start)


def _check_home(name: str, value: Any) -> Position3:
    """Check latitude, longitude and altitude."""
    latitude, longitude, altitude = as_sequence(name, value, 3)
    position = (
        finite(f"latitude of {name}", latitude, -90, 90),
        finite(f"longitude of {name}", longitude, -180, 180),
        finite(f"altitude of {name}", 0.0 if altitude is None else altitude, -1e4, 1e5),
    )
    return position


class _Items:
    """Items that are collected from a file, with notes about those that are not flown."""

    def __init__(self) -> None:
        self.items: list[MissionItem] = []
        self.notes: list[str] = []

    def add(self, item: MissionItem) -> None:
        """Append an item, or an item without an effect in its place."""
        number = len(self.items)
        if number >= MAX_ITEMS:
            raise ValueError(f"more than {MAX_ITEMS} items: split the mission")
        if item.command in REPLACED_COMMANDS:
            command, note = REPLACED_COMMANDS[item.command]
            # Their parameters have other meanings, except for the yaw
            item = item._replace(command=command, params=(0.0, 0.0, 0.0, math.nan))
            self.notes.append(f"item {number}: {note}")
        if item.command not in SUPPORTED_COMMANDS:
            name = COMMAND_NAMES.get(item.command, "unknown")
            self.skip(f"command {item.command} ({name}) is not flown")
            return
        if item.command in POSITION_COMMANDS:
            if item.frame in TERRAIN_FRAMES:
                self.notes.append(f"item {number}: altitude above terrain is taken above home")
                item = item._replace(frame=RELATIVE_FRAMES[0])
            if item.frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
                raise ValueError(
                    f"item {number} has frame {item.frame}: 0, 3, 5, 6, 10 or 11 (latitude and "
                    f"longitude) is needed"
                )
        self.items.append(item)

    def skip(self, note: str) -> None:
        """Append an item without an effect, and a note."""
        self.notes.append(f"item {len(self.items)}: {note}")
        self.items.append(NO_CHANGE)

    def finish(
        self, path: Path, home: Position3 | None, fence: Iterable[MissionItem], speed: float | None
    ) -> Mission:
        """Return the mission."""
        if home is None:
            raise ValueError(
                "the file has no home position: pass one, `home` or --home LATITUDE LONGITUDE "
                "ALTITUDE"
            )
        if not any(item.command in POSITION_COMMANDS for item in self.items):
            what = "; ".join(self.notes[:3]) or "it has no items"
            raise ValueError(f"no item can be flown ({what}): add a waypoint")
        return Mission(path, home, tuple(self.items), tuple(fence), speed, tuple(self.notes))


# Waypoint files


def _read_waypoint_file(path: Path, text: str, home: Position3 | None) -> Mission:
    """Read a waypoint file, whose lines are items of 12 numbers."""
    header, *lines = text.lstrip().splitlines()
    if header.split() != [*WAYPOINT_HEADER.split(), "110"]:
        raise ValueError(
            f"its first line is {shown(header)}: version 110, '{WAYPOINT_HEADER} 110', is needed"
        )
    collected = _Items()
    for number, line in enumerate(lines, start=2):
        if not line.strip() or line.startswith("#"):
            continue
        item = _parse_row(number, line, len(collected.items))
        is_home = not collected.items and item.frame == 0 and item.command == WAYPOINT
        if is_home:
            home = home or _check_home("item 0", (item.x, item.y, item.z))
            collected.items.append(NO_CHANGE)
        else:
            collected.add(item)
    return collected.finish(path, home, (), None)


def _parse_row(number: int, line: str, sequence: int) -> MissionItem:
    """Parse a line of a waypoint file.

    Args:
        number: Number of the line, for messages.
        line: Twelve numbers, separated by white space.
        sequence: Expected sequence number.
    """
    cells = line.split()
    if len(cells) != NUM_COLUMNS:
        raise ValueError(
            f"line {number} has {len(cells)} columns: {NUM_COLUMNS} are needed (index, current, "
            f"frame, command, 4 parameters, latitude, longitude, altitude, autocontinue)"
        )
    try:
        values = [parse_number(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(f"line {number}: {error}") from None
    whole = [_whole(f"line {number}: {name}", values[k]) for k, name in WHOLE_COLUMNS]
    if whole[0] != sequence:
        raise ValueError(
            f"line {number} has the index {whole[0]}: {sequence} is next; number the items from 0"
        )
    _, frame, command, autocontinue = whole
    p1, p2, p3, p4, x, y, z = values[4:11]
    return MissionItem(frame, command, (p1, p2, p3, p4), x, y, z, bool(autocontinue))


WHOLE_COLUMNS = ((0, "index"), (2, "frame"), (3, "command"), (11, "autocontinue"))


def _whole(name: str, value: Any) -> int:
    """Check that a number is a whole one from 0 to 65535."""
    number = finite(name, value, 0, 65535)
    if number != int(number):
        raise ValueError(f"{name} is {shown(value)}: a whole number is needed")
    return int(number)


# Plans


def _read_plan(path: Path, plan: Any, home: Position3 | None) -> Mission:
    """Read a plan of QGroundControl."""
    mission = plan.get("mission")
    if plan.get("fileType") != "Plan" or not isinstance(mission, dict):
        what = shown(plan.get("fileType"))
        raise ValueError(
            f"fileType is {what} and mission is {shown(mission)}: a plan with fileType 'Plan' and "
            f"a mission is needed; save it again in QGroundControl"
        )
    for where, owner, version in (("the plan", plan, 1), ("the mission", mission, 2)):
        if owner.get("version", version) != version:
            raise ValueError(
                f"version of {where} is {shown(owner['version'])}: {version} is needed; save it "
                f"again in QGroundControl"
            )
    planned = mission.get("plannedHomePosition")
    if home is None and planned is not None:
        home = _check_home("plannedHomePosition", planned)
    collected, ids = _Items(), dict[int, list[int]]()
    for each in _list(mission, "items", "mission"):
        for item in _expand(each, collected):
            identifier = item.get("doJumpId")
            if isinstance(identifier, int):
                ids.setdefault(identifier, []).append(len(collected.items))
            collected.add(_parse_item(item, len(collected.items)))
    _set_jumps(collected.items, ids)
    speed = mission.get("hoverSpeed")
    fence = _read_fence(plan.get("geoFence"), collected.notes)
    rally = plan.get("rallyPoints")
    points = _list(rally, "points", "rallyPoints") if isinstance(rally, dict) else []
    if points:
        collected.notes.append(f"{len(points)} rally points are not used: a return flies home")
    return collected.finish(
        path, home, fence, None if speed is None else finite("hoverSpeed", speed, 0.1, 100)
    )


def _list(owner: dict[str, Any], name: str, where: str) -> list[Any]:
    """Return a list of a JSON object, empty if there is none."""
    value = owner.get(name, [])
    if not isinstance(value, list):
        raise ValueError(f"{name} of {where} is {shown(value)}: a list is needed")
    return value


def _expand(item: Any, collected: _Items) -> list[dict[str, Any]]:
    """Return the simple items of an item; note a complex item that has none."""
    number = len(collected.items)
    if not isinstance(item, dict):
        raise ValueError(f"item {number} is {shown(item)}: names and values are needed")
    if item.get("type") != "ComplexItem":
        return [item]
    kind = shown(item.get("complexItemType"))
    transects = item.get("TransectStyleComplexItem", item)
    if not isinstance(transects, dict):
        raise ValueError(f"item {number}: TransectStyleComplexItem has no names and values")
    inner = _list(transects, "Items", f"item {number}")
    if not inner:
        collected.skip(
            f"the complex item {kind} has no stored items and is not flown: save the mission as a "
            f"waypoint file, which has them"
        )
    if not all(isinstance(one, dict) and one.get("type") != "ComplexItem" for one in inner):
        raise ValueError(f"item {number}: the items of {kind} are not simple items")
    return inner


def _parse_item(item: dict[str, Any], number: int) -> MissionItem:
    """Parse a simple item."""
    command = _whole(f"command of item {number}", item.get("command"))
    frame = _whole(f"frame of item {number}", item.get("frame", MISSION_FRAME))
    if "params" in item:
        given = as_sequence(f"params of item {number}", item["params"], 7)
    # Plans of 2016 and before
    else:
        place = as_sequence(f"coordinate of item {number}", item.get("coordinate"), 3)
        given = (*(item.get(f"param{k}", 0) for k in range(1, 5)), *place)
    values = [
        math.nan if value is None else finite(f"parameter {k} of item {number}", value)
        for k, value in enumerate(given, start=1)
    ]
    p1, p2, p3, p4, x, y, z = values
    # QGroundControl leaves altitudes empty that follow from the terrain
    if math.isnan(z) and item.get("Altitude") is not None:
        z = finite(f"Altitude of item {number}", item["Altitude"])
        frame = TERRAIN_FRAMES[0]
    if command == WAYPOINT:
        for name, value in (("latitude", x), ("longitude", y), ("altitude", z)):
            if math.isnan(value):
                raise ValueError(f"item {number}: its {name} is missing, and a number is needed")
    return MissionItem(
        frame, command, (p1, p2, p3, p4), x, y, z, item.get("autoContinue", True) is True
    )


def _set_jumps(items: list[MissionItem], ids: dict[int, list[int]]) -> None:
    """Replace the identifiers to which items jump by sequence numbers."""
    for number, item in enumerate(items):
        if item.command == JUMP:
            target = item.params[0]
            found = ids.get(int(target), []) if math.isfinite(target) else []
            if len(found) != 1:
                raise ValueError(
                    f"item {number} jumps to doJumpId {target:g}, which {len(found)} items have: "
                    f"one is needed"
                )
            items[number] = item._replace(params=(float(found[0]), *item.params[1:]))


def _read_fence(fence: Any, notes: list[str]) -> list[MissionItem]:
    """Read the geofence of a plan as MAVLink's items."""
    if fence is None:
        return []
    if not isinstance(fence, dict):
        raise ValueError(f"geoFence is {shown(fence)}: names and values are needed")
    if fence.get("breachReturn") is not None:
        notes.append("geofence: breachReturn is not used: the vehicle holds after a breach")
    items = []
    for kind, commands in FENCE_KINDS.items():
        for k, area in enumerate(_list(fence, kind, "geoFence")):
            where = f"geofence, {kind}[{k}]"
            if not isinstance(area, dict) or not isinstance(area.get("inclusion", True), bool):
                raise ValueError(f"{where}: inclusion is needed, true or false")
            items += _read_area(where, area, commands[not area.get("inclusion", True)])
    if len(items) > MAX_FENCE_POINTS:
        raise ValueError(f"the geofence has {len(items)} points: at most {MAX_FENCE_POINTS}")
    return items


FENCE_KINDS = {
    "polygons": (POLYGON_INCLUSION, POLYGON_EXCLUSION),
    "circles": (CIRCLE_INCLUSION, CIRCLE_EXCLUSION),
}
"""Commands of areas that include or exclude, by their names in a plan"""


def _read_area(where: str, area: dict[str, Any], command: int) -> list[MissionItem]:
    """Read a polygon or a circle of a geofence."""
    if command in FENCE_KINDS["polygons"]:
        points = _list(area, "polygon", where)
        if len(points) < 3:
            raise ValueError(f"{where} has {len(points)} points: at least 3 are needed")
        first = float(len(points))
    else:
        circle = area.get("circle")
        if not isinstance(circle, dict):
            raise ValueError(f"{where}: circle is {shown(circle)}: centre and radius are needed")
        points = [circle.get("center")]
        first = finite(f"radius of {where}", circle.get("radius"), 1e-3, 1e5)
    corners = [_check_home(where, (*as_sequence(where, point, 2), 0.0)) for point in points]
    frame, params = RELATIVE_FRAMES[0], (first, 0.0, 0.0, 0.0)
    return [MissionItem(frame, command, params, x, y, 0.0, True) for x, y, _ in corners]
