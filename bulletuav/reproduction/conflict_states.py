"""States of UAVConflictGym that are made by hand, and decisions from them."""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.reproduction.hand_made import HandMade
from bulletuav.tasks import Spawn
from bulletuav.tasks.goal_flight import FlightConfig, GoalFlight

CENTRE = np.array((0.0, 0.0, 120.0))
"""Centre of the cube, m; theirs is the origin, so that half of it is below the ground"""
CONFLICT_OPTIONS: dict[str, Any] = {
    "preset": "uavconflict",
    "difficulty": "easy",
    "dynamics": "single_integrator",
}


class ConflictState(NamedTuple):
    """State of N points, relative to the cube's centre.

    Attributes:
        position: N positions, m.
        velocity: N velocities, m/s.
        goal: N goals, m.
    """

    position: Any
    velocity: Any
    goal: Any


def fly_state(state: ConflictState, **options: Any) -> HandMade:
    """Fly decisions from a state, in the cube and with the constants of UAVConflictGym.

    Args:
        state: The state.
        **options: Options of `HandMade` and of the environment.
    """

    class Given(GoalFlight[FlightConfig]):
        """Points that start in a given state."""

        name = "given_conflict"
        arena_low = CENTRE - 100.0
        arena_high = CENTRE + 100.0

        def spawn(self, rng: np.random.Generator) -> Spawn:
            """Return the state."""
            place, speed, goal = (np.array(one, dtype=float) for one in state)
            return Spawn(position=place + CENTRE, goal=goal + CENTRE, velocity=speed)

    return HandMade(Given, **{"num_drones": len(state.position), **CONFLICT_OPTIONS, **options})


APART = ConflictState(
    position=[(0, 0, 0), (60, 0, 0)],
    velocity=[(10, 0, 0), (0, 10, 0)],
    goal=[(30, 0, 0), (60, 60, 0)],
)
"""Two points that fly to their goals, far from each other"""
PAIR = ConflictState(
    position=[(10, -20, 30), (70, 0, -20)],
    velocity=[(3, 4, 0), (-1, 2, 5)],
    goal=[(40, 20, 30), (0, 0, 0)],
)
"""Two points for observations"""
ARRIVING = ConflictState(
    position=[(0, 0, 0), (60, 0, 0)], velocity=np.zeros((2, 3)), goal=[(1, 0, 0), (60, 60, 0)]
)
"""Two points at rest, the first at its goal"""
MEETING = ConflictState(
    position=[(0, 0, 0), (6, 0, 0), (60, 0, 0)],
    velocity=[(10, 0, 0), (-10, 0, 0), (0, 0, 0)],
    goal=np.full((3, 3), 50.0),
)
"""Two points that are 4 m apart after a decision, and a third"""
