"""Setpoints of bridge clients, and their conversion to airspace commands.

A setpoint may combine modes that `SetpointLevel` separates, such as a horizontal velocity and a
height to hold.
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
"""Attitude of a drone that faces north: quaternion x, y, z, w"""
PX4_CORNERS = ((1, -1), (-1, 1), (1, 1), (-1, -1))
"""Corners of a quadrotor in PX4's motor order: front right, rear left, front left, rear right. Each
is the signs of the rotor's x (forward) and y (left) coordinate."""
MAX_YAW_LEAD = 1.0
"""Maximum angle by which the integrated yaw setpoint may lead the yaw of the drone, rad"""

State = tuple[list[float], list[float], list[float], list[float]]
"""Position, quaternion, velocity and angular rates of a drone; see `Swarm`"""


def make_airspace(
    start_positions: Any,
    airframe: Any,
    levels: Sequence[SetpointLevel] = tuple(SetpointLevel),
    **options: Any,
) -> Airspace:
    """Create the airspace of a server, and check that it supports the commands of the server.

    Without this check, the simulation would fail in its first step, or at the first command of a
    client.

    Args:
        start_positions: (N, 3) start positions of the drones, m.
        airframe: Airframe of the drones: name, path of a URDF, or `Airframe`.
        levels: Setpoint levels that the server commands.
        **options: Other options of `Airspace`.

    Returns:
        The airspace.

    Raises:
        ValueError: If an option is invalid, or the dynamics does not support the commands.
    """
    airspace = Airspace(start_positions, airframe, **options)
    try:
        if airspace.consumes != SetpointLevel.ROTOR:
            raise ValueError(
                f"dynamics is {shown(options.get('dynamics'))}, which has no motors: servers need "
                f"'rigid_body' or 'bullet'"
            )
        for level in levels:
            airspace.require_level(level)
    except ValueError:
        airspace.close()
        raise
    return airspace


def require_hovering(airframe: Airframe, server: str) -> None:
    """Raise ValueError if an airframe cannot hover, as the commands of a server require.

    Args:
        airframe: Airframe of the drones.
        server: Name of the server's clients in the message, such as "AirSim".
    """
    if not airframe.can_hover:
        raise ValueError(
            f"airframe is {airframe.name!r}, which cannot hover, as clients of {server} need: use "
            f"'quadplane' or a multirotor, or fly it by 'bulletuav serve mavlink'"
        )


def get_states(swarm: Swarm) -> list[State]:
    """Return the states of all drones of a swarm, as lists of numbers."""
    arrays = (swarm.position, swarm.quaternion, swarm.velocity, swarm.rates)
    return list(zip(*(array.tolist() for array in arrays), strict=True))


def find_corners(airframe: Airframe) -> list[tuple[int, int]]:
    """Return the corner of each rotor of a quadrotor, in the rotor order of its URDF.

    Returns:
        Signs of the x (forward) and y (left) coordinate of each rotor.

    Raises:
        ValueError: If the airframe does not have four rotors, one in each corner.
    """
    corners = [(1 if x > 0 else -1, 1 if y > 0 else -1) for x, y, _ in airframe.rotors]
    if sorted(corners) != sorted(PX4_CORNERS):
        raise ValueError(
            f"{airframe.name} has {len(corners)} rotors at corners {shown(corners)}: four are "
            f"needed, one in each corner, as those of 'iris'"
        )
    return corners


def compute_corner_speeds(
    airframe: Airframe, fractions: Mapping[tuple[int, int], float]
) -> tuple[float, ...]:
    """Return the speeds of the four rotors of a quadrotor, in the rotor order of its URDF.

    Args:
        airframe: Airframe of the drone.
        fractions: Fractions of the maximum rotor speed by the corners of `find_corners`.

    Returns:
        Speed of each rotor, rad/s.

    Raises:
        ValueError: If the airframe does not have four rotors, one in each corner.
    """
    return tuple(airframe.max_rotor_speed * fractions[corner] for corner in find_corners(airframe))


def euler(quaternion: list[float] | tuple[float, ...]) -> tuple[float, float, float]:
    """Convert a quaternion to Euler angles in the aerospace order: yaw, pitch, roll.

    Args:
        quaternion: (4,) x, y, z, w, body (FLU) to world (ENU).

    Returns:
        Roll, pitch (positive nose down) and yaw, rad.
    """
    x, y, z, w = quaternion
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
    pitch = atan2(sine, math.sqrt(1 - sine * sine))
    return roll, pitch, atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class Setpoint(NamedTuple):
    """Setpoint of a drone, with separate modes for the horizontal, vertical and yaw axes.

    Attributes:
        xy_mode: Meaning of `xy`: "position" (m), "velocity" (m/s, world frame), "body" (m/s,
            heading frame), "attitude" (roll and pitch, rad) or "rates" (roll and pitch rates,
            rad/s).
        xy: Two numbers.
        z_mode: Meaning of `z`: "position" (m), "velocity" (m/s) or "thrust" (N).
        z: A number.
        yaw_mode: Meaning of `yaw`: "angle" (rad) or "rate" (rad/s).
        yaw: A number.
        feedforward: Velocity (m/s) and acceleration (m/s^2) of a moving position setpoint, six
            numbers; empty for a fixed position.
    """

    xy_mode: str
    xy: tuple[float, float]
    z_mode: str
    z: float
    yaw_mode: str = "rate"
    yaw: float = 0.0
    feedforward: tuple[float, ...] = ()

    def to_level(self) -> "Setpoint":
        """Return a failsafe setpoint with level attitude and the same vertical setpoint.

        Servers use this setpoint when a client has been silent for a while.
        """
        return Setpoint("attitude", (0.0, 0.0), self.z_mode, self.z)


class AirspaceCommand(NamedTuple):
    """Command for one drone of an airspace.

    Attributes:
        level: Setpoint level.
        values: Values of the command, as `level` defines them.
    """

    level: SetpointLevel
    values: tuple[float, ...]


def apply_commands(airspace: Airspace, commands: Sequence[AirspaceCommand | None]) -> None:
    """Send commands to the drones of an airspace.

    Args:
        airspace: The airspace.
        commands: Command of each drone; None stops its motors.
    """
    rows: dict[SetpointLevel | None, list[int]] = {}
    for i, command in enumerate(commands):
        rows.setdefault(None if command is None else command.level, []).append(i)
    for level, drones in rows.items():
        if level is None:
            airspace.stop(drones)
        else:
            values = [command.values for command in commands if command and command.level == level]
            airspace.command(drones, level, values)


class SetpointController:
    """Controller that converts the setpoints of one drone to airspace commands."""

    def __init__(self, airframe: Airframe) -> None:
        """Read the gains of the airframe's position controller."""
        gains = gain_rows([airframe], airframe.max_speed)[0]
        frequency, damping = float(gains["position_frequency"]), float(gains["damping"])
        self._position_gain = frequency / (2 * damping)
        self._velocity_gain, self._stiffness = 2 * damping * frequency, frequency**2
        self._mass, self._max_speed = airframe.mass, airframe.max_speed
        self._yaw: float | None = None

    def reset(self) -> None:
        """Clear the yaw that the drone holds."""
        self._yaw = None

    def compute_command(self, setpoint: Setpoint, state: State, period: float) -> AirspaceCommand:
        """Return the airspace command that tracks a setpoint.

        Args:
            setpoint: Setpoint of the drone.
            state: State of the drone.
            period: Time until the next command, s.

        Returns:
            The command.
        """
        position, quaternion, velocity, _ = state
        yaw = self._update_held_yaw(setpoint, quaternion, period)
        # Attitudes and rates need a thrust; holding a height or a climb rate needs one computed
        # here
        if setpoint.xy_mode in ("attitude", "rates"):
            thrust = setpoint.z
            if setpoint.z_mode != "thrust":
                # As in the cascaded controller, the climb rate error gives an acceleration
                vertical_acceleration = self._velocity_gain * (
                    self._compute_climb_rate(setpoint, position[2]) - velocity[2]
                )
                roll, pitch, _ = euler(quaternion)
                # Vertical fraction of the thrust; clamped at 0.5, so that a steeply tilted drone
                # may sink
                tilt_factor = max(cos(roll) * cos(pitch), 0.5)
                thrust = (
                    self._mass * max(STANDARD_GRAVITY + vertical_acceleration, 0.0) / tilt_factor
                )
            if setpoint.xy_mode == "attitude":
                return AirspaceCommand(SetpointLevel.ATTITUDE, (*setpoint.xy, yaw, thrust))
            yaw_rate = setpoint.yaw if setpoint.yaw_mode == "rate" else 0.0
            return AirspaceCommand(SetpointLevel.RATES, (*setpoint.xy, yaw_rate, thrust))
        # Moving positions are tracked with feedforward; fixed ones by the position controller
        if setpoint.xy_mode == "position":
            if setpoint.feedforward:
                return AirspaceCommand(
                    SetpointLevel.ACCELERATION,
                    (*self._compute_acceleration(setpoint, position, velocity), yaw),
                )
            return AirspaceCommand(SetpointLevel.POSITION, (*setpoint.xy, setpoint.z, yaw))
        # Velocities; those in the heading frame are rotated to the world frame
        x, y = setpoint.xy
        if setpoint.xy_mode == "body":
            heading = euler(quaternion)[2]
            x, y = (
                x * cos(heading) - y * sin(heading),
                x * sin(heading) + y * cos(heading),
            )
        return AirspaceCommand(
            SetpointLevel.VELOCITY, (x, y, self._compute_climb_rate(setpoint, position[2]), yaw)
        )

    def _compute_climb_rate(self, setpoint: Setpoint, height: float) -> float:
        """Return the climb rate of a setpoint, or the one that leads to its height, m/s."""
        if setpoint.z_mode == "velocity":
            return setpoint.z
        return min(
            max(self._position_gain * (setpoint.z - height), -self._max_speed), self._max_speed
        )

    def _compute_acceleration(
        self, setpoint: Setpoint, position: list[float], velocity: list[float]
    ) -> list[float]:
        """Return the acceleration that tracks a moving position (PD with feedforward), m/s^2."""
        target = (*setpoint.xy, setpoint.z)
        return [
            setpoint.feedforward[3 + k]
            + self._velocity_gain * (setpoint.feedforward[k] - velocity[k])
            + self._stiffness * (target[k] - position[k])
            for k in range(3)
        ]

    def _update_held_yaw(self, setpoint: Setpoint, quaternion: list[float], period: float) -> float:
        """Update and return the yaw to hold, rad.

        A yaw rate is integrated. The result may lead the yaw of the drone by at most
        `MAX_YAW_LEAD`.
        """
        if setpoint.yaw_mode == "angle":
            self._yaw = setpoint.yaw
            return setpoint.yaw
        heading = euler(quaternion)[2]
        held_yaw = heading if self._yaw is None else self._yaw
        lead = math.remainder(held_yaw + setpoint.yaw * period - heading, math.tau)
        self._yaw = math.remainder(heading + min(max(lead, -MAX_YAW_LEAD), MAX_YAW_LEAD), math.tau)
        return self._yaw
