"""Random walk of a target or leader that moves level at constant speed."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import atan2, cos, hypot, sin

TURN_ACCELERATION = 3.0
"""Maximum lateral acceleration, m/s^2: that of a car in a curve"""


class Wanderer(NamedTuple):
    """A point that moves at constant speed, with a course that changes at random.

    The heading follows the course as fast as TURN_ACCELERATION allows. Outside the arena the course
    leads back to the origin.

    Attributes:
        speed: m/s.
        turn: Standard deviation of the change of the course after one second, rad.
        arena: Distance from the origin at which the point turns back, m.
        period: Time between decisions, s.
    """

    speed: float
    turn: float
    arena: float
    period: float

    def move(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        course: np.ndarray,
        world: int,
        rng: np.random.Generator,
    ) -> None:
        """Move the point of one world through a decision.

        Args:
            position: (3,) m, modified in place.
            velocity: (3,) m/s, modified in place.
            course: (W,) directions that the headings follow, rad, from east to north; modified.
            world: Index of the world in `course`.
            rng: Generator of the world.
        """
        max_turn = TURN_ACCELERATION * self.period / max(self.speed, self.period)
        x, y, _ = position
        vx, vy, _ = velocity
        # A random walk, except at the edge; the heading follows at a limited rate
        course[world] += self.turn * np.sqrt(self.period) * rng.standard_normal()
        if hypot(x, y) > self.arena and x * vx + y * vy > 0:
            course[world] = atan2(-y, -x)
        heading = atan2(vy, vx)
        heading += min(max(angle_between(heading, course[world]), -max_turn), max_turn)
        velocity[:] = self.speed * np.array([cos(heading), sin(heading), 0.0])
        position += self.period * velocity

    def reach(self) -> float:
        """Return the maximum distance of the point from the origin, m."""
        return self.arena + 2 * self.speed**2 / TURN_ACCELERATION


def angle_between(first: float, second: float) -> float:
    """Return the signed angle from one heading to another, from -pi to pi, rad."""
    turn = second - first
    return turn - 2 * np.pi * round(turn / (2 * np.pi))
