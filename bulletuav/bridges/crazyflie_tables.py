"""What a virtual Crazyflie logs, and its parameters: names, types, values.

Names and units are those of the firmware's documentation. Angles are in degrees, and pitch is
positive when the nose is up, as the firmware has it.
"""

import functools
import math
import zlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from bulletuav.bridges.crtp import pack
from bulletuav.bridges.setpoints import euler
from bulletuav.geometry.rotation import Vec3, axes, dot
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

BATTERY = 4.0
"""Voltage that is told, V: batteries do not run empty"""
FARTHEST = 32767
"""Distance that ranging sensors tell where they see nothing, mm"""


class LogType(NamedTuple):
    """A type of logged numbers: its number, its letter in `struct`, its least and its greatest."""

    code: int
    letter: str
    least: float
    most: float


LOG_TYPES = MappingProxyType(
    {
        one.code: one
        for one in (
            LogType(1, "B", 0, 2**8 - 1),
            LogType(2, "H", 0, 2**16 - 1),
            LogType(3, "I", 0, 2**32 - 1),
            LogType(4, "b", -(2**7), 2**7 - 1),
            LogType(5, "h", -(2**15), 2**15 - 1),
            LogType(6, "i", -(2**31), 2**31 - 1),
            LogType(7, "f", -3e38, 3e38),
            LogType(8, "e", -65504.0, 65504.0),
        )
    }
)
"""Types of logged numbers by their codes"""
U8, U16, U32, FLOAT = 1, 2, 3, 7
PARAMETER_LETTERS = MappingProxyType(
    {0: "b", 1: "h", 2: "i", 3: "q", 5: "e", 6: "f", 7: "d", 8: "B", 9: "H", 10: "I", 11: "Q"}
)
"""Letters in `struct` of the types of parameters by their codes"""
P_U8, P_U16, P_U32, P_I8, P_FLOAT = 8, 9, 10, 0, 6


class Telemetry:
    """What a drone can log at one time.

    Attributes:
        position: (3,) m, world.
        quaternion: (4,) body to world.
        velocity: (3,) m/s, world.
        acceleration: (3,) m/s^2, world, of the last step.
        rates: (3,) rad/s, body.
        rotor_share: Speed of each rotor over its greatest.
        thrust: Command of the motors, from 0 to 65535.
        target: (3,) where the drone is told to be, m; where it is, if it is not told.
        supervisor: Bits of the supervisor.
        pressure: Of the air, Pa.
    """

    def __init__(
        self,
        state: tuple[list[float], list[float], list[float], list[float]],
        acceleration: list[float],
        rotor_share: list[float],
        told: tuple[float, list[float], int],
        pressure: Callable[[float], float],
    ) -> None:
        """Keep the numbers: position, quaternion, velocity, rates; thrust, target, bits."""
        self.position, self.quaternion, self.velocity, self.rates = state
        self.acceleration, self.rotor_share = acceleration, rotor_share
        self.thrust, self.target, self.supervisor = told
        self._pressure = pressure

    @functools.cached_property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch (nose up) and yaw, degrees."""
        roll, pitch, yaw = euler(self.quaternion)
        return math.degrees(roll), -math.degrees(pitch), math.degrees(yaw)

    @functools.cached_property
    def specific_force(self) -> tuple[float, float, float]:
        """What an accelerometer measures, body axes, multiples of gravity."""
        x, y, z = (one / STANDARD_GRAVITY for one in self.acceleration)
        return self.along((x, y, z + 1.0))

    def along(self, vector: Vec3) -> Vec3:
        """Turn a vector from world axes into body axes."""
        x, y, z, w = self.quaternion
        forward, left, up = axes((x, y, z, w))
        return dot(forward, vector), dot(left, vector), dot(up, vector)

    def pressure(self) -> float:
        """Tell the pressure of the air, hPa."""
        return self._pressure(self.position[2]) / 100


class LogVariable(NamedTuple):
    """Something that can be logged: the type that it is kept in, and how it is read."""

    code: int
    read: Callable[[Telemetry], float]


def _axes(
    group: str, names: str, read: Callable[[Telemetry, int], float], code: int = FLOAT
) -> dict[str, LogVariable]:
    """Make a variable for each of the names, which takes the entry of that place."""

    def one(k: int) -> LogVariable:
        return LogVariable(code, lambda told: read(told, k))

    return {f"{group}.{name}": one(k) for k, name in enumerate(names.split())}


def _millimetres(told: Telemetry) -> float:
    """Read the height above the ground, mm."""
    return 1000 * told.position[2]


LOGS: Mapping[str, LogVariable] = MappingProxyType(
    {
        **_axes("stateEstimate", "x y z", lambda told, k: told.position[k]),
        **_axes("stateEstimate", "vx vy vz", lambda told, k: told.velocity[k]),
        **_axes(
            "stateEstimate", "ax ay az", lambda told, k: told.acceleration[k] / STANDARD_GRAVITY
        ),
        **_axes("stateEstimate", "roll pitch yaw", lambda told, k: told.euler[k]),
        **_axes("stateEstimate", "qx qy qz qw", lambda told, k: told.quaternion[k]),
        **_axes("stabilizer", "roll pitch yaw", lambda told, k: told.euler[k]),
        "stabilizer.thrust": LogVariable(FLOAT, lambda told: told.thrust),
        **_axes("kalman", "stateX stateY stateZ", lambda told, k: told.position[k]),
        **_axes(
            "kalman",
            "statePX statePY statePZ",
            lambda told, k: told.along((told.velocity[0], told.velocity[1], told.velocity[2]))[k],
        ),
        **_axes("kalman", "q1 q2 q3", lambda told, k: told.quaternion[k]),
        "kalman.q0": LogVariable(FLOAT, lambda told: told.quaternion[3]),
        # The position is known: it does not vary.
        **_axes("kalman", "varPX varPY varPZ", lambda told, k: 1e-6),
        **_axes("gyro", "x y z", lambda told, k: math.degrees(told.rates[k])),
        **_axes("acc", "x y z", lambda told, k: told.specific_force[k]),
        "baro.pressure": LogVariable(FLOAT, Telemetry.pressure),
        **_axes("ctrltarget", "x y z", lambda told, k: told.target[k]),
        **_axes("motor", "m1 m2 m3 m4", lambda told, k: 65535 * told.rotor_share[k], U16),
        "range.zrange": LogVariable(U16, _millimetres),
        **{
            f"range.{side}": LogVariable(U16, lambda told: FARTHEST)
            for side in ("front", "back", "left", "right", "up")
        },
        "pm.vbat": LogVariable(FLOAT, lambda told: BATTERY),
        "pm.vbatMV": LogVariable(U16, lambda told: 1000 * BATTERY),
        "pm.batteryLevel": LogVariable(U8, lambda told: 100),
        "pm.state": LogVariable(4, lambda told: 0),
        "radio.rssi": LogVariable(U8, lambda told: 30),
        "radio.isConnected": LogVariable(U8, lambda told: 1),
        "supervisor.info": LogVariable(U16, lambda told: told.supervisor),
        "sys.armed": LogVariable(4, lambda told: told.supervisor >> 1 & 1),
        "sys.canfly": LogVariable(U8, lambda told: told.supervisor >> 3 & 1),
        "sys.isFlying": LogVariable(U8, lambda told: told.supervisor >> 4 & 1),
        "sys.isTumbled": LogVariable(U8, lambda told: told.supervisor >> 5 & 1),
    }
)
"""What can be logged, by full name; the place in this table is the number on the wire"""


class Parameter(NamedTuple):
    """A parameter: its type, its first value, and whether it can be written and stored."""

    code: int
    value: float
    read_only: bool = False
    persistent: bool = False


def _gains(group: str, loops: str, names: str) -> dict[str, Parameter]:
    """Make parameters for gains, which are kept and change nothing."""
    return {
        f"{group}.{loop}{name}": Parameter(P_FLOAT, 0.0, persistent=True)
        for loop in loops.split()
        for name in names.split()
    }


PARAMETERS: Mapping[str, Parameter] = MappingProxyType(
    {
        "flightmode.stabModeRoll": Parameter(P_U8, 1),
        "flightmode.stabModePitch": Parameter(P_U8, 1),
        "flightmode.stabModeYaw": Parameter(P_U8, 0),
        "commander.enHighLevel": Parameter(P_U8, 1),
        "stabilizer.estimator": Parameter(P_U8, 2),
        "stabilizer.controller": Parameter(P_U8, 1),
        "stabilizer.stop": Parameter(P_U8, 0),
        "kalman.resetEstimation": Parameter(P_U8, 0),
        "kalman.initialX": Parameter(P_FLOAT, 0.0),
        "kalman.initialY": Parameter(P_FLOAT, 0.0),
        "kalman.initialZ": Parameter(P_FLOAT, 0.0),
        "kalman.initialYaw": Parameter(P_FLOAT, 0.0),
        "locSrv.extPosStdDev": Parameter(P_FLOAT, 0.01),
        "locSrv.extQuatStdDev": Parameter(P_FLOAT, 0.0045),
        **{
            f"deck.{name}": Parameter(P_U8, int(name == "bcFlow2"), read_only=True)
            for name in ("bcFlow2", "bcLighthouse4", "bcLoco", "bcMultiranger", "bcZRanger2")
        },
        "deck.bcLedRing": Parameter(P_U8, 0, read_only=True),
        "led.bitmask": Parameter(P_U8, 0),
        "ring.effect": Parameter(P_U8, 6, persistent=True),
        "ring.solidRed": Parameter(P_U8, 20),
        "ring.solidGreen": Parameter(P_U8, 20),
        "ring.solidBlue": Parameter(P_U8, 20),
        "sound.effect": Parameter(P_U8, 0, persistent=True),
        "lighthouse.systemType": Parameter(P_U8, 2, persistent=True),
        "lighthouse.method": Parameter(P_U8, 0),
        **_gains("pid_attitude", "roll pitch yaw", "_kp _ki _kd"),
        **_gains("pid_rate", "roll pitch yaw", "_kp _ki _kd"),
        "firmware.revision0": Parameter(P_U32, 0, read_only=True),
        "firmware.revision1": Parameter(P_U16, 0, read_only=True),
        "firmware.modified": Parameter(P_U8, 1, read_only=True),
        "cpu.flash": Parameter(P_U16, 1024, read_only=True),
        "system.selftestPassed": Parameter(P_I8, 1, read_only=True),
    }
)
"""Parameters by full name; the place in this table is the number on the wire"""


def name_bytes(full_name: str) -> bytes:
    """Write a full name such as "stabilizer.roll" as the table of contents has it."""
    group, name = full_name.split(".")
    return group.encode() + b"\0" + name.encode() + b"\0"


def parameter_code(parameter: Parameter) -> int:
    """Tell the byte by which the table of contents describes a parameter."""
    return parameter.code | parameter.persistent << 4 | parameter.read_only << 6


def checksum(entries: list[bytes]) -> int:
    """Compute the number by which clients find a table of contents that they have kept."""
    return zlib.crc32(pack("I", len(entries)) + b"".join(entries))
