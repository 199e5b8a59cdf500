"""What clients of bridges make a drone do, until it is done."""

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.setpoints import Order, Setpoint, State, euler
from bulletuav.compiled.functions import atan2

ACCELERATION = 2.0
"""How fast drones speed up and brake along paths, m/s^2"""
ARRIVED = 0.3
"""Distance from a goal, m, at which a path is done, unless another is given"""
LANDING_SPEED = 0.5
"""m/s"""
Answer = Callable[[bool], None]
"""Function that is told whether a motion came to its end"""


class Ramp(NamedTuple):
    """How far along a path a drone is to be: it speeds up, flies on, and brakes.

    Attributes:
        length: m.
        speed: Greatest speed, m/s.
    """

    length: float
    speed: float

    @property
    def top(self) -> float:
        """Speed that it reaches, m/s."""
        return min(self.speed, math.sqrt(self.length * ACCELERATION))

    @property
    def duration(self) -> float:
        """How long it takes, s."""
        if self.length == 0:
            return 0.0
        return self.length / self.top + self.top / ACCELERATION

    def at(self, time: float) -> tuple[float, float, float]:
        """Tell distance (m), speed (m/s) and acceleration (m/s^2) at a time, s."""
        left = self.duration - time
        rise = self.top / ACCELERATION
        if left <= 0:
            return self.length, 0.0, 0.0
        if time < rise:
            return ACCELERATION * time**2 / 2, ACCELERATION * time, ACCELERATION
        if left < rise:
            return self.length - ACCELERATION * left**2 / 2, ACCELERATION * left, -ACCELERATION
        return self.top * (time - rise / 2), self.top, 0.0


class Heading(NamedTuple):
    """Where a drone looks during a motion.

    Attributes:
        turning: "angle" or "rate", see `Setpoint`.
        yaw: rad or rad/s.
        forward: Whether it looks where it flies, instead.
    """

    turning: str = "rate"
    yaw: float = 0.0
    forward: bool = False

    def along(self, velocity: Sequence[float]) -> tuple[str, float]:
        """Tell turning and yaw for a velocity (2,) or more, m/s, east and north."""
        if self.forward and abs(velocity[0]) + abs(velocity[1]) > 0.1:
            return "angle", atan2(velocity[1], velocity[0])
        return self.turning, self.yaw


class Motion(ABC):
    """Something that a drone does; derived classes tell what, and until when.

    Attributes:
        begin: When it began, s.
        limit: How long it may take, s.
    """

    def __init__(self, begin: float, limit: float) -> None:
        """Begin."""
        self.begin, self.limit = begin, limit

    @abstractmethod
    def order(self, state: State, now: float) -> Setpoint | Order | None:
        """Tell what to do now; None for motors off."""

    def outcome(self, state: State, now: float, touches: bool) -> bool | None:
        """Tell whether it came to its end, or None while it goes on.

        Args:
            state: State of the drone.
            now: Time, s.
            touches: Whether the drone touches what it can stand on.
        """
        return True if now - self.begin >= self.limit - 1e-9 else None

    def after(self, state: State) -> "Motion":
        """Tell what the drone does once it has ended: it stays where it will have braked."""
        return Stay(state)


class Off(Motion):
    """Motors off."""

    def __init__(self) -> None:
        """Begin, for good."""
        super().__init__(0.0, math.inf)

    def order(self, state: State, now: float) -> None:
        """Tell that motors are off."""
        return


class Stay(Motion):
    """Stay at a place, with a yaw."""

    def __init__(self, state: State, begin: float = 0.0, yaw: float | None = None) -> None:
        """Stay where the drone comes to rest when it brakes, or with another yaw."""
        super().__init__(begin, 0.0)
        place, quaternion, velocity, _ = state
        speed = math.sqrt(sum(one * one for one in velocity))
        self._place = [
            here + way * speed / (2 * ACCELERATION)
            for here, way in zip(place, velocity, strict=True)
        ]
        self._yaw = euler(quaternion)[2] if yaw is None else yaw

    def order(self, state: State, now: float) -> Setpoint:
        """Tell the place."""
        x, y, z = self._place
        return Setpoint("position", (x, y), "position", z, "angle", self._yaw)

    def after(self, state: State) -> "Motion":
        """Tell that it goes on."""
        return self


class Turn(Motion):
    """Turn to a yaw on the spot."""

    def __init__(self, state: State, begin: float, limit: float, yaw: float, margin: float) -> None:
        """Turn to a yaw, rad, to within a margin, rad."""
        super().__init__(begin, limit)
        self._stay, self._yaw, self._margin = Stay(state, begin, yaw), yaw, margin

    def order(self, state: State, now: float) -> Setpoint:
        """Tell the place, and the yaw."""
        return self._stay.order(state, now)

    def outcome(self, state: State, now: float, touches: bool) -> bool | None:
        """Tell whether it looks there, or the time is over."""
        away = math.remainder(euler(state[1])[2] - self._yaw, math.tau)
        if abs(away) <= self._margin:
            return True
        return False if now - self.begin >= self.limit else None

    def after(self, state: State) -> Motion:
        """Tell that the drone goes on to look there."""
        return self._stay


class Hold(Motion):
    """Hold a setpoint for a time, such as a velocity or an attitude."""

    def __init__(
        self, begin: float, limit: float, setpoint: Setpoint | Order, forward: bool = False
    ) -> None:
        """Hold a setpoint; with `forward` the drone looks along its velocity."""
        super().__init__(begin, limit)
        self._setpoint = setpoint
        if forward and isinstance(setpoint, Setpoint):
            turning, yaw = Heading(forward=True).along(setpoint.xy)
            self._setpoint = setpoint._replace(turning=turning, yaw=yaw)

    def order(self, state: State, now: float) -> Setpoint | Order:
        """Tell the setpoint."""
        return self._setpoint


class Path(Motion):
    """Fly along straight pieces at a speed, and stop at the end."""

    def __init__(
        self,
        state: State,
        points: list[np.ndarray],
        speed: float,
        heading: Heading,
        times: tuple[float, float],
        near: float = ARRIVED,
    ) -> None:
        """Plan the path from where the drone is.

        Args:
            state: State of the drone.
            points: Where to go, (3,) each, m.
            speed: m/s, above 0.
            heading: Where to look.
            times: When it begins, and how long it may take, s.
            near: Distance from the goal at which it is done, m.
        """
        super().__init__(*times)
        self._near = near
        places = np.array([state[0], *points])
        steps = np.diff(places, axis=0)
        lengths = np.sqrt((steps * steps).sum(axis=1))
        # Lists of numbers, as each step asks for a few of them.
        self._points: list[list[float]] = places.tolist()
        self._ends: list[float] = [0.0, *np.cumsum(lengths).tolist()]
        self._ways: list[list[float]] = (steps / np.maximum(lengths, 1e-9)[:, None]).tolist()
        self._ramp = Ramp(self._ends[-1], speed)
        self._heading = heading

    def order(self, state: State, now: float) -> Setpoint:
        """Tell where to be, how fast, and where to look."""
        far, speed, gain = self._ramp.at(now - self.begin)
        piece = bisect_right(self._ends, far, 1, len(self._ends) - 1) - 1
        way, begin, more = self._ways[piece], self._points[piece], far - self._ends[piece]
        x, y, z = (one + more * part for one, part in zip(begin, way, strict=True))
        ahead = (*(speed * one for one in way), *(gain * one for one in way))
        turning, yaw = self._heading.along([one * max(speed, 0.2) for one in way])
        return Setpoint("position", (x, y), "position", z, turning, yaw, ahead)

    def outcome(self, state: State, now: float, touches: bool) -> bool | None:
        """Tell whether it has arrived, or the time is over."""
        is_over = now - self.begin >= self._ramp.duration
        if is_over and math.dist(state[0], self._points[-1]) < self._near:
            return True
        return False if now - self.begin >= self.limit else None

    def after(self, state: State) -> Motion:
        """Tell that the drone stays at the goal."""
        still = (self._points[-1], state[1], [0.0] * 3, [0.0] * 3)
        return Stay(still)


class Land(Motion):
    """Sink until something is touched, then switch the motors off."""

    def __init__(
        self, state: State, begin: float, limit: float, speed: float = LANDING_SPEED
    ) -> None:
        """Sink from where the drone is, at a speed, m/s."""
        super().__init__(begin, limit)
        self._place, self._speed = state[0], speed

    def order(self, state: State, now: float) -> Setpoint:
        """Tell to sink, right below."""
        x, y, z = self._place
        down = self._speed * (now - self.begin)
        ahead = (0.0, 0.0, -self._speed, 0.0, 0.0, 0.0)
        return Setpoint("position", (x, y), "position", z - down, "rate", 0.0, ahead)

    def outcome(self, state: State, now: float, touches: bool) -> bool | None:
        """Tell whether it stands, or the time is over."""
        if touches:
            return True
        return False if now - self.begin >= self.limit else None

    def after(self, state: State) -> Motion:
        """Tell that motors stop."""
        return Off()
