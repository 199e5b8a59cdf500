"""MAVLink frames and messages, by pymavlink's dialect `common`.

Numbers of commands, results and modes are those of MAVLink's `common` and of PX4.
Source: https://mavlink.io/en/messages/common.html.
"""

import functools
from collections.abc import Hashable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

from bulletuav.errors import missing_extra

COMPONENT = 1
"""Component ID of the autopilot"""
MAVLINK_1_MAGIC, MAVLINK_2_MAGIC = 0xFE, 0xFD
"""First byte of a MAVLink 1 and of a MAVLink 2 frame"""
SIGNED_FLAG = 1
"""Incompatibility flag of frames with a signature of 13 bytes"""
MAX_TEXT_LENGTH = 50
"""Maximum length of a STATUSTEXT, bytes"""
Message = Any
"""Message that pymavlink has decoded, with MAVLink's field names as attributes"""


class Command(IntEnum):
    """Supported commands (MAV_CMD)."""

    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    ORBIT = 34
    SET_MODE = 176
    CHANGE_SPEED = 178
    CHANGE_ALTITUDE = 186
    TERMINATE = 185
    REPOSITION = 192
    ROI_LOCATION = 195
    ROI_NONE = 197
    PAUSE = 193
    SET_MISSION_CURRENT = 224
    CALIBRATE = 241
    MISSION_START = 300
    ARM = 400
    GET_HOME = 410
    INJECT_FAILURE = 420
    GET_INTERVAL = 510
    SET_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_CAPABILITIES = 520
    SET_CAMERA_MODE = 530
    GIMBAL_PITCHYAW = 1000
    GIMBAL_CONFIGURE = 1001
    START_CAPTURE = 2000
    STOP_CAPTURE = 2001
    VTOL_TRANSITION = 3000


class CommandResult(IntEnum):
    """Result of a command in its COMMAND_ACK (MAV_RESULT)."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3


class Mode(IntEnum):
    """PX4's flight modes as in HEARTBEAT.custom_mode: main mode << 16 | sub-mode << 24."""

    ALTITUDE = 2 << 16
    POSITION = 3 << 16
    ORBIT = 3 << 16 | 1 << 24
    TAKEOFF = 4 << 16 | 2 << 24
    HOLD = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RETURN = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24
    FOLLOW = 4 << 16 | 8 << 24
    OFFBOARD = 6 << 16


class RefusedError(ValueError):
    """Error for a request that the vehicle denies.

    Attributes:
        result: Result in the COMMAND_ACK, if the request is a command.
    """

    def __init__(self, text: str, result: CommandResult = CommandResult.DENIED) -> None:
        """Initialise with a text that is sent as STATUSTEXT."""
        super().__init__(text)
        self.result = result


class OutgoingMessage(NamedTuple):
    """Message that a vehicle sends.

    Attributes:
        name: Message name in lower case, such as "heartbeat".
        fields: Values in the order of pymavlink's message class.
        component: Component that sends the message.
    """

    name: str
    fields: tuple[Any, ...]
    component: int = COMPONENT


class Sender(NamedTuple):
    """Sender of a message.

    Attributes:
        system_id, component_id: MAVLink IDs in the message's header.
        link: Address; distinguishes clients with the same IDs.
    """

    system_id: int
    component_id: int
    link: Hashable = None


def text(words: str, severity: int = 4) -> OutgoingMessage:
    """Return a STATUSTEXT message; severity 4 is a warning, 6 an information."""
    return OutgoingMessage(
        "statustext", (severity, words.encode("ascii", "replace")[:MAX_TEXT_LENGTH])
    )


@functools.cache
def dialect() -> Any:
    """Import pymavlink's dialect `common`.

    Raises:
        ImportError: If pymavlink is not installed.
    """
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise missing_extra("serving clients of MAVLink", "mavlink") from None
    return common


class MavlinkCodec:
    """Encoder and decoder of the frames of one system.

    Attributes:
        malformed: Number of datagrams with bytes that are not a frame.
    """

    def __init__(self, system_id: int) -> None:
        """Initialise with the system's ID, from 1 to 254."""
        self._dialect = dialect()
        self._packer = self._dialect.MAVLink(None, srcSystem=system_id, srcComponent=COMPONENT)
        self.malformed = 0

    def pack(self, outgoing: OutgoingMessage) -> bytes:
        """Encode a message as a MAVLink 2 frame."""
        message = getattr(self._dialect, f"MAVLink_{outgoing.name}_message")(*outgoing.fields)
        self._packer.srcComponent = outgoing.component
        frame = bytes(message.pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        return frame

    def read(self, datagram: bytes) -> list[Message]:
        """Decode the messages of a datagram; bytes after a malformed frame are ignored.

        Messages of other dialects are skipped, as their checksums cannot be verified.
        """
        messages = []
        for frame in _iterate_frames(datagram):
            try:
                message = self._packer.decode(bytearray(frame))
            except self._dialect.MAVError:
                self.malformed += 1
                break
            if not isinstance(message, self._dialect.MAVLink_unknown):
                messages.append(message)
        return messages


def split_frames(data: bytes) -> tuple[bytes, bytes]:
    """Split a byte stream into complete frames and the start of an incomplete one.

    Args:
        data: Bytes received so far, from the start of a frame on.

    Returns:
        Complete frames, and the remaining bytes.
    """
    *whole, last = [b"", *_iterate_frames(data)]
    is_whole = last[:1] not in (MAVLINK_1_MAGIC.to_bytes(), MAVLINK_2_MAGIC.to_bytes()) or len(
        last
    ) == _frame_size(last)
    return (data, b"") if is_whole else (b"".join(whole), last)


def _iterate_frames(data: bytes) -> Iterator[bytes]:
    """Split data into frames; if the rest is not a frame, the last item contains all of it."""
    while data:
        size = _frame_size(data)
        yield data[:size]
        data = data[size:]


def _frame_size(data: bytes) -> int:
    """Return the size of the first frame in data, which may exceed the data if the frame is cut."""
    if data[0] == MAVLINK_1_MAGIC:
        return 8 + (data[1] if len(data) > 1 else 0)
    if data[0] == MAVLINK_2_MAGIC:
        return 12 + (data[1] + (13 if data[2] & SIGNED_FLAG else 0) if len(data) > 2 else 0)
    return len(data)
