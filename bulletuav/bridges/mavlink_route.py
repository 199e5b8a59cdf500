"""Progress of a mission: the current item, and the motions for each item."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_fence import MissionItem
from bulletuav.bridges.mavlink_items import (
    CHANGE_SPEED,
    DELAY,
    JUMP,
    LAND,
    LOITER_TIME,
    LOITER_UNLIMITED,
    RETURN,
    TAKEOFF,
    WAYPOINT,
    compute_item_position,
)
from bulletuav.bridges.mavlink_protocol import Mode
from bulletuav.bridges.motions import (
    PATH_ACCELERATION,
    FollowPath,
    Heading,
    HoldSetpoint,
    MotionPrimitive,
)
from bulletuav.bridges.setpoints import Setpoint, State, euler

MAX_WAIT = 1e5
"""Maximum time to wait at an item, s"""
MIN_SPEED, MAX_SPEED = 0.1, 100.0
"""Limits of the speed that an item may set, m/s"""
SAME_POSITION_DISTANCE = 0.5
"""Horizontal distance below which an item is at the vehicle's present position, m"""
MIN_ACCEPTANCE_RADIUS = 0.1
"""Distance from a position at which it counts as reached, unless an item sets a larger one, m"""
LEG_TIMEOUT_MARGIN = 5.0
"""Time after the planned arrival at which a leg ends in any case, s"""


class Route:
    """Items of a mission, and its progress.

    Attributes:
        items: Items of the mission.
        current: Index of the current item.
        reached: Indices of reached items that have not been reported to clients.
        speed: Speed of the legs, m/s.
    """

    def __init__(self, site: Site, values: Mapping[str, float]) -> None:
        """Initialise without items.

        Args:
            site: Start position of the vehicle.
            values: Values of the parameters.
        """
        self._site, self._values = site, values
        self._state: State = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self._now, self._has_landed = 0.0, True
        self.replace(())

    def replace(self, items: tuple[MissionItem, ...]) -> None:
        """Replace the mission, and restart at its first item."""
        self.items, self.reached = items, list[int]()
        self._num_jumps, self._has_moved = dict[int, int](), False
        self._speed: float | None = None
        self.set_current_item(0)

    def set_current_item(self, number: int) -> None:
        """Continue with an item, from its start."""
        self.current = number
        self._motions: Iterator[MotionPrimitive | Mode] | None = None

    @property
    def speed(self) -> float:
        """Speed of the legs, m/s."""
        return self._values["MPC_XY_CRUISE"] if self._speed is None else self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = speed

    @property
    def is_over(self) -> bool:
        """True if the last item is done."""
        return self.current >= len(self.items)

    def plan_leg(
        self,
        state: State,
        goal: tuple[float, float, float],
        speed: float,
        heading: Heading,
        now: float,
        acceptance_radius: float = MIN_ACCEPTANCE_RADIUS,
    ) -> FollowPath:
        """Plan a straight leg to a position, with the vertical speed limited by the parameters.

        Args:
            state: State of the drone.
            goal: (3,) goal, m.
            speed: Speed, m/s.
            heading: Heading during the leg.
            now: Time, s.
            acceptance_radius: Distance from the goal at which it counts as reached, m.
        """
        rise = goal[2] - state[0][2]
        distance = math.dist(goal, state[0])
        max_climb_rate = self._values["MPC_Z_VEL_MAX_UP" if rise > 0 else "MPC_Z_VEL_MAX_DN"]
        if speed * abs(rise) > max_climb_rate * distance:
            speed = max_climb_rate * distance / abs(rise)
        # Wind may keep the drone away from the goal: end the leg after a timeout
        limit = distance / speed + speed / PATH_ACCELERATION + LEG_TIMEOUT_MARGIN
        return FollowPath(state, [np.array(goal)], speed, heading, (now, limit), acceptance_radius)

    def next_motion(
        self, state: State, now: float, has_landed: bool
    ) -> MotionPrimitive | Mode | None:
        """Return the next motion of the mission.

        Args:
            state: State of the drone.
            now: Time, s.
            has_landed: Whether the drone stands on the ground.

        Returns:
            A motion; a mode whose motion follows; or None at the end of the mission.
        """
        self._state, self._now, self._has_landed = state, now, has_landed
        while not self.is_over:
            if self._motions is None:
                self._motions = self._item_motions(self.items[self.current])
            motion = next(self._motions, None)
            if motion is not None:
                self._has_moved = True
                return motion
            self.reached.append(self.current)
            self.set_current_item(self._find_next_item())
        return None

    def _find_next_item(self) -> int:
        """Return the index of the item after the current one, which may be a jump."""
        item, number = self.items[self.current], self.current
        # Jumps without a motion between them would repeat forever within one step
        if item.command == JUMP and self._has_moved:
            count, repeats = self._num_jumps.get(number, 0), item.params[1]
            if count < repeats or repeats < 0:
                self._num_jumps[number], self._has_moved = count + 1, False
                return int(item.params[0])
            # The next time that the mission arrives here, it jumps again
            self._num_jumps[number] = 0
        return number + 1

    def _item_motions(self, item: MissionItem) -> Iterator[MotionPrimitive | Mode]:
        """Yield the motions of an item, one by one, from the drone's present position."""
        if item.command == CHANGE_SPEED:
            if item.params[1] > 0:
                self.speed = min(max(item.params[1], MIN_SPEED), MAX_SPEED)
        elif item.command == DELAY:
            yield self._wait(item.params[0])
        elif item.command == JUMP:
            return  # `_find_next_item` selects the item
        elif item.command == RETURN:
            self.reached.append(self.current)
            self.set_current_item(len(self.items))
            yield Mode.RETURN
        else:
            yield from self._position_item_motions(item)

    def _position_item_motions(self, item: MissionItem) -> Iterator[MotionPrimitive | Mode]:
        """Yield the motions of an item with a position."""
        current_position = self._state[0]
        goal = compute_item_position(item, self._site, current_position)
        is_far = math.dist(current_position[:2], goal[:2]) > SAME_POSITION_DISTANCE
        if item.command == TAKEOFF or (self._has_landed and is_far):
            # Climb before a leg that starts on the ground
            takeoff_height = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
            height = (
                goal[2]
                if item.command == TAKEOFF
                else max(goal[2], takeoff_height, current_position[2])
            )
            yield self._plan_leg((current_position[0], current_position[1], height), Heading())
        if item.command == LAND:
            if is_far:
                yield self._plan_leg((goal[0], goal[1], self._state[0][2]), Heading(forward=True))
            yield Mode.LAND
            return
        if item.command != TAKEOFF or is_far:
            yaw = item.params[3]
            yaw_enu = math.remainder(math.pi / 2 - math.radians(yaw), math.tau)
            heading = Heading("angle", yaw_enu) if math.isfinite(yaw) else Heading(forward=True)
            acceptance_radius = (
                item.params[1] if item.params[1] > MIN_ACCEPTANCE_RADIUS else MIN_ACCEPTANCE_RADIUS
            )
            yield self._plan_leg(goal, heading, acceptance_radius)
        if item.command in (WAYPOINT, LOITER_TIME) and item.params[0] > 0:
            yield self._wait(item.params[0])
        while item.command == LOITER_UNLIMITED:
            yield self._wait(MAX_WAIT)

    def _plan_leg(
        self,
        goal: tuple[float, float, float],
        heading: Heading,
        acceptance_radius: float = MIN_ACCEPTANCE_RADIUS,
    ) -> FollowPath:
        """Plan a straight leg at the mission's speed."""
        return self.plan_leg(self._state, goal, self.speed, heading, self._now, acceptance_radius)

    def _wait(self, seconds: float) -> HoldSetpoint:
        """Return a motion that holds the position for a time, s."""
        (x, y, z), quaternion, _, _ = self._state
        setpoint = Setpoint("position", (x, y), "position", z, "angle", euler(quaternion)[2])
        return HoldSetpoint(self._now, min(max(seconds, 0.0), MAX_WAIT), setpoint)
