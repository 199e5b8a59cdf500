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

from bulletuav.bridges.crtp import pack_data
from bulletuav.bridges.setpoints import euler
from bulletuav.geometry.rotation import Vec3, axes, dot
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

BATTERY_VOLTAGE = 4.0
"""Voltage that is told, V: batteries do not run empty"""
OUT_OF_RANGE = 32767
"""Distance that ranging sensors tell where they see nothing, mm"""


class LogType(NamedTuple):
    """A type of logged numbers: its number, its letter in `struct`, its least and its greatest."""

    code: int
    struct_format: str
    minimum: float
    maximum: float


LOG_TYPES = MappingProxyType(
    {
        log_type.code: log_type
        for log_type in (
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
PARAMETER_FORMATS = MappingProxyType(
    {0: "b", 1: "h", 2: "i", 3: "q", 5: "e", 6: "f", 7: "d", 8: "B", 9: "H", 10: "I", 11: "Q"}
)
"""Letters in `struct` of the types of parameters by their codes"""
PARAM_U8, PARAM_U16, PARAM_U32, PARAM_I8, PARAM_FLOAT = 8, 9, 10, 0, 6


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
        rotor_speed_fraction: list[float],
        outputs: tuple[float, list[float], int],
        pressure: Callable[[float], float],
    ) -> None:
        """Keep the numbers: position, quaternion, velocity, rates; thrust, target, bits."""
        self.position, self.quaternion, self.velocity, self.rates = state
        self.acceleration, self.rotor_speed_fraction = acceleration, rotor_speed_fraction
        self.thrust, self.target, self.supervisor = outputs
        self._pressure = pressure

    @functools.cached_property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch (nose up) and yaw, degrees."""
        roll, pitch, yaw = euler(self.quaternion)
        return math.degrees(roll), -math.degrees(pitch), math.degrees(yaw)

    @functools.cached_property
    def specific_force(self) -> tuple[float, float, float]:
        """What an accelerometer measures, body axes, multiples of gravity."""
        x, y, z = (value / STANDARD_GRAVITY for value in self.acceleration)
        return self.to_body((x, y, z + 1.0))

    def to_body(self, vector: Vec3) -> Vec3:
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


def _axis_variables(
    group: str, names: str, read: Callable[[Telemetry, int], float], code: int = FLOAT
) -> dict[str, LogVariable]:
    """Make a variable for each of the names, which takes the entry of that place."""

    def make_variable(k: int) -> LogVariable:
        return LogVariable(code, lambda data: read(data, k))

    return {f"{group}.{name}": make_variable(k) for k, name in enumerate(names.split())}


def _height_mm(telemetry: Telemetry) -> float:
    """Read the height above the ground, mm."""
    return 1000 * telemetry.position[2]


LOGS: Mapping[str, LogVariable] = MappingProxyType(
    {
        **_axis_variables("stateEstimate", "x y z", lambda data, k: data.position[k]),
        **_axis_variables("stateEstimate", "vx vy vz", lambda data, k: data.velocity[k]),
        **_axis_variables(
            "stateEstimate",
            "ax ay az",
            lambda data, k: data.acceleration[k] / STANDARD_GRAVITY,
        ),
        **_axis_variables(
            "stateEstimate", "roll pitch yaw", lambda data, k: data.euler[k]
        ),
        **_axis_variables(
            "stateEstimate", "qx qy qz qw", lambda data, k: data.quaternion[k]
        ),
        **_axis_variables("stabilizer", "roll pitch yaw", lambda data, k: data.euler[k]),
        "stabilizer.thrust": LogVariable(FLOAT, lambda data: data.thrust),
        **_axis_variables(
            "kalman", "stateX stateY stateZ", lambda data, k: data.position[k]
        ),
        **_axis_variables(
            "kalman",
            "statePX statePY statePZ",
            lambda data, k: data.to_body(
                (data.velocity[0], data.velocity[1], data.velocity[2])
            )[k],
        ),
        **_axis_variables("kalman", "q1 q2 q3", lambda data, k: data.quaternion[k]),
        "kalman.q0": LogVariable(FLOAT, lambda data: data.quaternion[3]),
        # The position is known: it does not vary.
        **_axis_variables("kalman", "varPX varPY varPZ", lambda data, k: 1e-6),
        **_axis_variables("gyro", "x y z", lambda data, k: math.degrees(data.rates[k])),
        **_axis_variables("acc", "x y z", lambda data, k: data.specific_force[k]),
        "baro.pressure": LogVariable(FLOAT, Telemetry.pressure),
        **_axis_variables("ctrltarget", "x y z", lambda data, k: data.target[k]),
        **_axis_variables(
            "motor",
            "m1 m2 m3 m4",
            lambda data, k: 65535 * data.rotor_speed_fraction[k],
            U16,
        ),
        "range.zrange": LogVariable(U16, _height_mm),
        **{
            f"range.{side}": LogVariable(U16, lambda data: OUT_OF_RANGE)
            for side in ("front", "back", "left", "right", "up")
        },
        "pm.vbat": LogVariable(FLOAT, lambda data: BATTERY_VOLTAGE),
        "pm.vbatMV": LogVariable(U16, lambda data: 1000 * BATTERY_VOLTAGE),
        "pm.batteryLevel": LogVariable(U8, lambda data: 100),
        "pm.state": LogVariable(4, lambda data: 0),
        "radio.rssi": LogVariable(U8, lambda data: 30),
        "radio.isConnected": LogVariable(U8, lambda data: 1),
        "supervisor.info": LogVariable(U16, lambda data: data.supervisor),
        "sys.armed": LogVariable(4, lambda data: data.supervisor >> 1 & 1),
        "sys.canfly": LogVariable(U8, lambda data: data.supervisor >> 3 & 1),
        "sys.isFlying": LogVariable(U8, lambda data: data.supervisor >> 4 & 1),
        "sys.isTumbled": LogVariable(U8, lambda data: data.supervisor >> 5 & 1),
    }
)
"""What can be logged, by full name; the place in this table is the number on the wire"""


class CrtpParameter(NamedTuple):
    """A parameter: its type, its first value, and whether it can be written and stored."""

    code: int
    value: float
    read_only: bool = False
    persistent: bool = False


def _gain_parameters(group: str, loops: str, names: str) -> dict[str, CrtpParameter]:
    """Make parameters for gains, which are kept and change nothing."""
    return {
        f"{group}.{loop}{name}": CrtpParameter(PARAM_FLOAT, 0.0, persistent=True)
        for loop in loops.split()
        for name in names.split()
    }


PARAMETERS: Mapping[str, CrtpParameter] = MappingProxyType(
    {
        "flightmode.stabModeRoll": CrtpParameter(PARAM_U8, 1),
        "flightmode.stabModePitch": CrtpParameter(PARAM_U8, 1),
        "flightmode.stabModeYaw": CrtpParameter(PARAM_U8, 0),
        "commander.enHighLevel": CrtpParameter(PARAM_U8, 1),
        "stabilizer.estimator": CrtpParameter(PARAM_U8, 2),
        "stabilizer.controller": CrtpParameter(PARAM_U8, 1),
        "stabilizer.stop": CrtpParameter(PARAM_U8, 0),
        "kalman.resetEstimation": CrtpParameter(PARAM_U8, 0),
        "kalman.initialX": CrtpParameter(PARAM_FLOAT, 0.0),
        "kalman.initialY": CrtpParameter(PARAM_FLOAT, 0.0),
        "kalman.initialZ": CrtpParameter(PARAM_FLOAT, 0.0),
        "kalman.initialYaw": CrtpParameter(PARAM_FLOAT, 0.0),
        "locSrv.extPosStdDev": CrtpParameter(PARAM_FLOAT, 0.01),
        "locSrv.extQuatStdDev": CrtpParameter(PARAM_FLOAT, 0.0045),
        **{
            f"deck.{name}": CrtpParameter(PARAM_U8, int(name == "bcFlow2"), read_only=True)
            for name in ("bcFlow2", "bcLighthouse4", "bcLoco", "bcMultiranger", "bcZRanger2")
        },
        "deck.bcLedRing": CrtpParameter(PARAM_U8, 0, read_only=True),
        "led.bitmask": CrtpParameter(PARAM_U8, 0),
        "ring.effect": CrtpParameter(PARAM_U8, 6, persistent=True),
        "ring.solidRed": CrtpParameter(PARAM_U8, 20),
        "ring.solidGreen": CrtpParameter(PARAM_U8, 20),
        "ring.solidBlue": CrtpParameter(PARAM_U8, 20),
        "sound.effect": CrtpParameter(PARAM_U8, 0, persistent=True),
        "lighthouse.systemType": CrtpParameter(PARAM_U8, 2, persistent=True),
        "lighthouse.method": CrtpParameter(PARAM_U8, 0),
        **_gain_parameters("pid_attitude", "roll pitch yaw", "_kp _ki _kd"),
        **_gain_parameters("pid_rate", "roll pitch yaw", "_kp _ki _kd"),
        "firmware.revision0": CrtpParameter(PARAM_U32, 0, read_only=True),
        "firmware.revision1": CrtpParameter(PARAM_U16, 0, read_only=True),
        "firmware.modified": CrtpParameter(PARAM_U8, 1, read_only=True),
        "cpu.flash": CrtpParameter(PARAM_U16, 1024, read_only=True),
        "system.selftestPassed": CrtpParameter(PARAM_I8, 1, read_only=True),
    }
)
"""Parameters by full name; the place in this table is the number on the wire"""


def encode_name(full_name: str) -> bytes:
    """Write a full name such as "stabilizer.roll" as the table of contents has it."""
    group, name = full_name.split(".")
    return group.encode() + b"\0" + name.encode() + b"\0"


def encode_parameter_type(parameter: CrtpParameter) -> int:
    """Tell the byte by which the table of contents describes a parameter."""
    return parameter.code | parameter.persistent << 4 | parameter.read_only << 6


def compute_toc_crc(entries: list[bytes]) -> int:
    """Compute the number by which clients find a table of contents that they have kept."""
    return zlib.crc32(pack_data("I", len(entries)) + b"".join(entries))
