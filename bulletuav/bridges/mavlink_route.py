"""A mission on its way: which item is next, and the motion for it."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_fence import MissionItem
from bulletuav.bridges.mavlink_items import (
    CHANGE_SPEED,
    DELAY,
    LAND,
    LOITER_TIME,
    LOITER_UNLIMITED,
    RETURN,
    TAKEOFF,
    WAYPOINT,
    compute_item_position,
)
from bulletuav.bridges.mavlink_protocol import Mode
from bulletuav.bridges.motions import ACCELERATION, Heading, Hold, Motion, Path
from bulletuav.bridges.setpoints import Setpoint, State, euler

MAX_WAIT = 1e5
"""Longest time to wait at an item, s"""
MIN_SPEED, MAX_SPEED = 0.1, 100.0
"""Speeds that an item may ask for, m/s"""
SAME_POSITION_DISTANCE = 0.5
"""Distance across below which a place is where the vehicle is, m"""
MIN_ACCEPTANCE_RADIUS = 0.1
"""Distance from a place at which it has arrived, unless an item allows more, m"""
LEG_TIMEOUT_MARGIN = 5.0
"""How long after its time a leg may arrive, s"""


class Route:
    """The items of a mission, and how far it is.

    Attributes:
        items: The mission.
        current: Number of the item that is flown to.
        reached: Numbers of items that have been reached, and nobody was told of yet.
        speed: At which it flies, m/s.
    """

    def __init__(self, site: Site, values: Mapping[str, float]) -> None:
        """Begin without items.

        Args:
            site: Where the vehicle's coordinates begin.
            values: Of the parameters.
        """
        self._site, self._values = site, values
        self._state: State = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self._now, self._has_landed = 0.0, True
        self.replace(())

    def replace(self, items: tuple[MissionItem, ...]) -> None:
        """Take another mission."""
        self.items, self.reached = items, list[int]()
        self._speed: float | None = None
        self.set_current_item(0)

    def set_current_item(self, number: int) -> None:
        """Go on with an item, from its beginning."""
        self.current = number
        self._motions: Iterator[Motion | Mode] | None = None

    @property
    def speed(self) -> float:
        """Speed along pieces, m/s."""
        return self._values["MPC_XY_CRUISE"] if self._speed is None else self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = speed

    @property
    def is_over(self) -> bool:
        """Whether the last item is done."""
        return self.current >= len(self.items)

    def plan_leg(
        self,
        state: State,
        goal: tuple[float, float, float],
        speed: float,
        heading: Heading,
        now: float,
        acceptance_radius: float = MIN_ACCEPTANCE_RADIUS,
    ) -> Path:
        """Fly straight to a place, m, as fast as parameters allow.

        Args:
            state: State of the drone.
            goal: Where to go, m.
            speed: m/s.
            heading: Where to look.
            now: Time, s.
            near: Distance from the place at which it has arrived, m.
        """
        rise = goal[2] - state[0][2]
        distance = math.dist(goal, state[0])
        max_climb_rate = self._values["MPC_Z_VEL_MAX_UP" if rise > 0 else "MPC_Z_VEL_MAX_DN"]
        if speed * abs(rise) > max_climb_rate * distance:
            speed = max_climb_rate * distance / abs(rise)
        # A wind may keep it from arriving: it goes on all the same, a while later.
        limit = distance / speed + speed / ACCELERATION + LEG_TIMEOUT_MARGIN
        return Path(state, [np.array(goal)], speed, heading, (now, limit), acceptance_radius)

    def next_motion(self, state: State, now: float, has_landed: bool) -> Motion | Mode | None:
        """Tell what comes next.

        Args:
            state: State of the drone.
            now: Time, s.
            has_landed: Whether it stands.

        Returns:
            A motion; a mode for what is done as in that mode; None when the mission is over.
        """
        self._state, self._now, self._has_landed = state, now, has_landed
        while not self.is_over:
            if self._motions is None:
                self._motions = self._item_motions(self.items[self.current])
            motion = next(self._motions, None)
            if motion is not None:
                return motion
            self.reached.append(self.current)
            self.set_current_item(self.current + 1)
        return None

    def _item_motions(self, item: MissionItem) -> Iterator[Motion | Mode]:
        """Give what is to be done for an item, one after the other, from where the drone is."""
        if item.command == CHANGE_SPEED:
            if item.params[1] > 0:
                self.speed = min(max(item.params[1], MIN_SPEED), MAX_SPEED)
        elif item.command == DELAY:
            yield self._wait(item.params[0])
        elif item.command == RETURN:
            self.reached.append(self.current)
            self.set_current_item(len(self.items))
            yield Mode.RETURN
        else:
            yield from self._position_item_motions(item)

    def _position_item_motions(self, item: MissionItem) -> Iterator[Motion | Mode]:
        """Fly to an item's place, and do there what it says."""
        current_position = self._state[0]
        goal = compute_item_position(item, self._site, current_position)
        is_far = math.dist(current_position[:2], goal[:2]) > SAME_POSITION_DISTANCE
        if item.command == TAKEOFF or (self._has_landed and is_far):
            # Nobody flies along the ground: it rises first.
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
    ) -> Path:
        """Fly straight to a place, at the mission's speed."""
        return self.plan_leg(self._state, goal, self.speed, heading, self._now, acceptance_radius)

    def _wait(self, seconds: float) -> Hold:
        """Stay for a time, s."""
        (x, y, z), quaternion, _, _ = self._state
        setpoint = Setpoint("position", (x, y), "position", z, "angle", euler(quaternion)[2])
        return Hold(self._now, min(max(seconds, 0.0), MAX_WAIT), setpoint)
