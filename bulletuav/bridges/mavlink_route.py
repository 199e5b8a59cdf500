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
    LOITER_COMMANDS,
    LOITER_TIME,
    LOITER_TO_ALTITUDE,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    POSITION_COMMANDS,
    RETURN,
    TAKEOFF,
    VTOL_LAND,
    VTOL_TAKEOFF,
    VTOL_TRANSITION,
    WAYPOINT,
    compute_item_position,
    read_item_radius,
)
from bulletuav.bridges.mavlink_protocol import Mode
from bulletuav.bridges.mavlink_wings import (
    ON_WINGS,
    ClimbOut,
    Launch,
    Loiter,
    WingFlight,
    WingLeg,
    plan_landing,
)
from bulletuav.bridges.motions import (
    PATH_ACCELERATION,
    FollowPath,
    Heading,
    HoldSetpoint,
    MotionPrimitive,
)
from bulletuav.bridges.setpoints import Setpoint, State, euler
from bulletuav.compiled.functions import atan2

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


TAKEOFFS = (TAKEOFF, VTOL_TAKEOFF)


class Route:
    """Items of a mission, and its progress.

    Attributes:
        items: Items of the mission.
        current: Index of the current item.
        reached: Indices of reached items that have not been reported to clients.
        speed: Speed of the legs, m/s.
    """

    def __init__(
        self, site: Site, values: Mapping[str, float], wings: WingFlight | None = None
    ) -> None:
        """Initialise without items.

        Args:
            site: Start position of the vehicle.
            values: Values of the parameters.
            wings: Flight on wings; None for a multirotor.
        """
        self._site, self._values, self._wings = site, values, wings
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
        """Speed of the legs, m/s: on wings an airspeed."""
        if self._forward is not None:
            return self._forward.speed
        return self._values["MPC_XY_CRUISE"] if self._speed is None else self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if self._forward is not None:
            self._forward.chosen_speed = speed
        else:
            self._speed = speed

    @property
    def _forward(self) -> WingFlight | None:
        """Flight on wings if the vehicle flies so, else None."""
        return self._wings if self._wings is not None and self._wings.is_forward else None

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
        elif item.command == VTOL_TRANSITION:
            yield from self._transition(item.params[0] == ON_WINGS)
        elif item.command == JUMP:
            return  # `_find_next_item` selects the item
        elif item.command == RETURN:
            self.reached.append(self.current)
            self.set_current_item(len(self.items))
            yield Mode.RETURN
        elif item.command in POSITION_COMMANDS:
            move = self._position_item_motions if self._forward is None else self._wing_item_motions
            yield from move(item)

    def _position_item_motions(self, item: MissionItem) -> Iterator[MotionPrimitive | Mode]:
        """Yield the motions of an item with a position."""
        current_position = self._state[0]
        goal = compute_item_position(item, self._site, current_position)
        is_far = math.dist(current_position[:2], goal[:2]) > SAME_POSITION_DISTANCE
        if item.command in TAKEOFFS or (self._has_landed and is_far):
            # Climb before a leg that starts on the ground
            takeoff_height = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
            height = (
                goal[2]
                if item.command in TAKEOFFS
                else max(goal[2], takeoff_height, current_position[2])
            )
            yield self._plan_leg((current_position[0], current_position[1], height), Heading())
        if item.command == VTOL_TAKEOFF:
            yield from self._transition(True)
            return
        if item.command in (LAND, VTOL_LAND):
            if is_far:
                yield self._plan_leg((goal[0], goal[1], self._state[0][2]), Heading(forward=True))
            yield Mode.LAND
            return
        if item.command not in TAKEOFFS or is_far:
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

    def _transition(self, is_forward: bool) -> Iterator[MotionPrimitive]:
        """Yield the transition of a VTOL to its wings, or to its rotors."""
        wings = self._wings
        if wings is None or wings.is_forward == is_forward or self._has_landed:
            return
        yield wings.start_transition(is_forward, self._state, self._now)

    def _wing_item_motions(self, item: MissionItem) -> Iterator[MotionPrimitive | Mode]:
        """Yield the motions of an item with a position, on wings."""
        wings = self._forward
        assert wings is not None
        goal = compute_item_position(item, self._site, self._state[0])
        has_launched = self._has_landed
        if self._has_landed:
            yield Launch(wings, self._state, self._now)
        if has_launched or item.command == TAKEOFF:
            lowest = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
            height = goal[2] if item.command == TAKEOFF else lowest
            yield ClimbOut(wings, self._state, self._now, height)
        if item.command in (LAND, VTOL_LAND):
            yield from self._wing_landing(wings, item, goal)
            return
        if item.command == WAYPOINT:
            radius = item.params[1] if item.params[1] > 0 else wings.values["NAV_ACC_RAD"]
            yield WingLeg(wings, self._state, goal, radius)
            # As in PX4: a waypoint needs its height, too
            if abs(self._state[0][2] - goal[2]) > wings.values["NAV_FW_ALT_RAD"]:
                yield Loiter(wings, goal, ends_at_height=True)
            if item.params[0] > 0:
                yield Loiter(wings, goal, seconds=item.params[0])
        elif item.command in LOITER_COMMANDS:
            yield Loiter(
                wings,
                goal,
                read_item_radius(item),
                seconds=item.params[0] if item.command == LOITER_TIME else math.inf,
                turns=item.params[0] if item.command == LOITER_TURNS else math.inf,
                ends_at_height=item.command == LOITER_TO_ALTITUDE,
            )

    def _wing_landing(
        self, wings: WingFlight, item: MissionItem, goal: tuple[float, float, float]
    ) -> Iterator[MotionPrimitive | Mode]:
        """Yield the landing on wings; a VTOL lands on its rotors."""
        x, y = goal[0] - self._state[0][0], goal[1] - self._state[0][1]
        if wings.can_hover:
            above = (goal[0], goal[1], self._state[0][2])
            yield WingLeg(wings, self._state, above, wings.brake_distance)
            yield from self._transition(False)
            yield self._plan_leg(above, Heading(forward=True))
            yield Mode.LAND
            return
        # The approach comes from the item before, if there is room
        far = math.hypot(x, y) > 2 * wings.radius
        course = float(atan2(y, x)) if far else wings.landing_course(self._state)
        yield from plan_landing(wings, lambda: self._state, goal, course)

    def _wait(self, seconds: float) -> MotionPrimitive:
        """Return a motion that holds the position, or loiters, for a time, s."""
        (x, y, z), quaternion, _, _ = self._state
        if self._forward is not None:
            return Loiter(self._forward, (x, y, z), seconds=seconds)
        setpoint = Setpoint("position", (x, y), "position", z, "angle", euler(quaternion)[2])
        return HoldSetpoint(self._now, min(max(seconds, 0.0), MAX_WAIT), setpoint)
