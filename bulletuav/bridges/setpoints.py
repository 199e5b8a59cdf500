"""Setpoints as clients of bridges give them, and the commands of an airspace that follow.

A setpoint may mix what `SetpointLevel` keeps apart, such as a velocity across and a height to hold.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.control.gains import gain_rows
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.errors import shown
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.swarm import Swarm

NORTH = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""Attitude of a drone that looks north"""
MOST_LEAD = 1.0
"""How far the yaw to hold may run ahead of the drone, rad"""

State = tuple[list[float], list[float], list[float], list[float]]
"""Position, quaternion, velocity, rates of a drone; see `Swarm`"""


def make_airspace(
    starts: Any,
    airframe: Airframe,
    levels: Sequence[SetpointLevel] = tuple(SetpointLevel),
    **options: Any,
) -> Airspace:
    """Make the airspace of a server, in which drones have motors and hear the commands it gives.

    Otherwise the flight would end with its first step, or with a client's first command.

    Args:
        starts: (N, 3) where drones start, m.
        airframe: Their airframe.
        levels: Setpoint levels that the server commands.
        **options: More options of `Airspace`.

    Raises:
        ValueError: An option cannot be, or the dynamics does not take the commands.
    """
    airspace = Airspace(starts, airframe, **options)
    try:
        if airspace.consumes != SetpointLevel.ROTOR:
            raise ValueError(
                f"dynamics is {shown(options.get('dynamics'))}, which has no motors: servers for "
                f"programs of others need 'rigid_body' or 'bullet'"
            )
        for level in levels:
            airspace.require_level(level)
    except ValueError:
        airspace.close()
        raise
    return airspace


def states_of(swarm: Swarm) -> list[State]:
    """Tell the states of all drones of an airspace, as lists of numbers."""
    arrays = (swarm.position, swarm.quaternion, swarm.velocity, swarm.rates)
    return list(zip(*(array.tolist() for array in arrays), strict=True))


def corner_speeds(frame: Airframe, shares: Mapping[tuple[int, int], float]) -> tuple[float, ...]:
    """Tell the speeds of four rotors, in the order of the URDF.

    Args:
        frame: The airframe.
        shares: Of the greatest speed, by the signs of a rotor's x (forward) and y (left).

    Returns:
        One for each rotor, rad/s.

    Raises:
        ValueError: It has not four rotors, one in each corner.
    """
    corners = [(1 if x > 0 else -1, 1 if y > 0 else -1) for x, y, _ in frame.rotors]
    if sorted(corners) != sorted(shares):
        raise ValueError(
            f"{frame.name} has {len(corners)} rotors at corners {shown(corners)}: one in each of "
            f"four is needed, as those of 'iris'"
        )
    return tuple(frame.max_rotor_speed * shares[corner] for corner in corners)


def euler(quaternion: list[float] | tuple[float, ...]) -> tuple[float, float, float]:
    """Convert an attitude into Euler angles in the aerospace order.

    Args:
        quaternion: (4,) x, y, z, w, body (FLU) to world (ENU).

    Returns:
        Roll, pitch (nose down) and yaw, rad.
    """
    x, y, z, w = quaternion
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
    pitch = atan2(sine, math.sqrt(1 - sine * sine))
    return roll, pitch, atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class Setpoint(NamedTuple):
    """What a drone is to do, in the units of this package.

    Attributes:
        across: What `xy` is: "position" (m), "velocity" (world) or "body" (m/s), "attitude" (roll
            and pitch, rad) or "rates" (rad/s).
        xy: Two numbers.
        upward: What `z` is: "position" (m), "velocity" (m/s) or "thrust" (N).
        z: A number.
        turning: What `yaw` is: "angle" (rad) or "rate" (rad/s).
        yaw: A number.
        ahead: Velocity (m/s) and acceleration (m/s^2) that go with a position, six numbers.
    """

    across: str
    xy: tuple[float, float]
    upward: str
    z: float
    turning: str = "rate"
    yaw: float = 0.0
    ahead: tuple[float, ...] = ()

    def levelled(self) -> "Setpoint":
        """Return the setpoint of a drone that has heard nothing for a while: level, as high."""
        return Setpoint("attitude", (0.0, 0.0), self.upward, self.z)


class Order(NamedTuple):
    """A command for an airspace: level and numbers."""

    level: SetpointLevel
    numbers: tuple[float, ...]


def give(airspace: Airspace, orders: Sequence[Order | None]) -> None:
    """Tell each drone of an airspace its command; None is for motors off."""
    rows: dict[SetpointLevel | None, list[int]] = {}
    for i, order in enumerate(orders):
        rows.setdefault(None if order is None else order.level, []).append(i)
    for level, drones in rows.items():
        if level is None:
            airspace.stop(drones)
        else:
            wanted = [order.numbers for order in orders if order and order.level == level]
            airspace.command(drones, level, wanted)


class Guide:
    """Turns setpoints into commands of an airspace, for one drone."""

    def __init__(self, airframe: Airframe) -> None:
        """Take the loops of the airframe's controller."""
        gains = gain_rows([airframe], airframe.max_speed)[0]
        frequency, damping = float(gains["position_frequency"]), float(gains["damping"])
        self._near = frequency / (2 * damping)
        self._rate, self._stiffness = 2 * damping * frequency, frequency**2
        self._mass, self._fastest = airframe.mass, airframe.max_speed
        self._yaw: float | None = None

    def rest(self) -> None:
        """Forget the yaw that was held."""
        self._yaw = None

    def order(self, setpoint: Setpoint, state: State, period: float) -> Order:
        """Tell the command for a setpoint.

        Args:
            setpoint: What the drone is to do.
            state: Its state.
            period: Time until the next command, s.

        Returns:
            The command.
        """
        position, quaternion, velocity, _ = state
        yaw = self._held_yaw(setpoint, quaternion, period)
        # Attitudes and rates need a thrust; one that holds a height is worked out here
        if setpoint.across in ("attitude", "rates"):
            thrust = setpoint.z
            if setpoint.upward != "thrust":
                # The climb's error becomes an acceleration, as in the cascade
                up = self._rate * (self._climb(setpoint, position[2]) - velocity[2])
                roll, pitch, _ = euler(quaternion)
                # Share of the thrust that lifts; below a half the drone may sink
                lean = max(cos(roll) * cos(pitch), 0.5)
                thrust = self._mass * max(STANDARD_GRAVITY + up, 0.0) / lean
            if setpoint.across == "attitude":
                return Order(SetpointLevel.ATTITUDE, (*setpoint.xy, yaw, thrust))
            rate = setpoint.yaw if setpoint.turning == "rate" else 0.0
            return Order(SetpointLevel.RATES, (*setpoint.xy, rate, thrust))
        # Positions: along with what moves, or to a stop
        if setpoint.across == "position":
            if setpoint.ahead:
                return Order(
                    SetpointLevel.ACCELERATION, (*self._follow(setpoint, position, velocity), yaw)
                )
            return Order(SetpointLevel.POSITION, (*setpoint.xy, setpoint.z, yaw))
        # Velocities, of which those of the body turn with its heading
        x, y = setpoint.xy
        if setpoint.across == "body":
            heading = euler(quaternion)[2]
            x, y = (
                x * cos(heading) - y * sin(heading),
                x * sin(heading) + y * cos(heading),
            )
        return Order(SetpointLevel.VELOCITY, (x, y, self._climb(setpoint, position[2]), yaw))

    def _climb(self, setpoint: Setpoint, height: float) -> float:
        """Tell the velocity upwards, m/s, that leads to the height wanted, or is wanted."""
        if setpoint.upward == "velocity":
            return setpoint.z
        return min(max(self._near * (setpoint.z - height), -self._fastest), self._fastest)

    def _follow(
        self, setpoint: Setpoint, position: list[float], velocity: list[float]
    ) -> list[float]:
        """Tell the acceleration that leads to a position that moves."""
        place = (*setpoint.xy, setpoint.z)
        return [
            setpoint.ahead[3 + k]
            + self._rate * (setpoint.ahead[k] - velocity[k])
            + self._stiffness * (place[k] - position[k])
            for k in range(3)
        ]

    def _held_yaw(self, setpoint: Setpoint, quaternion: list[float], period: float) -> float:
        """Turn the yaw that is held."""
        if setpoint.turning == "angle":
            self._yaw = setpoint.yaw
            return setpoint.yaw
        heading = euler(quaternion)[2]
        held = heading if self._yaw is None else self._yaw
        lead = math.remainder(held + setpoint.yaw * period - heading, math.tau)
        self._yaw = math.remainder(heading + min(max(lead, -MOST_LEAD), MOST_LEAD), math.tau)
        return self._yaw
