"""Services of a virtual Crazyflie: tables of contents, logging, parameters, memory.

Each takes packets of one port and gives answers. Layouts are those of CRTP version 12.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from bulletuav.bridges.crazyflie_tables import (
    LOG_TYPES,
    LOGS,
    PARAMETER_LETTERS,
    PARAMETERS,
    LogVariable,
    Telemetry,
    checksum,
    name_bytes,
    parameter_code,
)
from bulletuav.bridges.crtp import Errno, MalformedError, Packet, Port, pack, unpack

TABLE, SETTINGS, DATA = 0, 1, 2
"""Channels of the logging port"""
READ, WRITE, MISCELLANEOUS = 1, 2, 3
"""Channels of the parameters' port, beside `TABLE`"""
MOST_BLOCKS = 16
MOST_VARIABLES = 128
MOST_LOGGED = 26
"""Greatest size of a block's values, bytes"""
TICK = 10
"""Unit of log periods, ms"""
TRAJECTORY_MEMORY = 0x12
"""Type of the memory that trajectories are written to"""
MEMORY_SIZE = 4096
"""Size of that memory, bytes"""
MOST_MEMORY = 24
"""Most bytes that a packet reads or writes"""


class Table:
    """A table of contents, which clients read entry by entry."""

    def __init__(self, port: Port, entries: Sequence[tuple[int, str]], tail: bytes = b"") -> None:
        """Write the entries.

        Args:
            port: Port of the packets.
            entries: Byte that describes it, and full name, of each entry.
            tail: What follows count and checksum in the answer about the table.
        """
        self._port = port
        self._entries: list[bytes] = [bytes([code]) + name_bytes(name) for code, name in entries]
        self._about = pack("BHI", 3, len(self._entries), checksum(self._entries)) + tail

    def answer(self, data: bytes) -> bytes:
        """Answer a request for the table's size, or for one entry."""
        (request,) = unpack("B", data)
        if request == 3:
            return self._about
        if request != 2:
            raise MalformedError(f"request {request} to a table: 2 or 3 is needed")
        _, number = unpack("BH", data)
        if number >= len(self._entries):
            return pack("B", 2)
        entry: bytes = self._entries[number]
        return pack("BH", 2, number) + entry


LOG_TABLE = Table(
    Port.LOG,
    [(variable.code, name) for name, variable in LOGS.items()],
    pack("BB", MOST_BLOCKS, MOST_VARIABLES),
)
PARAMETER_TABLE = Table(
    Port.PARAMETERS, [(parameter_code(one), name) for name, one in PARAMETERS.items()]
)
LOG_VARIABLES = tuple(LOGS.values())
PARAMETER_NAMES = tuple(PARAMETERS)


@dataclass
class Block:
    """A block of variables that are logged together.

    Attributes:
        variables: Each with the code of the type that it is sent in.
        period: Time from one packet to the next, in ticks; 0 if it does not run.
        start: Tick of the first packet.
    """

    variables: list[tuple[int, LogVariable]]
    period: int = 0
    start: int = 0

    @property
    def size(self) -> int:
        """Size of the values, bytes."""
        return sum(struct.calcsize(LOG_TYPES[code].letter) for code, _ in self.variables)


class LogService:
    """The log blocks of one drone."""

    def __init__(self) -> None:
        """Begin without blocks."""
        self._blocks: dict[int, Block] = {}

    def clear(self) -> None:
        """Forget all blocks."""
        self._blocks.clear()

    def answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Answer a packet.

        Args:
            packet: To the port LOG.
            tick: Present time in units of `TICK`.

        Returns:
            The answers.

        Raises:
            MalformedError: The packet is not what it should be.
        """
        if packet.channel == TABLE:
            return [packet._replace(data=LOG_TABLE.answer(packet.data))]
        if packet.channel != SETTINGS:
            raise MalformedError(f"channel {packet.channel} of logs takes no packets")
        (request,) = unpack("B", packet.data)
        if request == 5:
            self.clear()
            return [packet._replace(data=pack("BBB", request, 0, 0))]
        _, block = unpack("BB", packet.data)
        error = self._change(request, block, packet.data[2:], tick)
        return [packet._replace(data=pack("BBB", request, block, error))]

    def _change(self, request: int, block: int, rest: bytes, tick: int) -> Errno:
        """Create, delete, start, stop or extend a block."""
        # Create: a block of this number must be new, and there must be room
        if request == 6:
            if block in self._blocks:
                return Errno.EEXIST
            if len(self._blocks) == MOST_BLOCKS:
                return Errno.ENOMEM
            error = self._extend(Block([]), rest, block)
        # From here on the block must exist
        elif request not in (2, 3, 4, 7):
            error = Errno.ENOEXEC
        elif block not in self._blocks:
            error = Errno.ENOENT
        # Append variables
        elif request == 7:
            error = self._extend(self._blocks[block], rest, block)
        else:
            error = Errno.NONE
            chosen = self._blocks[block]
            # Delete, start with a period in units of 10 ms, or stop
            if request == 2:
                del self._blocks[block]
            elif request == 3:
                (chosen.period,) = unpack("B", rest)
                chosen.start = tick + 1
            else:
                chosen.period = 0
        return error

    def _extend(self, block: Block, rest: bytes, number: int) -> Errno:
        """Add variables to a block, and keep it if they fit."""
        added = list(block.variables)
        for code, variable in struct.iter_unpack("<BH", rest[: len(rest) // 3 * 3]):
            if variable >= len(LOG_VARIABLES) or code & 0x0F not in LOG_TYPES:
                return Errno.ENOENT
            added.append((code & 0x0F, LOG_VARIABLES[variable]))
        longer = Block(added, block.period, block.start)
        if longer.size > MOST_LOGGED:
            return Errno.E2BIG
        used = sum(len(one.variables) for one in self._blocks.values()) - len(block.variables)
        if used + len(added) > MOST_VARIABLES:
            return Errno.ENOMEM
        self._blocks[number] = longer
        return Errno.NONE

    def due(self, tick: int) -> list[tuple[int, Block]]:
        """List the blocks that are to be sent at a tick, with their numbers."""
        return [
            (number, block)
            for number, block in self._blocks.items()
            if block.period and tick >= block.start and not (tick - block.start) % block.period
        ]

    @staticmethod
    def write(number: int, block: Block, tick: int, told: Telemetry) -> Packet:
        """Write a block's values as a packet."""
        values = b""
        for code, variable in block.variables:
            kind = LOG_TYPES[code]
            value = min(max(variable.read(told), kind.least), kind.most)
            values += pack(kind.letter, value if kind.letter in "fe" else int(value))
        stamp = pack("I", tick * TICK & 0xFFFFFF)[:3]
        return Packet(Port.LOG, DATA, bytes([number]) + stamp + values)


class ParameterService:
    """The parameters of one drone.

    Attributes:
        values: Values by full name.
    """

    def __init__(self) -> None:
        """Begin with the values of the table."""
        self.values = {name: one.value for name, one in PARAMETERS.items()}
        self._stored: dict[str, float] = {}

    def answer(self, packet: Packet) -> list[Packet]:
        """Answer a packet to the port PARAMETERS.

        Raises:
            MalformedError: The packet is not what it should be.
        """
        if packet.channel == TABLE:
            data = PARAMETER_TABLE.answer(packet.data)
        elif packet.channel == READ:
            (number,) = unpack("H", packet.data)
            if number < len(PARAMETER_NAMES):
                data = pack("HB", number, Errno.NONE) + self._bytes(PARAMETER_NAMES[number])
            else:
                data = pack("HB", number, Errno.ENOENT)
        elif packet.channel == WRITE:
            data = self._write(packet.data)
        else:
            data = self._other(packet.data)
        return [packet._replace(data=data)]

    def _bytes(self, name: str, value: float | None = None) -> bytes:
        """Write the present value of a parameter, or a given one."""
        letter = PARAMETER_LETTERS[PARAMETERS[name].code]
        number = self.values[name] if value is None else value
        return pack(letter, number if letter in "efd" else int(number))

    def _write(self, data: bytes) -> bytes:
        """Set the value of a parameter by its number; the answer tells the value as it is then."""
        (number,) = unpack("H", data)
        if number >= len(PARAMETER_NAMES):
            return pack("HB", number, Errno.ENOENT)
        name = PARAMETER_NAMES[number]
        if not PARAMETERS[name].read_only:
            (self.values[name],) = unpack(PARAMETER_LETTERS[PARAMETERS[name].code], data[2:])
        return pack("H", number) + self._bytes(name)

    def _other(self, data: bytes) -> bytes:
        """Answer what is rarer: setting by name, types, stored and first values."""
        (request,) = unpack("B", data)
        if request == 0:
            return self._write_by_name(data)
        if request not in (2, 3, 4, 5, 6, 7, 8):
            raise MalformedError(f"request {request} to parameters: from 0 to 8 is needed")
        _, number = unpack("BH", data)
        if number >= len(PARAMETER_NAMES):
            return pack("BHB", request, number, Errno.ENOENT)
        name = PARAMETER_NAMES[number]
        return pack("BH", request, number) + self._told(request, name)

    def _told(self, request: int, name: str) -> bytes:
        """Tell what a rarer request asks about a parameter."""
        first = self._bytes(name, PARAMETERS[name].value)
        persistent = PARAMETERS[name].persistent
        # Kind, first value, and their later forms: these change nothing
        answers = {
            2: lambda: pack("B", persistent),
            6: lambda: first,
            7: lambda: pack("BB", Errno.NONE, persistent),
            8: lambda: pack("B", Errno.NONE) + first,
        }
        if request in answers:
            return answers[request]()
        # The rest is about stored values, which only some parameters have
        if not persistent:
            return pack("B", Errno.ENOENT)
        # Store the present value, forget it, or tell both
        if request == 3:
            self._stored[name] = self.values[name]
        elif request == 5:
            self._stored.pop(name, None)
        elif name in self._stored:
            return pack("B", 1) + first + self._bytes(name, self._stored[name])
        else:
            return pack("B", 0) + first
        return pack("B", Errno.NONE)

    def _write_by_name(self, data: bytes) -> bytes:
        """Set the value of a parameter by its group and name."""
        parts = data[1:].split(b"\0", 2)
        if len(parts) != 3:
            raise MalformedError("a parameter set by name needs group and name")
        name = b".".join(parts[:2]).decode("latin-1")
        (code,) = unpack("B", parts[2])
        if name not in PARAMETERS:
            error = Errno.ENOENT
        elif PARAMETERS[name].read_only:
            error = Errno.EACCES
        elif code != PARAMETERS[name].code:
            error = Errno.EINVAL
        else:
            (self.values[name],) = unpack(PARAMETER_LETTERS[code], parts[2][1:])
            error = Errno.NONE
        return b"\0" + b"\0".join(parts[:2]) + pack("BB", 0, error)


class MemoryService:
    """The memory of one drone that trajectories are written to.

    Attributes:
        content: Its bytes.
    """

    def __init__(self) -> None:
        """Begin with zeros."""
        self.content = bytearray(MEMORY_SIZE)

    def answer(self, packet: Packet) -> list[Packet]:
        """Answer a packet to the port MEMORY.

        Raises:
            MalformedError: The packet is not what it should be.
        """
        # Channel 0 tells of memories, 1 reads, 2 writes
        if packet.channel == 0:
            return [packet._replace(data=self._about(packet.data))]
        if packet.channel not in (1, 2):
            raise MalformedError(f"channel {packet.channel} of memories takes no packets")
        # Only memory 0 exists, and nothing reaches beyond its end
        memory, address = unpack("BI", packet.data)
        if packet.channel == 2:
            written = packet.data[5:]
            fits = memory == 0 and address + len(written) <= MEMORY_SIZE
            if fits:
                self.content[address : address + len(written)] = written
            data = b""
        else:
            _, _, length = unpack("BIB", packet.data)
            fits = memory == 0 and length <= MOST_MEMORY and address + length <= MEMORY_SIZE
            data = bytes(self.content[address : address + length]) if fits else b""
        status = Errno.NONE if fits else Errno.EIO
        return [packet._replace(data=pack("BIB", memory, address, status) + data)]

    @staticmethod
    def _about(data: bytes) -> bytes:
        """Tell how many memories there are, or what one is."""
        (request,) = unpack("B", data)
        if request == 1:
            return pack("BB", 1, 1)
        _, memory = unpack("BB", data)
        if memory:
            return pack("BB", request, memory)
        return pack("BBBI8s", request, memory, TRAJECTORY_MEMORY, MEMORY_SIZE, b"")
