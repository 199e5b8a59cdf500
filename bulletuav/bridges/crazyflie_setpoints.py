"""Low-level setpoints of a virtual Crazyflie: decoding, limits and timeouts.

The firmware documents what each setpoint means. Its controller is a cascade of PIDs; here the
same setpoints go to the package's own cascade (`bulletuav.control`).
"""

import math

import numpy as np

from bulletuav.bridges.crtp import CrtpPort, MalformedError, Packet, unpack_data
from bulletuav.bridges.setpoints import Setpoint, euler
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.rotors import RPM

MAX_COORDINATE = 1000.0
"""Maximum coordinate of a setpoint, m"""
MAX_SPEED = 100.0
"""Maximum velocity (m/s) of a setpoint"""
MAX_TILT = math.radians(60)
"""Maximum roll and pitch of a setpoint, rad"""
MAX_RATE = 20.0
"""Maximum angular rate of a setpoint, rad/s"""
MIN_THRUST_COMMAND, MAX_THRUST_COMMAND = 1000, 60000
"""Thrust commands below the minimum mean zero, those above the maximum are clipped (firmware)"""
STABILIZE_TIMEOUT, SHUTDOWN_TIMEOUT = 0.5, 2.0
"""Time without setpoints until a drone levels out, and until its motors stop, s"""


class ThrustMap:
    """Map from the firmware's thrust command, from 0 to 65535, to newtons."""

    def __init__(self, airframe: Airframe) -> None:
        """Initialise with the PWM map of the airframe.

        An airframe without a PWM map has rotor speeds proportional to the command.
        """
        self._max_speed = airframe.max_rotor_speed
        self._factor = len(airframe.rotors) * airframe.thrust_coefficient
        pwm = airframe.pwm
        self._slope, self._min_command = self._max_speed / 65535, 0.0
        self._intercept = 0.0
        if pwm is not None:
            self._slope, self._intercept = pwm.slope * RPM, pwm.intercept * RPM
            self._min_command = pwm.minimum

    def thrust(self, command: float) -> float:
        """Convert a command from 0 to 65535 into a thrust, N."""
        speed = self._slope * max(command, self._min_command) + self._intercept
        # The map is unknown below its minimum command: the speed decreases linearly to zero
        if command < self._min_command:
            speed *= command / self._min_command
        return self._factor * min(speed, self._max_speed) ** 2

    def command(self, rotor_speed: list[float]) -> float:
        """Return the command that leads to rotor speeds, rad/s."""
        speed = math.sqrt(sum(speed * speed for speed in rotor_speed) / len(rotor_speed))
        min_speed = self._slope * self._min_command + self._intercept
        if speed < min_speed:
            return self._min_command * speed / min_speed
        return min((speed - self._intercept) / self._slope, 65535.0)


class Commander:
    """Low-level commander of one drone: the last setpoint and its timeouts.

    Attributes:
        is_released: Whether the high-level commander may take over.
    """

    def __init__(self, thrust_map: ThrustMap) -> None:
        """Initialise without a setpoint, with the thrust locked."""
        self._thrust_map = thrust_map
        self._setpoint: Setpoint | None = None
        self._received_time = 0.0
        self._thrust_locked = True
        self.is_released = True

    def clear(self) -> None:
        """Discard the setpoint, and lock the thrust until a command of zero."""
        self._setpoint, self._thrust_locked, self.is_released = None, True, True

    def release(self) -> None:
        """Allow the high-level commander to take over as soon as it has a plan."""
        self.is_released = True

    def set_setpoint(self, packet: Packet, now: float, are_rates: tuple[bool, bool]) -> None:
        """Decode a packet and set its setpoint.

        Args:
            packet: Packet to the port `CrtpPort.SETPOINT` or `CrtpPort.SETPOINT_GENERIC`.
            now: Present time, s.
            are_rates: Whether roll and pitch, and whether yaw, of `CrtpPort.SETPOINT` are rates.

        Raises:
            MalformedError: If the data does not have the layout of the setpoint. The previous
                setpoint remains.
        """
        if packet.port == CrtpPort.SETPOINT:
            *angles, command = unpack_data("fffH", packet.data)
            # Full thrust right after connecting would be dangerous: a command of zero unlocks it
            self._thrust_locked = self._thrust_locked and command > 0
            command = 0 if self._thrust_locked else command
            self._setpoint = self._make_manual(tuple(angles), command, *are_rates)
        else:
            (setpoint_type,) = unpack_data("B", packet.data)
            self._setpoint = self._decode_generic(setpoint_type, packet.data[1:])
        self._received_time, self.is_released = now, self._setpoint is None

    def _decode_generic(self, setpoint_type: int, data: bytes) -> Setpoint | None:
        """Decode a setpoint of the port `CrtpPort.SETPOINT_GENERIC`; return None for a stop."""
        # Stop; lock the thrust until a command of zero
        if setpoint_type == 0:
            self._thrust_locked = True
            return None
        # Manual: roll, pitch and yaw rate with a thrust; roll and pitch may be rates
        if setpoint_type == 11:
            *angles, command, is_rate = unpack_data("fffHB", data)
            return self._make_manual(tuple(angles), command, bool(is_rate), True)._replace(
                yaw=_to_rate(angles[2])
            )
        if setpoint_type == 6:
            return _decode_full_state(data)
        if setpoint_type not in (7, 8, 9, 10):
            raise MalformedError(f"setpoint type {setpoint_type}: 0 or from 6 to 11 is needed")
        # The other types have four numbers each
        a, b, c, d = unpack_data("ffff", data)
        # Position and yaw
        if setpoint_type == 7:
            position = (_clamp(a, MAX_COORDINATE), _clamp(b, MAX_COORDINATE))
            return Setpoint(
                "position", position, "position", _clamp(c, MAX_COORDINATE), "angle", _to_angle(d)
            )
        # Roll, pitch and yaw rate at a height (zdistance)
        if setpoint_type == 9:
            return Setpoint(
                "attitude",
                _to_tilt(a, b),
                "position",
                _clamp(d, MAX_COORDINATE),
                "rate",
                _to_rate(c),
            )
        # Velocity in the world frame, or in the body frame at a height (hover)
        velocity = (_clamp(a, MAX_SPEED), _clamp(b, MAX_SPEED))
        if setpoint_type == 8:
            return Setpoint(
                "velocity", velocity, "velocity", _clamp(c, MAX_SPEED), "rate", _to_rate(d)
            )
        return Setpoint(
            "body", velocity, "position", _clamp(d, MAX_COORDINATE), "rate", _to_rate(c)
        )

    def _make_manual(
        self, angles: tuple[float, ...], command: int, is_rate: bool, yaw_is_rate: bool
    ) -> Setpoint:
        """Return the setpoint for roll, pitch, yaw and a thrust command."""
        roll, pitch, yaw = angles
        thrust = 0.0
        if command >= MIN_THRUST_COMMAND:
            thrust = self._thrust_map.thrust(min(command, MAX_THRUST_COMMAND))
        # The firmware's legacy convention: yaw of this setpoint is positive clockwise
        turning, yaw = ("rate", -_to_rate(yaw)) if yaw_is_rate else ("angle", _to_angle(-yaw))
        if is_rate:
            return Setpoint(
                "rates", (_to_rate(roll), -_to_rate(pitch)), "thrust", thrust, turning, yaw
            )
        return Setpoint("attitude", _to_tilt(roll, pitch), "thrust", thrust, turning, yaw)

    def current(self, now: float) -> Setpoint | None:
        """Return the setpoint at a time, or None without one.

        After `STABILIZE_TIMEOUT` the setpoint is levelled out, after `SHUTDOWN_TIMEOUT` discarded.
        """
        if self._setpoint is None:
            return None
        age = now - self._received_time
        if age > SHUTDOWN_TIMEOUT:
            self.clear()
            return None
        return self._setpoint if age <= STABILIZE_TIMEOUT else self._setpoint.to_level()


def _clamp(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _to_rate(degrees: float) -> float:
    """Convert a rate from degrees/s to rad/s, and clip it."""
    return _clamp(math.radians(degrees), MAX_RATE)


def _to_angle(degrees: float) -> float:
    """Convert an angle from degrees to rad, within [-pi, pi]."""
    return math.remainder(math.radians(degrees), math.tau)


def _to_tilt(roll: float, pitch: float) -> tuple[float, float]:
    """Convert roll and pitch (nose up) from degrees to rad, with pitch nose down."""
    return _clamp(math.radians(roll), MAX_TILT), _clamp(-math.radians(pitch), MAX_TILT)


def _decode_full_state(data: bytes) -> Setpoint:
    """Decode a full state: position, velocity, acceleration, and the yaw of its attitude."""
    numbers = unpack_data("9hI3h", data)
    x, y, z, *ahead = (number / 1000 for number in numbers[:9])
    _, _, yaw = euler(decompress_quaternion(numbers[9]))
    return Setpoint("position", (x, y), "position", z, "angle", yaw, tuple(ahead))


def decompress_quaternion(packed: int) -> tuple[float, ...]:
    """Decompress a quaternion from 32 bits, as the firmware's `quatdecompress`.

    The upper two bits are the index of the largest entry, which is positive and omitted. Each other
    entry has a sign bit and 9 bits of magnitude, in units of 1 / (511 sqrt(2)).

    Args:
        packed: The 32 bits.

    Returns:
        (4,) unit quaternion x, y, z, w.
    """
    largest = packed >> 30
    entries = np.zeros(4)
    others = [k for k in range(4) if k != largest]
    for index, k in enumerate(reversed(others)):
        bits = packed >> 10 * index & 0x3FF
        entries[k] = (bits & 0x1FF) / 511 * math.sqrt(0.5) * (-1 if bits & 0x200 else 1)
    entries[largest] = math.sqrt(max(1.0 - float((entries * entries).sum()), 0.0))
    norm = math.sqrt(float((entries * entries).sum()))
    return tuple((entries / norm).tolist())
