"""A mission on its way: which item is next, and the motion for it."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from bulletuav.bridges.mavlink_fence import Item
from bulletuav.bridges.mavlink_items import (
    CHANGE_SPEED,
    DELAY,
    LAND,
    LOITER_TIME,
    LOITER_UNLIMITED,
    RETURN,
    TAKEOFF,
    WAYPOINT,
    place_of,
)
from bulletuav.bridges.mavlink_places import Site
from bulletuav.bridges.mavlink_wire import Mode
from bulletuav.bridges.motions import (
    PATH_ACCELERATION,
    FollowPath,
    Heading,
    HoldSetpoint,
    MotionPrimitive,
)
from bulletuav.bridges.setpoints import Setpoint, State, euler

LONGEST = 1e5
"""Longest time to wait at an item, s"""
SLOWEST, FASTEST = 0.1, 100.0
"""Speeds that an item may ask for, m/s"""
NEAR = 0.5
"""Distance across below which a place is where the vehicle is, m"""
NEAREST = 0.1
"""Distance from a place at which it has arrived, unless an item allows more, m"""
PATIENCE = 5.0
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

    def replace(self, items: tuple[Item, ...]) -> None:
        """Take another mission."""
        self.items, self.reached = items, list[int]()
        self._speed: float | None = None
        self.jump(0)

    def jump(self, number: int) -> None:
        """Go on with an item, from its beginning."""
        self.current = number
        self._steps: Iterator[MotionPrimitive | Mode] | None = None

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

    def leg(
        self,
        state: State,
        goal: tuple[float, float, float],
        speed: float,
        heading: Heading,
        now: float,
        near: float = NEAREST,
    ) -> FollowPath:
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
        way = math.dist(goal, state[0])
        most = self._values["MPC_Z_VEL_MAX_UP" if rise > 0 else "MPC_Z_VEL_MAX_DN"]
        if speed * abs(rise) > most * way:
            speed = most * way / abs(rise)
        # A wind may keep it from arriving: it goes on all the same, a while later.
        limit = way / speed + speed / PATH_ACCELERATION + PATIENCE
        return FollowPath(state, [np.array(goal)], speed, heading, (now, limit), near)

    def motion(
        self,
        state: State,
        now: float,
        has_landed: bool,
    ) -> MotionPrimitive | Mode | None:
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
            if self._steps is None:
                self._steps = self._of_item(self.items[self.current])
            found = next(self._steps, None)
            if found is not None:
                return found
            self.reached.append(self.current)
            self.jump(self.current + 1)
        return None

    def _of_item(self, item: Item) -> Iterator[MotionPrimitive | Mode]:
        """Give what is to be done for an item, one after the other, from where the drone is."""
        if item.command == CHANGE_SPEED:
            if item.numbers[1] > 0:
                self.speed = min(max(item.numbers[1], SLOWEST), FASTEST)
        elif item.command == DELAY:
            yield self._wait(item.numbers[0])
        elif item.command == RETURN:
            self.reached.append(self.current)
            self.jump(len(self.items))
            yield Mode.RETURN
        else:
            yield from self._at_place(item)

    def _at_place(self, item: Item) -> Iterator[MotionPrimitive | Mode]:
        """Fly to an item's place, and do there what it says."""
        here = self._state[0]
        goal = place_of(item, self._site, here)
        is_far = math.dist(here[:2], goal[:2]) > NEAR
        if item.command == TAKEOFF or (self._has_landed and is_far):
            # Nobody flies along the ground: it rises first.
            lift = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
            height = goal[2] if item.command == TAKEOFF else max(goal[2], lift, here[2])
            yield self._leg((here[0], here[1], height), Heading())
        if item.command == LAND:
            if is_far:
                yield self._leg((goal[0], goal[1], self._state[0][2]), Heading(forward=True))
            yield Mode.LAND
            return
        if item.command != TAKEOFF or is_far:
            yaw = item.numbers[3]
            turn = math.remainder(math.pi / 2 - math.radians(yaw), math.tau)
            heading = Heading("angle", turn) if math.isfinite(yaw) else Heading(forward=True)
            near = item.numbers[1] if item.numbers[1] > NEAREST else NEAREST
            yield self._leg(goal, heading, near)
        if item.command in (WAYPOINT, LOITER_TIME) and item.numbers[0] > 0:
            yield self._wait(item.numbers[0])
        while item.command == LOITER_UNLIMITED:
            yield self._wait(LONGEST)

    def _leg(
        self,
        goal: tuple[float, float, float],
        heading: Heading,
        near: float = NEAREST,
    ) -> FollowPath:
        """Fly straight to a place, at the mission's speed."""
        return self.leg(self._state, goal, self.speed, heading, self._now, near)

    def _wait(self, seconds: float) -> HoldSetpoint:
        """Stay for a time, s."""
        (x, y, z), turn, _, _ = self._state
        still = Setpoint("position", (x, y), "position", z, "angle", euler(turn)[2])
        return HoldSetpoint(self._now, min(max(seconds, 0.0), LONGEST), still)
