"""Who flies a MAVLink vehicle: arming, modes, and the motion of each."""

import math
from collections.abc import Callable

from bulletuav.bridges.mavlink_fence import Fence, Item
from bulletuav.bridges.mavlink_items import check_items
from bulletuav.bridges.mavlink_parameters import ParameterService
from bulletuav.bridges.mavlink_places import Site
from bulletuav.bridges.mavlink_route import Route
from bulletuav.bridges.mavlink_wire import Mode, RefusedError, Result
from bulletuav.bridges.motions import (
    FollowPath,
    Heading,
    HoldPosition,
    Land,
    MotionPrimitive,
    MotorsOff,
)
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, SetpointController, State, euler
from bulletuav.vehicle.airframe import Airframe

STANDS_AFTER = 0.1
"""How long it touches the ground, or does not, until it has landed, or flies, s"""
TUMBLED_AFTER = 1.0
"""How long it is upside down until it is disarmed, s"""
WARN, HOLD, RETURN, LAND = 1, 2, 3, 5
"""What GF_ACTION asks for beyond the fence"""


class Pilot:
    """Arming, modes and motions of one vehicle, without messages.

    Attributes:
        mode: Flight mode.
        is_armed: Whether motors may turn.
        has_landed: Whether it stands on something.
        state: State of the body.
        now: Time, s.
        route: The mission.
        said: Texts that clients are to be shown.
    """

    def __init__(
        self,
        airframe: Airframe,
        site: Site,
        parameters: ParameterService,
        fence: Fence,
    ) -> None:
        """Begin on the ground, disarmed."""
        self._airframe, self._site, self._fence = airframe, site, fence
        self._values = parameters.values
        self._guide = SetpointController(airframe)
        self.mode, self.is_armed, self.has_landed = Mode.HOLD, False, True
        self.state: State = (list(site.start), [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self.now = 0.0
        self.route = Route(site, self._values)
        self.said: list[str] = []
        self._motion: MotionPrimitive = MotorsOff()
        self._next: Callable[[], MotionPrimitive | None] = lambda: None
        self._goal: tuple[float, float, float] | None = None
        self._offboard: Setpoint | AirspaceCommand | None = None
        self._heard = -math.inf
        self._yaw: float | None = None
        self._changed = self._upright = 0.0
        self._touched, self._has_flown, self._is_inside = True, False, True

    def sense(
        self,
        state: State,
        now: float,
        touches: bool,
    ) -> None:
        """Take the body's state over, and look what follows from it.

        Args:
            state: State of the body.
            now: Time, s.
            touches: Whether it touches what it can stand on.
        """
        self.state, self.now = state, now
        self._feel(touches)
        x, y, _, _ = state[1]
        if 1 - 2 * (x * x + y * y) > 0:
            self._upright = now
        elif self.is_armed and self.has_tumbled:
            self._disarm("upside down: disarmed")
        if self.is_armed:
            self._watch_fence()
            self._look()
            self._watch_ground()

    def _feel(self, touches: bool) -> None:
        """Note whether it stands, once it has done so for a while."""
        if touches == self.has_landed:
            self._touched = touches
        elif touches != self._touched:
            self._touched, self._changed = touches, self.now
        elif self.now - self._changed >= STANDS_AFTER - 1e-9:
            self.has_landed, self._changed = touches, self.now
            self._has_flown = self._has_flown or not touches

    @property
    def has_tumbled(self) -> bool:
        """Whether it has been upside down for a while."""
        return self.now - self._upright > TUMBLED_AFTER

    def _watch_fence(self) -> None:
        """Do what GF_ACTION asks for, where the fence has been crossed."""
        reason = self._fence.refusal(self.state[0])
        was_inside, self._is_inside = self._is_inside, reason is None
        action = self._values["GF_ACTION"]
        if reason is None or not was_inside or action < WARN:
            return
        self.said.append(f"vehicle is {reason}")
        modes = {HOLD: Mode.HOLD, RETURN: Mode.RETURN, LAND: Mode.LAND}
        if action in modes and self.mode != Mode.LAND:
            self.enter(modes[int(action)])

    def _look(self) -> None:
        """Look whether the motion has come to its end, and what comes next."""
        if self.mode == Mode.OFFBOARD:
            if not self.hears:
                self.said.append("no offboard setpoints: hold")
                self.enter(Mode.HOLD)
            return
        if isinstance(self._motion, MotorsOff | HoldPosition):
            return
        if self._motion.check_outcome(self.state, self.now, self._touched) is None:
            return
        was = self._motion
        self._motion = self._next() or was.get_next_motion(self.state)
        if self.mode in (Mode.TAKEOFF, Mode.MISSION) and isinstance(self._motion, HoldPosition):
            self.mode = Mode.HOLD

    def _watch_ground(self) -> None:
        """Disarm who has landed, or does not take off."""
        wait = self._values["COM_DISARM_LAND" if self._has_flown else "COM_DISARM_PRFLT"]
        if self.has_landed and 0 < wait < self.now - self._changed:
            self._disarm("disarmed after landing" if self._has_flown else "disarmed: no take-off")

    @property
    def hears(self) -> bool:
        """Whether an offboard setpoint has come lately."""
        return self.now - self._heard <= self._values["COM_OF_LOSS_T"]

    def follow(self, wanted: Setpoint | AirspaceCommand) -> None:
        """Take an offboard setpoint, which is followed in mode OFFBOARD.

        Raises:
            RefusedError: It is a place beyond the fence.
        """
        if isinstance(wanted, Setpoint) and wanted.xy_mode == "position":
            self._fence.check("setpoint is", (*wanted.xy, wanted.z))
        self._offboard, self._heard = wanted, self.now

    def order(self, period: float) -> AirspaceCommand | None:
        """Tell the command of the next step, or None for motors off."""
        wanted: Setpoint | AirspaceCommand | None = None
        if self.is_armed and self.mode == Mode.OFFBOARD:
            wanted = self._offboard
        elif self.is_armed:
            wanted = self._motion.get_setpoint(self.state, self.now)
            if isinstance(wanted, Setpoint) and wanted.yaw_mode == "angle":
                return self._guide.compute_command(self._slowed(wanted, period), self.state, period)
        self._yaw = None
        if isinstance(wanted, Setpoint):
            return self._guide.compute_command(wanted, self.state, period)
        self._guide.reset()
        return wanted

    def _slowed(self, wanted: Setpoint, period: float) -> Setpoint:
        """Turn to the yaw of a motion by and by: at once, it would disturb the flight."""
        most = math.radians(self._values["MPC_YAWRAUTO_MAX"]) * period
        yaw = euler(self.state[1])[2] if self._yaw is None else self._yaw
        away = math.remainder(wanted.yaw - yaw, math.tau)
        self._yaw = math.remainder(yaw + min(max(away, -most), most), math.tau)
        return wanted._replace(yaw=self._yaw)

    def arm(self) -> None:
        """Arm, and do what the mode asks for.

        Raises:
            RefusedError: It lies upside down, or the mode cannot begin.
        """
        if self.is_armed:
            return
        if self.has_tumbled:
            words = "arming refused: upside down; restart the server"
            raise RefusedError(words, Result.TEMPORARILY_REJECTED)
        self.is_armed, self._has_flown, self._changed = True, not self.has_landed, self.now
        try:
            self.enter(self.mode)
        except RefusedError:
            self.is_armed = False
            raise

    def disarm(self, by_force: bool) -> None:
        """Switch motors off.

        Raises:
            RefusedError: It flies, and there was no word of force.
        """
        if self.is_armed and not self.has_landed and not by_force:
            raise RefusedError("disarming refused: it flies", Result.TEMPORARILY_REJECTED)
        self._disarm("")

    def _disarm(self, words: str) -> None:
        """Switch motors off, and tell why."""
        self.is_armed, self.mode, self._motion = False, Mode.HOLD, MotorsOff()
        self.said += [words] if words else []

    def take_off(self, height: float | None) -> None:
        """Rise straight up, as soon as it is armed.

        Args:
            height: m; left out, MIS_TAKEOFF_ALT above home.

        Raises:
            RefusedError: It is beyond the fence.
        """
        x, y, z = self.state[0]
        if height is None:
            height = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
        goal = (x, y, max(z, height))
        self._fence.check("take-off is", goal)
        self._goal = goal
        self.enter(Mode.TAKEOFF)

    def go_to(self, place: tuple[float, float, float], yaw: float | None) -> None:
        """Fly straight to a place, m, and hold there; look to a yaw, rad, or forward.

        Raises:
            RefusedError: It is beyond the fence, or the vehicle does not fly.
        """
        self._fence.check("place is", place)
        if not self.is_armed or self.has_landed:
            raise RefusedError(
                "it does not fly: arm it and take off first", Result.TEMPORARILY_REJECTED
            )
        heading = Heading(forward=True) if yaw is None else Heading("angle", yaw)
        self.mode, self._next = Mode.HOLD, lambda: None
        self._motion = self._leg(place, self.route.speed, heading)

    def take_mission(self, items: tuple[Item, ...]) -> None:
        """Take another mission; who flies the old one holds."""
        self.route.replace(items)
        if self.mode == Mode.MISSION:
            self.enter(Mode.HOLD)

    def jump(self, number: int) -> None:
        """Go on with another item of the mission.

        Raises:
            RefusedError: There is no such item.
        """
        if not 0 <= number < len(self.route.items):
            raise RefusedError(f"item {number}: there are {len(self.route.items)}")
        self.route.jump(number)
        if self.mode == Mode.MISSION:
            self.enter(Mode.MISSION)

    def enter(self, mode: Mode) -> None:
        """Change the mode; who is disarmed begins when it is armed.

        Raises:
            RefusedError: The mode cannot begin.
        """
        if mode == Mode.OFFBOARD and not self.hears:
            words = "offboard refused: send setpoints first"
            raise RefusedError(words, Result.TEMPORARILY_REJECTED)
        if mode == Mode.MISSION:
            self._check_route()
        if mode == Mode.TAKEOFF and self._goal is None:
            self.take_off(None)
            return
        self.mode = mode
        if self.is_armed:
            self._next = lambda: None
            self._motion = self._begin(mode)

    def _check_route(self) -> None:
        """Look whether the mission can begin: the fence may have changed since it came."""
        if not self.route.items:
            raise RefusedError("no mission: upload one first", Result.TEMPORARILY_REJECTED)
        farthest = self._values["MIS_DIST_1WP"]
        check_items(self.route.items, self._site, self._fence, farthest)

    def _begin(self, mode: Mode) -> MotionPrimitive:
        """Begin the motion of a mode."""
        if mode == Mode.TAKEOFF:
            goal, self._goal = self._goal, None
            assert goal is not None  # as `enter` sees to it
            return self._leg(goal, self._values["MPC_TKO_SPEED"], Heading())
        # A mission that is over begins again
        if mode == Mode.MISSION:
            self.route.jump(0 if self.route.is_over else self.route.current)
            self._next = self._go_on
            return self._go_on() or HoldPosition(self.state)
        # On the ground other modes leave the motors off
        if self.has_landed:
            return MotorsOff()
        if mode == Mode.LAND:
            return self._land()
        if mode == Mode.RETURN:
            return self._return()
        return HoldPosition(self.state, self.now)

    def _go_on(self) -> MotionPrimitive | None:
        """Go on with the mission; None when it is over."""
        found = self.route.motion(self.state, self.now, self.has_landed)
        if found == Mode.RETURN:
            self.mode = Mode.RETURN
            return MotorsOff() if self.has_landed else self._return()
        if found == Mode.LAND:
            return self._land()
        assert found is None or isinstance(found, MotionPrimitive)
        return found

    def _land(self) -> MotionPrimitive:
        """Sink until something is touched."""
        return Land(self.state, self.now, math.inf, self._values["MPC_LAND_SPEED"])

    def _return(self) -> MotionPrimitive:
        """Rise, fly to above home, sink, and land."""
        x, y, z = self.state[0]
        home, values = self._site.start, self._values
        # PX4's heights above home; never down before it is there
        high = max(z, home[2] + values["RTL_RETURN_ALT"])
        low = min(high, home[2] + values["RTL_DESCEND_ALT"])
        ways = iter([(home[0], home[1], high), (home[0], home[1], low)])

        def go_on() -> MotionPrimitive | None:
            goal = next(ways, None)
            if goal is None:
                self._next = lambda: None
                return self._land()
            return self._leg(goal, values["MPC_XY_CRUISE"], Heading(forward=True))

        # Rise where it is, then one leg after the other
        self._next = go_on
        return self._leg((x, y, high), values["MPC_XY_CRUISE"], Heading())

    def _leg(
        self,
        goal: tuple[float, float, float],
        speed: float,
        heading: Heading,
    ) -> FollowPath:
        """Fly straight to a place."""
        return self.route.leg(self.state, goal, speed, heading, self.now)
