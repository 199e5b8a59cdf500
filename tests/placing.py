"""Cities by hand, with drones and users at given places."""

import numpy as np

import bulletuav
from bulletuav.city.model import City
from bulletuav.city.streets import Streets
from bulletuav.geometry.solids import Solids
from bulletuav.tasks import find_task
from bulletuav.tasks.base import Spawn
from bulletuav.tasks.parts.city_layouts import CityOptions

SMALL = {"area": 250.0, "num_layouts": 1}


def small_cities(task):
    """Options by which worlds draw one of two small cities; none for tasks without cities.

    Cities of the usual size and number take three quarters of the time to make an environment.
    """
    has_cities = issubclass(find_task(task).Config, CityOptions)
    return {**SMALL, "num_layouts": 2} if has_cities else {}


def city_of(*boxes, side=200.0):
    """A city made by hand, of boxes (low corner, high corner), without streets."""
    solids = Solids(np.array(boxes, dtype=float).reshape(-1, 2, 3))
    return City(
        "hand",
        side,
        solids,
        np.arange(len(boxes)),
        Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int)),
    )


OPEN = city_of()
WALL = city_of(((10, -50, 0), (20, 50, 60)))


def fly(aviary, *ways):
    """Take one decision with the action `ways[i]` for drone i, the same in all worlds.

    The last of the ways is for all drones that follow.
    """
    actions = [ways[min(i, len(ways) - 1)] for i in range(aviary.num_drones)]
    return aviary.step(np.broadcast_to(np.array(actions, dtype=float), (*aviary.alive.shape, 3)))


class Placing:
    """Builds aviaries of tasks over users, and closes them."""

    def __init__(self):
        self._made = []

    def make(self, task, num_worlds=1, **options):
        """One that is started, by default small and kinematic."""
        small = {} if "city" in options else SMALL
        self._made.append(
            bulletuav.Aviary(
                task, num_worlds, **{"dynamics": "single_integrator", **small, **options}
            )
        )
        self._made[-1].reset(seeds=0)
        return self._made[-1]

    def put(self, task, city, position, users, num_worlds=1, **options):
        """One whose drones hover, and whose users stand, at given places (N, 3) and (U, 3), m."""
        start, memory = np.array(position, dtype=float), {"users": np.array(users, dtype=float)}

        class Placed(find_task(task)):
            name = "placed"

            def spawn(self, rng):
                layout = self.city_layouts.draw(rng)
                return Spawn(position=start, goal=start, layout=layout, memory=memory)

        numbers = {"num_drones": len(start), "num_users": len(users), "mobility": "still"}
        return self.make(Placed, num_worlds, city=city, **{**numbers, **options})

    def close(self):
        for aviary in self._made:
            aviary.close()
