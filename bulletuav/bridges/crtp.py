"""Packets of CRTP, the protocol by which programs talk to a Crazyflie.

A packet is a header and up to 30 bytes. The header has a port, two reserved bits and a channel.
Numbers are little-endian. Over `udp://` each datagram is one packet.

Source: Bitcraze, "CRTP - Communication with the Crazyflie", and what cflib 0.1.34 sends.
"""

import math
import struct
from enum import IntEnum
from typing import Any, NamedTuple

MAX_DATA_SIZE = 30
"""Greatest size of a packet's data, bytes"""
RESERVED = 0x0C
"""Bits of the header that are always set"""
NULL_PACKET = b"\xff"
"""Packet without meaning, by which clients look for drones"""
PROTOCOL_VERSION = 12
"""Version that is told to clients; from 12 on they use the supervisor's port"""


class CrtpPort(IntEnum):
    """Ports of CRTP, each of which belongs to a part of the firmware."""

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
    """Numbers by which the firmware tells errors, as in C."""

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
    """Error for a packet whose data is not what its port needs."""


class Packet(NamedTuple):
    """One packet.

    Attributes:
        port: Number from 0 to 15.
        channel: Number from 0 to 3.
        data: At most 30 bytes.
    """

    port: int
    channel: int
    data: bytes

    @classmethod
    def parse(cls, datagram: bytes) -> "Packet":
        """Read a packet.

        Args:
            datagram: Header and data.

        Returns:
            The packet.

        Raises:
            MalformedError: It is empty or too long.
        """
        if not 1 <= len(datagram) <= 1 + MAX_DATA_SIZE:
            raise MalformedError(
                f"a datagram of {len(datagram)} bytes: from 1 to {1 + MAX_DATA_SIZE} are needed"
            )
        return cls(datagram[0] >> 4, datagram[0] & 0x03, datagram[1:])

    def frame(self) -> bytes:
        """Write the packet as a datagram."""
        return bytes([self.port << 4 | RESERVED | self.channel]) + self.data


def unpack_data(layout: str, data: bytes) -> tuple[Any, ...]:
    """Read numbers from the start of a packet's data; what follows them is left.

    Args:
        layout: Format of `struct`, without the byte order.
        data: The bytes.

    Returns:
        The numbers.

    Raises:
        MalformedError: There are too few bytes, or a number is not finite.
    """
    byte_layout = f"<{layout}"
    size = struct.calcsize(byte_layout)
    if len(data) < size:
        raise MalformedError(f"data of {len(data)} bytes: {size} are needed")
    numbers = struct.unpack_from(byte_layout, data)
    if not all(map(math.isfinite, (number for number in numbers if isinstance(number, float)))):
        raise MalformedError("a number that is not finite")
    return numbers


def pack_data(layout: str, *numbers: Any) -> bytes:
    """Write numbers as bytes, little-endian."""
    packed: bytes = struct.pack(f"<{layout}", *numbers)
    return packed
