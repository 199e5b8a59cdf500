"""States over cities and users that are made by hand, and decisions from them."""

from typing import Any

import numpy as np

from bulletuav.city.model import City
from bulletuav.city.streets import Streets
from bulletuav.geometry.solids import Solids
from bulletuav.reproduction.hand_made import HandMade
from bulletuav.tasks import Spawn, find_task

MAX_SPEED, MAX_CLIMB = 20.0, 12.0
"""Limits of the preset `urbanmarl`, m/s"""
HOVER = (0.0, -1.0, 0.0)
"""Action `heading_speed` of a drone that stays"""
WALL = ((-120.0, -120.0, 0.0), (-100.0, 120.0, 150.0))
"""Corners of a wide building, m"""
USERS = (
    (100.0, 0.0, 1.5),
    (0.0, 50.0, 1.5),
    (-50.0, 0.0, 1.5),
    (-150.0, 0.0, 1.5),
    (-150.0, 30.0, 1.5),
)
"""Five users, of which `WALL` hides the last two from drones above the origin, m"""


def steer_to(speed: float, heading: float, climb: float) -> tuple[float, float, float]:
    """Return the action `heading_speed` of a speed (m/s), heading (degrees) and climb (m/s)."""
    return (heading / 180.0, 2.0 * speed / MAX_SPEED - 1.0, climb / MAX_CLIMB)


def build_city(buildings: Any, side: float = 500.0) -> City:
    """Build a city of boxes without streets.

    Args:
        buildings: (B, 2, 3) low and high corner of each building, m.
        side: Side of the city's square, m.
    """
    boxes = np.array(buildings, dtype=float).reshape(-1, 2, 3)
    streets = Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int))
    return City("made by hand", side, Solids(boxes), np.arange(len(boxes)), streets)


def fly_over(
    task: str,
    buildings: Any,
    drones: Any,
    users: Any = None,
    goals: Any = None,
    actions: Any = HOVER,
    **options: Any,
) -> HandMade:
    """Fly decisions over a city made by hand, with the sizes and weights of UrbanMARL.

    Args:
        task: Name of the task, which has the preset `urbanmarl`.
        buildings: (B, 2, 3) corners of the buildings, m.
        drones: (N, 3) positions of the drones, which start at rest, m.
        users: (U, 3) positions of users, who stand still, m; None for tasks without users.
        goals: (N, 3) goals, m; None for tasks without goals.
        actions: (N, 3) or (3,) actions `heading_speed` of all decisions.
        **options: Options of `HandMade` and of the environment.
    """
    start = np.array(drones, dtype=float)
    goal = start if goals is None else np.array(goals, dtype=float)
    memory = {} if users is None else {"users": np.array(users, dtype=float)}
    if users is not None:
        options = {"num_users": len(users), "mobility": "still", **options}

    class Placed(find_task(task)):  # type: ignore[misc]
        """The task, started in the given state."""

        name = "placed_by_hand"

        def spawn(self, rng: np.random.Generator) -> Spawn:
            """Return the state."""
            return Spawn(position=start, goal=goal, layout=0, memory=memory)

    known = {
        "preset": "urbanmarl",
        "difficulty": "easy",
        "city": build_city(buildings),
        "num_drones": len(start),
        "action": "heading_speed",
    }
    return HandMade(Placed, actions, **{**known, **options})
