"""Measure the servers of `bulletuav serve` in real time, and their memory for an hour.

    python benchmarks/bridges.py --out docs/benchmarks/adapters.md
    python benchmarks/bridges.py --soak 3600 --log soak.csv

Each server runs in a process of its own; the clients here send and read bytes on sockets. All
vehicles fly: every 2 s, each one at another time, a vehicle is commanded to a point 0.5 m further
north or south. The delay of a command is the time on the client's clock from sending it to the
first telemetry whose pitch rate has changed by 0.02 rad/s in the new direction. Telemetry has
100 Hz (Crazyflie: a log block; MAVLink: ATTITUDE; AirSim: the state, read every 2 ms), and so have
the steps of these servers. Autopilots in the loop (`hil`) command motors at 250 Hz; their delay is
the time from sending motor commands to the next measurement, which these motors have changed.

A command without an effect within 2 s, when the next one comes, is missed, and has no delay.

The real-time factor is simulated time per time, both by the telemetry. Processor time is that of
the server and its children, as a fraction of one core.

With `--soak`, the servers of AirSim, MAVLink and Crazyflie fly two vehicles each, and every minute
one more client connects and disconnects. Resident memory is flat if the line fitted to its second
half rises by less than 1 MiB an hour.

With `--pictures`: the delay of one client's pings while another client asks for pictures.

Needs psutil, msgpack and pymavlink, of the extra `test`.
"""

import argparse
import contextlib
import selectors
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
from bridge_clients import (
    KINDS,
    NUM_PORTS,
    AirsimConnection,
    Clients,
    pack_mavlink,
)
from pymavlink.dialects.v20 import common

from bulletuav.files import replace_file

HIL_HZ = 250
PERIOD = 2.0
"""Time between changes of a vehicle's direction, s"""
MIN_CHANGE = 0.02
"""Change of the pitch rate that shows the effect of a command, rad/s"""
READ_AHEAD = 0.05
"""Time before a command from which on telemetry of its vehicle is read, s"""
SETTLING_TIME = 6.0
"""Time for taking off, s"""
SAMPLE_PERIOD, VISIT_PERIOD = 10.0, 60.0
"""Times between samples of memory, and between visits of one more client, s"""
MAX_GROWTH = 1.0
"""Maximum slope of memory that counts as flat, MiB/h"""


class Server(NamedTuple):
    """Running server.

    Attributes:
        popen: Handle that stops it.
        process: Process, with its memory and processor time.
    """

    popen: subprocess.Popen
    process: psutil.Process

    def processes(self) -> list[psutil.Process]:
        """Return the server and its children."""
        return [self.process, *self.process.children(recursive=True)]

    def cpu_time(self) -> float:
        """Return the processor time so far, s."""
        return sum(sum(process.cpu_times()[:2]) for process in self.processes())

    def memory(self) -> float:
        """Return the resident memory, MiB."""
        return sum(process.memory_info().rss for process in self.processes()) / 2**20


@contextlib.contextmanager
def serve(*words: str) -> Iterator[Server]:
    """Run `bulletuav serve`, once it listens, until the end of a `with` block."""
    command = [sys.executable, "-m", "bulletuav", "serve", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as popen:
        try:
            assert popen.stdout is not None
            while " at " not in popen.stdout.readline():
                if popen.poll() is not None:
                    raise SystemExit(f"{' '.join(words)} did not start")
            yield Server(popen, psutil.Process(popen.pid))
        finally:
            popen.terminate()


class Flight(NamedTuple):
    """Measurements of a flight.

    Attributes:
        factor: Simulated time per time.
        delays: Delay of each change of direction, s.
        missed: Number of changes of direction without an effect before the next one.
    """

    factor: float
    delays: list[float]
    missed: int


def fly(clients: Clients, seconds: float, stop: threading.Event | None = None) -> Flight:
    """Fly all vehicles back and forth.

    Args:
        clients: Connected clients.
        seconds: Duration, s.
        stop: Event that ends the flight earlier.

    Returns:
        The real-time factor, the delays and the number of missed commands.
    """
    count = clients.num_vehicles
    begin = now = time.perf_counter()
    # The first turn follows one period later, when all vehicles have come to rest
    sides, turns = [1] * count, [begin + PERIOD * (1 + (k + 1) / count) for k in range(count)]
    pitch_rates, repeats = [0.0] * count, begin
    # Time of each command without an effect yet, and the pitch rate at that time
    pending: dict[int, tuple[float, float]] = {}
    delays, missed, stamps = [], 0, []
    while now < begin + seconds and not (stop and stop.is_set()):
        for k in range(count):
            if now >= turns[k]:
                missed += k in pending
                sides[k], turns[k] = -sides[k], turns[k] + PERIOD
                pending[k] = (time.perf_counter(), pitch_rates[k])
                clients.send(k, sides[k])
        if now >= repeats:
            repeats += 1 / clients.command_hz
            for k in range(count):
                clients.send(k, sides[k])
        due = min(repeats, *turns, begin + seconds)
        watched = {*pending, *(k for k in range(count) if turns[k] < now + READ_AHEAD)}
        readings = clients.receive(max(due - time.perf_counter(), 0.0), watched)
        now = time.perf_counter()
        for k, _, pitch_rate in readings:
            pitch_rates[k] = pitch_rate
            if k in pending and sides[k] * (pitch_rate - pending[k][1]) > MIN_CHANGE:
                delays.append(now - pending.pop(k)[0])
        if readings:
            stamps[1:] = [(now, readings[-1].stamp)]
    (first, early), (last, late) = stamps
    return Flight((late - early) / (last - first), delays, missed)


def measure(kind: str, count: int, seconds: float, port: int) -> list[str]:
    """Fly all vehicles of a server for a time, and return the cells of its row."""
    clients = KINDS[kind](count, port)
    with serve(*clients.words) as server, contextlib.closing(clients):
        clients.connect()
        fly(clients, SETTLING_TIME)
        cpu, begin = server.cpu_time(), time.perf_counter()
        flight = fly(clients, seconds)
        cpu_fraction = (server.cpu_time() - cpu) / (time.perf_counter() - begin)
    return make_row(kind, count, flight, cpu_fraction)


def make_row(kind: str, count: int, flight: Flight, cpu_fraction: float) -> list[str]:
    """Return the cells of a row."""
    return [
        kind,
        str(count),
        f"{flight.factor:.3f}",
        f"{1000 * statistics.median(flight.delays):.1f}",
        f"{1000 * max(flight.delays):.1f}",
        f"{len(flight.delays)}",
        f"{flight.missed}",
        f"{100 * cpu_fraction:.0f} %",
    ]


def measure_hil(count: int, seconds: float, port: int) -> list[str]:
    """Answer the measurements of all bodies for a time, as autopilots do; return their row."""
    answer = pack_mavlink("hil_actuator_controls", 2**62, [0.5] * 16, 128, 1)
    words = ("--drones", str(count), "--port", str(port))
    delays, seen = [], 0
    with (
        serve("hil", *words) as server,
        selectors.DefaultSelector() as selector,
        contextlib.ExitStack() as stack,
    ):
        for k in range(count):
            link = stack.enter_context(socket.create_connection(("127.0.0.1", port + k)))
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            selector.register(link, selectors.EVENT_READ)
            # The first message makes a connection the autopilot of its body
            link.send(pack_mavlink("heartbeat", 1, 12, 0, 0, 4, 3))
        sent: dict[socket.socket, float] = {}
        cpu, begin = server.cpu_time(), time.perf_counter()
        while time.perf_counter() < begin + seconds:
            for key, _ in selector.select(1.0):
                data = key.fileobj.recv(4096)
                now = time.perf_counter()
                if key.fileobj in sent:
                    delays.append(now - sent[key.fileobj])
                seen += data[7] == common.MAVLINK_MSG_ID_HIL_SENSOR
                sent[key.fileobj] = time.perf_counter()
                key.fileobj.send(answer)
        lasted = time.perf_counter() - begin
        cpu_fraction = (server.cpu_time() - cpu) / lasted
    flight = Flight(seen / count / HIL_HZ / lasted, delays, 0)
    return make_row("hil", count, flight, cpu_fraction)


class Soak(NamedTuple):
    """Memory of a server over time.

    Attributes:
        times: Times of the samples, s.
        memory: Resident memory, MiB.
    """

    times: list[float]
    memory: list[float]

    def slope(self) -> float:
        """Return the slope of the line fitted to the second half, MiB/h."""
        half = len(self.times) // 2
        return 3600 * float(np.polyfit(self.times[half:], self.memory[half:], 1)[0])


def soak(seconds: float, port: int, log: Path | None) -> bool:
    """Fly two vehicles of each server for a time, and print how its memory changed.

    Args:
        seconds: Duration, s.
        port: First port of the servers.
        log: CSV file of all samples; None for no file.

    Returns:
        Whether memory was flat in all servers.
    """
    fleets = {
        kind: make(2, port + NUM_PORTS * place) for place, (kind, make) in enumerate(KINDS.items())
    }
    soaks = {kind: Soak([], []) for kind in fleets}
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        servers = {kind: stack.enter_context(serve(*fleet.words)) for kind, fleet in fleets.items()}
        for fleet in fleets.values():
            fleet.connect()
            stack.callback(fleet.close)
        pool = stack.enter_context(ThreadPoolExecutor(len(fleets)))
        stack.callback(stop.set)
        flights = {kind: pool.submit(fly, fleet, seconds, stop) for kind, fleet in fleets.items()}
        begin, visits = time.perf_counter(), 0
        while time.perf_counter() - begin < seconds:
            raise_errors(flights)
            if time.perf_counter() - begin >= visits * VISIT_PERIOD:
                visits += 1
                for fleet in fleets.values():
                    fleet.visit()
            for kind, server in servers.items():
                soaks[kind].times.append(time.perf_counter() - begin)
                soaks[kind].memory.append(server.memory())
            if log is not None:
                write_soak(log, soaks)
            time.sleep(min(SAMPLE_PERIOD, max(begin + seconds - time.perf_counter(), 0.0)))
        rows = [
            [
                kind,
                *(f"{found.memory[k]:.1f}" for k in (0, len(found.memory) // 2, -1)),
                f"{found.slope():.2f}",
                f"{flights[kind].result().factor:.4f}",
                f"{len(flights[kind].result().delays)}",
                f"{flights[kind].result().missed}",
                f"{visits}",
                f"{servers[kind].cpu_time() / seconds:.1%}",
            ]
            for kind, found in soaks.items()
        ]
    print(make_table(SOAK_HEADS, rows))
    return all(found.slope() < MAX_GROWTH for found in soaks.values())


def raise_errors(flights: dict[str, Future[Flight]]) -> None:
    """Raise the error of a flight that has ended by one."""
    for flight in flights.values():
        if flight.done():
            flight.result()


def write_soak(path: Path, soaks: dict[str, Soak]) -> None:
    """Write the memory of all servers over time as CSV."""
    times = next(iter(soaks.values())).times
    rows = zip(times, *(found.memory for found in soaks.values()), strict=True)
    lines = [",".join(["s", *(f"{kind}_mib" for kind in soaks)])]
    lines += [",".join(f"{value:.3f}" for value in row) for row in rows]
    replace_file(path, "\n".join(lines) + "\n")


def measure_lockstep(count: int, seconds: float, port: int) -> list[str]:
    """Measure decisions through one client of AirSim's calls, in lockstep.

    In each decision, all vehicles are commanded, 0.1 s is simulated, and all states are read.

    Returns:
        The cells of a row.
    """
    words = ("--drones", str(count), "--port", str(port), "--paused")
    free = (0, {"is_rate": True, "yaw_or_rate": 0.0})
    with serve("airsim", *words) as server:
        connection = AirsimConnection(port)
        names = connection.call("listVehicles")
        for name in names:
            connection.call("enableApiControl", True, name)
            connection.send("takeoff", 20.0, name)
        connection.call("simContinueForTime", 5.0)
        decisions, cpu, begin = 0, server.cpu_time(), time.perf_counter()
        while time.perf_counter() < begin + seconds:
            for name in names:
                connection.send("moveByVelocity", 0.1, 0.0, 0.0, 1.0, *free, name)
            connection.call("simContinueForTime", 0.1)
            for name in names:
                connection.call("getMultirotorState", name)
            decisions += 1
        lasted, cpu = time.perf_counter() - begin, server.cpu_time() - cpu
        connection.socket.close()
    rate = decisions / lasted
    return [
        str(count),
        f"{rate:.0f}",
        f"{0.1 * rate:.1f}",
        f"{100 * cpu / lasted:.0f} %",
        f"{1000 * cpu / decisions:.1f}",
    ]


def measure_pictures(seconds: float, port: int) -> str:
    """Measure what one client's pictures cost another client and the flight; return a sentence."""
    with serve("airsim", "--port", str(port)):
        reader, drawer = AirsimConnection(port), AirsimConnection(port)
        wanted = [{"camera_name": "0", "image_type": 0}] * 32
        drawer.call("simGetImages", wanted, "")  # the first one waits for the process that draws
        drawn, delays, stop = 0, [], threading.Event()

        def draw() -> None:
            nonlocal drawn
            while not stop.is_set():
                drawn += len(drawer.call("simGetImages", wanted, ""))

        def read_time() -> float:
            return reader.call("getMultirotorState", "")["timestamp"] / 1e9

        thread = threading.Thread(target=draw)
        thread.start()
        begin, simulated = time.perf_counter(), read_time()
        while time.perf_counter() < begin + seconds:
            sent = time.perf_counter()
            reader.call("ping")
            delays.append(1000 * (time.perf_counter() - sent))
            time.sleep(0.01)
        simulated, passed = read_time() - simulated, time.perf_counter() - begin
        stop.set()
        thread.join()
    return (
        f"{drawn / passed:.0f} pictures/s; pings of another client took {max(delays):.1f} ms at "
        f"most, {statistics.median(delays):.1f} ms in the median; real-time factor "
        f"{simulated / passed:.3f}"
    )


HEADS = (
    *("server", "vehicles", "real-time factor", "median delay, ms", "worst delay, ms"),
    *("commands", "missed", "processor"),
)
LOCKSTEP_HEADS = (
    *("vehicles", "decisions/s", "times real time", "processor"),
    "processor time of a decision, ms",
)
SOAK_HEADS = (
    *("server", "MiB at the start", "MiB at half", "MiB at the end", "slope, MiB/h"),
    *("real-time factor", "commands", "missed", "visits", "processor"),
)


def make_table(heads: tuple[str, ...], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [list(heads), ["---:"] * len(heads), *rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in lines)


def replace_table(page: Path, heads: tuple[str, ...], rows: list[list[str]]) -> None:
    """Replace the table of a page that has these heads.

    Raises:
        SystemExit: If the page has no such table.
    """
    table, text = make_table(heads, rows), page.read_text(encoding="utf-8")
    first_line = table.splitlines()[0] + "\n"
    start = text.find(first_line)
    if start < 0:
        raise SystemExit(f"{page} has no table that begins with {first_line}")
    lines = text[start:].splitlines(keepends=True)
    rest = next((k for k, line in enumerate(lines) if not line.startswith("|")), len(lines))
    replace_file(page, text[:start] + table + "".join(lines[rest:]))


def main() -> None:
    """Measure, and print or write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="page whose tables are replaced")
    parser.add_argument("--servers", nargs="+", choices=[*KINDS, "hil"], default=[*KINDS, "hil"])
    parser.add_argument("--drones", type=int, nargs="+", default=[1, 8, 50])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--port", type=int, default=20450, help="first of 600 free ports")
    parser.add_argument("--soak", type=float, metavar="SECONDS", help="fly for memory instead")
    parser.add_argument("--log", type=Path, help="CSV file of the memory in a soak")
    parser.add_argument("--pictures", action="store_true", help="measure AirSim's pictures instead")
    arguments = parser.parse_args()
    if arguments.pictures:
        print(measure_pictures(arguments.seconds, arguments.port))
        return
    if arguments.soak is not None:
        sys.exit(0 if soak(arguments.soak, arguments.port, arguments.log) else "memory grows")
    given = (arguments.seconds, arguments.port)
    rows = []
    for kind in arguments.servers:
        for count in arguments.drones:
            row = measure_hil(count, *given) if kind == "hil" else measure(kind, count, *given)
            rows.append(row)
            print(*row, sep="\t", flush=True)
    lockstep = [measure_lockstep(count, *given) for count in arguments.drones]
    for heads, cells in ((HEADS, rows), (LOCKSTEP_HEADS, lockstep)):
        print(make_table(heads, cells))
        if arguments.out is not None:
            replace_table(arguments.out, heads, cells)


if __name__ == "__main__":
    main()
