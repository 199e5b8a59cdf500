"""Memory of contacts: impulses of the last substep, with which the next one begins.

What rests needs the same impulses again and again. Beginning with them, sweeps over a stack or a
heap go on from substep to substep until nothing moves (warm starting: E. Catto, Iterative dynamics
with temporal coherence, 2005).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import is_at_impact_limit, read_quaternion, read_vec3, write_vec3
from bulletuav.geometry.rotation import dot, minus, to_body, to_world

MAX_CACHED_POINTS = 16
"""Points of contact that are remembered of a drone"""
MIN_CACHED_FRACTION = 1e-4
"""Rest of a substep, as a share of it, whose impulses are not remembered: they are of an impact"""
MATCH_DISTANCE = 0.3
"""Distance of points on a drone that count as one, as share of its radius"""

CACHED_POINT = record_type([("other", "i8"), ("arm", "f8", 3), ("force", "f8", 3), ("free", "?")])
"""A point of contact.

Attributes:
    other: Number of the shape that the drone touched.
    arm: Where, from the centre of mass, in axes of the drone, m.
    force: Impulse over the share of the substep in which it acted, in axes of the drone, N s.
    free: Whether no point has taken it yet.
"""


class ContactCache(NamedTuple):
    """What contacts of W worlds of N drones remember.

    Attributes:
        rows: (W, N, ROWS) rows of `CACHED_POINT`, of each pair with its first drone.
        number: (W, N) how many of them count.
    """

    rows: np.ndarray
    number: np.ndarray


def make_contact_cache(num_worlds: int, num_drones: int) -> ContactCache:
    """Make an empty memory."""
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
    size: int,
    rest: float,
) -> None:
    """Begin with the impulses that were remembered nearest to each point.

    Args:
        memory: Of all worlds.
        motions: (N,) rows of `MOTION`.
        radii: Of all shapes, m.
        w: The world.
        points: Rows of `POINT`; impulses are written.
        pairs: Rows of `PAIR`.
        size: How many points count.
        rest: Share of the substep that is left.
    """
    for k in range(size):
        point = points[k]
        write_vec3(point.impulse, (0.0, 0.0, 0.0))
        # No forces act any more on drones that are spent
        if is_at_impact_limit(motions[point.a]) and (
            point.b < 0 or is_at_impact_limit(motions[point.b])
        ):
            continue
        rows = memory.rows[w, point.a]
        turn = read_quaternion(motions[point.a])
        arm = to_body(turn, read_vec3(point.arm_a))
        best = -1
        least = (MATCH_DISTANCE * radii[point.a]) ** 2
        for m in range(memory.number[w, point.a]):
            if rows[m].other == pairs[point.pair].b and rows[m].free:
                off = minus(read_vec3(rows[m].arm), arm)
                if dot(off, off) < least:
                    best = m
                    least = dot(off, off)
        if best < 0:
            continue
        rows[best].free = False
        force = to_world(turn, read_vec3(rows[best].force))
        point.impulse[0] = max(0.0, rest * dot(force, read_vec3(point.normal)))
        # The drone has turned since: without friction no sweep would take back what is across
        if point.friction == 0.0:
            continue
        point.impulse[1] = rest * dot(force, read_vec3(point.tangent[0]))
        point.impulse[2] = rest * dot(force, read_vec3(point.tangent[1]))


@func
def store_impulses(
    memory: ContactCache,
    motions: np.ndarray,
    w: int,
    island: np.ndarray,
    members: int,
    points: np.ndarray,
    pairs: np.ndarray,
    size: int,
    rest: float,
) -> None:
    """Remember the impulses of an island, as far as its forces may need them again.

    What stopped an impact does not hold in the next substep. Arguments as those of `warm_start_impulses`.
    """
    most = 0.0
    for m in range(members):
        i = island[m]
        push = read_vec3(motions[i].velocity_change)
        most = max(most, members * math.sqrt(dot(push, push)) / motions[i].inverse_mass)
        if is_at_impact_limit(motions[i]):
            # What held it while forces acted will do so again
            for k in range(memory.number[w, i]):
                memory.rows[w, i, k].free = True
        else:
            memory.number[w, i] = 0
    if rest < MIN_CACHED_FRACTION:
        return
    for k in range(size):
        point = points[k]
        count = memory.number[w, point.a]
        if count == MAX_CACHED_POINTS or is_at_impact_limit(motions[point.a]):
            continue
        row = memory.rows[w, point.a, count]
        turn = read_quaternion(motions[point.a])
        share = 1.0 / rest
        if share * point.impulse[0] > most:
            share = most / point.impulse[0]
        normal = share * point.impulse[0]
        one, two = share * point.impulse[1], share * point.impulse[2]
        force = (
            normal * point.normal[0] + one * point.tangent[0, 0] + two * point.tangent[1, 0],
            normal * point.normal[1] + one * point.tangent[0, 1] + two * point.tangent[1, 1],
            normal * point.normal[2] + one * point.tangent[0, 2] + two * point.tangent[1, 2],
        )
        row.other = pairs[point.pair].b
        write_vec3(row.arm, to_body(turn, read_vec3(point.arm_a)))
        write_vec3(row.force, to_body(turn, force))
        row.free = True
        memory.number[w, point.a] = count + 1
