"""Reward terms of flights to goals through a shared airspace, by name; a task weights them.

Each takes the task, the frame and its marks, and gives (W, N), unweighted.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import closest_squared, offset
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.kernel import func, kernel

if TYPE_CHECKING:
    from bulletuav.tasks.base import Frame
    from bulletuav.tasks.families.airspace import Airspace


class StepEvents(NamedTuple):
    """What happened to each drone in a decision, (W, N) bool.

    reached     came to its goal, for the first time
    outside     is outside the arena, or was thrown back at its bounds
    terminated  its episode ended here, for good or ill
    ended       that, or the horizon cut it
    """

    reached: np.ndarray
    outside: np.ndarray
    terminated: np.ndarray
    ended: np.ndarray


def progress(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """Metres nearer to the goal than before the decision."""
    return frame.distance_before - frame.distance


def goal(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 on reaching it, once."""
    return events.reached.astype(float)


def conflict(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """Other drones with which a conflict began."""
    return frame.conflict.onsets.astype(float)


def warning(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """Summed over other drones: from 0 at the edge of the warning zone, linear, to 1 at d_safe."""
    return frame.conflict.nearness


def collision(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 on contact of collision shapes."""
    return frame.collision.astype(float)


def out_of_bounds(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 outside the arena, or thrown back at its bounds."""
    return events.outside.astype(float)


def energy(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """Square of the velocity change, (m/s)^2."""
    return ((frame.after.velocity - frame.before.velocity) ** 2).sum(axis=-1)


def efficiency(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 at the goal, 0 as far from it as at the start: 1 - d / d0, of the way to where the goal stops."""
    return 1 - task.way(frame) / np.maximum(frame.scene.memory["way"], task.config.goal_radius)


def speed_keeping(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 at a speed between 0.3 and 0.8 of max_speed."""
    share = np.linalg.norm(frame.after.velocity, axis=-1) / task.context.max_speed
    return ((share > 0.3) & (share < 0.8)).astype(float)


def time(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """1 a decision."""
    return np.ones(frame.alive.shape)


def shaping(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """The discounted potential after, less that before: -the way to where the goal stops, m, 0 where the episode terminates.

    Leaves optimal policies as they are: A. Ng, D. Harada, S. Russell, Policy invariance under reward transformations, 1999.
    """
    return task.way_before(frame) - task.config.discount * np.where(
        events.terminated, 0.0, task.way(frame)
    )


def concession(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """At the end of a drone's episode: for how many drones it made way, less how many made way for it; 0 at least.

    See `follow_encounters`.
    """
    memory = frame.scene.memory
    met, effort = memory["encounter"] == CLEAR, memory["effort"]
    yielded = np.sign(effort - effort.swapaxes(1, 2))
    return np.where(events.ended, np.maximum((met * yielded).sum(axis=2), 0.0), 0.0)


def obstacle_warning(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """Summed over obstacles: from 0 at d_safe from their bounding spheres, linear, to 1 at contact with them."""
    reach = (
        np.array([obstacle.radius for obstacle in task.obstacles()]) + task.context.collision_radius
    )
    offset = frame.scene.obstacle[:, None] - frame.after.position[:, :, None]
    return np.clip(1 - (np.linalg.norm(offset, axis=-1) - reach) / frame.d_safe, 0.0, 1.0).sum(
        axis=-1
    )


def proximity(task: "Airspace", frame: "Frame", events: StepEvents) -> np.ndarray:
    """From 0 where the shortest range is `proximity_range`, linear, to 1 at 0 m."""
    reach: float = task.config.proximity_range  # type: ignore[attr-defined]
    return np.maximum(0.0, 1 - frame.readings["lidar"].min(axis=-1) / reach)


REWARDS: dict[str, Callable[["Airspace", "Frame", StepEvents], np.ndarray]] = {
    term.__name__: term
    for term in (
        progress,
        goal,
        conflict,
        warning,
        collision,
        out_of_bounds,
        energy,
        efficiency,
        speed_keeping,
        time,
        shaping,
        concession,
        obstacle_warning,
        proximity,
    )
}
NONE, CLEAR, CONFLICT = 0.0, 1.0, 2.0
"""Between two drones: no encounter yet; an encounter that stayed clear; one that became a conflict"""
LOOK_AHEAD = 10.0  # s


@func
def _change(before, after, w, i):
    """Size of a drone's velocity change, m/s."""
    own, new = vec3(before.velocity, w, i), vec3(after.velocity, w, i)
    return math.sqrt((new[0] - own[0]) ** 2 + (new[1] - own[1]) ** 2 + (new[2] - own[2]) ** 2)


@kernel
def follow_encounters(encounter, effort, before, after, d_safe, alive):
    """Bring the encounters of all pairs (W, N, N) up to date after a decision, from the swarms before and after it.

    An encounter begins when two living drones would come closer than d_safe (m) within 10 s if both flew straight on from
    where they were before the decision. From then on, until they part, `effort` sums up each one's change of velocity, m/s:
    of the two, the drone with the larger sum is the one that makes way. It is a conflict once they are closer than d_safe.
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                gap, speed = offset(before.position, w, i, j), offset(before.velocity, w, i, j)
                along, fast = dot(gap, speed), dot(speed, speed)
                _, least = closest_squared(gap, offset(after.position, w, i, j))
                state = encounter[w, i, j]
                if along < 0.0:
                    meeting = -along / fast
                    if (
                        state == NONE
                        and meeting < LOOK_AHEAD
                        and dot(gap, gap) + meeting * along < d_safe * d_safe
                    ):
                        state = CLEAR
                    if state != NONE:
                        effort[w, i, j] += _change(before, after, w, i)
                        effort[w, j, i] += _change(before, after, w, j)
                if least < d_safe * d_safe:
                    state = CONFLICT
                encounter[w, i, j] = encounter[w, j, i] = state


@kernel
def variance_nearby(reward, position, alive, reach):
    """(W, N) variance of the rewards of the living drones within `reach` m of each, itself among them."""
    result = np.zeros(reward.shape)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            count, total, square = 0, 0.0, 0.0
            for j in range(alive.shape[1]):
                gap = 0.0
                for k in range(3):
                    gap += (position[w, j, k] - position[w, i, k]) ** 2
                if alive[w, j] and gap <= reach * reach:
                    count += 1
                    total += reward[w, j]
                    square += reward[w, j] ** 2
            if alive[w, i]:
                result[w, i] = max(0.0, square / count - (total / count) ** 2)
    return result
