"""The mission protocol: items of missions and fences are uploaded, told and cleared.

Source: https://mavlink.io/en/services/mission.html.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES
from bulletuav.bridges.mavlink_fence import FENCE_COMMANDS, Geofence, MissionItem
from bulletuav.bridges.mavlink_items import DENIED, UNSUPPORTED, MissionError
from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage, RefusedError, Sender, text

MISSION, FENCE, ALL = 0, 1, 255
"""Kinds of lists"""
ACCEPTED, ERROR, NO_SPACE, BAD_SEQUENCE, CANCELLED = 0, 1, 4, 13, 15
"""Answers, besides those of `mavlink_items`"""
MAX_MISSION_ITEMS = 500
ITEM_TIMEOUT, MAX_TRIES = 1.0, 5
"""How long an item is waited for until it is asked for again, s, and how often"""
UNSET_INT32 = 2**31 - 1
"""A latitude or longitude that is left out"""
MissionCheck = Callable[[tuple[MissionItem, ...]], None]


class MissionUpload(NamedTuple):
    """Items that a client is sending.

    Attributes:
        sender: Who.
        kind: Of the list.
        total: How many there will be.
        items: That have come.
        is_float: Whether they come with degrees in floats.
        asked: When the next was asked for, s.
        tries: How often.
    """

    sender: Sender
    mission_type: int
    total: int
    items: tuple[MissionItem, ...] = ()
    is_float: bool = False
    requested_time: float = 0.0
    tries: int = 1


class MissionService:
    """Lists of items, and the messages about them.

    Attributes:
        lists: Items by kind.
    """

    def __init__(self, check: MissionCheck, fence: Geofence, on_change: Callable[[], None]) -> None:
        """Begin with empty lists.

        Args:
            check: Function that raises RefusedError for a mission that cannot be.
            fence: What uploaded fences become.
            taken: Function that is told that there is another mission.
        """
        self._check, self._fence, self._on_change = check, fence, on_change
        self.lists: dict[int, tuple[MissionItem, ...]] = {MISSION: (), FENCE: ()}
        self._upload: MissionUpload | None = None

    def answer(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Answer a message about lists.

        Args:
            message: The message.
            sender: Who sent it.
            now: Time, s.

        Returns:
            What to send back.
        """
        kind = message.get_type()
        # A client that acknowledges a request has given its upload up
        if kind == "MISSION_ACK":
            if self._is_uploading(sender):
                self._upload = None
            return []
        if kind in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            return self._add_item(message, sender, now)
        # Missions, fences and rally points are lists of their own
        mission_type = message.mission_type
        if kind == "MISSION_CLEAR_ALL":
            return self._clear(mission_type, sender)
        # Lists that are not kept are empty to who asks, and refuse the rest
        if mission_type not in self.lists:
            if kind == "MISSION_REQUEST_LIST":
                return [OutgoingMessage("mission_count", (*sender[:2], 0, mission_type))]
            return [_ack(sender, UNSUPPORTED, mission_type)]
        if kind == "MISSION_REQUEST_LIST":
            return [
                OutgoingMessage(
                    "mission_count", (*sender[:2], len(self.lists[mission_type]), mission_type)
                )
            ]
        if kind == "MISSION_COUNT":
            return self._start_upload(message, sender, now)
        return self._send_item(message, sender)

    def _is_uploading(self, sender: Sender) -> bool:
        """Tell whether it is this client that sends items."""
        return self._upload is not None and self._upload.sender == sender

    def _start_upload(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Begin an upload."""
        mission_type = message.mission_type
        if self._upload is not None and not self._is_uploading(sender):
            return [text("another client uploads a mission"), _ack(sender, DENIED, mission_type)]
        if message.count > MAX_MISSION_ITEMS:
            return [text(f"{message.count} items: at most {MAX_MISSION_ITEMS}"), _ack(sender, NO_SPACE)]
        self._upload = MissionUpload(sender, mission_type, message.count, requested_time=now)
        return self._request_next_item()

    def _request_next_item(self) -> list[OutgoingMessage]:
        """Ask for the next item, or take the list if it is whole."""
        upload = self._upload
        assert upload is not None
        if len(upload.items) < upload.total:
            name = "mission_request" if upload.is_float else "mission_request_int"
            return [
                OutgoingMessage(name, (*upload.sender[:2], len(upload.items), upload.mission_type))
            ]
        self._upload = None
        try:
            self._replace(upload.mission_type, upload.items)
        except MissionError as error:
            return [text(str(error)), _ack(upload.sender, error.code, upload.mission_type)]
        except RefusedError as error:
            return [text(str(error)), _ack(upload.sender, ERROR, upload.mission_type)]
        return [_ack(upload.sender, ACCEPTED, upload.mission_type)]

    def _replace(self, mission_type: int, items: tuple[MissionItem, ...]) -> None:
        """Take a list over."""
        if mission_type == FENCE:
            if any(item.command not in FENCE_COMMANDS for item in items):
                raise MissionError("a fence has polygons and circles alone", UNSUPPORTED)
            self._fence.set_items(items)
        else:
            self._check(items)
        self.lists[mission_type] = items
        if mission_type == MISSION:
            self._on_change()

    def _add_item(self, message: Message, sender: Sender, now: float) -> list[OutgoingMessage]:
        """Take an item; one that was not asked for is answered by what is."""
        upload, mission_type = self._upload, message.mission_type
        if upload is None or upload.sender != sender or upload.mission_type != mission_type:
            return [_ack(sender, ERROR, mission_type)]
        if message.seq != len(upload.items):
            # One that came twice says nothing new.
            return self._request_next_item() if message.seq > len(upload.items) else []
        self._upload = upload._replace(
            items=(*upload.items, read_item(message)), requested_time=now, tries=1
        )
        return self._request_next_item()

    def _send_item(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Tell one item."""
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
        """Clear one list, or all."""
        if mission_type not in (*self.lists, ALL):
            return [_ack(sender, UNSUPPORTED, mission_type)]
        for each_type in self.lists if mission_type == ALL else (mission_type,):
            self._replace(each_type, ())
        return [_ack(sender, ACCEPTED, mission_type)]

    def due(self, now: float) -> list[OutgoingMessage]:
        """Ask again for an item that has not come; give up after some times."""
        upload = self._upload
        if upload is None or now - upload.requested_time < ITEM_TIMEOUT:
            return []
        if upload.tries >= MAX_TRIES:
            self._upload = None
            return [_ack(upload.sender, CANCELLED, upload.mission_type)]
        # Clients that know floats alone do not answer requests of the other kind.
        is_float = not upload.is_float if not upload.items else upload.is_float
        self._upload = upload._replace(
            requested_time=now, tries=upload.tries + 1, is_float=is_float
        )
        return self._request_next_item()


def _ack(sender: Sender, code: int, mission_type: int = MISSION) -> OutgoingMessage:
    """Answer a client."""
    return OutgoingMessage("mission_ack", (*sender[:2], code, mission_type))


def read_item(message: Message) -> MissionItem:
    """Read an item."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM_INT":
        x, y = (
            math.nan if value == UNSET_INT32 else value * _scale(message.frame) for value in (x, y)
        )
    params = (message.param1, message.param2, message.param3, message.param4)
    more = (x, y, message.z, bool(message.autocontinue))
    return MissionItem(message.frame, message.command, params, *more)


def write_item_fields(item: MissionItem, is_float: bool) -> tuple[Any, ...]:
    """Write an item, from its frame on."""
    x, y = item.x, item.y
    if not is_float:
        x, y = (_round_int32(value / _scale(item.frame)) for value in (x, y))
    return (item.frame, item.command, 0, int(item.autocontinue), *item.params, x, y, item.z)


def _round_int32(number: float) -> int:
    """Round a number for a field of 32 bits; what does not fit is left out."""
    return round(number) if abs(number) < UNSET_INT32 else UNSET_INT32


def _scale(frame: int) -> float:
    """Tell what one of a whole latitude is, deg; other frames have numbers as they are."""
    return 1e-7 if frame in GLOBAL_FRAMES + RELATIVE_FRAMES else 1.0
