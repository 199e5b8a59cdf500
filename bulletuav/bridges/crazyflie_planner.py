"""The planner of a virtual Crazyflie: takes off, lands, goes to places, follows trajectories."""

import math

import numpy as np

from bulletuav.bridges.crazyflie_plans import (
    Pose,
    Spiral,
    Stored,
    read_compressed,
    read_pieces,
    smooth,
    straight,
)
from bulletuav.bridges.crazyflie_setpoints import FARTHEST
from bulletuav.bridges.crtp import Errno, MalformedError, unpack
from bulletuav.bridges.setpoints import AirspaceCommand, State, euler
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.control.trajectory import Tracker, Trajectory
from bulletuav.vehicle.airframe import Airframe

SHORTEST, LONGEST = 0.01, 1000.0
"""Least and greatest duration of a plan, s"""
FASTEST = 1000.0
"""Greatest acceleration that is commanded, m/s^2"""
MOST_TRAJECTORIES = 10
"""How many trajectories can be defined"""


class Planner:
    """Plans of one drone. It holds the end of the last plan, but for that of a landing.

    Attributes:
        flies: Whether there is a plan to follow or to hold.
    """

    def __init__(self, airframe: Airframe, memory: bytearray) -> None:
        """Begin without a plan.

        Args:
            airframe: Of the drone.
            memory: What trajectories are read from.
        """
        self._airframe, self._memory = airframe, memory
        self._tracker: Tracker | None = None
        self._end: AirspaceCommand | None = None
        self._start = 0.0
        self._lands = False
        self._group = 0
        self._stored: dict[int, tuple[int, int, int]] = {}

    @property
    def flies(self) -> bool:
        """Whether there is a plan."""
        return self._tracker is not None

    def finished(self, now: float) -> bool:
        """Tell whether there is no plan, or it has come to its end."""
        return self._tracker is None or now - self._start >= self._tracker.trajectory.end

    def stop(self) -> None:
        """Forget the plan."""
        self._tracker = None

    def order(self, state: State, now: float) -> AirspaceCommand | None:
        """Tell the command of a time, or None once a landing has ended."""
        if self._lands and self.finished(now):
            self.stop()
        if self._tracker is None:
            return None
        if self.finished(now):
            return self._end
        place, velocity = np.array(state[0]), np.array(state[2])
        x, y, z, yaw = self._tracker.setpoint(now - self._start, place, velocity).tolist()
        numbers = (min(max(one, -FASTEST), FASTEST) for one in (x, y, z))
        return AirspaceCommand(
            SetpointLevel.ACCELERATION, (*numbers, math.remainder(yaw, math.tau))
        )

    def target(self, now: float) -> list[float] | None:
        """Tell where the plan is, (3,) m."""
        if self._tracker is None:
            return None
        place: list[float] = self._tracker.trajectory.at(now - self._start).position.tolist()
        return place

    def take(
        self,
        data: bytes,
        state: State,
        now: float,
    ) -> Errno:
        """Take a command.

        Args:
            data: Data of a packet to the port PLANNER.
            state: State of the drone.
            now: Present time, s.

        Returns:
            What is answered.

        Raises:
            MalformedError: The packet is not what it should be; nothing has changed.
        """
        # Numbers of the commands of the firmware's high-level commander
        (command,) = unpack("B", data)
        commands = {
            0: self._set_group,
            3: self._stop,
            6: self._define,
            7: self._take_off,
            8: self._land,
            11: self._spiral,
            12: self._go_to,
            13: self._follow,
        }
        if command not in commands:
            return Errno.ENOEXEC
        # Those to fly may be meant for a group of drones alone
        if command not in (0, 6):
            _, group = unpack("BB", data)
            if group and not group & self._group:
                return Errno.NONE  # it is for others
        return commands[command](data, self._pose(state, now), now)

    def _pose(self, state: State, now: float) -> Pose:
        """Tell where a new plan begins: where the present one is, or else the drone."""
        if self._tracker is not None:
            told = self._tracker.trajectory.at(now - self._start)
            return Pose(
                np.append(told.position, told.yaw),
                np.append(told.velocity, 0.0),
                np.append(told.acceleration, 0.0),
            )
        place, quaternion, velocity, _ = state
        return Pose(
            np.array([*place, euler(quaternion)[2]]), np.array([*velocity, 0.0]), np.zeros(4)
        )

    def _begin(
        self,
        plan: Trajectory,
        now: float,
        lands: bool = False,
    ) -> Errno:
        """Follow a plan from now on."""
        self._tracker, self._start, self._lands = Tracker(self._airframe, plan), now, lands
        end = plan.at(plan.end)
        numbers = (*end.position.tolist(), math.remainder(end.yaw, math.tau))
        self._end = AirspaceCommand(SetpointLevel.POSITION, numbers)
        return Errno.NONE

    def _set_group(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        _, self._group = unpack("BB", data)
        return Errno.NONE

    def _stop(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        self.stop()
        return Errno.NONE

    def _vertical(
        self,
        data: bytes,
        begin: Pose,
        now: float,
        lands: bool,
    ) -> Errno:
        """Rise or sink to a height."""
        _, _, height, yaw, keeps_yaw, duration = unpack("BBff?f", data)
        goal = begin.place.copy()
        goal[2] = height
        if not keeps_yaw:
            goal[3] += math.remainder(yaw - goal[3], math.tau)
        if _impossible(goal, duration):
            return Errno.EINVAL
        return self._begin(smooth(begin, goal, duration), now, lands)

    def _take_off(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        if self.flies:
            return Errno.EBUSY
        return self._vertical(data, Pose.still(begin.place), now, False)

    def _land(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        return self._vertical(data, begin, now, True)

    def _go_to(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        _, _, is_relative, is_linear, *goal, duration = unpack("BBBBfffff", data)
        place = np.array(goal)
        if is_relative:
            place += begin.place
        else:
            place[3] = begin.place[3] + math.remainder(goal[3] - begin.place[3], math.tau)
        if _impossible(place, duration):
            return Errno.EINVAL
        if is_linear:
            return self._begin(straight(begin.place, place, duration), now)
        return self._begin(smooth(begin, place, duration), now)

    def _spiral(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        _, _, sideways, clockwise, angle, first, last, ascent, duration = unpack("BBBBfffff", data)
        limited = min(max(angle, -math.tau), math.tau)
        reach = np.array([first, last, ascent, 0.0])
        if min(first, last) < 0 or _impossible(reach, duration):
            return Errno.EINVAL
        spiral = Spiral(limited, first, last, ascent, bool(sideways), bool(clockwise))
        return self._begin(spiral.plan(begin.place, duration), now)

    def _define(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        _, number, location, kind, offset, count = unpack("BBBBIB", data)
        if location != 1 or kind not in (0, 1) or not count:
            return Errno.EINVAL
        if number not in self._stored and len(self._stored) == MOST_TRAJECTORIES:
            return Errno.ENOMEM
        self._stored[number] = (kind, offset, count)
        return Errno.NONE

    def _follow(
        self,
        data: bytes,
        begin: Pose,
        now: float,
    ) -> Errno:
        _, _, along, turned, backwards, number, scale = unpack("BBBBBBf", data)
        if number not in self._stored:
            return Errno.ENOENT
        kind, offset, count = self._stored[number]
        read = read_compressed if kind else read_pieces
        try:
            stored: Stored = read(bytes(self._memory), offset, count)
            if not 0.01 <= scale <= 100.0:
                return Errno.EINVAL
            stored = stored.scaled(scale)
            if backwards:
                stored = stored.reverse()
            return self._begin(stored.moved(begin.place, bool(along), bool(turned)).plan(), now)
        # What is in the memory is not this packet's fault.
        except MalformedError:
            return Errno.EINVAL


def _impossible(place: np.ndarray, duration: float) -> bool:
    """Tell whether a goal is too far away, or to be reached in no time."""
    return bool((np.abs(place) > FARTHEST).any()) or not SHORTEST <= duration <= LONGEST
