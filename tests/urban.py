"""Cities, drones and users at given places, for tests of tasks in cities."""

import numpy as np
from placing import city_of

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.tasks import find_task
from bulletuav.tasks.frame import Spawn

URBAN = ("navigation", "lidar_navigation", "los", "coverage", "default")
FLIGHTS = ("navigation", "lidar_navigation")
EXACT = {"dynamics": "single_integrator"}  # flies what it is told, at once
SPEED, PERIOD = 15.0, 0.1  # m/s, s: of all these tasks
RADIUS = 0.27554491  # m, of a hummingbird
UP, EAST, WEST, STAY = (0.0, 0, 1), (1.0, 0, 0), (-1.0, 0, 0), (0.0, 0, 0)

WALL = city_of(((10, -50, 0), (20, 50, 60)))
TOWER = city_of(((-10, -10, 0), (10, 10, 30)))


def placed(task, position, goal=None, users=None):
    """The task, with its drones at rest at `position` (N, 3), m."""
    start = np.array(position, dtype=float)
    memory = {} if users is None else {"users": np.array(users, dtype=float)}

    class Placed(find_task(task)):
        name = "placed"

        def spawn(self, rng):
            to = start + (0.0, -90, 0) if goal is None else np.array(goal, dtype=float)
            return Spawn(position=start, goal=to, layout=self.city_layouts.draw(rng), memory=memory)

    return Placed


def town(task="navigation", **options):
    """The town of a task, without an engine."""
    return EnvSpec(task, 1, options).task.city_layouts


def blocked(start, end, box):
    """Whether the segment from `start` to `end` meets a box (low, high).

    It does where the intervals of its parameter overlap, in which it is within the box on an axis.
    """
    first, last = 0.0, 1.0
    for a, b, low, high in zip(start, end, *box, strict=True):
        if a == b:
            if not low <= a <= high:
                return False
            continue
        near, far = sorted(((low - a) / (b - a), (high - a) / (b - a)))
        first, last = max(first, near), min(last, far)
    return first <= last


DRONES = np.array([(-50.0, 0, 10), (-50.0, 40, 10)])
USERS = np.array(
    [(40.0, 0, 1.5), (20.0, 0, 1.5), (-30.0, -20, 1.5), (40.0, -30, 1.5), (30.0, -40, 1.5)]
)
SEEN = np.array([(0, 0, 1, 1, 1), (1, 0, 1, 0, 0)], dtype=bool)
"""At TOWER.

From the second drone to user 0 the line passes x = 10 at y = 13.3, beside the tower; to user 1 at
5.7; to users 3 and 4 it passes x = -10 at 8.9 and 0. From the first drone those pass x = -10 at
-13.3 and -20.
"""
