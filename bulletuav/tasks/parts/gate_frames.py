"""Frames of gates as solids: which passages share a frame, and which frames intersect."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.compiled.functions import atan2, tan
from bulletuav.geometry.rotation import axes
from bulletuav.tasks.parts.gates import Gate, bar_poses, gate_axes

SAME = 1e-6
"""Tolerance of positions, m, and directions, rad, within which two gates are one"""
TOUCH = 1e-9
"""Penetration up to which solids only touch, m"""


def find_frames(gates: Sequence[Gate]) -> np.ndarray:
    """Return the frames of gates; gates with the same place, shape, size and bars share a frame.

    Gates may share a frame in the same or in the opposite direction.

    Returns:
        (G,) index of the first gate with the same frame.
    """
    position = np.array([gate.position for gate in gates])
    axis = gate_axes(gates)
    first = np.arange(len(gates))
    for k, gate in enumerate(gates):
        near = (np.abs(position[:k] - position[k]) <= SAME).all(axis=1)
        for other in np.flatnonzero(near & (first[:k] == np.arange(k))).tolist():
            like = gates[other]
            is_like = (like.shape, like.size, like.bar) == (gate.shape, gate.size, gate.bar)
            if is_like and _is_same_frame(axis[other], axis[k], gate.sides):
                first[k] = other
                break
    return first


def _is_same_frame(one: np.ndarray, two: np.ndarray, sides: int) -> bool:
    """Return True if the axes (3, 3) of two concentric gates are those of the same frame."""
    forward = one[0] @ np.array([two[0], two[1]]).T
    turn = float(atan2(two[1] @ one[2], two[1] @ one[1])) * sides / (2 * math.pi)
    is_parallel = abs(abs(forward[0]) - 1) <= SAME**2 + TOUCH and abs(forward[1]) <= SAME
    return bool(is_parallel and abs(turn - round(turn)) <= SAME)


def make_bars(gate: Gate, motion: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the bars of a gate as zonotopes, swept by its oscillation.

    Args:
        gate: The gate.
        motion: Amplitude of the oscillation along its y axis, m.

    Returns:
        (B, 3) centres and (B, 4, 3) generators, m: a bar is its centre plus the sums of fractions
        from -1 to 1 of its generators.
    """
    _, offset, turn = bar_poses([gate])
    length = (gate.size + 2 * gate.bar) * float(tan(math.pi / gate.sides))
    half = 0.5 * np.array((gate.bar, gate.bar, length))
    bars = np.array([half[:, None] * np.array(axes(tuple(one))) for one in turn.tolist()])
    aside = np.broadcast_to(motion * gate_axes([gate])[0, 1], (len(bars), 1, 3))
    return np.array(gate.position) + offset, np.concatenate([bars, aside], axis=1)


def do_intersect(
    centre: np.ndarray, generators: np.ndarray, others: np.ndarray, their_generators: np.ndarray
) -> bool:
    """Return True if any zonotope of one set penetrates any of another set.

    Two zonotopes are disjoint if their centres are further apart than their extents along the
    normal of a face of their Minkowski difference, which is the cross product of two generators.

    Args:
        centre: (A, 3) centres of the first set, m.
        generators: (A, M, 3) generators of the first set, m.
        others: (B, 3) centres of the second set, m.
        their_generators: (B, N, 3) generators of the second set, m.

    References:
        C. Ericson, "Real-Time Collision Detection", 2005, 5.2.1 (separating axes).
    """
    offset = (others - centre[:, None]).reshape(-1, 3)
    shape = (len(centre), len(others))
    mine = np.broadcast_to(generators[:, None], (*shape, *generators.shape[1:]))
    theirs = np.broadcast_to(their_generators, (*shape, *their_generators.shape[1:]))
    both = np.concatenate([mine, theirs], axis=2).reshape(len(offset), -1, 3)
    one, two = np.triu_indices(both.shape[1], 1)
    normal = np.cross(both[:, one], both[:, two])
    length = np.sqrt((normal**2).sum(axis=-1))
    distance = np.abs(np.einsum("pnk,pk->pn", normal, offset))
    extent = np.abs(np.einsum("pnk,pgk->png", normal, both)).sum(axis=-1)
    is_apart = (distance >= extent - TOUCH * length) & (length > TOUCH**2)
    return not is_apart.any(axis=1).all()
