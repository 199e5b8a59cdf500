"""Warm starting: contact impulses of the last substep, cached by shape and position.

Bodies at rest need the same impulses in each substep. Starting from them, the solver converges
over several substeps even for stacks and piles (E. Catto, Iterative dynamics with temporal
coherence, 2005).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import is_at_impact_limit, read_quaternion, read_vec3, write_vec3
from bulletuav.geometry.rotation import dot, minus, to_body, to_world

MAX_CACHED_POINTS = 16
"""Contact points that are cached for each drone"""
MIN_CACHED_FRACTION = 1e-4
"""Remaining fraction of a substep below which impulses, being those of an impact, are not cached"""
MATCH_DISTANCE = 0.3
"""Distance within which points on a drone match, as a fraction of its radius"""

CACHED_POINT = record_type([("other", "i8"), ("arm", "f8", 3), ("force", "f8", 3), ("free", "?")])
"""A cached contact point.

Attributes:
    other: Index of the shape that the drone touched.
    arm: Position relative to the centre of mass, in body axes, m.
    force: Impulse divided by the fraction of the substep in which it acted, in body axes, N s.
    free: Whether no contact point has used it yet.
"""


class ContactCache(NamedTuple):
    """Cached contact impulses of W worlds of N drones.

    Attributes:
        rows: (W, N, MAX_CACHED_POINTS) rows of `CACHED_POINT`, with the first drone of each pair.
        number: (W, N) number of rows in use.
    """

    rows: np.ndarray
    number: np.ndarray


def make_contact_cache(num_worlds: int, num_drones: int) -> ContactCache:
    """Create an empty contact cache."""
    rows = np.zeros((num_worlds, num_drones, MAX_CACHED_POINTS), dtype=CACHED_POINT)
    return ContactCache(rows, np.zeros((num_worlds, num_drones), dtype=np.int64))


@func
def warm_start_impulses(
    memory: ContactCache,
    motions: np.ndarray,
    radii: np.ndarray,
    w: int,
    points: np.ndarray,
    pairs: np.ndarray,
    num_points: int,
    remaining: float,
) -> None:
    """Initialise the impulse of each point with the closest cached impulse of the same pair.

    Args:
        memory: Contact cache of all worlds.
        motions: (N,) rows of `MOTION`.
        radii: Bounding radii of all shapes, m.
        w: Index of the world.
        points: Rows of `CONTACT_POINT`; impulses are written.
        pairs: Rows of `PAIR`.
        num_points: Number of points in use.
        remaining: Remaining fraction of the substep.
    """
    for k in range(num_points):
        point = points[k]
        write_vec3(point.impulse, (0.0, 0.0, 0.0))
        # No forces act on drones at the impact limit
        if is_at_impact_limit(motions[point.a]) and (
            point.b < 0 or is_at_impact_limit(motions[point.b])
        ):
            continue
        rows = memory.rows[w, point.a]
        turn = read_quaternion(motions[point.a])
        arm = to_body(turn, read_vec3(point.arm_a))
        best = -1
        best_square = (MATCH_DISTANCE * radii[point.a]) ** 2
        for m in range(memory.number[w, point.a]):
            if rows[m].other == pairs[point.pair].b and rows[m].free:
                off = minus(read_vec3(rows[m].arm), arm)
                if dot(off, off) < best_square:
                    best = m
                    best_square = dot(off, off)
        if best < 0:
            continue
        rows[best].free = False
        force = to_world(turn, read_vec3(rows[best].force))
        point.impulse[0] = max(0.0, remaining * dot(force, read_vec3(point.normal)))
        # The drone has turned since: without friction the solver could not remove a tangential part
        if point.friction == 0.0:
            continue
        point.impulse[1] = remaining * dot(force, read_vec3(point.tangent[0]))
        point.impulse[2] = remaining * dot(force, read_vec3(point.tangent[1]))


@func
def store_impulses(
    memory: ContactCache,
    motions: np.ndarray,
    w: int,
    island: np.ndarray,
    num_members: int,
    points: np.ndarray,
    pairs: np.ndarray,
    num_points: int,
    remaining: float,
) -> None:
    """Cache the impulses of an island for the next substep.

    Normal impulses are limited to what the forces on the island can require, since impulses of an
    impact do not act in the next substep.

    Args:
        memory: Contact cache of all worlds; written.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        island: (N,) drones of the island.
        num_members: Number of drones of the island.
        points: Rows of `CONTACT_POINT`.
        pairs: Rows of `PAIR`.
        num_points: Number of points in use.
        remaining: Remaining fraction of the substep.
    """
    max_impulse = 0.0
    for m in range(num_members):
        i = island[m]
        push = read_vec3(motions[i].velocity_change)
        max_impulse = max(
            max_impulse, num_members * math.sqrt(dot(push, push)) / motions[i].inverse_mass
        )
        if is_at_impact_limit(motions[i]):
            # The impulses from when forces still acted will be needed again
            for k in range(memory.number[w, i]):
                memory.rows[w, i, k].free = True
        else:
            memory.number[w, i] = 0
    if remaining < MIN_CACHED_FRACTION:
        return
    for k in range(num_points):
        point = points[k]
        num_cached = memory.number[w, point.a]
        if num_cached == MAX_CACHED_POINTS or is_at_impact_limit(motions[point.a]):
            continue
        row = memory.rows[w, point.a, num_cached]
        turn = read_quaternion(motions[point.a])
        scale = 1.0 / remaining
        if scale * point.impulse[0] > max_impulse:
            scale = max_impulse / point.impulse[0]
        normal = scale * point.impulse[0]
        one, two = scale * point.impulse[1], scale * point.impulse[2]
        force = (
            normal * point.normal[0] + one * point.tangent[0, 0] + two * point.tangent[1, 0],
            normal * point.normal[1] + one * point.tangent[0, 1] + two * point.tangent[1, 1],
            normal * point.normal[2] + one * point.tangent[0, 2] + two * point.tangent[1, 2],
        )
        row.other = pairs[point.pair].b
        write_vec3(row.arm, to_body(turn, read_vec3(point.arm_a)))
        write_vec3(row.force, to_body(turn, force))
        row.free = True
        memory.number[w, point.a] = num_cached + 1
