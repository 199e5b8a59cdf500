"""Setpoints of a virtual Crazyflie: what its packets ask for, and for how long they hold.

The firmware documents what each setpoint means. Its controller is a cascade of PIDs; here the
same setpoints go to the package's own cascade (`bulletuav.control`).
"""

import math

import numpy as np

from bulletuav.bridges.crtp import MalformedError, Packet, Port, unpack
from bulletuav.bridges.setpoints import Setpoint, euler
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.rotors import RPM

FARTHEST = 1000.0
"""Greatest coordinate that a setpoint may have, m"""
FASTEST = 100.0
"""Greatest velocity (m/s) and acceleration (m/s^2) of a setpoint"""
STEEPEST = math.radians(60)
"""Greatest roll and pitch of a setpoint, rad"""
QUICKEST = 20.0
"""Greatest rate of a setpoint, rad/s"""
LEAST_THRUST, MOST_THRUST = 1000, 60000
"""Commands of thrust below are none, and above are cut, as in the firmware"""
LEVEL_AFTER, OFF_AFTER = 0.5, 2.0
"""Time without setpoints until a drone levels out, and until its motors stop, s"""


class Motors:
    """The map from the firmware's command of thrust, from 0 to 65535, to newtons."""

    def __init__(self, airframe: Airframe) -> None:
        """Take the map of the airframe; without one, speeds grow in proportion to the command."""
        self._most = airframe.max_rotor_speed
        self._factor = len(airframe.rotors) * airframe.thrust_coefficient
        pwm = airframe.pwm
        self._slope, self._least = self._most / 65535, 0.0
        self._intercept = 0.0
        if pwm is not None:
            self._slope, self._intercept = pwm.slope * RPM, pwm.intercept * RPM
            self._least = pwm.minimum

    def thrust(self, command: float) -> float:
        """Convert a command from 0 to 65535 into a thrust, N."""
        speed = self._slope * max(command, self._least) + self._intercept
        # Below its least command the map is not known: speeds go to zero in proportion.
        if command < self._least:
            speed *= command / self._least
        return self._factor * min(speed, self._most) ** 2

    def command(self, rotor_speed: list[float]) -> float:
        """Tell the command of rotors at speeds, rad/s."""
        speed = math.sqrt(sum(one * one for one in rotor_speed) / len(rotor_speed))
        least = self._slope * self._least + self._intercept
        if speed < least:
            return self._least * speed / least
        return min((speed - self._intercept) / self._slope, 65535.0)


class Commander:
    """The low-level setpoints of one drone, and for how long they hold."""

    def __init__(self, motors: Motors) -> None:
        """Begin without a setpoint, and with a lock on the thrust."""
        self._motors = motors
        self._setpoint: Setpoint | None = None
        self._since = 0.0
        self._thrust_locked = True
        self.released = True

    def drop(self) -> None:
        """Forget the setpoint; thrust is locked until a command of zero."""
        self._setpoint, self._thrust_locked, self.released = None, True, True

    def release(self) -> None:
        """Let the planner take over as soon as it has something to do."""
        self.released = True

    def take(
        self,
        packet: Packet,
        now: float,
        rates: tuple[bool, bool],
    ) -> None:
        """Take a setpoint.

        Args:
            packet: To the ports ATTITUDE_SETPOINT or SETPOINT.
            now: Present time, s.
            rates: Whether roll and pitch, and yaw, of ATTITUDE_SETPOINT are rates.

        Raises:
            MalformedError: The packet is not what it should be; nothing has changed.
        """
        if packet.port == Port.ATTITUDE_SETPOINT:
            *angles, command = unpack("fffH", packet.data)
            # A command of zero unlocks what a client may have left at full thrust.
            self._thrust_locked = self._thrust_locked and command > 0
            command = 0 if self._thrust_locked else command
            self._setpoint = self._manual(tuple(angles), command, *rates)
        else:
            (kind,) = unpack("B", packet.data)
            self._setpoint = self._generic(kind, packet.data[1:])
        self._since, self.released = now, self._setpoint is None

    def _generic(self, kind: int, data: bytes) -> Setpoint | None:
        """Read a setpoint of the port SETPOINT by its kind."""
        # A stop; thrust by hand is locked until a command of zero
        if kind == 0:
            self._thrust_locked = True
            return None
        # By hand: angles and thrust; the yaw may be a rate
        if kind == 11:
            *angles, command, is_rate = unpack("fffHB", data)
            return self._manual(tuple(angles), command, bool(is_rate), True)._replace(
                yaw=_turn(angles[2])
            )
        if kind == 6:
            return _full_state(data)
        if kind not in (7, 8, 9, 10):
            raise MalformedError(f"setpoint of kind {kind}: 0 or from 6 to 11 is needed")
        # The other kinds are four numbers each
        a, b, c, d = unpack("ffff", data)
        # A place with a yaw
        if kind == 7:
            place = (_within(a, FARTHEST), _within(b, FARTHEST))
            return Setpoint("position", place, "position", _within(c, FARTHEST), "angle", _angle(d))
        # Angles at a height, with a rate of yaw
        if kind == 9:
            return Setpoint(
                "attitude", _tilt(a, b), "position", _within(d, FARTHEST), "rate", _turn(c)
            )
        # Velocity: in the world with a climb, or in the body at a height
        velocity = (_within(a, FASTEST), _within(b, FASTEST))
        if kind == 8:
            return Setpoint("velocity", velocity, "velocity", _within(c, FASTEST), "rate", _turn(d))
        return Setpoint("body", velocity, "position", _within(d, FARTHEST), "rate", _turn(c))

    def _manual(
        self,
        angles: tuple[float, ...],
        command: int,
        is_rate: bool,
        yaw_is_rate: bool,
    ) -> Setpoint:
        """Make a setpoint of roll, pitch, yaw and thrust."""
        roll, pitch, yaw = angles
        thrust = 0.0
        if command >= LEAST_THRUST:
            thrust = self._motors.thrust(min(command, MOST_THRUST))
        # Yaw of this port turns clockwise, as it always did.
        turning, turn = ("rate", -_turn(yaw)) if yaw_is_rate else ("angle", _angle(-yaw))
        if is_rate:
            return Setpoint("rates", (_turn(roll), -_turn(pitch)), "thrust", thrust, turning, turn)
        return Setpoint("attitude", _tilt(roll, pitch), "thrust", thrust, turning, turn)

    def current(self, now: float) -> Setpoint | None:
        """Tell the setpoint that holds at a time, if any; old ones level out, and then end."""
        if self._setpoint is None:
            return None
        age = now - self._since
        if age > OFF_AFTER:
            self.drop()
            return None
        return self._setpoint if age <= LEVEL_AFTER else self._setpoint.to_level()


def _within(value: float, most: float) -> float:
    """Cut a number to a range about zero."""
    return min(max(value, -most), most)


def _turn(degrees: float) -> float:
    """Convert a rate from degrees, within what a drone can be asked for."""
    return _within(math.radians(degrees), QUICKEST)


def _angle(degrees: float) -> float:
    """Convert an angle from degrees to within half a turn."""
    return math.remainder(math.radians(degrees), math.tau)


def _tilt(roll: float, pitch: float) -> tuple[float, float]:
    """Convert roll and pitch (nose up) from degrees to radians, pitch nose down."""
    return _within(math.radians(roll), STEEPEST), _within(-math.radians(pitch), STEEPEST)


def _full_state(data: bytes) -> Setpoint:
    """Read a position with velocity, acceleration and attitude, of which the yaw is held."""
    numbers = unpack("9hI3h", data)
    x, y, z, *ahead = (number / 1000 for number in numbers[:9])
    _, _, yaw = euler(uncompressed(numbers[9]))
    return Setpoint("position", (x, y), "position", z, "angle", yaw, tuple(ahead))


def uncompressed(packed: int) -> tuple[float, ...]:
    """Read a quaternion from 32 bits.

    Two bits tell which entry is the largest. It is left out, and positive. The others have a sign
    and 9 bits each, in units of 1 / (511 sqrt(2)).

    Args:
        packed: The bits.

    Returns:
        (4,) x, y, z, w, a unit quaternion.
    """
    largest = packed >> 30
    entries = np.zeros(4)
    others = [k for k in range(4) if k != largest]
    for place, k in enumerate(reversed(others)):
        bits = packed >> 10 * place & 0x3FF
        entries[k] = (bits & 0x1FF) / 511 * math.sqrt(0.5) * (-1 if bits & 0x200 else 1)
    entries[largest] = math.sqrt(max(1.0 - float((entries * entries).sum()), 0.0))
    norm = math.sqrt(float((entries * entries).sum()))
    return tuple((entries / norm).tolist())
