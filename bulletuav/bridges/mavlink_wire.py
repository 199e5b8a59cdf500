"""MAVLink on the wire, by pymavlink's dialect `common`: frames in, messages out, and back.

Numbers of commands, results and modes are those of MAVLink's `common` and of PX4.
Source: https://mavlink.io/en/messages/common.html.
"""

import functools
from collections.abc import Hashable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

from bulletuav.errors import missing_extra

COMPONENT = 1
"""Number of the autopilot among the components of a vehicle"""
MAGIC_1, MAGIC_2 = 0xFE, 0xFD
"""First byte of a frame of MAVLink 1 and 2"""
SIGNED = 1
"""Flag of frames that carry a signature of 13 bytes"""
MOST_TEXT = 50
"""Most bytes of a text that clients show"""
Message = Any
"""A message that pymavlink has read: attributes by the names of MAVLink"""


class Command(IntEnum):
    """Commands that vehicles know."""

    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    SET_MODE = 176
    CHANGE_SPEED = 178
    TERMINATE = 185
    REPOSITION = 192
    PAUSE = 193
    SET_MISSION_CURRENT = 224
    MISSION_START = 300
    ARM = 400
    GET_HOME = 410
    GET_INTERVAL = 510
    SET_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_CAPABILITIES = 520


class Result(IntEnum):
    """How a command was answered."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


class Mode(IntEnum):
    """PX4's flight modes, as heartbeats tell them: main mode << 16 | sub-mode << 24."""

    TAKEOFF = 4 << 16 | 2 << 24
    HOLD = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RETURN = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24
    OFFBOARD = 6 << 16


class RefusedError(ValueError):
    """A request that cannot be done.

    Attributes:
        result: How a command that asked for it is answered.
    """

    def __init__(self, text: str, result: Result = Result.DENIED) -> None:
        """Tell why, in a text that clients show."""
        super().__init__(text)
        self.result = result


class Told(NamedTuple):
    """A message that a vehicle sends.

    Attributes:
        name: In small letters, such as "heartbeat".
        fields: Values in MAVLink's order.
    """

    name: str
    fields: tuple[Any, ...]


class Sender(NamedTuple):
    """Who sent a message.

    Attributes:
        system, component: Numbers that it gives itself.
        link: Where it is; differs between clients with the same numbers.
    """

    system: int
    component: int
    link: Hashable = None


def text(words: str, severity: int = 4) -> Told:
    """Make a text that clients show; 4 is a warning, 6 an information."""
    return Told("statustext", (severity, words.encode("ascii", "replace")[:MOST_TEXT]))


@functools.cache
def dialect() -> Any:
    """Load pymavlink's dialect.

    Raises:
        ImportError: pymavlink is not installed.
    """
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise missing_extra("serving clients of MAVLink", "mavlink") from None
    return common


class Wire:
    """Packs and reads frames of one system.

    Attributes:
        malformed: How many datagrams held what is no frame.
    """

    def __init__(self, system: int) -> None:
        """Take a number, from 1 to 254, as the system's own."""
        self._dialect = dialect()
        self._packer = self._dialect.MAVLink(None, srcSystem=system, srcComponent=COMPONENT)
        self.malformed = 0

    def pack(self, told: Told) -> bytes:
        """Pack a message into a frame of MAVLink 2."""
        message = getattr(self._dialect, f"MAVLink_{told.name}_message")(*told.fields)
        frame = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        return frame

    def read(self, datagram: bytes) -> list[Message]:
        """Read the messages of a datagram; what follows something broken is dropped.

        Messages of other dialects are left out: their checksums cannot be checked.
        """
        found = []
        for frame in _frames(datagram):
            try:
                message = self._packer.decode(bytearray(frame))
            except self._dialect.MAVError:
                self.malformed += 1
                break
            if not isinstance(message, self._dialect.MAVLink_unknown):
                found.append(message)
        return found


def whole_frames(data: bytes) -> tuple[bytes, bytes]:
    """Split a stream into frames that are whole, and the beginning of the next.

    Args:
        data: What has come so far, from the beginning of a frame on.

    Returns:
        Whole frames, and what is left.
    """
    *most, last = [b"", *_frames(data)]
    is_whole = last[:1] not in (MAGIC_1.to_bytes(), MAGIC_2.to_bytes()) or len(last) == _size(last)
    return (data, b"") if is_whole else (b"".join(most), last)


def _frames(data: bytes) -> Iterator[bytes]:
    """Cut data into frames; a last one that is none holds all that could not be cut."""
    while data:
        size = _size(data)
        yield data[:size]
        data = data[size:]


def _size(data: bytes) -> int:
    """Tell how long the frame is that data begins with; more than all of it, if it is cut."""
    if data[0] == MAGIC_1:
        return 8 + (data[1] if len(data) > 1 else 0)
    if data[0] == MAGIC_2:
        return 12 + (data[1] + (13 if data[2] & SIGNED else 0) if len(data) > 2 else 0)
    return len(data)
