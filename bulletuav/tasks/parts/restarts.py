"""Further starts of drones whose episode would end, in traffic that lasts until the horizon."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.given import GivenPositions
from bulletuav.tasks.parts.base import Part, Rngs
from bulletuav.vehicle.swarm import Swarm

MAX_START_DRAWS = 100
"""Maximum number of draws of a further start; usually the first one has a suitable drone"""


class Restarts(Part):
    """Starts drones again whose episode would end: crashed, outside the arena, battery empty.

    Such a drone is placed at the beginning of the next decision, before it flies. The start is
    drawn as those of an episode: position, motion and goal of the first drone of a drawn episode
    whose start and goal are clear of the drones, goals and obstacles of the world.
    """

    def __init__(self, task: Any, apart: float, obstacle_distance: np.ndarray) -> None:
        """Set the distances that starts and goals keep.

        Args:
            task: The task, whose `spawn` draws starts.
            apart: Minimum distance of a start from drones, and of a goal from goals, m.
            obstacle_distance: (K,) minimum distances of both from the centres of obstacles, m.
        """
        self._task, self._apart, self._obstacle_distance = task, apart, obstacle_distance

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the marks of drones that start again, and of their number."""
        drones = self._task.context.num_drones
        return {"restarting": (drones,), "restarts": (drones,)}

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return how often each drone started again, including the next decision, (W, N)."""
        return {"restarts": frame.scene.memory["restarts"].copy()}

    def mark(self, frame: Frame, ended: np.ndarray) -> None:
        """Mark the drones of `ended` (W, N) bool that flew, to start again."""
        memory = frame.scene.memory
        memory["restarting"][:] = ended & frame.alive
        memory["restarts"][:] += memory["restarting"]

    def place(
        self, swarm: Swarm, scene: Scene, due: np.ndarray, flown: np.ndarray, rngs: Rngs
    ) -> None:
        """Write position, motion and goal of the drones that start again.

        Args:
            swarm: State of all drones, modified.
            scene: Goals and starts, modified, and obstacles.
            due: (W, N) bool, drones that start again.
            flown: (W, N) bool, drones that fly the decision.
            rngs: Random generator of each world.
        """
        others = flown & ~due
        for w, i in np.argwhere(due).tolist():
            taken = (swarm.position[w, others[w]], scene.goal[w, others[w]], scene.obstacle[w])
            drawn = self._draw(taken, rngs[w])
            for name in ("position", "quaternion", "velocity", "rates"):
                getattr(swarm, name)[w, i] = drawn[name]
            scene.start[w, i], scene.goal[w, i] = drawn["position"], drawn["goal"]
            scene.memory["restarting"][w, i] = 0.0
            others[w, i] = True

    def _draw(
        self, taken: tuple[np.ndarray, np.ndarray, np.ndarray], rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        """Draw the start of one drone, clear of drones, goals and obstacles.

        If none of MAX_START_DRAWS episodes has a suitable drone, the most suitable is returned.
        """
        positions, goals, obstacles = taken
        task, best, chosen = self._task, -np.inf, {}
        for _ in range(MAX_START_DRAWS):
            spawn = task.finish(task.spawn(rng), GivenPositions(), rng)
            # Distances beyond the required ones, m
            start, goal = np.asarray(spawn.position), np.asarray(spawn.goal)
            clear = np.minimum(
                _least_margin(start, positions, self._apart),
                _least_margin(goal, goals, self._apart),
            )
            for place in (start, goal):
                margin = _least_margin(place, obstacles, self._obstacle_distance)
                clear = np.minimum(clear, margin)
            is_free = bool((clear > 0).any())
            row = int((clear > 0).argmax() if is_free else clear.argmax())
            if clear[row] > best:
                best, chosen = clear[row], {"position": start[row], "goal": goal[row]}
                for name in ("quaternion", "velocity", "rates"):
                    value = np.asarray(getattr(spawn, name), dtype=float)
                    width = 4 if name == "quaternion" else 3
                    chosen[name] = np.broadcast_to(value, (len(start), width))[row]
            if is_free:
                break
        return chosen


def _least_margin(
    places: np.ndarray, taken: np.ndarray, distance: np.ndarray | float
) -> np.ndarray:
    """Return the least distance of each place (N, 3) from taken ones (M, 3), less the required."""
    margin: np.ndarray = np.linalg.norm(places[:, None] - taken, axis=-1) - distance
    least: np.ndarray = margin.min(axis=1, initial=np.inf)
    return least
