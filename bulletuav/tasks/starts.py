"""Validation of start and goal positions."""

from typing import Any

import numpy as np

from bulletuav.errors import numbers_of, shown
from bulletuav.tasks.base import Task
from bulletuav.tasks.given import PLACES, GivenPositions


def read_given_positions(
    task: Task[Any], start: object = None, goal: object = None
) -> GivenPositions:
    """Convert and validate start and goal positions set by the user.

    Args:
        task: The task.
        start: (N, 3) start positions, m; None to draw them.
        goal: (N, 3) goal positions, m; None to draw them.

    Raises:
        ValueError: If the task does not accept the positions, they are not N finite positions
            inside the arena and outside of buildings, or starts overlap.
    """
    places = {}
    for name, value in zip(PLACES, (start, goal), strict=True):
        if value is None:
            continue
        if name not in task.places:
            accepted = " or ".join(task.places) or "nothing"
            raise ValueError(f"{name} cannot be given in task {task.name!r}: {accepted} can")
        places[name] = _read_positions(task, name, value)
    if "start" in places and not task.takes_off:
        lowest = float(places["start"][:, 2].min())
        if lowest <= task.context.collision_radius:
            raise ValueError(
                f"start is {lowest:g} m up at its lowest, where drones touch the ground: more than "
                f"{task.context.collision_radius:.3g} m is needed; or choose take_off=True"
            )
    if "start" in places:
        check_overlap(places["start"], task.context.collision_radius)
    return GivenPositions(**places)


def _read_positions(task: Task[Any], name: str, value: object) -> np.ndarray:
    """Return an option as positions (N, 3), m, after checking that they are free."""
    drones = task.context.num_drones
    try:
        positions = numbers_of(f"{name} is", value)
    except ValueError:
        positions = np.empty(0)
    if positions.shape != (drones, 3) or not np.isfinite(positions).all():
        raise ValueError(
            f"{name} is {shown(value)}: {drones} finite positions (x, y, z) in metres are needed"
        )
    if name == "start" and task.takes_off:
        positions = task.on_ground(positions)
    # Check all layouts, as each episode draws one of them
    beyond = ((positions < task.arena_low) | (positions > task.arena_high)).any(axis=1)
    if beyond.any():
        i = int(beyond.argmax())
        low, high = (tuple(corner.tolist()) for corner in (task.arena_low, task.arena_high))
        raise ValueError(
            f"{name} of drone {i} is {tuple(positions[i].tolist())}: "
            f"a position inside the arena, from {low} to {high} m, is needed"
        )
    for layout in range(len(task.layouts())):
        for i, place in enumerate(positions):
            if not task.is_free(place, task.context.collision_radius, layout):
                raise ValueError(
                    f"{name} of drone {i} is {tuple(place.tolist())}, inside a building "
                    f"or touching it, in layout {layout}: choose a position outdoors"
                )
    return positions


def check_overlap(position: np.ndarray, radius: float) -> None:
    """Check that positions (N, 3), m, are more than two collision radii apart.

    Raises:
        ValueError: If two drones overlap.
    """
    if len(position) < 2:
        return
    from scipy.spatial import cKDTree  # slow to import

    pairs = cKDTree(position).query_pairs(2 * radius)
    if pairs:
        i, j = min(pairs)
        gap = float(np.linalg.norm(position[i] - position[j]))
        raise ValueError(
            f"start positions of drones {i} and {j} overlap: they are {gap:.3g} m apart, and their "
            f"collision shapes need more than "
            f"{2 * radius:.3g} m; move them or widen the spacing"
        )


def check_start_distance(max_distance: float, start_offset: float, rise: float = 0.0) -> None:
    """Check that starts are within the distance at which episodes end.

    Args:
        max_distance: Distance to the goal at which an episode ends, m.
        start_offset: Maximum offset of a start from its goal on each axis, m.
        rise: Additional vertical offset, m.

    Raises:
        ValueError: If a start can be farther than `max_distance` from its goal.
    """
    farthest = float(np.sqrt(2 * start_offset**2 + (start_offset + rise) ** 2))
    if max_distance <= farthest:
        raise ValueError(
            f"max_distance is {max_distance:g} m: starts may be {farthest:.4g} m from their goals, "
            f"by start_offset {start_offset:g} m and height {rise:g} m; raise it"
        )
