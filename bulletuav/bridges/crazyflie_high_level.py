"""High-level commander of a virtual Crazyflie: take-off, landing, go-to, spiral, trajectory."""

import math

import numpy as np

from bulletuav.bridges.crazyflie_setpoints import MAX_COORDINATE
from bulletuav.bridges.crazyflie_trajectories import (
    Spiral,
    StoredTrajectory,
    TrajectoryStart,
    plan_line,
    plan_polynomial,
    read_compressed,
    read_pieces,
)
from bulletuav.bridges.crtp import Errno, MalformedError, unpack_data
from bulletuav.bridges.setpoints import AirspaceCommand, State, euler
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.control.trajectory import Tracker, Trajectory
from bulletuav.vehicle.airframe import Airframe

MIN_DURATION, MAX_DURATION = 0.01, 1000.0
"""Minimum and maximum duration of a plan, s"""
MAX_ACCELERATION = 1000.0
"""Limit of the commanded acceleration, m/s^2"""
MAX_TRAJECTORIES = 10
"""Maximum number of defined trajectories"""


class HighLevelCommander:
    """High-level commander of one drone, which plans trajectories and follows them.

    At the end of a plan the drone holds the last position; after a landing the plan is discarded.
    """

    def __init__(self, airframe: Airframe, memory: bytearray) -> None:
        """Initialise without a plan.

        Args:
            airframe: Airframe of the drone.
            memory: Trajectory memory, from which uploaded trajectories are read.
        """
        self._airframe, self._memory = airframe, memory
        self._tracker: Tracker | None = None
        self._final_command: AirspaceCommand | None = None
        self._start_time = 0.0
        self._is_landing = False
        self._group = 0
        self._definitions: dict[int, tuple[int, int, int]] = {}

    @property
    def has_plan(self) -> bool:
        """True if there is a plan to follow, or an end position to hold."""
        return self._tracker is not None

    def is_finished(self, now: float) -> bool:
        """Return True if there is no plan, or if its end has been reached."""
        return self._tracker is None or now - self._start_time >= self._tracker.trajectory.end

    def stop(self) -> None:
        """Discard the plan."""
        self._tracker = None

    def order(self, state: State, now: float) -> AirspaceCommand | None:
        """Return the flight command at a time, or None without a plan or after a landing."""
        if self._is_landing and self.is_finished(now):
            self.stop()
        if self._tracker is None:
            return None
        if self.is_finished(now):
            return self._final_command
        position, velocity = np.array(state[0]), np.array(state[2])
        x, y, z, yaw = self._tracker.setpoint(now - self._start_time, position, velocity).tolist()
        numbers = (min(max(value, -MAX_ACCELERATION), MAX_ACCELERATION) for value in (x, y, z))
        return AirspaceCommand(
            SetpointLevel.ACCELERATION, (*numbers, math.remainder(yaw, math.tau))
        )

    def target(self, now: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return planned position (3,), m, and velocity (3,), m/s, at a time; None without a plan.

        Args:
            now: The time, s.
        """
        if self._tracker is None:
            return None
        point = self._tracker.trajectory.at(now - self._start_time)
        return point.position, point.velocity

    def handle_command(self, data: bytes, state: State, now: float) -> Errno:
        """Handle a command.

        Args:
            data: Data of a packet to the port `CrtpPort.SETPOINT_HL`.
            state: State of the drone.
            now: Present time, s.

        Returns:
            Error code to send back.

        Raises:
            MalformedError: If the data does not have the layout of the command. Nothing is changed.
        """
        # Command numbers of the firmware (crtp_commander_high_level.c)
        (command,) = unpack_data("B", data)
        commands = {
            0: self._set_group,
            3: self._stop,
            6: self._define_trajectory,
            7: self._take_off,
            8: self._land,
            11: self._spiral,
            12: self._go_to,
            13: self._start_trajectory,
        }
        if command not in commands:
            return Errno.ENOEXEC
        # Flight commands may be addressed to a group of drones
        if command not in (0, 6):
            _, group = unpack_data("BB", data)
            if group and not group & self._group:
                return Errno.NONE
        return commands[command](data, self._start_state(state, now), now)

    def _start_state(self, state: State, now: float) -> TrajectoryStart:
        """Return the start state of a new plan: on the present plan, or else the drone's state."""
        if self._tracker is not None:
            setpoint = self._tracker.trajectory.at(now - self._start_time)
            return TrajectoryStart(
                np.append(setpoint.position, setpoint.yaw),
                np.append(setpoint.velocity, 0.0),
                np.append(setpoint.acceleration, 0.0),
            )
        position, quaternion, velocity, _ = state
        return TrajectoryStart(
            np.array([*position, euler(quaternion)[2]]), np.array([*velocity, 0.0]), np.zeros(4)
        )

    def _follow_plan(self, plan: Trajectory, now: float, is_landing: bool = False) -> Errno:
        """Start to follow a plan."""
        self._tracker, self._start_time, self._is_landing = (
            Tracker(self._airframe, plan),
            now,
            is_landing,
        )
        end = plan.at(plan.end)
        numbers = (*end.position.tolist(), math.remainder(end.yaw, math.tau))
        self._final_command = AirspaceCommand(SetpointLevel.POSITION, numbers)
        return Errno.NONE

    def _set_group(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        _, self._group = unpack_data("BB", data)
        return Errno.NONE

    def _stop(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        self.stop()
        return Errno.NONE

    def _vertical(self, data: bytes, start: TrajectoryStart, now: float, is_landing: bool) -> Errno:
        """Plan a climb or descent to a height."""
        _, _, height, yaw, keeps_yaw, duration = unpack_data("BBff?f", data)
        goal = start.position.copy()
        goal[2] = height
        if not keeps_yaw:
            goal[3] += math.remainder(yaw - goal[3], math.tau)
        if _is_out_of_range(goal, duration):
            return Errno.EINVAL
        return self._follow_plan(plan_polynomial(start, goal, duration), now, is_landing)

    def _take_off(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        if self.has_plan:
            return Errno.EBUSY
        return self._vertical(data, TrajectoryStart.at_rest(start.position), now, False)

    def _land(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        return self._vertical(data, start, now, True)

    def _go_to(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        _, _, is_relative, is_linear, *goal, duration = unpack_data("BBBBfffff", data)
        position = np.array(goal)
        if is_relative:
            position += start.position
        else:
            position[3] = start.position[3] + math.remainder(goal[3] - start.position[3], math.tau)
        if _is_out_of_range(position, duration):
            return Errno.EINVAL
        if is_linear:
            return self._follow_plan(plan_line(start.position, position, duration), now)
        return self._follow_plan(plan_polynomial(start, position, duration), now)

    def _spiral(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        _, _, sideways, clockwise, angle, first, last, ascent, duration = unpack_data(
            "BBBBfffff", data
        )
        limited = min(max(angle, -math.tau), math.tau)
        reach = np.array([first, last, ascent, 0.0])
        if min(first, last) < 0 or _is_out_of_range(reach, duration):
            return Errno.EINVAL
        spiral = Spiral(limited, first, last, ascent, bool(sideways), bool(clockwise))
        return self._follow_plan(spiral.plan(start.position, duration), now)

    def _define_trajectory(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        _, number, location, trajectory_type, offset, count = unpack_data("BBBBIB", data)
        if location != 1 or trajectory_type not in (0, 1) or not count:
            return Errno.EINVAL
        if number not in self._definitions and len(self._definitions) == MAX_TRAJECTORIES:
            return Errno.ENOMEM
        self._definitions[number] = (trajectory_type, offset, count)
        return Errno.NONE

    def _start_trajectory(self, data: bytes, start: TrajectoryStart, now: float) -> Errno:
        _, _, is_relative, is_yaw_relative, is_reversed, number, scale = unpack_data(
            "BBBBBBf", data
        )
        if number not in self._definitions:
            return Errno.ENOENT
        trajectory_type, offset, count = self._definitions[number]
        read = read_compressed if trajectory_type else read_pieces
        try:
            stored: StoredTrajectory = read(bytes(self._memory), offset, count)
            if not 0.01 <= scale <= 100.0:
                return Errno.EINVAL
            stored = stored.scaled(scale)
            if is_reversed:
                stored = stored.reverse()
            return self._follow_plan(
                stored.moved(start.position, bool(is_relative), bool(is_yaw_relative)).plan(), now
            )
        # The packet is well-formed: only the memory's content is invalid
        except MalformedError:
            return Errno.EINVAL


def _is_out_of_range(position: np.ndarray, duration: float) -> bool:
    """Return True if a goal is too far away, or if its duration is out of range."""
    return (
        bool((np.abs(position) > MAX_COORDINATE).any())
        or not MIN_DURATION <= duration <= MAX_DURATION
    )
