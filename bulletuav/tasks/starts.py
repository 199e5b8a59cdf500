"""Checks of starts, and of places that users give."""

from typing import Any

import numpy as np

from bulletuav.errors import numbers_of, shown
from bulletuav.tasks.base import Task
from bulletuav.tasks.given import PLACES, GivenPositions


def read_given_positions(
    task: Task[Any], start: object = None, goal: object = None
) -> GivenPositions:
    """Take places that users give, and refuse those that cannot be.

    Args:
        task: The task.
        start: (N, 3) numbers, m; None to have starts drawn.
        goal: The same of goals.

    Raises:
        ValueError: The task takes no such places, or they are no finite positions inside the arena,
            one for each drone; they are in a building, or starts overlap.
    """
    places = {}
    for name, value in zip(PLACES, (start, goal), strict=True):
        if value is None:
            continue
        # Not every task lets places be chosen
        if name not in task.places:
            remedy = " or ".join(task.places) or "nothing"
            raise ValueError(f"{name} cannot be given in task {task.name!r}: {remedy} can")
        places[name] = _read_positions(task, name, value)
    # Who starts in the air must not touch the ground
    if "start" in places and not task.takes_off:
        lowest = float(places["start"][:, 2].min())
        if lowest <= task.context.collision_radius:
            raise ValueError(
                f"start is {lowest:g} m up at its lowest: drones touch the ground there; more than "
                f"{task.context.collision_radius:.3g} m is needed; or choose take_off=True"
            )
    if "start" in places:
        check_overlap(places["start"], task.context.collision_radius)
    return GivenPositions(**places)


def _read_positions(task: Task[Any], name: str, value: object) -> np.ndarray:
    """Return an option as positions (N, 3), m, and refuse all but those in the free."""
    drones = task.context.num_drones
    # Anything may be given: numbers first, then their shape
    try:
        positions = numbers_of(f"{name} is", value)
    except ValueError:
        positions = np.empty(0)
    if positions.shape != (drones, 3) or not np.isfinite(positions).all():
        raise ValueError(
            f"{name} is {shown(value)}: {drones} finite positions (x, y, z) in metres are needed"
        )
    # Heights of those who take off follow from the airframe
    if name == "start" and task.takes_off:
        positions = task.on_ground(positions)
    # Inside the arena, and outside of all buildings that an episode may have
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
                    f"{name} of drone {i} is {tuple(place.tolist())}: that is inside a building, "
                    f"or in touch with it, in layout {layout}; choose a place outdoors"
                )
    return positions


def check_overlap(position: np.ndarray, radius: float) -> None:
    """Raise ValueError when two of (N, 3) positions are closer than two collision radii."""
    if len(position) < 2:
        return
    from scipy.spatial import cKDTree  # which takes long to import

    pairs = cKDTree(position).query_pairs(2 * radius)
    if pairs:
        i, j = min(pairs)
        gap = float(np.linalg.norm(position[i] - position[j]))
        raise ValueError(
            f"start positions of drones {i} and {j} overlap: {gap:.3g} m apart, their collision "
            f"shapes need more than "
            f"{2 * radius:.3g} m; move them or widen the spacing"
        )


def check_start_distance(max_distance: float, start_offset: float, rise: float = 0.0) -> None:
    """Refuse starts that are too far from the goal.

    Args:
        max_distance: Distance at which an episode ends, m.
        start_offset: How far starts may be from the goal on each axis, m.
        rise: By how much they are below it or above beside that, m.

    Raises:
        ValueError: They can be farther away than `max_distance`.
    """
    farthest = float(np.sqrt(2 * start_offset**2 + (start_offset + rise) ** 2))
    if max_distance <= farthest:
        raise ValueError(
            f"max_distance is {max_distance:g} m: starts may be {farthest:.4g} m from their goals, "
            f"by start_offset {start_offset:g} m and height {rise:g} m; raise it"
        )
