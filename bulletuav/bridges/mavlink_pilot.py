"""Arming, flight modes and motions of a MAVLink vehicle."""

import math
from collections.abc import Callable, Iterator

from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_failures import Failures
from bulletuav.bridges.mavlink_fence import Geofence, MissionItem
from bulletuav.bridges.mavlink_items import (
    SUPPORTED_COMMANDS,
    VTOL_COMMANDS,
    WING_COMMANDS,
    check_mission,
)
from bulletuav.bridges.mavlink_motions import (
    Descend,
    FollowMovingTarget,
    ManualFlight,
    Orbit,
    OrbitPlan,
    Sticks,
    Target,
)
from bulletuav.bridges.mavlink_parameters import MavlinkParameterService
from bulletuav.bridges.mavlink_protocol import CommandResult, Mode, RefusedError
from bulletuav.bridges.mavlink_route import Route
from bulletuav.bridges.mavlink_wings import (
    NO_VTOL,
    ON_ROTORS,
    ON_WINGS,
    TO_ROTORS,
    TO_WINGS,
    Brake,
    ClimbOut,
    Launch,
    Loiter,
    ManualWings,
    SpiralDescent,
    Transition,
    WingFlight,
    WingLeg,
    plan_landing,
)
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

CONTACT_DEBOUNCE_TIME = 0.1
"""Time with or without ground contact until the vehicle counts as landed or flying, s"""
MAX_LANDED_SPEED = 5.0
"""Horizontal speed above which wings have not landed, m/s: default of LNDFW_VEL_XY_MAX of PX4"""
TUMBLE_TIMEOUT = 1.0
"""Time upside down after which the vehicle is disarmed, s"""
WARN, HOLD, RETURN, LAND = 1, 2, 3, 5
"""Values of GF_ACTION, the reaction to a breach of the geofence"""
BATTERY_LAND, BATTERY_RETURN = 2, 3
"""Values of COM_LOW_BAT_ACT, the reaction to an empty battery; 0 warns"""
MANUAL_MODES = (Mode.ALTITUDE, Mode.POSITION)
NO_POSITION_MODES = (Mode.ALTITUDE, Mode.LAND)
"""Modes that do not need a position"""


class Pilot:
    """State machine of one vehicle: arming, flight modes, and the motion of each mode.

    Attributes:
        mode: Flight mode.
        is_armed: Whether the motors may turn.
        has_landed: Whether the vehicle stands on something.
        state: State of the body.
        now: Time, s.
        route: Progress of the mission.
        rally_points: (3,) positions at which a return may end besides home, m.
        failures: Injected failures.
        target: Last position of the target of mode FOLLOW.
        sticks: Last input of the manual modes.
        status_texts: Texts to send to all clients.
    """

    def __init__(
        self,
        airframe: Airframe,
        site: Site,
        parameters: MavlinkParameterService,
        fence: Geofence,
        failures: Failures,
        wings: WingFlight | None = None,
    ) -> None:
        """Initialise on the ground, disarmed.

        Args:
            airframe: Airframe of the body.
            site: Start position.
            parameters: Parameters.
            fence: Geofence.
            failures: Injected failures.
            wings: Flight on wings; None for a multirotor.
        """
        self._wings = wings
        self._airframe, self._site, self._fence = airframe, site, fence
        self._values = parameters.values
        self._guide = SetpointController(airframe)
        self.mode, self.is_armed, self.has_landed = Mode.HOLD, False, True
        self.state: State = (list(site.start), [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
        self.now = 0.0
        self.route = Route(site, self._values, wings)
        self.rally_points: list[tuple[float, float, float]] = []
        self.failures = failures
        self.target: Target | None = None
        self.sticks = Sticks()
        self.status_texts: list[str] = []
        self._motion: MotionPrimitive = MotorsOff()
        self._next_motion: Callable[[], MotionPrimitive | None] = lambda: None
        self._takeoff_goal: tuple[float, float, float] | None = None
        self._offboard_setpoint: Setpoint | AirspaceCommand | None = None
        self._last_setpoint_time = -math.inf
        self._yaw: float | None = None
        self._contact_change_time = self._last_upright_time = 0.0
        self._is_touching, self._has_flown, self._is_inside = True, False, True

    def update_state(self, state: State, now: float, is_touching: bool) -> None:
        """Set the measured state, and update landing, tumble, geofence, motion and auto-disarm.

        Args:
            state: State of the body.
            now: Time, s.
            is_touching: Whether the body touches something that supports it.
        """
        self.state, self.now = state, now
        self._update_contact(is_touching)
        x, y, _, _ = state[1]
        if 1 - 2 * (x * x + y * y) > 0:
            self._last_upright_time = now
        elif self.is_armed and self.has_tumbled:
            self._disarm("upside down: disarmed")
        if self.is_armed:
            self._check_fence()
            self._advance_motion()
            self._check_auto_disarm()

    def _update_contact(self, is_touching: bool) -> None:
        """Update `has_landed`, with debounced ground contact."""
        if is_touching == self.has_landed:
            self._is_touching = is_touching
        elif is_touching != self._is_touching or (is_touching and self._is_rolling):
            self._is_touching, self._contact_change_time = is_touching, self.now
        elif self.now - self._contact_change_time >= CONTACT_DEBOUNCE_TIME - 1e-9:
            self.has_landed, self._contact_change_time = is_touching, self.now
            self._has_flown = self._has_flown or not is_touching

    @property
    def _is_rolling(self) -> bool:
        """True if an aircraft with wings is too fast to have landed."""
        vx, vy, _ = self.state[2]
        return self.is_forward and math.hypot(vx, vy) > MAX_LANDED_SPEED

    @property
    def has_tumbled(self) -> bool:
        """True if the vehicle has been upside down for longer than `TUMBLE_TIMEOUT`."""
        return self.now - self._last_upright_time > TUMBLE_TIMEOUT

    def _check_fence(self) -> None:
        """React to a breach of the geofence as GF_ACTION requires, once per breach."""
        if not self.failures.has_gps:
            return
        reason = self._fence.find_breach(self.state[0])
        was_inside, self._is_inside = self._is_inside, reason is None
        action = self._values["GF_ACTION"]
        if reason is None or not was_inside or action < WARN:
            return
        self.status_texts.append(f"vehicle is {reason}")
        modes = {HOLD: Mode.HOLD, RETURN: Mode.RETURN, LAND: Mode.LAND}
        if action in modes and self.mode != Mode.LAND:
            self.enter_mode(modes[int(action)])

    def _advance_motion(self) -> None:
        """Start the next motion if the present one has ended; hold without setpoints or sticks."""
        if self.mode == Mode.OFFBOARD:
            if not self.has_recent_setpoint:
                self._hold_or_land("no offboard setpoints")
            return
        if self.mode in MANUAL_MODES and not self.has_recent_sticks:
            self._hold_or_land("no manual control")
            return
        if isinstance(self._motion, MotorsOff | HoldPosition):
            return
        if self._motion.check_outcome(self.state, self.now, self._is_touching) is None:
            return
        previous = self._motion
        following = self._next_motion()
        self._motion = following or previous.get_next_motion(self.state)
        holds = isinstance(self._motion, HoldPosition | Loiter)
        if self.mode in (Mode.TAKEOFF, Mode.MISSION) and following is None and holds:
            self.mode = Mode.HOLD

    def _hold_or_land(self, reason: str) -> None:
        """Hold, or land without a position, and send the reason to the clients."""
        mode = Mode.HOLD if self.failures.has_gps else Mode.LAND
        self.status_texts.append(f"{reason}: {mode.name.lower()}")
        self.enter_mode(mode)

    def inject_failure(self, unit: int, kind: int, instance: int) -> None:
        """Inject or clear a failure, and react to it; see `Failures.inject`.

        Without a position the vehicle lands; with an empty battery it does what COM_LOW_BAT_ACT
        requires.

        Raises:
            RefusedError: If the failure is not supported.
        """
        before = (self.failures.has_gps, self.failures.is_battery_empty)
        self.failures.inject(unit, kind, instance)
        has_gps, is_empty = self.failures.has_gps, self.failures.is_battery_empty
        if (has_gps, is_empty) == before or not self.is_armed:
            return
        if not has_gps and self.mode not in NO_POSITION_MODES:
            self._hold_or_land("GPS failed")
        elif is_empty:
            self.status_texts.append("battery is empty")
            actions = {BATTERY_LAND: Mode.LAND, BATTERY_RETURN: Mode.RETURN}
            mode = actions.get(int(self._values["COM_LOW_BAT_ACT"]))
            if mode is not None and has_gps and self.mode != Mode.LAND:
                self.enter_mode(mode)

    def _check_auto_disarm(self) -> None:
        """Disarm after a landing, or without a take-off, after the time that parameters set."""
        wait = self._values["COM_DISARM_LAND" if self._has_flown else "COM_DISARM_PRFLT"]
        if self.has_landed and 0 < wait < self.now - self._contact_change_time:
            self._disarm("disarmed after landing" if self._has_flown else "disarmed: no take-off")

    @property
    def has_recent_setpoint(self) -> bool:
        """True if an offboard setpoint has arrived within COM_OF_LOSS_T."""
        return self.now - self._last_setpoint_time <= self._values["COM_OF_LOSS_T"]

    def set_offboard_setpoint(self, setpoint: Setpoint | AirspaceCommand) -> None:
        """Set the offboard setpoint, which is followed in mode OFFBOARD.

        Raises:
            RefusedError: If the setpoint is a position that breaches the geofence.
        """
        if isinstance(setpoint, Setpoint) and setpoint.xy_mode == "position":
            self._fence.require_inside("setpoint is", (*setpoint.xy, setpoint.z))
        self._offboard_setpoint, self._last_setpoint_time = setpoint, self.now

    def order(self, period: float) -> AirspaceCommand | None:
        """Return the flight command of the next step, or None for motors off."""
        setpoint: Setpoint | AirspaceCommand | None = None
        if self.is_armed and self.mode == Mode.OFFBOARD:
            setpoint = self._offboard_setpoint
            if self._wings is not None and self.is_forward and isinstance(setpoint, Setpoint):
                setpoint = self._wings.follow(setpoint, self.state)
        elif self.is_armed:
            setpoint = self._motion.get_setpoint(self.state, self.now)
            if isinstance(setpoint, Setpoint) and setpoint.yaw_mode == "angle":
                return self._guide.compute_command(
                    self._limit_yaw_rate(setpoint, period), self.state, period
                )
        self._yaw = None
        if isinstance(setpoint, Setpoint):
            return self._guide.compute_command(setpoint, self.state, period)
        self._guide.reset()
        return setpoint

    def get_launch_force(self) -> tuple[float, float, float] | None:
        """Return the force of the launcher, (3,), N, world; None except during a launch."""
        if not isinstance(self._motion, Launch):
            return None
        return self._motion.get_force(self.state)

    @property
    def is_forward(self) -> bool:
        """True if the vehicle flies on wings, or is commanded to."""
        return self._wings is not None and self._wings.is_forward

    @property
    def vtol_state(self) -> int:
        """State of a VTOL (MAV_VTOL_STATE)."""
        if self._wings is None or not self._wings.can_hover:
            return NO_VTOL
        if self.is_forward:
            return TO_WINGS if isinstance(self._motion, Transition) else ON_WINGS
        return TO_ROTORS if isinstance(self._motion, Brake) else ON_ROTORS

    def _limit_yaw_rate(self, setpoint: Setpoint, period: float) -> Setpoint:
        """Limit the yaw rate to MPC_YAWRAUTO_MAX, as a step of the yaw would disturb the flight."""
        max_step = math.radians(self._values["MPC_YAWRAUTO_MAX"]) * period
        yaw = euler(self.state[1])[2] if self._yaw is None else self._yaw
        error = math.remainder(setpoint.yaw - yaw, math.tau)
        self._yaw = math.remainder(yaw + min(max(error, -max_step), max_step), math.tau)
        return setpoint._replace(yaw=self._yaw)

    def arm(self) -> None:
        """Arm, and start the motion of the mode.

        Raises:
            RefusedError: If the vehicle lies upside down, the battery is empty, or the mode cannot
                be entered.
        """
        if self.is_armed:
            return
        if self.has_tumbled:
            reason = "arming denied: upside down; restart the server"
            raise RefusedError(reason, CommandResult.TEMPORARILY_REJECTED)
        if self.failures.is_battery_empty:
            reason = "arming denied: battery is empty"
            raise RefusedError(reason, CommandResult.TEMPORARILY_REJECTED)
        self.is_armed, self._has_flown, self._contact_change_time = (
            True,
            not self.has_landed,
            self.now,
        )
        try:
            self.enter_mode(self.mode)
        except RefusedError:
            self.is_armed = False
            raise

    def disarm(self, force: bool) -> None:
        """Switch the motors off.

        Args:
            force: Whether to disarm in the air.

        Raises:
            RefusedError: If the vehicle flies, unless forced.
        """
        if self.is_armed and not self.has_landed and not force:
            raise RefusedError(
                "disarming denied: vehicle is flying", CommandResult.TEMPORARILY_REJECTED
            )
        self._disarm("")

    def _disarm(self, reason: str) -> None:
        """Switch the motors off, and send the reason to the clients."""
        self.is_armed, self.mode, self._motion = False, Mode.HOLD, MotorsOff()
        if self._wings is not None:
            self._wings.reset()
        self.status_texts += [reason] if reason else []

    def take_off(self, height: float | None) -> None:
        """Climb vertically, or on wings straight ahead, as soon as the vehicle is armed.

        Args:
            height: Height in the airspace, m; None for MIS_TAKEOFF_ALT above home.

        Raises:
            RefusedError: If the goal breaches the geofence.
        """
        x, y, z = self.state[0]
        if height is None:
            height = self._site.start[2] + self._values["MIS_TAKEOFF_ALT"]
        goal = (x, y, max(z, height))
        self._fence.require_inside("take-off is", goal)
        self._takeoff_goal = goal
        self.enter_mode(Mode.TAKEOFF)

    def go_to(self, position: tuple[float, float, float], yaw: float | None) -> None:
        """Fly straight to a position, m, and hold there, facing a yaw (rad) or forward.

        Raises:
            RefusedError: If the position breaches the geofence, or the vehicle does not fly.
        """
        self._fence.require_inside("position is", position)
        self._require_flying()
        self._require_position(Mode.HOLD)
        heading = Heading(forward=True) if yaw is None else Heading("angle", yaw)
        self.mode, self._next_motion = Mode.HOLD, lambda: None
        self._motion = self._leg(position, self.route.speed, heading)

    def _require_flying(self) -> None:
        """Raise RefusedError if the vehicle does not fly."""
        if not self.is_armed or self.has_landed:
            raise RefusedError(
                "not flying: arm and take off first", CommandResult.TEMPORARILY_REJECTED
            )

    def circle(self, center: tuple[float, float, float], radius: float, speed: float = 0.0) -> None:
        """Fly on wings to a circle, and around it until the mode changes.

        Args:
            center: (3,) centre, m.
            radius: Radius, m; negative for an anticlockwise circle; 0 or NaN for NAV_LOITER_RAD.
            speed: Airspeed, m/s; 0 or less or NaN for the present one.

        Raises:
            RefusedError: If the centre breaches the geofence, the circle is too small, or the
                vehicle does not fly.
        """
        assert self._wings is not None
        self._fence.require_inside("position is", center)
        self._require_flying()
        self._require_position(Mode.HOLD)
        least = self._wings.min_radius
        if 0 < abs(radius) < least:
            raise RefusedError(f"radius below {least:.0f} m at this airspeed")
        if speed > 0:
            self._wings.chosen_speed = speed
        self.mode, self._next_motion = Mode.HOLD, lambda: None
        self._motion = Loiter(self._wings, center, radius)

    def change_height(self, height: float) -> None:
        """Hold at another height in the airspace, m; a loiter keeps its circle.

        Raises:
            RefusedError: If the position breaches the geofence, or the vehicle does not fly.
        """
        x, y, _ = self.state[0]
        if not self.is_forward:
            self.go_to((x, y, height), euler(self.state[1])[2])
        elif isinstance(self._motion, Loiter):
            center = self._motion.center
            self.circle((center[0], center[1], height), self._motion.radius)
        else:
            self.circle((x, y, height), 0.0)

    def transition(self, is_forward: bool) -> None:
        """Make a VTOL fly on its wings, or on its rotors, and continue its mode.

        Raises:
            RefusedError: If the vehicle is no VTOL, or does not fly.
        """
        if self._wings is None or not self._wings.can_hover:
            raise RefusedError("no VTOL", CommandResult.UNSUPPORTED)
        self._require_flying()
        if self._wings.is_forward == is_forward:
            return
        mode = self.mode
        if mode in (Mode.TAKEOFF, Mode.ORBIT):
            mode = self.mode = Mode.HOLD
        self.route.set_current_item(self.route.current)
        self._motion = self._wings.start_transition(is_forward, self.state, self.now)
        self._next_motion = lambda: self._start_motion(mode)

    def orbit(self, plan: OrbitPlan) -> None:
        """Fly to the nearest point of a circle, and along the circle until the mode changes.

        Raises:
            RefusedError: If the circle breaches the geofence, or the vehicle does not fly.
        """
        for point in plan.points():
            self._fence.require_inside("circle is", point)
        self.go_to(plan.entry(self.state[0]), None)
        self.mode = Mode.ORBIT
        self._next_motion = lambda: Orbit(plan, self.state, self.now)

    def set_mission(self, items: tuple[MissionItem, ...]) -> None:
        """Replace the mission; a vehicle in mode MISSION holds."""
        self.route.replace(items)
        if self.mode == Mode.MISSION:
            self.enter_mode(Mode.HOLD)

    def set_current_item(self, number: int) -> None:
        """Continue the mission at another item.

        Raises:
            RefusedError: If there is no such item.
        """
        if not 0 <= number < len(self.route.items):
            raise RefusedError(f"item {number}: there are {len(self.route.items)}")
        self.route.set_current_item(number)
        if self.mode == Mode.MISSION:
            self.enter_mode(Mode.MISSION)

    def enter_mode(self, mode: Mode) -> None:
        """Change the flight mode; if disarmed, the motion starts with arming.

        Raises:
            RefusedError: If the mode cannot be entered.
        """
        if mode == Mode.OFFBOARD and not self.has_recent_setpoint:
            reason = "offboard denied: send setpoints first"
            raise RefusedError(reason, CommandResult.TEMPORARILY_REJECTED)
        if mode in MANUAL_MODES and not self.has_recent_sticks:
            reason = "manual control denied: send sticks first"
            raise RefusedError(reason, CommandResult.TEMPORARILY_REJECTED)
        if mode in MANUAL_MODES and self.is_forward and self.has_landed:
            reason = "manual control denied: take off first"
            raise RefusedError(reason, CommandResult.TEMPORARILY_REJECTED)
        if mode == Mode.FOLLOW and self.is_forward:
            raise RefusedError("follow denied: on wings")
        if mode == Mode.ORBIT and not isinstance(self._motion, Orbit):
            raise RefusedError("orbit denied: use the command 34")
        self._require_position(mode)
        if mode == Mode.MISSION:
            self._check_mission()
        if mode == Mode.TAKEOFF and self._takeoff_goal is None:
            self.take_off(None)
            return
        self.mode = mode
        if self.is_armed:
            self._next_motion = lambda: None
            self._motion = self._start_motion(mode)

    @property
    def has_recent_sticks(self) -> bool:
        """True if sticks have arrived within COM_RC_LOSS_T."""
        return self.now - self.sticks.time <= self._values["COM_RC_LOSS_T"]

    def _require_position(self, mode: Mode) -> None:
        """Raise RefusedError if a mode needs a position, and the GPS receiver has failed."""
        if not self.failures.has_gps and mode not in NO_POSITION_MODES:
            raise RefusedError(
                f"{mode.name.lower()} denied: GPS failed", CommandResult.TEMPORARILY_REJECTED
            )

    def check_mission(self, items: tuple[MissionItem, ...]) -> None:
        """Validate the items of a mission.

        Raises:
            MissionError: If an item is not supported, or breaches the geofence.
        """
        commands: tuple[int, ...] = SUPPORTED_COMMANDS
        least = 0.0
        if self._wings is not None:
            commands = VTOL_COMMANDS if self._wings.can_hover else WING_COMMANDS
            least = self._wings.min_radius
        max_distance = self._values["MIS_DIST_1WP"]
        check_mission(items, self._site, self._fence, max_distance, commands, least)

    def _check_mission(self) -> None:
        """Validate the mission again before its start, as the geofence may have changed."""
        if not self.route.items:
            raise RefusedError("no mission: upload one first", CommandResult.TEMPORARILY_REJECTED)
        self.check_mission(self.route.items)

    def _start_motion(self, mode: Mode) -> MotionPrimitive:
        """Return the first motion of a mode."""
        if mode == Mode.TAKEOFF:
            goal, self._takeoff_goal = self._takeoff_goal, None
            assert goal is not None  # set by `enter_mode`
            if self._wings is not None and self.is_forward:
                return self._follow(self._launch(self._wings, goal[2]))
            return self._leg(goal, self._values["MPC_TKO_SPEED"], Heading())
        # A finished mission starts again
        if mode == Mode.MISSION:
            self.route.set_current_item(0 if self.route.is_over else self.route.current)
            self._next_motion = self._next_mission_motion
            return self._next_mission_motion() or self._hold()
        if mode in MANUAL_MODES and self._wings is not None and self.is_forward:
            return ManualWings(self._wings, lambda: self.sticks)
        if mode in MANUAL_MODES:
            return ManualFlight(
                lambda: self.sticks,
                lambda: self.has_landed,
                self._values,
                mode == Mode.POSITION,
            )
        # On the ground all other modes keep the motors off
        if self.has_landed:
            return MotorsOff()
        if mode == Mode.LAND:
            return self._land()
        if mode == Mode.RETURN:
            return self._return()
        if mode == Mode.ORBIT:
            return self._motion
        if mode == Mode.FOLLOW:
            hold = HoldPosition(self.state, self.now).get_setpoint(self.state, self.now)
            ground = self._site.start[2]
            return FollowMovingTarget(
                lambda: self.target, ground, self._values, hold, self.status_texts.append
            )
        return self._hold()

    def _hold(self) -> MotionPrimitive:
        """Return the motion that holds the position, or loiters around it on wings."""
        if self._wings is not None and self.is_forward:
            return Loiter(self._wings, self.state[0])
        return HoldPosition(self.state, self.now)

    def _follow(self, motions: Iterator[MotionPrimitive]) -> MotionPrimitive:
        """Return the first of some motions; the others follow."""
        self._next_motion = lambda: next(motions, None)
        return next(motions)

    def _launch(self, wings: WingFlight, height: float) -> Iterator[MotionPrimitive]:
        """Yield the motions of a take-off on wings to a height, m."""
        if self.has_landed:
            yield Launch(wings, self.state, self.now)
        yield ClimbOut(wings, self.state, self.now, height)

    def _next_mission_motion(self) -> MotionPrimitive | None:
        """Return the next motion of the mission, or None at its end."""
        motion = self.route.next_motion(self.state, self.now, self.has_landed)
        if motion == Mode.RETURN:
            self.mode = Mode.RETURN
            return MotorsOff() if self.has_landed else self._return()
        if motion == Mode.LAND:
            return self._land()
        assert motion is None or isinstance(motion, MotionPrimitive)
        return motion

    def _land(self) -> MotionPrimitive:
        """Return the motion that descends until ground contact."""
        if self._wings is not None and self.is_forward:
            return self._follow(self._wing_landing(self._wings))
        if not self.failures.has_gps:
            return Descend(self.state, self.now, math.inf, self._values["MPC_LAND_SPEED"])
        return Land(self.state, self.now, math.inf, self._values["MPC_LAND_SPEED"])

    def _wing_landing(
        self, wings: WingFlight, goal: tuple[float, float, float] | None = None
    ) -> Iterator[MotionPrimitive]:
        """Yield the motions of a landing on wings; a VTOL lands on its rotors.

        Args:
            wings: Flight on wings.
            goal: (3,) position from which a VTOL descends, and below which wings land, m; None to
                land at the present position.
        """
        x, y, _ = self.state[0] if goal is None else goal
        if wings.can_hover:
            yield wings.start_transition(False, self.state, self.now)
            if goal is not None:
                yield self._leg(goal, self._values["MPC_XY_CRUISE"], Heading(forward=True))
            yield self._land()
        elif not self.failures.has_gps:
            yield SpiralDescent(wings, self.now)
        else:
            point, course = (x, y, self._site.start[2]), wings.landing_course(self.state)
            yield from plan_landing(wings, lambda: self.state, point, course)

    def _wing_return(
        self, wings: WingFlight, x: float, y: float, high: float, low: float
    ) -> Iterator[MotionPrimitive]:
        """Yield the motions of a return on wings: climb, fly to the goal, descend, and land.

        As in PX4, an aircraft that cannot hover circles the goal without end if RTL_LAND_DELAY is
        below 0.

        Args:
            wings: Flight on wings.
            x: East coordinate of the goal, m.
            y: North coordinate of the goal, m.
            high: Height of the flight to the goal, m.
            low: Height to which the vehicle descends above the goal, m.
        """
        px, py, _ = self.state[0]
        yield Loiter(wings, (px, py, high), ends_at_height=True)
        near = wings.brake_distance if wings.can_hover else wings.radius
        yield WingLeg(wings, self.state, (x, y, high), near)
        yield Loiter(wings, (x, y, low), ends_at_height=True)
        if not wings.can_hover:
            delay = self._values["RTL_LAND_DELAY"]
            yield Loiter(wings, (x, y, low), seconds=delay if delay >= 0 else math.inf)
        yield from self._wing_landing(wings, (x, y, low))

    def _return(self) -> MotionPrimitive:
        """Return the first leg of a return: climb, fly above the goal, descend, and land.

        The goal is the nearest of home and the rally points.
        """
        x, y, z = self.state[0]
        home, values = self._site.start, self._values
        goals = [(home[0], home[1]), *((px, py) for px, py, _ in self.rally_points)]
        goal_x, goal_y = min(goals, key=lambda goal: math.dist(goal, (x, y)))
        # PX4's heights are above home; the vehicle never descends before it is above its goal
        return_height = max(z, home[2] + values["RTL_RETURN_ALT"])
        descent_height = min(return_height, home[2] + values["RTL_DESCEND_ALT"])
        if self._wings is not None and self.is_forward:
            legs = self._wing_return(self._wings, goal_x, goal_y, return_height, descent_height)
            return self._follow(legs)
        waypoints = iter([(goal_x, goal_y, return_height), (goal_x, goal_y, descent_height)])

        def next_leg() -> MotionPrimitive | None:
            goal = next(waypoints, None)
            if goal is None:
                self._next_motion = lambda: None
                return self._land()
            return self._leg(goal, values["MPC_XY_CRUISE"], Heading(forward=True))

        # First climb at the present position; further legs follow by `next_leg`
        self._next_motion = next_leg
        return self._leg((x, y, return_height), values["MPC_XY_CRUISE"], Heading())

    def _leg(self, goal: tuple[float, float, float], speed: float, heading: Heading) -> FollowPath:
        return self.route.plan_leg(self.state, goal, speed, heading, self.now)
