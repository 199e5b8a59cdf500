"""Cables between bodies of a world: their ends, lengths and tensions, and groups of tied bodies.

A cable is massless, limp and inextensible. It keeps the distance of its ends at or below its
length, and pulls only. It has no shape: drones, buildings and other cables pass through it.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.lanes import WIDTH, lane_zeros

WORLD = -1
"""Body of an end that is fixed in the world"""
FREE = -2
"""Body of both ends of an entry without a cable"""
MIN_LENGTH, MAX_LENGTH = 0.01, 1000.0
"""Minimum and maximum length of a cable, m"""
MAX_POINT = 1000.0
"""Maximum coordinate of an end in the axes of its body, m"""
KEPT = ("body", "point", "length", "is_taut", "tension")
"""Arrays of `Cables` that are in snapshots"""


class CableWork(NamedTuple):
    """Arrays that the flight of tied bodies works on, for N bodies and C cables of a world.

    Bodies are in lanes by their index: body i is lane i % `WIDTH` of block i // `WIDTH`. A further
    block stands for the world, to which ends may be fixed. The cables of a group are in lanes by
    their order in it.

    Attributes:
        now: (B + 1, 13, `WIDTH`) state of the bodies at the present stage: position, velocity,
            rates and quaternion.
        begun: The same at the begin of a Runge-Kutta step.
        slope: The time derivative of `now`.
        total: Weighted sum of the slopes of a Runge-Kutta step.
        speed: (3 B, R, `WIDTH`) rotor speeds at the begin, middle and end of the substep, rad/s.
        rotors: (3 B, 6, `WIDTH`) numbers of `Rotors` at these times.
        lift: (B,) number of rotors in ground effect of a block, if any drone has some.
        is_used: (B,) bool, blocks with bodies of the present group.
        is_block: (B,) bool, blocks with drones whose slopes are computed together.
        in_block: (N,) bool, drones whose slopes are computed with their block.
        lifted: (N,) number of rotors in ground effect.
        is_fixed: (N,) bool, bodies that do not move in this substep.
        ends: (2 L, `WIDTH`) place of the bodies at both ends of cables in the array `now`.
        number: (2 L, 1, `WIDTH`) indices of these bodies; negative for ends in the world.
        held: (2 L, 7, `WIDTH`) ends in the axes of their bodies, m, inverse masses, 1/kg, and
            inverse inertias, 1/(kg m^2); zero for bodies that do not move.
        measured: (L, 3, `WIDTH`) distance of the ends, m, its rate, m/s, and its second derivative
            at constant velocities and rates, m/s^2.
        push: (2 L, 6, `WIDTH`) force (world axes) and torque (body axes) on both bodies per
            tension.
        response: (2 L, 6, `WIDTH`) accelerations and changes of body rates per tension, 1/kg and
            1/(kg m).
        columns: (C, L, `WIDTH`) columns of the matrix: second derivatives of the distances by
            tensions, negative, 1/kg.
        matrix: (C, L `WIDTH`) the same numbers.
        factor: (C, C) factors of the matrix; see `tensions`.
        wanted: (2, L, `WIDTH`) right-hand sides.
        found: (2, C) solutions.
        listed: (C,) bool, cables in the present system of equations.
        acts: (C,) bool, listed cables that carry a tension in the present solution.
        pulls: (C,) bool, cables that carried a tension in the last solution.
        pull: (C,) mean tension of a step times its duration, N s.
    """

    now: np.ndarray
    begun: np.ndarray
    slope: np.ndarray
    total: np.ndarray
    speed: np.ndarray
    rotors: np.ndarray
    lift: np.ndarray
    is_used: np.ndarray
    is_block: np.ndarray
    in_block: np.ndarray
    lifted: np.ndarray
    is_fixed: np.ndarray
    ends: np.ndarray
    number: np.ndarray
    held: np.ndarray
    measured: np.ndarray
    push: np.ndarray
    response: np.ndarray
    columns: np.ndarray
    matrix: np.ndarray
    factor: np.ndarray
    wanted: np.ndarray
    found: np.ndarray
    listed: np.ndarray
    acts: np.ndarray
    pulls: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, num_bodies: int, num_rotors: int, num_cables: int) -> "CableWork":
        """Allocate the arrays for N bodies with R rotors and C cables; without cables for none."""
        blocks = -(-num_bodies // WIDTH) if num_cables else 0
        rows = -(-num_cables // WIDTH)
        now, begun, slope, total = (lane_zeros(blocks + 1, 13) for _ in range(4))
        now[-1, 12] = 1.0
        columns = lane_zeros(num_cables, rows)
        return cls(
            now=now,
            begun=begun,
            slope=slope,
            total=total,
            speed=lane_zeros(3 * blocks, num_rotors),
            rotors=lane_zeros(3 * blocks, 6),
            lift=np.zeros(blocks, dtype=np.int64),
            is_used=np.zeros(blocks, dtype=bool),
            is_block=np.zeros(blocks, dtype=bool),
            in_block=np.zeros(num_bodies, dtype=bool),
            lifted=np.zeros(num_bodies, dtype=np.int64),
            is_fixed=np.zeros(num_bodies, dtype=bool),
            ends=np.zeros((2 * rows, WIDTH), dtype=np.int64),
            number=lane_zeros(2 * rows, 1),
            held=lane_zeros(2 * rows, 7),
            measured=lane_zeros(rows, 3),
            push=lane_zeros(2 * rows, 6),
            response=lane_zeros(2 * rows, 6),
            columns=columns,
            matrix=columns.reshape(num_cables, rows * WIDTH),
            factor=np.zeros((num_cables, num_cables)),
            wanted=lane_zeros(2, rows),
            found=np.zeros((2, num_cables)),
            listed=np.zeros(num_cables, dtype=bool),
            acts=np.zeros(num_cables, dtype=bool),
            pulls=np.zeros(num_cables, dtype=bool),
            pull=np.zeros(num_cables),
        )


class Cables(NamedTuple):
    """Cables of W worlds of N bodies, with C entries a world.

    Attributes:
        body: (W, C, 2) indices of the bodies at both ends; `WORLD` for an end that is fixed in the
            world, `FREE` for an entry without a cable.
        point: (W, C, 2, 3) ends in the axes of their bodies, or in the world, m.
        length: (W, C) m.
        is_taut: (W, C) bool, cables that may carry a tension.
        tension: (W, C) mean tension in the last substep, with the impulses of cables that became
            taut, N.
        is_tied: (W, N) bool, bodies with a cable.
        member: (W, N) tied bodies, sorted by group.
        cable: (W, C) cables, sorted by group.
        first_member: (W, G + 1) index of the first entry of each group in `member`, and the end.
        first_cable: (W, G + 1) the same in `cable`.
        num_groups: (W,) number of groups: bodies that are connected by cables.
        work: Arrays to work on.
    """

    body: np.ndarray
    point: np.ndarray
    length: np.ndarray
    is_taut: np.ndarray
    tension: np.ndarray
    is_tied: np.ndarray
    member: np.ndarray
    cable: np.ndarray
    first_member: np.ndarray
    first_cable: np.ndarray
    num_groups: np.ndarray
    work: CableWork

    def kept(self) -> dict[str, np.ndarray]:
        """Return the arrays that snapshots need, by name; none without an entry."""
        if not self.length.shape[1]:
            return {}
        return {f"cable {name}": getattr(self, name) for name in KEPT}

    def for_thread(self) -> "Cables":
        """Return the same cables with arrays to work on for another thread."""
        sizes = (self.is_tied.shape[1], self.work.speed.shape[1], self.length.shape[1])
        return self._replace(work=CableWork.of(*sizes))


def make_cables(shape: tuple[int, int, int], num_cables: int) -> Cables:
    """Allocate C entries without cables in each world.

    Args:
        shape: (W, N, R) numbers of worlds, bodies and rotors.
        num_cables: C.
    """
    worlds, bodies, rotors = shape
    each = (worlds, num_cables)
    return Cables(
        body=np.full((*each, 2), FREE),
        point=np.zeros((*each, 2, 3)),
        length=np.ones(each),
        is_taut=np.zeros(each, dtype=bool),
        tension=np.zeros(each),
        is_tied=np.zeros((worlds, bodies), dtype=bool),
        member=np.zeros((worlds, bodies), dtype=np.int64),
        cable=np.zeros(each, dtype=np.int64),
        first_member=np.zeros((worlds, bodies + 1), dtype=np.int64),
        first_cable=np.zeros((worlds, bodies + 1), dtype=np.int64),
        num_groups=np.zeros(worlds, dtype=np.int64),
        # Groups are solved one after the other, in the same arrays
        work=CableWork.of(bodies, rotors, num_cables),
    )


def with_entries(cables: Cables, num_cables: int) -> Cables:
    """Return the same cables in arrays of `num_cables` entries a world, at least as many."""
    worlds, bodies = cables.is_tied.shape
    more = make_cables((worlds, bodies, cables.work.speed.shape[1]), num_cables)
    for name in KEPT:
        before: np.ndarray = getattr(cables, name)
        getattr(more, name)[:, : before.shape[1]] = before
    group_bodies(more)
    return more


def group_bodies(cables: Cables, worlds: Iterable[int] | None = None) -> None:
    """Find the groups of bodies that are connected by cables, and list their bodies and cables.

    Args:
        cables: The cables; their lists are written.
        worlds: Indices of the worlds; None for all.
    """
    if not cables.length.shape[1]:
        return
    for w in range(len(cables.body)) if worlds is None else worlds:
        bodies = cables.body[w]
        # Each body belongs to the group of the lowest index that it is connected to
        group = np.arange(cables.is_tied.shape[1])
        tied = np.zeros(len(group), dtype=bool)
        ends = [[end for end in pair if end >= 0] for pair in bodies.tolist()]
        for pair in ends:
            tied[pair] = True
            low = min(group[pair], default=0)
            for end in pair:
                group[group == group[end]] = low
        cables.is_tied[w] = tied
        numbers = np.unique(group[tied])
        cables.num_groups[w] = len(numbers)
        members: list[int] = []
        listed: list[int] = []
        for g, number in enumerate(numbers.tolist()):
            cables.first_member[w, g], cables.first_cable[w, g] = len(members), len(listed)
            members += np.flatnonzero(tied & (group == number)).tolist()
            listed += [c for c, pair in enumerate(ends) if pair and group[pair[0]] == number]
        cables.first_member[w, len(numbers)] = len(members)
        cables.first_cable[w, len(numbers)] = len(listed)
        cables.member[w, : len(members)] = members
        cables.cable[w, : len(listed)] = listed


def cable_bounds(num_bodies: int) -> dict[str, tuple[Any, Any]]:
    """Return the bounds of the arrays of `Cables.kept`, by name."""
    return {
        "cable body": (FREE, num_bodies - 1),
        "cable point": (-MAX_POINT, MAX_POINT),
        "cable length": (MIN_LENGTH, MAX_LENGTH),
        "cable tension": (0.0, np.inf),
    }
