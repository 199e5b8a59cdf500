"""Motions of MAVLink vehicles on wings: legs, loiters, launch, approach and VTOL transitions.

Names and defaults are those of PX4's fixed-wing modes (https://docs.px4.io/main/en/flight_modes_fw/).
Courses follow the vector fields of D. Nelson, D. Barber, T. McLain and R. Beard, Vector field path
following for miniature air vehicles, IEEE T-RO 2007: towards a path at a distance e from it, the
course differs from that of the path by atan(e / w). All motions command velocities, which
`bulletuav.control.fixed_wing` tracks.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from bulletuav.bridges.mavlink_motions import Sticks
from bulletuav.bridges.motions import (
    PATH_ACCELERATION,
    HoldPosition,
    MotionPrimitive,
    MotorsOff,
)
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, State, euler
from bulletuav.compiled.functions import atan2, cos, sin, tan
from bulletuav.control.fixed_wing import HEIGHT_RATE, SPEED_RATE
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

MIN_GROUND_SPEED = 5.0
"""Minimum ground speed, m/s: default of FW_GND_SPD_MIN of PX4"""
FIELD_WIDTH = 5.0
"""Width w of a vector field, in distances that the vehicle covers in 1 / (rate of its course
errors): a damping ratio of sqrt(FIELD_WIDTH) / 2"""
MAX_LEAD = 0.9
"""Maximum sine of the angle by which a course leads that of a circle"""
BANK_MARGIN = 0.8
"""Lateral acceleration on the smallest circle, relative to that at the maximum bank"""
ON_CIRCLE = 0.2
"""Distance from a circle at which a vehicle is on it, relative to the radius"""
SAME_HEIGHT = 1.0
"""Height error at which a loiter to a height ends, m"""
LAUNCH_ACCELERATION = 30.0
"""Acceleration of a launch, m/s^2: default of FW_LAUN_AC_THLD, above which PX4 detects a launch"""
LAUNCH_SPEED = 1.25
"""Airspeed at the end of a launch, relative to the minimum airspeed"""
LAUNCH_TIMEOUT = 15.0
"""Time after which a take-off that has not reached its speed has failed, s"""
LIFTOFF_TIMEOUT = 3.0
"""Time after the launch by which a vehicle has left the ground, s"""
LOWEST_APPROACH, APPROACH_HEIGHT = 5.0, 20.0
"""Limits of the height above the landing point at which an approach begins, m"""
APPROACH_SPEED = 1.3 / 1.2
"""Airspeed of an approach relative to the minimum airspeed, 1.2 stall speeds: 1.3 stall speeds, as
in 14 CFR 23.73 until 2017"""
FLARE_HEIGHT, FLARE_SINK = 2.0, 0.25
"""Height at which a vehicle flares, m, and its commanded sink rate then, m/s (FW_LND_FL_SINK)"""
FLARE_TIME = 3.5
"""Time of the flare, s, by which the glide slope ends before the landing point"""
MAX_CALM_WIND = 1.0
"""Wind below which a landing keeps the present course, m/s"""
SPIRAL_TURN, SPIRAL_SINK = 0.3, 0.8
"""Lateral acceleration of a descent without GPS relative to the maximum, and its sink rate, m/s"""
BRAKE_SPEED = 2.0
"""Speed at which a transition to hovering ends, m/s"""
TRANSITION_TIMEOUT = 15.0
"""Time after which a transition ends in any case, s: default of VT_TRANS_TIMEOUT of PX4"""
NO_VTOL, TO_WINGS, TO_ROTORS, ON_ROTORS, ON_WINGS = range(5)
"""VTOL states (MAV_VTOL_STATE)"""
Point = Sequence[float]


class WingFlight:
    """Limits, speed and steering of one vehicle in flight on wings.

    Attributes:
        can_hover: Whether it is a VTOL.
        values: Values of the parameters.
        is_forward: Whether it flies on wings, or is commanded to.
        chosen_speed: Airspeed that a client has chosen, m/s; None for FW_AIRSPD_TRIM.
    """

    def __init__(
        self,
        airframe: Airframe,
        row: np.record,
        values: Mapping[str, float],
        get_wind: Callable[[], Point],
    ) -> None:
        """Initialise on the ground.

        Args:
            airframe: Airframe of the vehicle.
            row: Its row of `AUTOPILOT`.
            values: Values of the parameters.
            get_wind: Function that returns the velocity of the air at the vehicle, (3,), m/s.
        """
        self.can_hover, self.values, self._get_wind = airframe.can_hover, values, get_wind
        self.is_forward = not airframe.can_hover
        self.chosen_speed: float | None = None
        self.mass, self.max_thrust = airframe.mass, forward_thrust(airframe)
        self.stall_speed, self.min_speed = float(row["stall_speed"]), float(row["min_speed"])
        self.max_climb, self._course_rate = float(row["max_climb"]), float(row["course_rate"])
        self._max_lateral = STANDARD_GRAVITY * float(row["max_bank"])

    def reset(self) -> None:
        """Return to the state on the ground, after disarming."""
        self.is_forward, self.chosen_speed = not self.can_hover, None

    def start_transition(self, is_forward: bool, state: State, now: float) -> MotionPrimitive:
        """Change a VTOL to flight on wings or on rotors, and return the motion that does so."""
        self.is_forward = is_forward
        return Transition(self, state, now) if is_forward else Brake(state, now)

    @property
    def speed(self) -> float:
        """Airspeed of legs and loiters, m/s."""
        values = self.values
        wanted = values["FW_AIRSPD_TRIM"] if self.chosen_speed is None else self.chosen_speed
        return min(max(wanted, values["FW_AIRSPD_MIN"], self.min_speed), values["FW_AIRSPD_MAX"])

    @property
    def min_radius(self) -> float:
        """Radius of the smallest loiter at the present airspeed, m."""
        return self.speed**2 / (BANK_MARGIN * self._max_lateral)

    @property
    def radius(self) -> float:
        """Radius of a loiter without one, m."""
        return max(self.values["NAV_LOITER_RAD"], self.min_radius)

    @property
    def brake_distance(self) -> float:
        """Distance in which a VTOL stops from the airspeed of legs, m."""
        return self.speed**2 / (2 * PATH_ACCELERATION)

    @property
    def glide_slope(self) -> float:
        """Slope of an approach, height by distance."""
        return float(tan(math.radians(self.values["FW_LND_ANG"])))

    def airspeed(self, state: State) -> float:
        """Return the airspeed, m/s."""
        return math.dist(state[2], self._get_wind())

    def course(self, state: State) -> float:
        """Return the course over ground, rad from east to north; the heading at low speed."""
        vx, vy, _ = state[2]
        if math.hypot(vx, vy) < 0.5 * self.stall_speed:
            return euler(state[1])[2]
        return float(atan2(vy, vx))

    def landing_course(self, state: State) -> float:
        """Return the course of a landing: into the wind, or the present course without wind."""
        wx, wy, _ = self._get_wind()
        return float(atan2(-wy, -wx)) if math.hypot(wx, wy) > MAX_CALM_WIND else self.course(state)

    def width(self, state: State) -> float:
        """Return the width of the vector fields around paths, m."""
        vx, vy, _ = state[2]
        return FIELD_WIDTH * max(math.hypot(vx, vy), self.stall_speed) / self._course_rate

    def line_course(self, state: State, goal: Point, course: float) -> float:
        """Return the course that leads to a line and along it.

        Args:
            state: State of the vehicle.
            goal: Point of the line, m.
            course: Course of the line, rad from east to north.
        """
        _, left = place_by_line(state, goal, course)
        return float(course - atan2(left, self.width(state)))

    def circle_course(self, state: State, center: Point, radius: float) -> float:
        """Return the course that leads to a circle and around it.

        On the circle it leads the tangent by the angle at which the course controller commands the
        centripetal acceleration.

        Args:
            state: State of the vehicle.
            center: Centre, m.
            radius: Radius, m; negative for an anticlockwise circle, as in MAVLink.
        """
        x, y = state[0][0] - center[0], state[0][1] - center[1]
        distance, size = math.hypot(x, y), abs(radius)
        inward = atan2(distance - size, self.width(state))
        speed = math.hypot(state[2][0], state[2][1])
        sine = speed * cos(inward) / (self._course_rate * max(distance, size))
        sine = min(sine, MAX_LEAD)
        lead = atan2(sine, math.sqrt(1 - sine * sine))
        turn = -1.0 if radius > 0 else 1.0
        return float(atan2(y, x) + turn * (math.pi / 2 + inward + lead))

    def climb_rate(self, state: State, height: float) -> float:
        """Return the climb rate towards a height in the airspace, m/s."""
        return HEIGHT_RATE * (height - state[0][2])

    def fly(
        self, state: State, course: float, climb: float, speed: float | None = None
    ) -> AirspaceCommand:
        """Return the command of a course over ground, a climb rate and an airspeed.

        The ground speed s along the unit vector u has |s u - wind| = airspeed. It has a minimum, so
        that the vehicle makes headway in strong wind, and then the airspeed is higher.

        Args:
            state: State of the vehicle.
            course: Course, rad from east to north.
            climb: Climb rate, m/s.
            speed: Airspeed, m/s; by default `speed`.
        """
        wx, wy, _ = self._get_wind()
        ux, uy = float(cos(course)), float(sin(course))
        along, across = wx * ux + wy * uy, wy * ux - wx * uy
        air = self.speed if speed is None else speed
        ground = along + math.sqrt(max(air * air - across * across, 0.0))
        if self.can_hover:
            # A slower VTOL would fly on its rotors
            ground = max(ground, self.min_speed)
            velocity = (ground * ux, ground * uy, climb, course)
            return AirspaceCommand(SetpointLevel.VELOCITY, velocity)
        ground = max(ground, MIN_GROUND_SPEED)
        faster = SPEED_RATE * (math.hypot(ground - along, across) - self.airspeed(state))
        vx, vy, vz = state[2]
        size = math.sqrt(vx * vx + vy * vy + 1e-6)
        # Course errors above 90 degrees turn as those of 90 degrees
        sine = (vx * uy - vy * ux) / size
        if vx * ux + vy * uy < 0:
            sine = math.copysign(1.0, sine)
        left = self._course_rate * size * sine
        return AirspaceCommand(
            SetpointLevel.ACCELERATION,
            (
                (faster * vx - left * vy) / size,
                (faster * vy + left * vx) / size,
                HEIGHT_RATE * (climb - vz),
                course,
            ),
        )

    def follow(self, setpoint: Setpoint, state: State) -> Setpoint | AirspaceCommand:
        """Return what a vehicle on wings does with an offboard setpoint: positions are circled."""
        if setpoint.xy_mode != "position":
            return setpoint
        return Loiter(self, (*setpoint.xy, setpoint.z)).get_setpoint(state, 0.0)

    def turn(self, state: State, lateral: float, climb: float, speed: float) -> AirspaceCommand:
        """Return the command of a turn.

        Args:
            state: State of the vehicle.
            lateral: Lateral acceleration relative to that at the maximum bank, from -1 (right) to
                1 (left).
            climb: Climb rate, m/s.
            speed: Airspeed, m/s.
        """
        vx, vy, _ = state[2]
        rate = self._course_rate * max(math.hypot(vx, vy), self.stall_speed)
        sine = min(max(BANK_MARGIN * lateral * self._max_lateral / rate, -MAX_LEAD), MAX_LEAD)
        course = self.course(state) + float(atan2(sine, math.sqrt(1 - sine * sine)))
        return self.fly(state, course, climb, speed)


def place_by_line(state: State, goal: Point, course: float) -> tuple[float, float]:
    """Return how far a vehicle is from a point along a line, and to the left of the line, m.

    Args:
        state: State of the vehicle.
        goal: Point of the line, m.
        course: Course of the line, rad from east to north. The first distance is positive before
            the point.
    """
    x, y = goal[0] - state[0][0], goal[1] - state[0][1]
    east, north = float(cos(course)), float(sin(course))
    return x * east + y * north, x * north - y * east


def forward_thrust(airframe: Airframe) -> float:
    """Return the static thrust of all forward rotors at maximum speed, N."""
    fastest = airframe.max_rotor_speed
    return len(airframe.forward_rotors) * airframe.thrust_coefficient * fastest * fastest


class WingMotion(MotionPrimitive):
    """Motion on wings, after which the vehicle loiters."""

    def __init__(self, wings: WingFlight, start_time: float = 0.0) -> None:
        """Initialise without a time limit."""
        super().__init__(start_time, math.inf)
        self._wings = wings

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the motion that loiters around the present position."""
        return Loiter(self._wings, state[0])


class Loiter(WingMotion):
    """Circle a point, without end or until a time, a number of turns or a height is reached."""

    def __init__(
        self,
        wings: WingFlight,
        center: Point,
        radius: float = 0.0,
        *,
        seconds: float = math.inf,
        turns: float = math.inf,
        ends_at_height: bool = False,
    ) -> None:
        """Plan the circle.

        Args:
            wings: Flight on wings.
            center: (3,) centre, m.
            radius: Radius, m; negative for an anticlockwise circle; 0 or NaN for NAV_LOITER_RAD.
            seconds: Time on the circle after which the motion ends, s.
            turns: Number of turns after which the motion ends.
            ends_at_height: Whether the motion ends at the height of the centre.
        """
        super().__init__(wings)
        self.center, self._seconds, self._turns = tuple(center), seconds, turns
        self.radius = radius if radius and math.isfinite(radius) else wings.radius
        self._ends_at_height = ends_at_height
        self._arrival: tuple[float, float] | None = None
        self._swept = 0.0

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the course of the circle, and the climb rate to its height."""
        course = self._wings.circle_course(state, self.center, self.radius)
        return self._wings.fly(state, course, self._wings.climb_rate(state, self.center[2]))

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True once the time, the turns or the height are reached, else None."""
        if self._ends_at_height:
            return True if abs(state[0][2] - self.center[2]) < SAME_HEIGHT else None
        x, y = state[0][0] - self.center[0], state[0][1] - self.center[1]
        angle = float(atan2(y, x))
        if self._arrival is None:
            if abs(math.hypot(x, y) - abs(self.radius)) < ON_CIRCLE * abs(self.radius):
                self._arrival = (now, angle)
            return None
        time, last = self._arrival
        self._swept += abs(math.remainder(angle - last, math.tau))
        self._arrival = (time, angle)
        is_over = now - time >= self._seconds or self._swept >= self._turns * math.tau
        return True if is_over else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return a motion that stays on the circle."""
        return Loiter(self._wings, self.center, self.radius)


class WingLeg(WingMotion):
    """Fly along a straight line to a point, and past it; the height changes evenly."""

    def __init__(
        self, wings: WingFlight, state: State, goal: Point, acceptance_radius: float = 0.0
    ) -> None:
        """Plan the line from the present position.

        Args:
            wings: Flight on wings.
            state: State of the vehicle.
            goal: (3,) goal, m.
            acceptance_radius: Horizontal distance from the goal at which it counts as reached, m.
                It counts as reached, too, when the vehicle passes by.
        """
        super().__init__(wings)
        self._start, self._goal, self._acceptance = state[0], goal, acceptance_radius
        x, y = goal[0] - state[0][0], goal[1] - state[0][1]
        self._length = math.hypot(x, y)
        self._course = float(atan2(y, x)) if self._length else wings.course(state)

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the course along the line, and the climb rate to its height."""
        rise = self._goal[2] - self._start[2]
        remaining, _ = place_by_line(state, self._goal, self._course)
        share = min(max(remaining / max(self._length, 1e-9), 0.0), 1.0)
        slope = rise / max(self._length, 1e-9) if 0.0 < share < 1.0 else 0.0
        steady = slope * math.hypot(state[2][0], state[2][1])
        climb = steady + self._wings.climb_rate(state, self._goal[2] - rise * share)
        course = self._wings.line_course(state, self._goal, self._course)
        return self._wings.fly(state, course, climb)

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True within the acceptance radius or past the goal, else None."""
        distance = math.dist(state[0][:2], self._goal[:2])
        remaining, _ = place_by_line(state, self._goal, self._course)
        return True if distance <= self._acceptance or remaining <= 0 else None


class Launch(WingMotion):
    """Accelerate along the ground to flying speed: by the own thrust, or by a launcher."""

    def __init__(self, wings: WingFlight, state: State, now: float) -> None:
        """Start at rest, along the heading."""
        super().__init__(wings, now)
        self._heading = euler(state[1])[2]

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return level wings and full thrust."""
        values = (0.0, 0.0, self._heading, self._wings.max_thrust)
        return AirspaceCommand(SetpointLevel.ATTITUDE, values)

    def get_force(self, state: State) -> tuple[float, float, float] | None:
        """Return the force of the launcher along the heading, which carries the weight first, N.

        There is none if RWTO_TKOFF is 1.
        """
        wings = self._wings
        if wings.values["RWTO_TKOFF"] > 0:
            return None
        push = wings.mass * LAUNCH_ACCELERATION
        share = min(wings.airspeed(state) / wings.min_speed, 1.0)
        carried = wings.mass * STANDARD_GRAVITY * (1 - share * share)
        return float(push * cos(self._heading)), float(push * sin(self._heading)), carried

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True at the launch speed, False if that takes too long, else None."""
        if self._wings.airspeed(state) >= LAUNCH_SPEED * self._wings.min_speed:
            return True
        return False if now - self.start_time > LAUNCH_TIMEOUT else None


class ClimbOut(WingMotion):
    """Climb straight ahead to a height."""

    def __init__(self, wings: WingFlight, state: State, now: float, height: float) -> None:
        """Keep the course of the start.

        Args:
            wings: Flight on wings.
            state: State of the vehicle.
            now: Time, s.
            height: Height in the airspace, m.
        """
        super().__init__(wings, now)
        self._origin, self._course, self._height = state[0], wings.course(state), height

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the course, and the climb rate, which falls close to the height."""
        course = self._wings.line_course(state, self._origin, self._course)
        climb = min(self._wings.climb_rate(state, self._height), self._wings.max_climb)
        return self._wings.fly(state, course, max(climb, 0.5))

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True at the height, False on the ground, else None."""
        if state[0][2] >= self._height - 0.5:
            return True
        return False if has_contact and now - self.start_time > LIFTOFF_TIMEOUT else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the loiter at the height, or motors off if the take-off failed."""
        if state[0][2] < self._height - 0.5:
            return MotorsOff()
        return Loiter(self._wings, (*state[0][:2], self._height))


class Touchdown(WingMotion):
    """Motion that ends at ground contact with motors off."""

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True after touchdown, else None."""
        return True if has_contact else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the motion that stops the motors."""
        return MotorsOff()


class Approach(Touchdown):
    """Descend along a glide slope, and flare."""

    def __init__(self, wings: WingFlight, point: Point, course: float, height: float) -> None:
        """Plan the approach.

        Args:
            wings: Flight on wings.
            point: (3,) landing point, at the height of the vehicle standing there, m.
            course: Course of the approach, rad from east to north.
            height: Height above the point at which the slope begins, m.
        """
        super().__init__(wings)
        self._point, self._course, self._height = point, course, height
        self._is_flaring = False

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the course to the point, and the sink rate of the slope or of the flare."""
        wings, height = self._wings, state[0][2] - self._point[2]
        course = wings.line_course(state, self._point, self._course)
        self._is_flaring = self._is_flaring or height < FLARE_HEIGHT
        if self._is_flaring:
            return wings.fly(state, course, -FLARE_SINK, wings.min_speed)
        remaining, _ = place_by_line(state, self._point, self._course)
        speed = math.hypot(state[2][0], state[2][1])
        slope_height = FLARE_HEIGHT + max(remaining - FLARE_TIME * speed, 0.0) * wings.glide_slope
        sink = wings.glide_slope * speed if slope_height < self._height else 0.0
        wanted = self._point[2] + min(slope_height, self._height)
        climb = wings.climb_rate(state, wanted) - sink
        return wings.fly(state, course, climb, APPROACH_SPEED * wings.min_speed)


class SpiralDescent(Touchdown):
    """Descend in a turn of constant bank, without a position."""

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the turn and the sink rate."""
        return self._wings.turn(state, SPIRAL_TURN, -SPIRAL_SINK, self._wings.speed)


class Transition(WingMotion):
    """Accelerate a VTOL straight ahead until its wings carry it."""

    def __init__(self, wings: WingFlight, state: State, now: float) -> None:
        """Keep the height and the heading of the start."""
        super().__init__(wings, now)
        self._height, self._heading = state[0][2], euler(state[1])[2]

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the velocity ahead, at constant height."""
        return self._wings.fly(state, self._heading, self._wings.climb_rate(state, self._height))

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True at the minimum airspeed, False after the timeout, else None."""
        if self._wings.airspeed(state) >= self._wings.min_speed:
            return True
        return False if now - self.start_time >= TRANSITION_TIMEOUT else None


class Brake(MotionPrimitive):
    """Slow a VTOL down until it hovers on its rotors."""

    def __init__(self, state: State, now: float) -> None:
        """Brake along the present course."""
        super().__init__(now, TRANSITION_TIMEOUT)
        self._hold = HoldPosition(state)

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the position at which the vehicle comes to rest."""
        return self._hold.get_setpoint(state, now)

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True when the vehicle is slow, or after the timeout, else None."""
        if math.sqrt(sum(one * one for one in state[2])) < BRAKE_SPEED:
            return True
        return super().check_outcome(state, now, has_contact)


class ManualWings(WingMotion):
    """Flight on wings by sticks: bank, climb rate and airspeed."""

    def __init__(self, wings: WingFlight, get_sticks: Callable[[], Sticks]) -> None:
        """Fly by the last sticks, which a function returns."""
        super().__init__(wings)
        self._get_sticks = get_sticks

    def get_setpoint(self, state: State, now: float) -> AirspaceCommand:
        """Return the turn, the climb rate (stick back is up) and the airspeed of the throttle."""
        wings, sticks = self._wings, self._get_sticks()
        limit = wings.values["FW_AIRSPD_MAX" if sticks.throttle > 0 else "FW_AIRSPD_MIN"]
        speed = wings.speed + abs(sticks.throttle) * (limit - wings.speed)
        return wings.turn(state, -sticks.roll, -sticks.pitch * wings.max_climb, speed)


def plan_landing(
    wings: WingFlight, get_state: Callable[[], State], point: Point, course: float
) -> Iterator[MotionPrimitive]:
    """Yield the motions of a landing: to the start of the slope, down to its height, and down.

    A vehicle that is on the line of the approach already, before the start of its slope, lands
    straight ahead.

    Args:
        wings: Flight on wings.
        get_state: Function that returns the state of the vehicle.
        point: (3,) landing point, at the height of the vehicle standing there, m.
        course: Course of the approach, rad from east to north.
    """
    state = get_state()
    remaining, left = place_by_line(state, point, course)
    height, width = state[0][2] - point[2], wings.width(state)
    if height > 0 and abs(left) < width and remaining > height / wings.glide_slope + 2 * width:
        yield Approach(wings, point, course, height)
        return
    height = min(max(height, LOWEST_APPROACH), APPROACH_HEIGHT)
    # Room to turn onto the line before the slope begins
    length = height / wings.glide_slope + 2 * wings.radius + 2 * width
    start = (
        point[0] - length * float(cos(course)),
        point[1] - length * float(sin(course)),
        point[2] + height,
    )
    if math.dist(state[0][:2], start[:2]) > wings.radius:
        yield WingLeg(wings, state, start, wings.values["NAV_ACC_RAD"])
    if get_state()[0][2] - start[2] > wings.values["NAV_FW_ALT_RAD"]:
        yield Loiter(wings, start, ends_at_height=True)
    yield Approach(wings, point, course, height)
