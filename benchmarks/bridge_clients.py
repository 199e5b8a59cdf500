"""Small clients of the servers of `bulletuav serve`, by bytes on sockets.

Each class flies all vehicles of one server. `send` commands a vehicle to a point north or south of
its start, and `receive` returns the telemetry that has arrived since.
"""

import contextlib
import math
import selectors
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import msgpack
from pymavlink.dialects.v20 import common

from bulletuav.bridges.crazyflie_toc import LOGS

NUM_PORTS = 200
"""Ports that the server of one kind and its clients need"""
HALF_STROKE = 0.25
"""Distance of the commanded points from the start, m"""
HEIGHT = 1.5
"""Height of flight, m"""


class Reading(NamedTuple):
    """Telemetry of a vehicle.

    Attributes:
        vehicle: Index of the vehicle.
        stamp: Simulated time, s.
        pitch_rate: Angular velocity about the axis to the left, rad/s: positive as the nose sinks.
    """

    vehicle: int
    stamp: float
    pitch_rate: float


class Clients(ABC):
    """Clients of all vehicles of a server.

    Attributes:
        command_hz: Rate at which each vehicle's command is repeated, Hz.
        words: Arguments of `bulletuav serve`.
    """

    command_hz: float
    words: tuple[str, ...]

    def __init__(self, num_vehicles: int, port: int) -> None:
        """Initialise without a connection; the server has to run before `connect`.

        Args:
            num_vehicles: Number of vehicles.
            port: First port of the server, of `NUM_PORTS`.
        """
        self.num_vehicles, self._port = num_vehicles, port

    @abstractmethod
    def connect(self) -> None:
        """Connect, and command all vehicles to take off."""

    @abstractmethod
    def send(self, k: int, side: int) -> None:
        """Command vehicle `k` to fly to the north (`side` 1) or to the south (-1)."""

    @abstractmethod
    def receive(self, seconds: float, watched: Collection[int]) -> list[Reading]:
        """Return the telemetry that arrives; wait up to `seconds` for the first.

        Args:
            seconds: Maximum time to wait, s.
            watched: Vehicles whose telemetry is wanted most.
        """

    @abstractmethod
    def visit(self) -> None:
        """Connect one more client, read from the server, and disconnect."""

    @abstractmethod
    def close(self) -> None:
        """Close the sockets."""


class DatagramClients(Clients):
    """Clients with one UDP socket for each vehicle."""

    def __init__(self, num_vehicles: int, port: int) -> None:
        """Open the sockets."""
        super().__init__(num_vehicles, port)
        self._selector = selectors.DefaultSelector()
        self._sockets: list[socket.socket] = []

    def _open(self, port: int, own_port: int = 0) -> socket.socket:
        """Open the socket of the next vehicle, which listens at `port`."""
        link = _connect_datagrams(port, own_port)
        self._selector.register(link, selectors.EVENT_READ, len(self._sockets))
        self._sockets.append(link)
        return link

    @abstractmethod
    def _read(self, k: int, datagram: bytes) -> Iterator[Reading]:
        """Return the readings in a datagram of vehicle `k`."""

    def receive(self, seconds: float, watched: Collection[int]) -> list[Reading]:
        """Return the telemetry that arrives."""
        readings: list[Reading] = []
        for key, _ in self._selector.select(seconds):
            with contextlib.suppress(BlockingIOError):
                while True:
                    readings += self._read(key.data, key.fileobj.recv(2000))
        return readings

    def close(self) -> None:
        """Close the sockets."""
        for link in self._sockets:
            link.close()
        self._selector.close()


def _connect_datagrams(port: int, own_port: int = 0) -> socket.socket:
    """Open a UDP socket, and connect it to a port of this machine."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", own_port))
    link.connect(("127.0.0.1", port))
    link.setblocking(False)
    return link


def _ask(link: socket.socket, request: bytes) -> bytes:
    """Send a datagram, and return the next one that arrives, of at most 100 bytes."""
    link.settimeout(2.0)
    link.send(request)
    answer = link.recv(100)
    link.setblocking(False)
    return answer


class CrazyflieClients(DatagramClients):
    """Clients of virtual Crazyflies: position setpoints, and a log block at 100 Hz."""

    command_hz = 50.0

    def __init__(self, num_vehicles: int, port: int) -> None:
        """Prepare for a number of drones. The server has one more, for `visit`."""
        super().__init__(num_vehicles, port)
        # In rows of ten, since the default grid of 0.5 m is too narrow for `HALF_STROKE`
        self._starts = [(2.0 * (k % 10), 2.0 * (k // 10)) for k in range(num_vehicles + 1)]
        positions = [str(coordinate) for start in self._starts for coordinate in start]
        self.words = ("crazyflie", "--port", str(port), "--positions", *positions)

    def connect(self) -> None:
        """Connect, start a log block for each drone, and take off."""
        rate = struct.pack("<BH", 7, list(LOGS).index("gyro.y"))
        take_off = b"\x8c" + struct.pack("<BBff?f", 7, 0, HEIGHT, 0.0, True, 1.0)
        for k in range(self.num_vehicles):
            link = self._open(self._port + k)
            for request in (b"\xfd\x00", b"\x5d\x06\x00" + rate, b"\x5d\x03\x00\x01", take_off):
                _ask(link, request)

    def send(self, k: int, side: int) -> None:
        """Send a position; drones face east (x), which is their north here."""
        x, y = self._starts[k]
        self._sockets[k].send(
            struct.pack("<BBffff", 0x7C, 7, x + HALF_STROKE * side, y, HEIGHT, 0.0)
        )

    def _read(self, k: int, datagram: bytes) -> Iterator[Reading]:
        """Return the reading of a packet of the log block."""
        if datagram[0] == 0x5E:
            stamp = int.from_bytes(datagram[2:5], "little") / 1000
            (degrees,) = struct.unpack("<f", datagram[5:9])
            yield Reading(k, stamp, math.radians(degrees))

    def visit(self) -> None:
        """Read the whole table of log variables of the last drone; ask the first one in vain."""
        taken = _connect_datagrams(self._port)
        taken.send(b"\xfd\x00")
        link = _connect_datagrams(self._port + self.num_vehicles)
        _ask(link, b"\xfd\x00")
        for variable in range(len(LOGS)):
            _ask(link, b"\x5d" + struct.pack("<BH", 2, variable))
        _ask(link, b"\x5d\x06\x07" + struct.pack("<BH", 7, 0))
        _ask(link, b"\x5d\x03\x07\x01")
        time.sleep(0.5)
        link.send(b"\x3c" + bytes(14))
        link.close()
        taken.close()


class MavlinkClients(DatagramClients):
    """Ground stations of MAVLink vehicles: offboard positions, and ATTITUDE at 100 Hz."""

    command_hz = 50.0

    def __init__(self, num_vehicles: int, port: int) -> None:
        """Prepare for a number of vehicles."""
        super().__init__(num_vehicles, port)
        self._own_port = port + NUM_PORTS // 2
        ports = ("--port", str(port), "--client-port", str(self._own_port))
        self.words = ("mavlink", "--drones", str(num_vehicles), *ports)
        self._positions = {
            (k, side): pack_mavlink(
                "set_position_target_local_ned",
                *(0, k + 1, 1, 1, 0xDF8, HALF_STROKE * side, 0.0, -HEIGHT, *[0.0] * 8),
            )
            for k in range(num_vehicles)
            for side in (1, -1)
        }

    def connect(self) -> None:
        """Request ATTITUDE, arm, and change to offboard mode."""
        commands = ((511, common.MAVLINK_MSG_ID_ATTITUDE, 10000), (400, 1), (176, 1, 6, 0))
        for k in range(self.num_vehicles):
            link = self._open(self._port + k, self._own_port + k)
            link.send(self._positions[k, 1])
            for number, *given in commands:
                values = (*given, *[0.0] * (7 - len(given)))
                link.send(pack_mavlink("command_long", k + 1, 1, number, 0, *values))

    def send(self, k: int, side: int) -> None:
        """Send a position."""
        self._sockets[k].send(self._positions[k, side])

    def _read(self, k: int, datagram: bytes) -> Iterator[Reading]:
        """Return the readings of all ATTITUDE messages of a datagram."""
        while datagram:
            size = datagram[1]
            if int.from_bytes(datagram[7:10], "little") == common.MAVLINK_MSG_ID_ATTITUDE:
                payload = datagram[10 : 10 + size].ljust(28, b"\0")
                stamp, *_, pitch_rate, _ = struct.unpack("<Iffffff", payload)
                # The y axis of MAVLink points to the right
                yield Reading(k, stamp / 1000, -pitch_rate)
            datagram = datagram[12 + size :]

    def visit(self) -> None:
        """Send a heartbeat, and read all parameters."""
        link = _connect_datagrams(self._port)
        link.send(pack_mavlink("heartbeat", 6, 8, 0, 0, 4, 3))
        link.send(pack_mavlink("param_request_list", 1, 1))
        end = time.perf_counter() + 0.5
        while time.perf_counter() < end:
            with contextlib.suppress(BlockingIOError):
                link.recv(2000)
            time.sleep(0.01)
        link.close()


def pack_mavlink(name: str, *fields: Any) -> bytes:
    """Pack a message of a ground station."""
    message = getattr(common, f"MAVLink_{name}_message")(*fields)
    return bytes(message.pack(common.MAVLink(None, 255, 190)))


class AirsimConnection:
    """Connection to a server of AirSim's calls."""

    def __init__(self, port: int) -> None:
        """Connect to a port of this machine."""
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._unpacker, self._count = msgpack.Unpacker(), 0

    def send(self, name: str, *arguments: Any) -> int:
        """Send a request, and return its number."""
        self._count += 1
        self.socket.sendall(msgpack.packb([0, self._count, name, list(arguments)]))
        return self._count

    def receive(self) -> Iterator[tuple[int, Any]]:
        """Wait for bytes, and return the number and result of each response.

        Raises:
            RuntimeError: If the server answered with an error.
            ConnectionError: If the server has closed the connection.
        """
        data = self.socket.recv(2**20)
        if not data:
            raise ConnectionError("the server of AirSim's calls has closed the connection")
        self._unpacker.feed(data)
        for _, number, error, result in self._unpacker:
            if error is not None:
                raise RuntimeError(error)
            yield number, result

    def call(self, name: str, *arguments: Any) -> Any:
        """Send a request and return its result; other responses are dropped."""
        wanted = self.send(name, *arguments)
        while True:
            for number, result in self.receive():
                if number == wanted:
                    return result


class AirsimClients(Clients):
    """Client of AirSim's calls: `moveToPosition`, and states that are read again and again."""

    command_hz = 1e-3  # motions last until the next one
    READ_PERIOD, IDLE_PERIOD = 0.002, 0.05
    """Times between requests for states, with and without a watched vehicle, s"""

    def __init__(self, num_vehicles: int, port: int) -> None:
        """Prepare for a number of vehicles."""
        super().__init__(num_vehicles, port)
        self.words = ("airsim", "--drones", str(num_vehicles), "--port", str(port))
        # Vehicle of each outstanding request for a state
        self._requests: dict[int, int] = {}

    def connect(self) -> None:
        """Connect, and take off."""
        self.connection = AirsimConnection(self._port)
        self.names = self.connection.call("listVehicles")
        for name in self.names:
            self.connection.call("enableApiControl", True, name)
            self.connection.call("armDisarm", True, name)
            self.connection.send("takeoff", 20.0, name)

    def send(self, k: int, side: int) -> None:
        """Send a position."""
        free = (0, {"is_rate": True, "yaw_or_rate": 0.0}, -1, 1)
        position = (HALF_STROKE * side, 0.0, -HEIGHT, 5.0, 60.0)
        self.connection.send("moveToPosition", *position, *free, self.names[k])

    def receive(self, seconds: float, watched: Collection[int]) -> list[Reading]:
        """Request the states of the watched vehicles; return those that arrive."""
        time.sleep(min(seconds, self.READ_PERIOD if watched else self.IDLE_PERIOD))
        wanted = set(watched or (0,)) - set(self._requests.values())
        for k in wanted:
            self._requests[self.connection.send("getMultirotorState", self.names[k])] = k
        readings = []
        for number, result in self.connection.receive():
            if number in self._requests:
                rates = result["kinematics_estimated"]["angular_velocity"]
                stamp = result["timestamp"] / 1e9
                readings.append(Reading(self._requests.pop(number), stamp, -rates["y_val"]))
        return readings

    def visit(self) -> None:
        """Connect, look at the scene, take a picture, and disconnect."""
        visitor = AirsimConnection(self._port)
        visitor.call("getServerVersion")
        visitor.call("simListSceneObjects", ".*")
        visitor.call("simGetImages", [{"camera_name": "0", "image_type": 0}], "")
        visitor.socket.close()

    def close(self) -> None:
        """Close the connection."""
        self.connection.socket.close()


KINDS: dict[str, type[Clients]] = {
    "airsim": AirsimClients,
    "mavlink": MavlinkClients,
    "crazyflie": CrazyflieClients,
}
"""Clients by the name of their server"""
