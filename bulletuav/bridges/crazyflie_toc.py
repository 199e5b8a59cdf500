"""Tables of contents (TOC) of a virtual Crazyflie: log variables and parameters.

Names and units are those of the firmware's documentation. Angles are in degrees, and pitch is
positive when the nose is up, as in the firmware.
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
"""Reported battery voltage, V: batteries do not discharge"""
OUT_OF_RANGE = 32767
"""Distance that the multiranger reports without an object in range, mm"""


class LogType(NamedTuple):
    """Data type of a log variable.

    Attributes:
        code: Number of the type in CRTP.
        struct_format: Format character of `struct`.
        minimum: Smallest value.
        maximum: Largest value.
    """

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
"""Data types of log variables by their codes"""
U8, U16, U32, FLOAT = 1, 2, 3, 7
PARAMETER_FORMATS = MappingProxyType(
    {0: "b", 1: "h", 2: "i", 3: "q", 5: "e", 6: "f", 7: "d", 8: "B", 9: "H", 10: "I", 11: "Q"}
)
"""Format characters of `struct` for the data types of parameters, by their codes"""
PARAM_U8, PARAM_U16, PARAM_U32, PARAM_I8, PARAM_FLOAT = 8, 9, 10, 0, 6


class Telemetry:
    """Values of all log variables of a drone at one time.

    Attributes:
        position: (3,) m, world.
        quaternion: (4,) body to world.
        velocity: (3,) m/s, world.
        acceleration: (3,) m/s^2, world, mean over the last step.
        rates: (3,) rad/s, body.
        rotor_speed_fraction: (R,) rotor speeds as fractions of the maximum speed.
        thrust: Thrust command, from 0 to 65535.
        target: (3,) target position, m; the present position without a target.
        supervisor: Bit field of the supervisor's state.
    """

    def __init__(
        self,
        state: tuple[list[float], list[float], list[float], list[float]],
        acceleration: list[float],
        rotor_speed_fraction: list[float],
        outputs: tuple[float, list[float], int],
        pressure: Callable[[float], float],
    ) -> None:
        """Initialise the values.

        Args:
            state: Position, quaternion, velocity and rates.
            acceleration: (3,) mean acceleration over the last step, m/s^2.
            rotor_speed_fraction: (R,) rotor speeds as fractions of the maximum speed.
            outputs: Thrust command, target position and supervisor bits.
            pressure: Function that returns the air pressure (Pa) at a height (m).
        """
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
        """Specific force in the body frame, as an accelerometer measures it, in units of g."""
        x, y, z = (value / STANDARD_GRAVITY for value in self.acceleration)
        return self.to_body((x, y, z + 1.0))

    def to_body(self, vector: Vec3) -> Vec3:
        """Rotate a vector from world axes into body axes."""
        x, y, z, w = self.quaternion
        forward, left, up = axes((x, y, z, w))
        return dot(forward, vector), dot(left, vector), dot(up, vector)

    def pressure(self) -> float:
        """Return the air pressure, hPa."""
        return self._pressure(self.position[2]) / 100


class LogVariable(NamedTuple):
    """Log variable.

    Attributes:
        code: Code of its data type, see `LOG_TYPES`.
        read: Function that returns its value.
    """

    code: int
    read: Callable[[Telemetry], float]


def _axis_variables(
    group: str, names: str, read: Callable[[Telemetry, int], float], code: int = FLOAT
) -> dict[str, LogVariable]:
    """Make one log variable for each of the names; name k reads entry k."""

    def make_variable(k: int) -> LogVariable:
        return LogVariable(code, lambda data: read(data, k))

    return {f"{group}.{name}": make_variable(k) for k, name in enumerate(names.split())}


def _height_mm(telemetry: Telemetry) -> float:
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
        **_axis_variables("stateEstimate", "roll pitch yaw", lambda data, k: data.euler[k]),
        **_axis_variables("stateEstimate", "qx qy qz qw", lambda data, k: data.quaternion[k]),
        **_axis_variables("stabilizer", "roll pitch yaw", lambda data, k: data.euler[k]),
        "stabilizer.thrust": LogVariable(FLOAT, lambda data: data.thrust),
        **_axis_variables("kalman", "stateX stateY stateZ", lambda data, k: data.position[k]),
        **_axis_variables(
            "kalman",
            "statePX statePY statePZ",
            lambda data, k: data.to_body((data.velocity[0], data.velocity[1], data.velocity[2]))[k],
        ),
        **_axis_variables("kalman", "q1 q2 q3", lambda data, k: data.quaternion[k]),
        "kalman.q0": LogVariable(FLOAT, lambda data: data.quaternion[3]),
        # The position is exact: report a negligible variance
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
"""Log variables by full name; the index in this mapping is the variable's ID in the TOC"""


class CrtpParameter(NamedTuple):
    """Parameter of the firmware.

    Attributes:
        code: Code of its data type, see `PARAMETER_FORMATS`.
        value: Default value.
        read_only: Whether clients cannot set it.
        persistent: Whether clients can store its value.
    """

    code: int
    value: float
    read_only: bool = False
    persistent: bool = False


def _gain_parameters(group: str, loops: str, names: str) -> dict[str, CrtpParameter]:
    """Make parameters for controller gains, which are stored but have no effect."""
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
"""Parameters by full name; the index in this mapping is the parameter's ID in the TOC"""


def encode_name(full_name: str) -> bytes:
    """Encode a full name such as "stabilizer.roll" as group and name of a TOC entry."""
    group, name = full_name.split(".")
    return group.encode() + b"\0" + name.encode() + b"\0"


def encode_parameter_type(parameter: CrtpParameter) -> int:
    """Return the type byte of a parameter's TOC entry."""
    return parameter.code | parameter.persistent << 4 | parameter.read_only << 6


def compute_toc_crc(entries: list[bytes]) -> int:
    """Compute the CRC by which clients recognise a TOC that they have cached."""
    return zlib.crc32(pack_data("I", len(entries)) + b"".join(entries))
