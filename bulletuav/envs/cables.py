"""Cables of an airspace: attached, detached, and checked against the positions of their ends."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bulletuav.dynamics.base import Dynamics
from bulletuav.dynamics.cables import (
    FREE,
    MAX_LENGTH,
    MAX_POINT,
    MIN_LENGTH,
    WORLD,
    Cables,
    group_bodies,
    with_entries,
)
from bulletuav.errors import as_int, as_sequence, finite
from bulletuav.geometry.rotation import to_world
from bulletuav.vehicle.swarm import Swarm

TOLERANCE = 1e-6
"""Excess over the length at which a cable can be attached, m"""
Ends = tuple[tuple[int, int], np.ndarray]
"""Bodies at both ends, and the ends (2, 3) in their axes or in the world, m"""


def require_cables(dynamics: Dynamics | type[Dynamics], contacts: str | None, reason: str) -> None:
    """Check that a dynamics moves loads and has cables.

    Args:
        dynamics: The dynamics.
        contacts: Response to contacts; None for the default.
        reason: Why cables are needed, for the message.

    Raises:
        ValueError: If it does not, or if Bullet's contacts would move bodies against their cables.
    """
    if not dynamics.feels_cables:
        raise ValueError(
            f"dynamics {dynamics.name!r} has no cables and loads, but {reason}: use dynamics "
            f"'rigid_body' or 'bullet'"
        )
    if contacts == "bullet":
        raise ValueError(
            f"contacts 'bullet' ignore cables and loads, but {reason}: use contacts 'impulse'"
        )


def check_ends(
    dynamics: Dynamics, body: Any, other: Any, point: Sequence[float], other_point: Sequence[float]
) -> Ends:
    """Check and convert the ends of a cable.

    Raises:
        ValueError: If the dynamics has no cables, there is no such body, both ends have the same
            body, or a coordinate is invalid.
    """
    require_cables(dynamics, dynamics.flight.contacts, "a cable is attached")
    last = dynamics.flight.parameters.shape[1] - 1
    one = as_int("body of a cable", body, 0, last)
    two = WORLD if other is None else as_int("other body of a cable", other, 0, last)
    if one == two:
        raise ValueError(f"both ends of a cable are at body {one}: two bodies are needed")
    points = [
        [finite("point of a cable", one, -MAX_POINT, MAX_POINT) for one in as_sequence(name, of, 3)]
        for name, of in (("point", point), ("other_point", other_point))
    ]
    return (one, two), np.array(points)


def list_ends(cables: Cables, swarm: Swarm, world: int = 0) -> np.ndarray:
    """Return the ends (C, 2, 3) of the attached cables of a world, m."""
    attached = cables.body[world, :, 0] != FREE
    pairs = zip(cables.body[world, attached].tolist(), cables.point[world, attached], strict=True)
    lines = [place_ends(swarm, ((one, two), points), world) for (one, two), points in pairs]
    return np.array(lines).reshape(-1, 2, 3)


def list_all_ends(cables: Cables, swarm: Swarm, world: int = 0) -> np.ndarray:
    """Return the ends (C, 2, 3) of all entries of a world, m; NaN for those without a cable."""
    ends = np.full((*cables.body.shape[1:], 3), np.nan)
    ends[cables.body[world, :, 0] != FREE] = list_ends(cables, swarm, world)
    return ends


def measure_reach(swarm: Swarm, ends: Ends) -> float:
    """Return the distance of two ends in the first world, m."""
    here, there = place_ends(swarm, ends)
    return math.sqrt(float(((here - there) ** 2).sum()))


def place_ends(swarm: Swarm, ends: Ends, world: int = 0) -> list[np.ndarray]:
    """Return the positions of two ends in a world, m."""
    return [
        place
        if body == WORLD
        else swarm.position[world, body] + np.array(to_world(swarm.quaternion[world, body], place))
        for body, place in zip(*ends, strict=True)
    ]


def attach(dynamics: Dynamics, swarm: Swarm, ends: Ends, length: float | None) -> int:
    """Attach a cable in the first world, and return its index.

    Raises:
        ValueError: If the length is invalid, or less than the distance of the ends.
    """
    reach = measure_reach(swarm, ends)
    wanted = finite("length", max(reach, MIN_LENGTH) if length is None else length)
    if not MIN_LENGTH <= wanted <= MAX_LENGTH:
        raise ValueError(
            f"length is {wanted:g} m: a number from {MIN_LENGTH:g} to {MAX_LENGTH:g} is needed"
        )
    if reach > wanted + TOLERANCE:
        raise ValueError(
            f"length is {wanted:g} m, and the ends are {reach:.6g} m apart: use a longer cable, or "
            f"place the bodies nearer to each other"
        )
    unused = np.flatnonzero(dynamics.cables.body[0, :, 0] == FREE)
    c = int(unused[0]) if len(unused) else dynamics.cables.length.shape[1]
    if not len(unused):
        dynamics.cables = with_entries(dynamics.cables, c + 1)
    cables = dynamics.cables
    cables.body[0, c], cables.point[0, c] = ends
    cables.length[0, c], cables.is_taut[0, c], cables.tension[0, c] = max(wanted, reach), False, 0.0
    group_bodies(cables)
    return c


def detach(dynamics: Dynamics, cable: Any) -> None:
    """Remove a cable from the first world; its entry is used again.

    Raises:
        ValueError: If there is no such cable.
    """
    cables = dynamics.cables
    attached = np.flatnonzero(cables.body[0, :, 0] != FREE).tolist()
    if not attached:
        raise ValueError("there are no cables: attach one by attach_cable")
    c = as_int("cable", cable, 0, attached[-1])
    if c not in attached:
        raise ValueError(f"cable {c} is detached: use one of {attached}")
    cables.body[0, c] = FREE
    cables.is_taut[0, c], cables.tension[0, c] = False, 0.0
    group_bodies(cables)


def loosen(dynamics: Dynamics, after: Swarm, moved: np.ndarray) -> None:
    """Mark the cables of moved bodies of the first world as slack, as their ends may be closer.

    Args:
        dynamics: The dynamics with the cables.
        after: State of all bodies in the new places.
        moved: (1, N) bool.

    Raises:
        ValueError: If a cable is shorter than the new distance of its ends.
    """
    touched = list_of(dynamics.cables, moved)
    for c in touched:
        bodies, points = dynamics.cables.body[0, c], dynamics.cables.point[0, c]
        reach = measure_reach(after, ((int(bodies[0]), int(bodies[1])), points))
        length = float(dynamics.cables.length[0, c])
        if reach > length + TOLERANCE:
            raise ValueError(
                f"the ends of cable {c}, of {length:g} m, would be {reach:.6g} m apart: place the "
                f"bodies {bodies[bodies >= 0].tolist()} in one call, or detach it first"
            )
    dynamics.cables.is_taut[0, touched] = False
    dynamics.cables.tension[0, touched] = 0.0


def list_of(cables: Cables, moved: np.ndarray) -> list[int]:
    """Return the indices of the cables in the first world that have an end at a body of a mask."""
    return [
        c
        for c, pair in enumerate(cables.body[0].tolist())
        if any(end >= 0 and moved[0, end] for end in pair)
    ]
