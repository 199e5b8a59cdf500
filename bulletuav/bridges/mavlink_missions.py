"""The mission protocol: items of missions and fences are uploaded, told and cleared.

Source: https://mavlink.io/en/services/mission.html.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from bulletuav.bridges.mavlink_fence import FENCE_ITEMS, Fence, Item
from bulletuav.bridges.mavlink_items import DENIED, UNSUPPORTED, MissionError
from bulletuav.bridges.mavlink_places import GLOBAL_FRAMES, RELATIVE_FRAMES
from bulletuav.bridges.mavlink_wire import Message, RefusedError, Sender, Told, text

MISSION, FENCE, ALL = 0, 1, 255
"""Kinds of lists"""
ACCEPTED, ERROR, NO_SPACE, BAD_SEQUENCE, CANCELLED = 0, 1, 4, 13, 15
"""Answers, besides those of `mavlink_items`"""
MOST_ITEMS = 500
PATIENCE, MOST_TRIES = 1.0, 5
"""How long an item is waited for until it is asked for again, s, and how often"""
LEFT_OUT = 2**31 - 1
"""A latitude or longitude that is left out"""
Check = Callable[[tuple[Item, ...]], None]


class Upload(NamedTuple):
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
    kind: int
    total: int
    items: tuple[Item, ...] = ()
    is_float: bool = False
    asked: float = 0.0
    tries: int = 1


class MissionService:
    """Lists of items, and the messages about them.

    Attributes:
        lists: Items by kind.
    """

    def __init__(self, check: Check, fence: Fence, taken: Callable[[], None]) -> None:
        """Begin with empty lists.

        Args:
            check: Function that raises RefusedError for a mission that cannot be.
            fence: What uploaded fences become.
            taken: Function that is told that there is another mission.
        """
        self._check, self._fence, self._taken = check, fence, taken
        self.lists: dict[int, tuple[Item, ...]] = {MISSION: (), FENCE: ()}
        self._upload: Upload | None = None

    def answer(self, message: Message, sender: Sender, now: float) -> list[Told]:
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
            return self._take_item(message, sender, now)
        # Missions, fences and rally points are lists of their own
        which = message.mission_type
        if kind == "MISSION_CLEAR_ALL":
            return self._clear(which, sender)
        # Lists that are not kept are empty to who asks, and refuse the rest
        if which not in self.lists:
            if kind == "MISSION_REQUEST_LIST":
                return [Told("mission_count", (*sender[:2], 0, which))]
            return [_ack(sender, UNSUPPORTED, which)]
        if kind == "MISSION_REQUEST_LIST":
            return [Told("mission_count", (*sender[:2], len(self.lists[which]), which))]
        if kind == "MISSION_COUNT":
            return self._begin(message, sender, now)
        return self._tell(message, sender)

    def _is_uploading(self, sender: Sender) -> bool:
        """Tell whether it is this client that sends items."""
        return self._upload is not None and self._upload.sender == sender

    def _begin(self, message: Message, sender: Sender, now: float) -> list[Told]:
        """Begin an upload."""
        which = message.mission_type
        if self._upload is not None and not self._is_uploading(sender):
            return [text("another client uploads a mission"), _ack(sender, DENIED, which)]
        if message.count > MOST_ITEMS:
            return [text(f"{message.count} items: at most {MOST_ITEMS}"), _ack(sender, NO_SPACE)]
        self._upload = Upload(sender, which, message.count, asked=now)
        return self._go_on()

    def _go_on(self) -> list[Told]:
        """Ask for the next item, or take the list if it is whole."""
        upload = self._upload
        assert upload is not None
        if len(upload.items) < upload.total:
            name = "mission_request" if upload.is_float else "mission_request_int"
            return [Told(name, (*upload.sender[:2], len(upload.items), upload.kind))]
        self._upload = None
        try:
            self._replace(upload.kind, upload.items)
        except MissionError as error:
            return [text(str(error)), _ack(upload.sender, error.code, upload.kind)]
        except RefusedError as error:
            return [text(str(error)), _ack(upload.sender, ERROR, upload.kind)]
        return [_ack(upload.sender, ACCEPTED, upload.kind)]

    def _replace(self, kind: int, items: tuple[Item, ...]) -> None:
        """Take a list over."""
        if kind == FENCE:
            if any(one.command not in FENCE_ITEMS for one in items):
                raise MissionError("a fence has polygons and circles alone", UNSUPPORTED)
            self._fence.take(items)
        else:
            self._check(items)
        self.lists[kind] = items
        if kind == MISSION:
            self._taken()

    def _take_item(self, message: Message, sender: Sender, now: float) -> list[Told]:
        """Take an item; one that was not asked for is answered by what is."""
        upload, which = self._upload, message.mission_type
        if upload is None or upload.sender != sender or upload.kind != which:
            return [_ack(sender, ERROR, which)]
        if message.seq != len(upload.items):
            # One that came twice says nothing new.
            return self._go_on() if message.seq > len(upload.items) else []
        self._upload = upload._replace(items=(*upload.items, item_of(message)), asked=now, tries=1)
        return self._go_on()

    def _tell(self, message: Message, sender: Sender) -> list[Told]:
        """Tell one item."""
        items, number, which = self.lists[message.mission_type], message.seq, message.mission_type
        if number >= len(items):
            return [_ack(sender, BAD_SEQUENCE, which)]
        is_float = message.get_type() == "MISSION_REQUEST"
        if is_float and self._is_uploading(sender):
            return []
        fields = fields_of(items[number], is_float)
        name = "mission_item" if is_float else "mission_item_int"
        return [Told(name, (*sender[:2], number, *fields, which))]

    def _clear(self, which: int, sender: Sender) -> list[Told]:
        """Clear one list, or all."""
        if which not in (*self.lists, ALL):
            return [_ack(sender, UNSUPPORTED, which)]
        for kind in self.lists if which == ALL else (which,):
            self._replace(kind, ())
        return [_ack(sender, ACCEPTED, which)]

    def due(self, now: float) -> list[Told]:
        """Ask again for an item that has not come; give up after some times."""
        upload = self._upload
        if upload is None or now - upload.asked < PATIENCE:
            return []
        if upload.tries >= MOST_TRIES:
            self._upload = None
            return [_ack(upload.sender, CANCELLED, upload.kind)]
        # Clients that know floats alone do not answer requests of the other kind.
        is_float = not upload.is_float if not upload.items else upload.is_float
        self._upload = upload._replace(asked=now, tries=upload.tries + 1, is_float=is_float)
        return self._go_on()


def _ack(sender: Sender, code: int, kind: int = MISSION) -> Told:
    """Answer a client."""
    return Told("mission_ack", (*sender[:2], code, kind))


def item_of(message: Message) -> Item:
    """Read an item."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM_INT":
        x, y = (math.nan if one == LEFT_OUT else one * _scale(message.frame) for one in (x, y))
    numbers = (message.param1, message.param2, message.param3, message.param4)
    more = (x, y, message.z, bool(message.autocontinue))
    return Item(message.frame, message.command, numbers, *more)


def fields_of(item: Item, is_float: bool) -> tuple[Any, ...]:
    """Write an item, from its frame on."""
    x, y = item.x, item.y
    if not is_float:
        x, y = (_whole(one / _scale(item.frame)) for one in (x, y))
    return (item.frame, item.command, 0, int(item.goes_on), *item.numbers, x, y, item.z)


def _whole(number: float) -> int:
    """Round a number for a field of 32 bits; what does not fit is left out."""
    return round(number) if abs(number) < LEFT_OUT else LEFT_OUT


def _scale(frame: int) -> float:
    """Tell what one of a whole latitude is, deg; other frames have numbers as they are."""
    return 1e-7 if frame in GLOBAL_FRAMES + RELATIVE_FRAMES else 1.0
