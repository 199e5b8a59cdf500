"""Measure what servers for programs of others keep up with.

    python benchmarks/bridges.py --out docs/results/bridges

The server runs in a process of its own, and the client here, by bytes on sockets. Virtual
Crazyflies: all hold a place, with setpoints at 50 Hz and a log block at 100 Hz each. Reported are
setpoints and log packets a second, the real-time factor, the processor time of the server, how long
an echo takes, and how much faster than real time the fleet flies if nothing holds it back.

AirSim's calls: states that one client reads a second, one after the other, while the world flies
in real time; velocities that it sets, one after the other; and how much faster than real time a
loop in lockstep runs that commands and reads every vehicle ten times a simulated second. With
`--pictures` alone: how long pings of one client take while another one asks for pictures.

MAVLink: all vehicles fly offboard, with setpoints at 50 Hz each, and send telemetry at the usual
rates, with local positions at 50 Hz. Reported are setpoints and messages a second, and the rest as
for Crazyflies; an echo is a TIMESYNC.

Autopilots in the loop: every body is measured 250 times a simulated second, and each measurement is
answered by motor commands. Reported are measurements a second of all bodies and the real-time
factor at speed 1, and how much faster than real time lockstep runs.

Writes crazyflie.md, airsim.md, mavlink.md and hil.md. Needs psutil, msgpack and pymavlink, of the
extra `test`.
"""

import argparse
import math
import selectors
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgpack
import psutil
from pymavlink.dialects.v20 import common

from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.crtp import Packet
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.mavlink_protocol import MavlinkCodec, Sender
from bulletuav.bridges.mavlink_services import join_frames
from bulletuav.files import replace_file

PORT = 20850
AIRSIM_PORT = 20450
MAVLINK_PORT, MAVLINK_CLIENT = 21570, 21270
HIL_PORT, HIL_HZ = 24560, 250
SETPOINTS_HZ = 50
HEIGHT = 1.0


def served(*words: str) -> tuple[subprocess.Popen, psutil.Process]:
    """Start `bulletuav serve`, and wait until it has told its address."""
    command = [sys.executable, "-m", "bulletuav", "serve", *words]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    while " at " not in server.stdout.readline():
        if server.poll() is not None:
            raise SystemExit(f"{' '.join(words)} did not start")
    return server, psutil.Process(server.pid)


def links(drones: int) -> list[socket.socket]:
    """Connect to all drones, let each log its place at 100 Hz, and take off."""
    found = []
    log = b"\x5d\x06\x00" + b"".join(struct.pack("<BH", 7, k) for k in range(3))
    take_off = b"\x8c" + struct.pack("<BBff?f", 7, 0, HEIGHT, 0.0, True, 1.0)
    for k in range(drones):
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.connect(("127.0.0.1", PORT + k))
        for request in (b"\xfd\x00", log, b"\x5d\x03\x00\x01", take_off):
            link.send(request)
            link.recv(100)
        link.setblocking(False)
        found.append(link)
    return found


def stream(found: list[socket.socket], seconds: float) -> tuple[int, list[int]]:
    """Send setpoints and read logs for a time; tell how many were sent, and the stamps of logs."""
    hold = [
        struct.pack("<BBffff", 0x7C, 7, 0.5 * (k % 10), 0.5 * (k // 10), HEIGHT, 0.0)
        for k in range(len(found))
    ]
    sent, stamps = 0, []
    end = due = time.perf_counter()
    end += seconds
    while time.perf_counter() < end:
        for link, packet in zip(found, hold, strict=True):
            link.send(packet)
            sent += 1
        due += 1 / SETPOINTS_HZ
        for link in found:
            try:
                while True:
                    data = link.recv(100)
                    if data[0] == 0x5E:
                        stamps.append(int.from_bytes(data[2:5], "little"))
            except BlockingIOError:
                pass
        time.sleep(max(due - time.perf_counter(), 0.0))
    return sent, stamps


def echo(link: socket.socket, times: int) -> float:
    """Measure the median time of an echo, s."""
    link.settimeout(1.0)
    lasted = []
    for _ in range(times):
        begin = time.perf_counter()
        link.send(b"\xfc")
        while link.recv(100)[0] >> 4 != 15:
            pass
        lasted.append(time.perf_counter() - begin)
    return statistics.median(lasted)


def unbound(drones: int, steps: int) -> float:
    """Tell simulated seconds in one of the clock for a fleet that nobody waits for."""
    fleet = CrazyflieFleet(drones, seed=0)
    fleet.warm_up()
    for k in range(drones):
        fleet.take(k, Packet(8, 0, struct.pack("<BBff?f", 7, 0, HEIGHT, 0.0, True, 1.0)))
    begin = time.perf_counter()
    for _ in range(steps):
        fleet.step()
    lasted = time.perf_counter() - begin
    fleet.close()
    return steps * fleet.airspace.period / lasted


def crazyflies(drones: int, seconds: float) -> list[str]:
    """Measure a number of virtual Crazyflies; give the cells of a row."""
    server, process = served("crazyflie", "--drones", str(drones), "--port", str(PORT))
    try:
        found = links(drones)
        stream(found, 2.0)  # until all are there
        before, begin = sum(process.cpu_times()[:2]), time.perf_counter()
        sent, stamps = stream(found, seconds)
        lasted = time.perf_counter() - begin
        busy = (sum(process.cpu_times()[:2]) - before) / lasted
        delay = echo(found[0], 300)
    finally:
        server.terminate()
        server.wait()
    factor = (stamps[-1] - stamps[0]) / 1000 / lasted
    free = unbound(drones, max(2000 // drones, 200))
    return [
        str(drones),
        f"{sent / lasted:.0f}",
        f"{len(stamps) / lasted:.0f}",
        f"{factor:.2f}",
        f"{100 * busy:.0f} %",
        f"{1000 * delay:.2f}",
        f"{free:.1f}",
    ]


class Caller:
    """A client of AirSim's calls that waits for each answer."""

    def __init__(self) -> None:
        """Connect."""
        self._socket = socket.create_connection(("127.0.0.1", AIRSIM_PORT))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._unpacker, self._count = msgpack.Unpacker(), 0

    def send(self, name: str, *arguments: object) -> int:
        """Send a request; give its number."""
        self._count += 1
        self._socket.sendall(msgpack.packb([0, self._count, name, list(arguments)]))
        return self._count

    def get(self, name: str, *arguments: object) -> object:
        """Send a request and wait for its answer; other answers are dropped."""
        number = self.send(name, *arguments)
        while True:
            for _, messages, error, result in self._unpacker:
                if messages == number:
                    assert error is None, error
                    return result
            self._unpacker.feed(self._socket.recv(2**20))


def times(seconds: float, call: Callable[[], object]) -> float:
    """Do something again and again for a time, s; tell how often a second."""
    count, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        call()
        count += 1
    return count / (time.perf_counter() - begin)


def airsim(drones: int, seconds: float) -> list[str]:
    """Measure AirSim's calls with a number of vehicles; give the cells of a row."""
    server, _ = served("airsim", "--drones", str(drones), "--port", str(AIRSIM_PORT))
    free = (0, {"is_rate": True, "yaw_or_rate": 0.0})
    try:
        caller = Caller()
        names = caller.get("listVehicles")
        for name in names:
            caller.get("enableApiControl", True, name)
            caller.get("armDisarm", True, name)
            caller.send("takeoff", 20.0, name)

        def command() -> None:
            caller.send("moveByVelocity", 0.1, 0.0, 0.0, 9.0, *free, names[0])
            caller.get("ping")

        reads = times(seconds, lambda: caller.get("getMultirotorState", names[0]))
        commands = times(seconds, command)
        caller.get("simPause", True)

        def turn() -> None:
            for name in names:
                caller.send("moveByVelocity", 0.1, 0.0, 0.0, 9.0, *free, name)
            caller.get("simContinueForTime", 0.1)
            for name in names:
                caller.get("getMultirotorState", name)

        factor = 0.1 * times(seconds, turn)
    finally:
        server.terminate()
        server.wait()
    return [str(drones), f"{reads:.0f}", f"{commands:.0f}", f"{factor:.1f}"]


def pictures(seconds: float) -> str:
    """Measure what one client's pictures cost another client and the flight; give a sentence."""
    server, _ = served("airsim", "--port", str(AIRSIM_PORT))
    try:
        caller, drawer = Caller(), Caller()
        wanted = [{"camera_name": "0", "image_type": 0}] * 32
        drawer.get("simGetImages", wanted, "")  # the first one waits for the process that draws
        drawn, lasted, stop = 0, [], threading.Event()

        def draw() -> None:
            nonlocal drawn
            while not stop.is_set():
                drawn += len(drawer.get("simGetImages", wanted, ""))

        def stamp() -> float:
            return caller.get("getMultirotorState", "")["timestamp"] / 1e9

        thread = threading.Thread(target=draw)
        thread.start()
        begin, stamped = time.perf_counter(), stamp()
        while time.perf_counter() < begin + seconds:
            sent = time.perf_counter()
            caller.get("ping")
            lasted.append(1000 * (time.perf_counter() - sent))
            time.sleep(0.01)
        flown, passed = stamp() - stamped, time.perf_counter() - begin
        stop.set()
        thread.join()
    finally:
        server.terminate()
        server.wait()
    return (
        f"{drawn / passed:.0f} pictures/s; pings of another client took {max(lasted):.1f} ms at "
        f"most, {statistics.median(lasted):.1f} ms in the median; real-time factor "
        f"{flown / passed:.3f}"
    )


def frame(drone: int, name: str, *fields: object) -> bytes:
    """Pack a message for a vehicle."""
    made = getattr(common, f"MAVLink_{name}_message")(*fields)
    return bytes(made.pack(common.MAVLink(None, 255, 190)))


def held(drone: int) -> bytes:
    """Pack a setpoint: 1.5 m above the start."""
    target = (drone + 1, 1, 1, 0xDF8)
    place = (0.0, 0.0, -1.5, *[0.0] * 8)
    return frame(drone, "set_position_target_local_ned", 0, *target, *place)


def requests(drone: int) -> list[bytes]:
    """Pack what lets a vehicle take off, and fly offboard."""
    commands = ((511, 32, 20000), (400, 1), (176, 1, 6, 0))
    packed = [
        frame(drone, "command_long", drone + 1, 1, one[0], 0, *one[1:], *[0.0] * (8 - len(one)))
        for one in commands
    ]
    return [held(drone), *packed]


def stream_mavlink(
    found: list[socket.socket], seconds: float
) -> tuple[int, int, list[tuple[float, int]]]:
    """Send setpoints and read telemetry for a time.

    Returns:
        How many setpoints were sent, how many messages came, and when (s) local positions of the
        first vehicle came, with their stamps (ms).
    """
    hold = [held(k) for k in range(len(found))]
    sent, came, stamps = 0, 0, []
    due = time.perf_counter()
    end = due + seconds
    while time.perf_counter() < end:
        for k, link in enumerate(found):
            link.sendto(hold[k], ("127.0.0.1", MAVLINK_PORT + k))
            sent += 1
        due += 1 / SETPOINTS_HZ
        for k, link in enumerate(found):
            try:
                while True:
                    data = link.recv(2000)
                    while data:
                        came += 1
                        if k == 0 and data[7] == 32:
                            stamp = int.from_bytes(data[10:14], "little")
                            stamps.append((time.perf_counter(), stamp))
                        data = data[12 + data[1] :]
            except BlockingIOError:
                pass
        time.sleep(max(due - time.perf_counter(), 0.0))
    return sent, came, stamps


def echo_mavlink(link: socket.socket, times: int) -> float:
    """Measure the median time of a TIMESYNC, s."""
    link.settimeout(1.0)
    lasted = []
    for k in range(times):
        request = frame(0, "timesync", 0, k + 1)
        begin = time.perf_counter()
        link.sendto(request, ("127.0.0.1", MAVLINK_PORT))
        while link.recv(2000)[7] != common.MAVLINK_MSG_ID_TIMESYNC:
            pass
        lasted.append(time.perf_counter() - begin)
    return statistics.median(lasted)


def unbound_mavlink(drones: int, steps: int) -> float:
    """Tell simulated seconds in one of the clock for vehicles that nobody waits for."""
    fleet, sender = MavlinkFleet(drones, seed=0), Sender(255, 190)
    fleet.warm_up()
    wires = [MavlinkCodec(k + 1) for k in range(drones)]
    for k, wire in enumerate(wires):
        (take_off,) = wire.read(frame(k, "command_long", k + 1, 1, 22, 0, *[math.nan] * 7))
        (arm,) = wire.read(frame(k, "command_long", k + 1, 1, 400, 0, 1, *[0.0] * 6))
        for message in (take_off, arm):
            fleet.take(k, message, sender)
    begin = time.perf_counter()
    for _ in range(steps):
        for wire, messages in zip(wires, fleet.step(), strict=True):
            join_frames([wire.pack(one) for one in messages], 1400)
    lasted = time.perf_counter() - begin
    fleet.close()
    return steps * fleet.airspace.period / lasted


def mavlink(drones: int, seconds: float) -> list[str]:
    """Measure a number of MAVLink vehicles; give the cells of a row."""
    ports = ("--port", str(MAVLINK_PORT), "--client-port", str(MAVLINK_CLIENT))
    server, process = served("mavlink", "--drones", str(drones), *ports)
    found = []
    try:
        for k in range(drones):
            link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.bind(("127.0.0.1", MAVLINK_CLIENT + k))
            for request in requests(k):
                link.sendto(request, ("127.0.0.1", MAVLINK_PORT + k))
            link.setblocking(False)
            found.append(link)
        stream_mavlink(found, 4.0)  # until all are there
        before, begin = sum(process.cpu_times()[:2]), time.perf_counter()
        sent, came, stamps = stream_mavlink(found, seconds)
        lasted = time.perf_counter() - begin
        busy = (sum(process.cpu_times()[:2]) - before) / lasted
        delay = echo_mavlink(found[0], 300)
    finally:
        server.terminate()
        server.wait()
        for link in found:
            link.close()
    (first, early), (last, late) = stamps[0], stamps[-1]
    free = unbound_mavlink(drones, max(2000 // drones, 200))
    return [
        str(drones),
        f"{sent / lasted:.0f}",
        f"{came / lasted:.0f}",
        f"{(late - early) / 1000 / (last - first):.2f}",
        f"{100 * busy:.0f} %",
        f"{1000 * delay:.2f}",
        f"{free:.1f}",
    ]


def lockstep(drones: int, seconds: float, speed: float) -> tuple[float, float]:
    """Answer measurements of all bodies for a time.

    Returns:
        Measurements a second of all bodies, and the real-time factor.
    """
    words = ("--drones", str(drones), "--port", str(HIL_PORT), "--speed", str(speed))
    server, _ = served("hil", *words)
    controls = ([0.5] * 16, 128, 1)
    answer = frame(0, "hil_actuator_controls", 2**62, *controls)
    links, seen = selectors.DefaultSelector(), 0
    try:
        for k in range(drones):
            link = socket.create_connection(("127.0.0.1", HIL_PORT + k))
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            links.register(link, selectors.EVENT_READ)
        begin = time.perf_counter()
        while time.perf_counter() < begin + seconds:
            for key, _ in links.select(1.0):
                key.fileobj.recv(4096)
                key.fileobj.send(answer)
                seen += 1
        lasted = time.perf_counter() - begin
    finally:
        server.terminate()
        server.wait()
        for key in list(links.get_map().values()):
            key.fileobj.close()
        links.close()
    return seen / lasted, seen / drones / HIL_HZ / lasted


def hil(drones: int, seconds: float) -> list[str]:
    """Measure lockstep with a number of autopilots; give the cells of a row."""
    rate, factor = lockstep(drones, seconds, 1.0)
    _, free = lockstep(drones, seconds, 1000.0)
    return [str(drones), f"{rate:.0f}", f"{factor:.2f}", f"{free:.1f}"]


def write(path: Path, heads: tuple[str, ...], rows: list[list[str]]) -> None:
    """Write a table."""
    lines = [list(heads), ["---:"] * len(heads), *rows]
    table = "".join(f"| {' | '.join(row)} |\n" for row in lines)
    replace_file(path, table)
    print(table)


def main() -> None:
    """Measure, and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/results/bridges"))
    parser.add_argument("--drones", type=int, nargs="+", default=[1, 10, 100])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--pictures", action="store_true", help="measure AirSim's pictures alone")
    arguments = parser.parse_args()
    if arguments.pictures:
        print(pictures(arguments.seconds))
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    rates = ("real-time factor", "processor of the server", "echo, ms", "times real time, unpaced")
    heads = ("drones", "setpoints/s", "log packets/s", *rates)
    rows = [crazyflies(count, arguments.seconds) for count in arguments.drones]
    write(arguments.out / "crazyflie.md", heads, rows)
    heads = ("vehicles", "states read/s", "velocities set/s", "times real time, in lockstep")
    rows = [airsim(count, arguments.seconds / 3) for count in arguments.drones]
    write(arguments.out / "airsim.md", heads, rows)
    heads = ("vehicles", "setpoints/s", "messages/s", *rates)
    rows = [mavlink(count, arguments.seconds) for count in arguments.drones]
    write(arguments.out / "mavlink.md", heads, rows)
    heads = ("bodies", "measurements/s", "real-time factor", "times real time, in lockstep")
    rows = [hil(count, arguments.seconds) for count in arguments.drones]
    write(arguments.out / "hil.md", heads, rows)


if __name__ == "__main__":
    main()
