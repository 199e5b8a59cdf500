"""Motions of MAVLink vehicles besides legs: orbit, following a target, and flight by sticks.

Names and defaults are those of PX4's flight modes (https://docs.px4.io/main/en/flight_modes_mc/).
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from bulletuav.bridges.motions import PATH_ACCELERATION, Land, MotionPrimitive
from bulletuav.bridges.setpoints import Setpoint, State, euler
from bulletuav.compiled.functions import atan2, cos, sin

FACE_CENTER, KEEP_HEADING, UNCONTROLLED_HEADING, FACE_TANGENT = range(4)
"""Yaw behaviours of an orbit (ORBIT_YAW_BEHAVIOUR)"""
MIN_COURSE_SPEED = 0.5
"""Speed of a target above which its velocity gives its course, m/s"""
MIN_FOLLOW_HEIGHT = 1.0
"""Minimum height above home while following a target, m"""
TARGET_TIMEOUT = 3.0
"""Time without messages after which a target counts as lost, s: GPS_MESSAGE_STALE_TIMEOUT_MS of PX4
(https://github.com/PX4/PX4-Autopilot, TargetEstimator.hpp), which then stops its estimate, too"""
FOLLOW_GAIN = 1.0
"""Speed towards the goal for each metre of distance to it, 1/s"""
CONSTANT_ALTITUDE, TARGET_ALTITUDE = 0, 2
"""Values of FLW_TGT_ALT_M: FLW_TGT_HT is above home, or above the target"""
MAX_STICK_LEAD = 1.0
"""Maximum distance between the position that sticks command and the vehicle, m"""
NUM_ORBIT_POINTS = 360
"""Number of points at which a circle is compared with the geofence"""


class OrbitPlan(NamedTuple):
    """Circle to fly.

    Attributes:
        center: (3,) centre of the circle, m.
        radius: Radius, m.
        speed: Speed, m/s.
        is_clockwise: Direction, seen from above.
        yaw_behavior: One of the yaw behaviours above.
    """

    center: tuple[float, float, float]
    radius: float
    speed: float
    is_clockwise: bool
    yaw_behavior: int

    def entry(self, position: list[float]) -> tuple[float, float, float]:
        """Return the point of the circle that is nearest to a position (3,), m."""
        return self._point(self._angle(position))

    def points(self) -> list[tuple[float, float, float]]:
        """Return `NUM_ORBIT_POINTS` points around the circle, m."""
        return [self._point(math.tau * k / NUM_ORBIT_POINTS) for k in range(NUM_ORBIT_POINTS)]

    def _point(self, angle: float) -> tuple[float, float, float]:
        """Return the point of the circle in a direction, rad from east to north."""
        x, y, z = self.center
        return x + self.radius * cos(angle), y + self.radius * sin(angle), z

    def _angle(self, position: list[float]) -> float:
        """Return the direction from the centre to a position, rad from east to north."""
        return atan2(position[1] - self.center[1], position[0] - self.center[0])


class Orbit(MotionPrimitive):
    """Fly along a circle without end; the speed rises evenly."""

    def __init__(self, plan: OrbitPlan, state: State, now: float) -> None:
        """Start at the point of the circle that is nearest to the drone.

        Args:
            plan: Circle to fly.
            state: State of the drone.
            now: Time, s.
        """
        super().__init__(now, math.inf)
        self.plan = plan
        self._start_angle, self._yaw = plan._angle(state[0]), euler(state[1])[2]

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the moving position on the circle, and the yaw."""
        plan, time = self.plan, now - self.start_time
        ramp = plan.speed / PATH_ACCELERATION
        speed = min(PATH_ACCELERATION * time, plan.speed)
        distance = speed * time / 2 if time < ramp else plan.speed * (time - ramp / 2)
        turn = -1.0 if plan.is_clockwise else 1.0
        angle = self._start_angle + turn * distance / plan.radius
        east, north = cos(angle), sin(angle)
        tangent = PATH_ACCELERATION if time < ramp else 0.0
        centripetal = speed**2 / plan.radius
        x, y, z = plan.center
        feedforward = (
            *(-turn * speed * north, turn * speed * east, 0.0),
            -turn * tangent * north - centripetal * east,
            turn * tangent * east - centripetal * north,
            0.0,
        )
        yaw = {
            FACE_CENTER: angle + math.pi,
            FACE_TANGENT: angle + turn * math.pi / 2,
        }.get(plan.yaw_behavior, self._yaw)
        position = (x + plan.radius * east, y + plan.radius * north)
        yaw = math.remainder(yaw, math.tau)
        return Setpoint("position", position, "position", z, "angle", yaw, feedforward)


class Descend(Land):
    """Descend with level attitude, without a position, until the drone touches a surface."""

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the level attitude and the rate of descent."""
        return Setpoint("attitude", (0.0, 0.0), "velocity", -self._speed)


class Target(NamedTuple):
    """Target to follow.

    Attributes:
        position: (3,) m.
        velocity: (3,) m/s, world axes.
        time: Time at which the position was received, s.
    """

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    time: float


class FollowMovingTarget(MotionPrimitive):
    """Stay at a distance and an angle from a moving target, and face it."""

    def __init__(
        self,
        get_target: Callable[[], Target | None],
        ground: float,
        values: Mapping[str, float],
        hold: Setpoint,
        report: Callable[[str], None],
    ) -> None:
        """Follow a target; hold a position until there is one.

        Args:
            get_target: Function that returns the last target.
            ground: Height of home, m.
            values: Values of the parameters.
            hold: Setpoint without a target.
            report: Function that sends a text to the clients, once for each loss of the target.
        """
        super().__init__(0.0, math.inf)
        self._get_target, self._ground, self._values = get_target, ground, values
        self._setpoint, self._course = hold, math.pi / 2
        self._report, self._is_lost = report, False

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the velocity towards the goal, which moves with the target until it is lost."""
        target, values = self._get_target(), self._values
        if target is None:
            return self._setpoint
        vx, vy, _ = target.velocity
        if math.hypot(vx, vy) > MIN_COURSE_SPEED:
            self._course = atan2(vy, vx)
        # FLW_TGT_FA is clockwise from the target's course
        angle = self._course - math.radians(values["FLW_TGT_FA"])
        # The last known velocity predicts the target until its next message, or its loss
        delay = min(now - target.time, TARGET_TIMEOUT)
        was_lost, self._is_lost = self._is_lost, delay == TARGET_TIMEOUT
        if self._is_lost:
            vx = vy = 0.0
            if not was_lost:
                self._report("target lost: waiting at its last position")
        tx, ty, tz = (p + v * delay for p, v in zip(target.position, target.velocity, strict=True))
        distance, height = values["FLW_TGT_DST"], values["FLW_TGT_HT"]
        base = tz if values["FLW_TGT_ALT_M"] == TARGET_ALTITUDE else self._ground
        goal = (
            tx + distance * cos(angle),
            ty + distance * sin(angle),
            max(base + height, self._ground + MIN_FOLLOW_HEIGHT),
        )
        x, y, z = state[0]
        ex, ey = FOLLOW_GAIN * (goal[0] - x) + vx, FOLLOW_GAIN * (goal[1] - y) + vy
        scale = min(1.0, values["FLW_TGT_MAX_VEL"] / max(math.hypot(ex, ey), 1e-9))
        rise = FOLLOW_GAIN * (goal[2] - z)
        climb = min(max(rise, -values["MPC_Z_VEL_MAX_DN"]), values["MPC_Z_VEL_MAX_UP"])
        yaw = atan2(ty - y, tx - x)
        return Setpoint("velocity", (scale * ex, scale * ey), "velocity", climb, "angle", yaw)


class Sticks(NamedTuple):
    """Sticks of a remote control, from -1 to 1.

    Attributes:
        pitch: Forward.
        roll: To the right.
        throttle: Upward; 0 is the centre.
        yaw: Clockwise.
        time: Time at which they were received, s.
    """

    pitch: float = 0.0
    roll: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0
    time: float = -math.inf


class ManualFlight(MotionPrimitive):
    """Flight by sticks: velocities (position mode), or tilt and climb rate (altitude mode).

    In position mode the sticks move a position, so that the vehicle stops, and holds its place
    against wind, when they are released.
    """

    def __init__(
        self,
        get_sticks: Callable[[], Sticks],
        has_landed: Callable[[], bool],
        values: Mapping[str, float],
        has_position: bool,
    ) -> None:
        """Start at the present position of the drone.

        Args:
            get_sticks: Function that returns the last sticks.
            has_landed: Function that returns whether the drone stands on something.
            values: Values of the parameters.
            has_position: True for position mode, False for altitude mode.
        """
        super().__init__(0.0, math.inf)
        self._get_sticks, self._has_landed, self._values = get_sticks, has_landed, values
        self._has_position = has_position
        self._target: list[float] | None = None
        self._velocity, self._time = [0.0] * 3, 0.0

    def get_setpoint(self, state: State, now: float) -> Setpoint | None:
        """Return the setpoint of the sticks; None, motors off, on the ground without throttle."""
        (pitch, roll, throttle, yaw, _), values = self._get_sticks(), self._values
        if self._has_landed() and throttle <= 0:
            self._target = None
            return None
        limit = values["MPC_Z_VEL_MAX_UP" if throttle > 0 else "MPC_Z_VEL_MAX_DN"]
        turn, climb = -math.radians(values["MPC_MAN_Y_MAX"]) * yaw, throttle * limit
        heading = euler(state[1])[2]
        east, north = cos(heading), sin(heading)
        if self._has_position:
            speed = values["MPC_VEL_MANUAL"]
            wanted = [
                speed * (pitch * east + roll * north),
                speed * (pitch * north - roll * east),
                climb,
            ]
        else:
            wanted = [0.0, 0.0, climb]
        (x, y, z), feedforward = self._advance(wanted, state, now)
        if self._has_position:
            return Setpoint("position", (x, y), "position", z, "rate", turn, feedforward)
        tilt = math.radians(values["MPC_MAN_TILT_MAX"])
        angles = (tilt * roll, tilt * pitch)
        if throttle:
            return Setpoint("attitude", angles, "velocity", climb, "rate", turn)
        return Setpoint("attitude", angles, "position", z, "rate", turn)

    def _advance(
        self, wanted: list[float], state: State, now: float
    ) -> tuple[list[float], tuple[float, ...]]:
        """Move the target by the wanted velocity, with limited acceleration.

        Returns:
            Target (3,), m, and its velocity and acceleration, six numbers.
        """
        if self._target is None:
            self._target, self._velocity = list(state[0]), list(state[2])
            self._time = now
        period = now - self._time
        self._time = now
        step = PATH_ACCELERATION * period
        change = [
            min(max(goal - own, -step), step)
            for goal, own in zip(wanted, self._velocity, strict=True)
        ]
        self._velocity = [own + part for own, part in zip(self._velocity, change, strict=True)]
        # Do not run ahead of a vehicle that cannot follow, such as one at a wall
        self._target = [
            place + min(max(own + period * speed - place, -MAX_STICK_LEAD), MAX_STICK_LEAD)
            for own, speed, place in zip(self._target, self._velocity, state[0], strict=True)
        ]
        acceleration = [part / period if period else 0.0 for part in change]
        return self._target, (*self._velocity, *acceleration)
