"""CRTP services of a virtual Crazyflie: tables of contents, logging, parameters, memory.

Each service handles the packets of one port and returns answers. Layouts are those of CRTP
version 12.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from bulletuav.bridges.crazyflie_toc import (
    LOG_TYPES,
    LOGS,
    PARAMETER_FORMATS,
    PARAMETERS,
    LogVariable,
    Telemetry,
    compute_toc_crc,
    encode_name,
    encode_parameter_type,
)
from bulletuav.bridges.crtp import CrtpPort, Errno, MalformedError, Packet, pack_data, unpack_data

TOC_CHANNEL, CONTROL_CHANNEL, DATA_CHANNEL = 0, 1, 2
"""Channels of the log port"""
READ_CHANNEL, WRITE_CHANNEL, MISC_CHANNEL = 1, 2, 3
"""Channels of the parameter port, besides `TOC_CHANNEL`"""
MAX_BLOCKS = 16
MAX_VARIABLES = 128
MAX_BLOCK_SIZE = 26
"""Maximum size of the values of a log block, bytes"""
TICK_MS = 10
"""Unit of log periods, ms"""
TRAJECTORY_MEMORY = 0x12
"""Memory type of the trajectory memory"""
MEMORY_SIZE = 4096
"""Size of the trajectory memory, bytes"""
MAX_MEMORY_TRANSFER = 24
"""Maximum number of bytes that one packet reads or writes"""


class Toc:
    """Table of contents (TOC), which clients download entry by entry."""

    def __init__(
        self, port: CrtpPort, entries: Sequence[tuple[int, str]], tail: bytes = b""
    ) -> None:
        """Encode the entries.

        Args:
            port: Port of the packets.
            entries: Type byte and full name of each entry.
            tail: Bytes after count and CRC in the info reply.
        """
        self._port = port
        self._entries: list[bytes] = [bytes([code]) + encode_name(name) for code, name in entries]
        self._info = pack_data("BHI", 3, len(self._entries), compute_toc_crc(self._entries)) + tail

    def answer(self, data: bytes) -> bytes:
        """Return the reply to an info request or to an item request."""
        (request,) = unpack_data("B", data)
        if request == 3:
            return self._info
        if request != 2:
            raise MalformedError(f"TOC request {request}: 2 or 3 is needed")
        _, number = unpack_data("BH", data)
        if number >= len(self._entries):
            return pack_data("B", 2)
        entry: bytes = self._entries[number]
        return pack_data("BH", 2, number) + entry


LOG_TOC = Toc(
    CrtpPort.LOG,
    [(variable.code, name) for name, variable in LOGS.items()],
    pack_data("BB", MAX_BLOCKS, MAX_VARIABLES),
)
PARAMETER_TOC = Toc(
    CrtpPort.PARAM,
    [(encode_parameter_type(parameter), name) for name, parameter in PARAMETERS.items()],
)
LOG_VARIABLES = tuple(LOGS.values())
PARAMETER_NAMES = tuple(PARAMETERS)


@dataclass
class LogBlock:
    """Log block: variables that are sent together.

    Attributes:
        variables: Data type code for the packet, and variable.
        period: Period in ticks; 0 if the block is stopped.
        start: Tick of the first packet.
    """

    variables: list[tuple[int, LogVariable]]
    period: int = 0
    start: int = 0

    @property
    def size(self) -> int:
        """Size of the values, bytes."""
        return sum(struct.calcsize(LOG_TYPES[code].struct_format) for code, _ in self.variables)


class LogService:
    """Log blocks of one drone."""

    def __init__(self) -> None:
        """Initialise without blocks."""
        self._blocks: dict[int, LogBlock] = {}

    def clear(self) -> None:
        """Delete all blocks."""
        self._blocks.clear()

    def answer(self, packet: Packet, tick: int) -> list[Packet]:
        """Handle a packet to the port `CrtpPort.LOG`.

        Args:
            packet: Packet from the client.
            tick: Present time in units of `TICK_MS`.

        Returns:
            Packets to send back.

        Raises:
            MalformedError: If the data does not have the layout of the request.
        """
        if packet.channel == TOC_CHANNEL:
            return [packet._replace(data=LOG_TOC.answer(packet.data))]
        if packet.channel != CONTROL_CHANNEL:
            raise MalformedError(f"log channel {packet.channel} takes no packets")
        (request,) = unpack_data("B", packet.data)
        if request == 5:
            self.clear()
            return [packet._replace(data=pack_data("BBB", request, 0, 0))]
        _, block = unpack_data("BB", packet.data)
        error = self._change_block(request, block, packet.data[2:], tick)
        return [packet._replace(data=pack_data("BBB", request, block, error))]

    def _change_block(self, request: int, block: int, payload: bytes, tick: int) -> Errno:
        """Create, delete, start, stop or extend a block; return the error code."""
        # Create a block: its ID must be unused
        if request == 6:
            if block in self._blocks:
                return Errno.EEXIST
            if len(self._blocks) == MAX_BLOCKS:
                return Errno.ENOMEM
            error = self._append_variables(LogBlock([]), payload, block)
        # All other requests need an existing block
        elif request not in (2, 3, 4, 7):
            error = Errno.ENOEXEC
        elif block not in self._blocks:
            error = Errno.ENOENT
        # Append variables
        elif request == 7:
            error = self._append_variables(self._blocks[block], payload, block)
        else:
            error = Errno.NONE
            log_block = self._blocks[block]
            # Delete, start with a period in ticks, or stop
            if request == 2:
                del self._blocks[block]
            elif request == 3:
                (log_block.period,) = unpack_data("B", payload)
                log_block.start = tick + 1
            else:
                log_block.period = 0
        return error

    def _append_variables(self, block: LogBlock, payload: bytes, number: int) -> Errno:
        """Append variables to a block, and store it if the variables fit; return the error code."""
        added = list(block.variables)
        for code, variable in struct.iter_unpack("<BH", payload[: len(payload) // 3 * 3]):
            if variable >= len(LOG_VARIABLES) or code & 0x0F not in LOG_TYPES:
                return Errno.ENOENT
            added.append((code & 0x0F, LOG_VARIABLES[variable]))
        extended = LogBlock(added, block.period, block.start)
        if extended.size > MAX_BLOCK_SIZE:
            return Errno.E2BIG
        used = sum(len(other.variables) for other in self._blocks.values()) - len(block.variables)
        if used + len(added) > MAX_VARIABLES:
            return Errno.ENOMEM
        self._blocks[number] = extended
        return Errno.NONE

    def due(self, tick: int) -> list[tuple[int, LogBlock]]:
        """Return the blocks to send at a tick, with their IDs."""
        return [
            (number, block)
            for number, block in self._blocks.items()
            if block.period and tick >= block.start and not (tick - block.start) % block.period
        ]

    @staticmethod
    def encode_block(number: int, block: LogBlock, tick: int, telemetry: Telemetry) -> Packet:
        """Return the packet with the values of a block.

        Args:
            number: ID of the block.
            block: The block.
            tick: Present time in units of `TICK_MS`.
            telemetry: Values of the log variables.
        """
        values = b""
        for code, variable in block.variables:
            log_type = LOG_TYPES[code]
            value = min(max(variable.read(telemetry), log_type.minimum), log_type.maximum)
            values += pack_data(
                log_type.struct_format, value if log_type.struct_format in "fe" else int(value)
            )
        stamp = pack_data("I", tick * TICK_MS & 0xFFFFFF)[:3]
        return Packet(CrtpPort.LOG, DATA_CHANNEL, bytes([number]) + stamp + values)


class CrtpParameterService:
    """Parameters of one drone.

    Attributes:
        values: Values by full name.
    """

    def __init__(self) -> None:
        """Initialise with the default values."""
        self.values = {name: parameter.value for name, parameter in PARAMETERS.items()}
        self._stored: dict[str, float] = {}

    def answer(self, packet: Packet) -> list[Packet]:
        """Handle a packet to the port `CrtpPort.PARAM`.

        Raises:
            MalformedError: If the data does not have the layout of the request.
        """
        if packet.channel == TOC_CHANNEL:
            data = PARAMETER_TOC.answer(packet.data)
        elif packet.channel == READ_CHANNEL:
            (number,) = unpack_data("H", packet.data)
            if number < len(PARAMETER_NAMES):
                data = pack_data("HB", number, Errno.NONE) + self._encode_value(
                    PARAMETER_NAMES[number]
                )
            else:
                data = pack_data("HB", number, Errno.ENOENT)
        elif packet.channel == WRITE_CHANNEL:
            data = self._write(packet.data)
        else:
            data = self._handle_misc(packet.data)
        return [packet._replace(data=data)]

    def _encode_value(self, name: str, value: float | None = None) -> bytes:
        """Encode the present value of a parameter, or a given one."""
        struct_format = PARAMETER_FORMATS[PARAMETERS[name].code]
        number = self.values[name] if value is None else value
        return pack_data(struct_format, number if struct_format in "efd" else int(number))

    def _write(self, data: bytes) -> bytes:
        """Set a parameter by its ID, and return the reply with its new value."""
        (number,) = unpack_data("H", data)
        if number >= len(PARAMETER_NAMES):
            return pack_data("HB", number, Errno.ENOENT)
        name = PARAMETER_NAMES[number]
        if not PARAMETERS[name].read_only:
            (self.values[name],) = unpack_data(PARAMETER_FORMATS[PARAMETERS[name].code], data[2:])
        return pack_data("H", number) + self._encode_value(name)

    def _handle_misc(self, data: bytes) -> bytes:
        """Handle a request of the miscellaneous channel, such as set by name and stored values."""
        (request,) = unpack_data("B", data)
        if request == 0:
            return self._write_by_name(data)
        if request not in (2, 3, 4, 5, 6, 7, 8):
            raise MalformedError(f"parameter request {request}: from 0 to 8 is needed")
        _, number = unpack_data("BH", data)
        if number >= len(PARAMETER_NAMES):
            return pack_data("BHB", request, number, Errno.ENOENT)
        name = PARAMETER_NAMES[number]
        return pack_data("BH", request, number) + self._misc_reply(request, name)

    def _misc_reply(self, request: int, name: str) -> bytes:
        """Handle a request about one parameter; return the reply after request and ID."""
        default = self._encode_value(name, PARAMETERS[name].value)
        persistent = PARAMETERS[name].persistent
        # Extended type and default value, each in two versions of the request
        answers = {
            2: lambda: pack_data("B", persistent),
            6: lambda: default,
            7: lambda: pack_data("BB", Errno.NONE, persistent),
            8: lambda: pack_data("B", Errno.NONE) + default,
        }
        if request in answers:
            return answers[request]()
        # The remaining requests concern stored values of persistent parameters
        if not persistent:
            return pack_data("B", Errno.ENOENT)
        # Store the present value, delete the stored value, or return stored and default value
        if request == 3:
            self._stored[name] = self.values[name]
        elif request == 5:
            self._stored.pop(name, None)
        elif name in self._stored:
            return pack_data("B", 1) + default + self._encode_value(name, self._stored[name])
        else:
            return pack_data("B", 0) + default
        return pack_data("B", Errno.NONE)

    def _write_by_name(self, data: bytes) -> bytes:
        """Set a parameter by its group and name."""
        parts = data[1:].split(b"\0", 2)
        if len(parts) != 3:
            raise MalformedError("setting a parameter by name needs group and name")
        name = b".".join(parts[:2]).decode("latin-1")
        (code,) = unpack_data("B", parts[2])
        if name not in PARAMETERS:
            error = Errno.ENOENT
        elif PARAMETERS[name].read_only:
            error = Errno.EACCES
        elif code != PARAMETERS[name].code:
            error = Errno.EINVAL
        else:
            (self.values[name],) = unpack_data(PARAMETER_FORMATS[code], parts[2][1:])
            error = Errno.NONE
        return b"\0" + b"\0".join(parts[:2]) + pack_data("BB", 0, error)


class MemoryService:
    """Trajectory memory of one drone.

    Attributes:
        content: Content of the memory.
    """

    def __init__(self) -> None:
        """Initialise with zeros."""
        self.content = bytearray(MEMORY_SIZE)

    def answer(self, packet: Packet) -> list[Packet]:
        """Handle a packet to the port `CrtpPort.MEM`.

        Raises:
            MalformedError: If the data does not have the layout of the request.
        """
        # Channel 0 describes memories, 1 reads, 2 writes
        if packet.channel == 0:
            return [packet._replace(data=self._describe_memory(packet.data))]
        if packet.channel not in (1, 2):
            raise MalformedError(f"memory channel {packet.channel} takes no packets")
        # Only memory 0 exists; accesses beyond its end are errors
        memory, address = unpack_data("BI", packet.data)
        if packet.channel == 2:
            written = packet.data[5:]
            fits = memory == 0 and address + len(written) <= MEMORY_SIZE
            if fits:
                self.content[address : address + len(written)] = written
            data = b""
        else:
            _, _, length = unpack_data("BIB", packet.data)
            fits = memory == 0 and length <= MAX_MEMORY_TRANSFER and address + length <= MEMORY_SIZE
            data = bytes(self.content[address : address + length]) if fits else b""
        status = Errno.NONE if fits else Errno.EIO
        return [packet._replace(data=pack_data("BIB", memory, address, status) + data)]

    @staticmethod
    def _describe_memory(data: bytes) -> bytes:
        """Return the reply with the number of memories, or with type and size of one."""
        (request,) = unpack_data("B", data)
        if request == 1:
            return pack_data("BB", 1, 1)
        _, memory = unpack_data("BB", data)
        if memory:
            return pack_data("BB", request, memory)
        return pack_data("BBBI8s", request, memory, TRAJECTORY_MEMORY, MEMORY_SIZE, b"")
