"""Packets of CRTP (Crazy RealTime Protocol), which clients and a Crazyflie exchange.

A packet consists of a header byte and up to 30 bytes of data. The header contains the port, two
reserved bits and the channel. Numbers are little-endian. Over `udp://` each datagram is one packet.

Source: Bitcraze, "CRTP - Communication with the Crazyflie", and what cflib 0.1.34 sends.
"""

import math
import struct
from enum import IntEnum
from typing import Any, NamedTuple

MAX_DATA_SIZE = 30
"""Maximum size of a packet's data, bytes"""
RESERVED = 0x0C
"""Reserved bits of the header, which are always set"""
NULL_PACKET = b"\xff"
"""Null packet, which clients send to scan for drones"""
PROTOCOL_VERSION = 12
"""CRTP version that the drone reports; clients use the supervisor port from version 12 on"""


class CrtpPort(IntEnum):
    """Ports of CRTP, by the names of the firmware; each port belongs to one subsystem.

    `SETPOINT` carries roll, pitch, yaw and thrust. `SETPOINT_GENERIC` carries all other low-level
    setpoints, `SETPOINT_HL` the commands of the high-level commander.
    """

    CONSOLE = 0
    PARAM = 2
    SETPOINT = 3
    MEM = 4
    LOG = 5
    LOCALIZATION = 6
    SETPOINT_GENERIC = 7
    SETPOINT_HL = 8
    SUPERVISOR = 9
    PLATFORM = 13
    LINK = 15


class Errno(IntEnum):
    """Error codes of the firmware, which are those of C's errno.h."""

    NONE = 0
    ENOENT = 2
    EIO = 5
    E2BIG = 7
    ENOEXEC = 8
    ENOMEM = 12
    EACCES = 13
    EBUSY = 16
    EEXIST = 17
    EINVAL = 22


class MalformedError(ValueError):
    """Error for a packet whose data does not have the layout that its port requires."""


class Packet(NamedTuple):
    """One CRTP packet.

    Attributes:
        port: Port, from 0 to 15.
        channel: Channel, from 0 to 3.
        data: Data, at most 30 bytes.
    """

    port: int
    channel: int
    data: bytes

    @classmethod
    def parse(cls, datagram: bytes) -> "Packet":
        """Parse a datagram into a packet.

        Args:
            datagram: Header and data.

        Returns:
            The packet.

        Raises:
            MalformedError: If the datagram is empty or longer than 31 bytes.
        """
        if not 1 <= len(datagram) <= 1 + MAX_DATA_SIZE:
            raise MalformedError(
                f"datagram has {len(datagram)} bytes: from 1 to {1 + MAX_DATA_SIZE} are needed"
            )
        return cls(datagram[0] >> 4, datagram[0] & 0x03, datagram[1:])

    def frame(self) -> bytes:
        """Return the packet as a datagram: header and data."""
        return bytes([self.port << 4 | RESERVED | self.channel]) + self.data


def unpack_data(layout: str, data: bytes) -> tuple[Any, ...]:
    """Unpack numbers from the start of a packet's data.

    Bytes after the last number are ignored.

    Args:
        layout: Format string of `struct`, without the byte order.
        data: Data of the packet.

    Returns:
        The numbers.

    Raises:
        MalformedError: If there are too few bytes, or if a number is not finite.
    """
    byte_layout = f"<{layout}"
    size = struct.calcsize(byte_layout)
    if len(data) < size:
        raise MalformedError(f"data has {len(data)} bytes: {size} are needed")
    numbers = struct.unpack_from(byte_layout, data)
    if not all(map(math.isfinite, (number for number in numbers if isinstance(number, float)))):
        raise MalformedError("data contains a number that is not finite")
    return numbers


def pack_data(layout: str, *numbers: Any) -> bytes:
    """Pack numbers into little-endian bytes."""
    packed: bytes = struct.pack(f"<{layout}", *numbers)
    return packed
