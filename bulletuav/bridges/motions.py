"""Motion primitives of drones, such as paths, turns and landings that clients request."""

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, State, euler
from bulletuav.compiled.functions import atan2

PATH_ACCELERATION = 2.0
"""Acceleration and deceleration along paths, m/s^2"""
DEFAULT_ARRIVAL_DISTANCE = 0.3
"""Default distance from the goal at which a path is complete, m"""
LANDING_SPEED = 0.5
"""Default descent rate of a landing, m/s"""
DoneCallback = Callable[[bool], None]
"""Function that is called with True if a motion succeeded, and False if it failed or was
replaced"""


class TrapezoidalProfile(NamedTuple):
    """Trapezoidal velocity profile along a path: constant acceleration, cruise, deceleration.

    Attributes:
        length: Length of the path, m.
        speed: Maximum speed, m/s.
    """

    length: float
    speed: float

    @property
    def peak_speed(self) -> float:
        """Peak speed, m/s; below the maximum speed on short paths."""
        return min(self.speed, math.sqrt(self.length * PATH_ACCELERATION))

    @property
    def duration(self) -> float:
        """Duration of the profile, s."""
        if self.length == 0:
            return 0.0
        return self.length / self.peak_speed + self.peak_speed / PATH_ACCELERATION

    def evaluate(self, time: float) -> tuple[float, float, float]:
        """Evaluate the profile at a time.

        Args:
            time: Time since the start of the path, s.

        Returns:
            Distance from the start (m), speed (m/s) and acceleration (m/s^2).
        """
        remaining = self.duration - time
        ramp_time = self.peak_speed / PATH_ACCELERATION
        if remaining <= 0:
            return self.length, 0.0, 0.0
        if time < ramp_time:
            return PATH_ACCELERATION * time**2 / 2, PATH_ACCELERATION * time, PATH_ACCELERATION
        if remaining < ramp_time:
            return (
                self.length - PATH_ACCELERATION * remaining**2 / 2,
                PATH_ACCELERATION * remaining,
                -PATH_ACCELERATION,
            )
        return self.peak_speed * (time - ramp_time / 2), self.peak_speed, 0.0


class Heading(NamedTuple):
    """Yaw policy of a drone during a motion.

    Attributes:
        yaw_mode: "angle" or "rate", see `Setpoint`.
        yaw: Yaw, rad, or yaw rate, rad/s.
        forward: Whether the drone faces its direction of flight instead.
    """

    yaw_mode: str = "rate"
    yaw: float = 0.0
    forward: bool = False

    def get_yaw_command(self, velocity: Sequence[float]) -> tuple[str, float]:
        """Return the yaw mode and the yaw for a velocity.

        Args:
            velocity: At least two numbers, velocity east and north, m/s.
        """
        if self.forward and abs(velocity[0]) + abs(velocity[1]) > 0.1:
            return "angle", atan2(velocity[1], velocity[0])
        return self.yaw_mode, self.yaw


class MotionPrimitive(ABC):
    """Motion that a drone executes until it succeeds, fails, times out or is replaced.

    Subclasses define the setpoint at each time and the condition that ends the motion.

    Attributes:
        start_time: Start time, s.
        timeout: Maximum duration, s.
    """

    def __init__(self, start_time: float, timeout: float) -> None:
        """Set the start time and the timeout, s."""
        self.start_time, self.timeout = start_time, timeout

    @abstractmethod
    def get_setpoint(self, state: State, now: float) -> Setpoint | AirspaceCommand | None:
        """Return the setpoint or command at a time; None stops the motors.

        Args:
            state: State of the drone.
            now: Time, s.
        """

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Check whether the motion has ended.

        Args:
            state: State of the drone.
            now: Time, s.
            has_contact: Whether the drone touches a surface that it can stand on.

        Returns:
            True if the motion succeeded, False if it failed, None while it goes on.
        """
        return True if now - self.start_time >= self.timeout - 1e-9 else None

    def get_next_motion(self, state: State) -> "MotionPrimitive":
        """Return the motion that follows this one: by default, brake and hold the position."""
        return HoldPosition(state)


class MotorsOff(MotionPrimitive):
    """Motors stopped, without a time limit."""

    def __init__(self) -> None:
        """Create a motion that never ends."""
        super().__init__(0.0, math.inf)

    def get_setpoint(self, state: State, now: float) -> None:
        """Return None, which stops the motors."""
        return


class HoldPosition(MotionPrimitive):
    """Hold a position and a yaw."""

    def __init__(self, state: State, start_time: float = 0.0, yaw: float | None = None) -> None:
        """Hold the point where the drone comes to rest after braking.

        Args:
            state: State of the drone.
            start_time: Start time, s.
            yaw: Yaw to hold, rad; by default the yaw of the drone.
        """
        super().__init__(start_time, 0.0)
        position, quaternion, velocity, _ = state
        speed = math.sqrt(sum(component * component for component in velocity))
        self._position = [
            coordinate + speed_component * speed / (2 * PATH_ACCELERATION)
            for coordinate, speed_component in zip(position, velocity, strict=True)
        ]
        self._yaw = euler(quaternion)[2] if yaw is None else yaw

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the position and the yaw to hold."""
        x, y, z = self._position
        return Setpoint("position", (x, y), "position", z, "angle", self._yaw)

    def get_next_motion(self, state: State) -> "MotionPrimitive":
        """Return this motion: the drone goes on holding its position."""
        return self


class TurnToYaw(MotionPrimitive):
    """Turn to a yaw angle at a fixed position."""

    def __init__(
        self, state: State, start_time: float, timeout: float, yaw: float, tolerance: float
    ) -> None:
        """Hold the position and turn.

        Args:
            state: State of the drone.
            start_time: Start time, s.
            timeout: Maximum duration, s.
            yaw: Yaw, rad.
            tolerance: Yaw error at which the turn is complete, rad.
        """
        super().__init__(start_time, timeout)
        self._hold = HoldPosition(state, start_time, yaw)
        self._yaw, self._tolerance = yaw, tolerance

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the position to hold and the final yaw."""
        return self._hold.get_setpoint(state, now)

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True within the yaw tolerance, False after the timeout, else None."""
        yaw_error = math.remainder(euler(state[1])[2] - self._yaw, math.tau)
        if abs(yaw_error) <= self._tolerance:
            return True
        return False if now - self.start_time >= self.timeout else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the motion that holds the position and the final yaw."""
        return self._hold


class HoldSetpoint(MotionPrimitive):
    """Hold a setpoint, such as a velocity or an attitude, for a duration."""

    def __init__(
        self,
        start_time: float,
        timeout: float,
        setpoint: Setpoint | AirspaceCommand,
        forward: bool = False,
    ) -> None:
        """Hold a setpoint or a command.

        Args:
            start_time: Start time, s.
            timeout: Duration, s; the motion succeeds when it is over.
            setpoint: Setpoint or airspace command to hold.
            forward: Whether the drone faces the direction of the velocity of `setpoint`.
        """
        super().__init__(start_time, timeout)
        self._setpoint = setpoint
        if forward and isinstance(setpoint, Setpoint):
            yaw_mode, yaw = Heading(forward=True).get_yaw_command(setpoint.xy)
            self._setpoint = setpoint._replace(yaw_mode=yaw_mode, yaw=yaw)

    def get_setpoint(self, state: State, now: float) -> Setpoint | AirspaceCommand:
        """Return the setpoint to hold."""
        return self._setpoint


class FollowPath(MotionPrimitive):
    """Fly a polyline with a trapezoidal velocity profile, and stop at the end."""

    def __init__(
        self,
        state: State,
        waypoints: list[np.ndarray],
        speed: float,
        heading: Heading,
        times: tuple[float, float],
        arrival_distance: float = DEFAULT_ARRIVAL_DISTANCE,
    ) -> None:
        """Plan the path from the present position of the drone.

        Args:
            state: State of the drone.
            waypoints: (3,) positions to fly through, m.
            speed: Maximum speed, m/s, above 0.
            heading: Yaw policy.
            times: Start time and maximum duration, s.
            arrival_distance: Distance from the goal at which the path is complete, m.
        """
        super().__init__(*times)
        self._arrival_distance = arrival_distance
        vertices = np.array([state[0], *waypoints])
        segments = np.diff(vertices, axis=0)
        lengths = np.sqrt((segments * segments).sum(axis=1))
        # Plain lists, because each step reads only a few elements
        self._vertices: list[list[float]] = vertices.tolist()
        self._distances: list[float] = [0.0, *np.cumsum(lengths).tolist()]
        self._directions: list[list[float]] = (
            segments / np.maximum(lengths, 1e-9)[:, None]
        ).tolist()
        self._profile = TrapezoidalProfile(self._distances[-1], speed)
        self._heading = heading

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the position on the path with feedforward, and the yaw."""
        distance, speed, acceleration = self._profile.evaluate(now - self.start_time)
        segment = bisect_right(self._distances, distance, 1, len(self._distances) - 1) - 1
        direction, origin = self._directions[segment], self._vertices[segment]
        remainder = distance - self._distances[segment]
        x, y, z = (
            component + remainder * direction_component
            for component, direction_component in zip(origin, direction, strict=True)
        )
        feedforward = (
            *(speed * component for component in direction),
            *(acceleration * component for component in direction),
        )
        yaw_mode, yaw = self._heading.get_yaw_command(
            [component * max(speed, 0.2) for component in direction]
        )
        return Setpoint("position", (x, y), "position", z, yaw_mode, yaw, feedforward)

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True at the goal, False after the timeout, else None."""
        is_complete = now - self.start_time >= self._profile.duration
        if is_complete and math.dist(state[0], self._vertices[-1]) < self._arrival_distance:
            return True
        return False if now - self.start_time >= self.timeout else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the motion that holds the position of the goal."""
        rest_state = (self._vertices[-1], state[1], [0.0] * 3, [0.0] * 3)
        return HoldPosition(rest_state)


class Land(MotionPrimitive):
    """Descend until the drone touches a surface, then stop the motors."""

    def __init__(
        self, state: State, start_time: float, timeout: float, speed: float = LANDING_SPEED
    ) -> None:
        """Descend vertically from the present position.

        Args:
            state: State of the drone.
            start_time: Start time, s.
            timeout: Maximum duration, s.
            speed: Descent rate, m/s.
        """
        super().__init__(start_time, timeout)
        self._position, self._speed = state[0], speed

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return a position that descends below the point where the landing started."""
        x, y, z = self._position
        descent = self._speed * (now - self.start_time)
        feedforward = (0.0, 0.0, -self._speed, 0.0, 0.0, 0.0)
        return Setpoint("position", (x, y), "position", z - descent, "rate", 0.0, feedforward)

    def check_outcome(self, state: State, now: float, has_contact: bool) -> bool | None:
        """Return True after touchdown, False after the timeout, else None."""
        if has_contact:
            return True
        return False if now - self.start_time >= self.timeout else None

    def get_next_motion(self, state: State) -> MotionPrimitive:
        """Return the motion that stops the motors."""
        return MotorsOff()
