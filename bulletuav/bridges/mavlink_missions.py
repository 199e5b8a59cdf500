"""MAVLink mission protocol: upload, download and clearing of missions, fences and rally points.

Source: https://mavlink.io/en/services/mission.html.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES
from bulletuav.bridges.mavlink_fence import FENCE_COMMANDS, Geofence, MissionItem
from bulletuav.bridges.mavlink_items import DENIED, UNSUPPORTED, MissionError
from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage, RefusedError, Sender, text

MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255
"""Mission types (MAV_MISSION_TYPE)"""
RALLY_POINT = 5100
"""Command of the items of rally points (MAV_CMD_NAV_RALLY_POINT)"""
ACCEPTED, ERROR, NO_SPACE, BAD_SEQUENCE, CANCELLED = 0, 1, 4, 13, 15
"""Result codes of a MISSION_ACK, besides those of `mavlink_items`"""
MAX_MISSION_ITEMS = 500
ITEM_TIMEOUT, MAX_TRIES = 1.0, 5
"""Time after which a missing item is requested again, s, and maximum number of requests"""
UNSET_INT32 = 2**31 - 1
"""Value of an unset latitude or longitude"""
MissionCheck = Callable[[tuple[MissionItem, ...]], None]


class MissionUpload(NamedTuple):
    """Upload of items that is in progress.

    Attributes:
        sender: Client that uploads.
        mission_type: Mission type of the list.
        total: Number of items.
        items: Items received so far.
        is_float: Whether items are requested as MISSION_ITEM, with degrees as floats.
        requested_time: Time of the last request, s.
        tries: Number of requests of the next item.
    """

    sender: Sender
    mission_type: int
    total: int
    items: tuple[MissionItem, ...] = ()
    is_float: bool = False
    requested_time: float = 0.0
    tries: int = 1


class MissionService:
    """Item lists of one vehicle, and the messages of the mission protocol.

    Attributes:
        lists: Items by mission type.
    """

    def __init__(
        self,
        check: MissionCheck,
        fence: Geofence,
        set_rally_points: MissionCheck,
        on_change: Callable[[], None],
    ) -> None:
        """Initialise with empty lists.

        Args:
            check: Function that raises RefusedError if a mission is invalid.
            fence: Geofence, which uploaded fence items replace.
            set_rally_points: Function that takes the rally points, or raises RefusedError.
            on_change: Function that is called after the mission has changed.
        """
        self._check, self._fence, self._on_change = check, fence, on_change
        self._set_rally_points = set_rally_points
        self.lists: dict[int, tuple[MissionItem, ...]] = {MISSION: (), FENCE: (), RALLY: ()}
        self._upload: MissionUpload | None = None

    def answer(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Handle a message of the mission protocol.

        Args:
            message: The message.
            sender: Sender of the message.
            now: Time, s.

        Returns:
            Messages to send back.
        """
        message_type = message.get_type()
        # A client that answers a request by MISSION_ACK cancels its upload
        if message_type == "MISSION_ACK":
            if self._is_uploading(sender):
                self._upload = None
            return []
        if message_type in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            return self._add_item(message, sender, now)
        # Missions, geofences and rally points are separate lists
        mission_type = message.mission_type
        if message_type == "MISSION_CLEAR_ALL":
            return self._clear(mission_type, sender)
        if mission_type not in self.lists:
            return [_ack(sender, UNSUPPORTED, mission_type)]
        if message_type == "MISSION_REQUEST_LIST":
            return [
                OutgoingMessage(
                    "mission_count", (*sender[:2], len(self.lists[mission_type]), mission_type)
                )
            ]
        if message_type == "MISSION_COUNT":
            return self._start_upload(message, sender, now)
        return self._send_item(message, sender)

    def _is_uploading(self, sender: Sender) -> bool:
        return self._upload is not None and self._upload.sender == sender

    def _start_upload(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Handle MISSION_COUNT: start an upload."""
        mission_type = message.mission_type
        if self._upload is not None and not self._is_uploading(sender):
            return [
                text("another client is uploading a mission"),
                _ack(sender, DENIED, mission_type),
            ]
        if message.count > MAX_MISSION_ITEMS:
            return [
                text(f"{message.count} items: at most {MAX_MISSION_ITEMS}"),
                _ack(sender, NO_SPACE),
            ]
        self._upload = MissionUpload(sender, mission_type, message.count, requested_time=now)
        return self._request_next_item()

    def _request_next_item(self) -> list[OutgoingMessage]:
        """Request the next item, or accept the list if it is complete."""
        upload = self._upload
        assert upload is not None
        if len(upload.items) < upload.total:
            name = "mission_request" if upload.is_float else "mission_request_int"
            return [
                OutgoingMessage(name, (*upload.sender[:2], len(upload.items), upload.mission_type))
            ]
        self._upload = None
        try:
            self.replace(upload.mission_type, upload.items)
        except MissionError as error:
            return [text(str(error)), _ack(upload.sender, error.code, upload.mission_type)]
        except RefusedError as error:
            return [text(str(error)), _ack(upload.sender, ERROR, upload.mission_type)]
        return [_ack(upload.sender, ACCEPTED, upload.mission_type)]

    def replace(self, mission_type: int, items: tuple[MissionItem, ...]) -> None:
        """Validate a list, and replace the previous list of its type.

        Args:
            mission_type: `MISSION`, `FENCE` or `RALLY`.
            items: Items of the list.

        Raises:
            RefusedError: If an item is not supported or invalid. The previous list remains.
        """
        if mission_type == FENCE:
            if any(item.command not in FENCE_COMMANDS for item in items):
                raise MissionError("fence items must be polygons or circles", UNSUPPORTED)
            self._fence.set_items(items)
        elif mission_type == RALLY:
            if any(item.command != RALLY_POINT for item in items):
                raise MissionError("rally items must be rally points", UNSUPPORTED)
            self._set_rally_points(items)
        else:
            self._check(items)
        self.lists[mission_type] = items
        if mission_type == MISSION:
            self._on_change()

    def _add_item(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Add an item to the upload; an item out of sequence is requested again."""
        upload, mission_type = self._upload, message.mission_type
        if upload is None or upload.sender != sender or upload.mission_type != mission_type:
            return [_ack(sender, ERROR, mission_type)]
        if message.seq != len(upload.items):
            # Ignore repeated items
            return self._request_next_item() if message.seq > len(upload.items) else []
        self._upload = upload._replace(
            items=(*upload.items, read_item(message)), requested_time=now, tries=1
        )
        return self._request_next_item()

    def _send_item(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Return the item that a client requests."""
        items, number, mission_type = (
            self.lists[message.mission_type],
            message.seq,
            message.mission_type,
        )
        if number >= len(items):
            return [_ack(sender, BAD_SEQUENCE, mission_type)]
        is_float = message.get_type() == "MISSION_REQUEST"
        if is_float and self._is_uploading(sender):
            return []
        fields = write_item_fields(items[number], is_float)
        name = "mission_item" if is_float else "mission_item_int"
        return [OutgoingMessage(name, (*sender[:2], number, *fields, mission_type))]

    def _clear(self, mission_type: int, sender: Sender) -> list[OutgoingMessage]:
        """Clear the list of one mission type, or all lists."""
        if mission_type not in (*self.lists, ALL):
            return [_ack(sender, UNSUPPORTED, mission_type)]
        for each_type in self.lists if mission_type == ALL else (mission_type,):
            self.replace(each_type, ())
        return [_ack(sender, ACCEPTED, mission_type)]

    def due(self, now: float) -> list[OutgoingMessage]:
        """Return a repeated request for a missing item, or a cancellation after some tries."""
        upload = self._upload
        if upload is None or now - upload.requested_time < ITEM_TIMEOUT:
            return []
        if upload.tries >= MAX_TRIES:
            self._upload = None
            return [_ack(upload.sender, CANCELLED, upload.mission_type)]
        # Clients without MISSION_ITEM_INT do not answer MISSION_REQUEST_INT: try the other kind
        is_float = not upload.is_float if not upload.items else upload.is_float
        self._upload = upload._replace(
            requested_time=now, tries=upload.tries + 1, is_float=is_float
        )
        return self._request_next_item()


def _ack(sender: Sender, code: int, mission_type: int = MISSION) -> OutgoingMessage:
    """Return a MISSION_ACK."""
    return OutgoingMessage("mission_ack", (*sender[:2], code, mission_type))


def read_item(message: Message) -> MissionItem:
    """Convert a MISSION_ITEM or MISSION_ITEM_INT message into an item."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM_INT":
        x, y = (
            math.nan if value == UNSET_INT32 else value * _scale(message.frame) for value in (x, y)
        )
    params = (message.param1, message.param2, message.param3, message.param4)
    more = (x, y, message.z, bool(message.autocontinue))
    return MissionItem(message.frame, message.command, params, *more)


def write_item_fields(item: MissionItem, is_float: bool) -> tuple[Any, ...]:
    """Return the message fields of an item, from its frame on."""
    x, y = item.x, item.y
    if not is_float:
        x, y = (_round_int32(value / _scale(item.frame)) for value in (x, y))
    return (item.frame, item.command, 0, int(item.autocontinue), *item.params, x, y, item.z)


def _round_int32(number: float) -> int:
    """Round a number to a signed 32-bit integer; return `UNSET_INT32` if it does not fit."""
    return round(number) if abs(number) < UNSET_INT32 else UNSET_INT32


def _scale(frame: int) -> float:
    """Return the degrees per unit of an integer coordinate; 1 in local frames."""
    return 1e-7 if frame in GLOBAL_FRAMES + RELATIVE_FRAMES else 1.0
