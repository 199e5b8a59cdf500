"""Deep sets of single precision: features of the other entities that a drone observes.

They are those of `bulletuav.adapters.swarm_features`, with the same weights. Observations are
first encoded to rows of numbers that do not depend on weights, once for all epochs:

    own numbers | numbers of each entity, kind by kind | 1 or 0 for the presence of each entity

Without entities the features are the own numbers.
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import log1p
from bulletuav.compiled.kernel import func, kernel
from bulletuav.policies.swarm_features import APPROACH, LOOK_AHEAD, TINY, ObservationLayout
from bulletuav.training.fast.dense import BLOCK, ZERO, backward, forward

HALF = np.float32(0.5)


class Sets(NamedTuple):
    """Layout of encoded rows and features.

    Attributes:
        own: (O,) int, columns of the own numbers in an observation.
        kinds: (G, 4) int: number of entities of the kind, of their observed numbers, of their
            encoded numbers, and index of its first entity among all.
        columns: (entities, max numbers) int, columns of the numbers of each entity.
        motion: (G, 6) int, indices of relative position and velocity among the numbers of an
            entity; -1 if they are not observed.
        size: Number of outputs of the network of each entity.
        scale: Scale of the symmetric logarithm; 0 if numbers are not compressed.
    """

    own: np.ndarray
    kinds: np.ndarray
    columns: np.ndarray
    motion: np.ndarray
    size: int
    scale: float


def make_sets(layout: ObservationLayout, size: int, scale: float) -> Sets:
    """Describe the layout of an observation for compiled functions."""
    kinds: list[tuple[int, ...]] = []
    columns: list[tuple[int, ...]] = []
    motion: list[tuple[int, ...]] = []
    for kind in layout.kinds.values():
        numbers = len(kind.columns[0])
        encoded = numbers + APPROACH * bool(kind.motion)
        kinds.append((len(kind.columns), numbers, encoded, len(columns)))
        columns += list(kind.columns)
        motion.append(kind.motion or (-1,) * 6)
    wide = np.zeros((len(columns), max(map(len, columns), default=0)), dtype=np.int64)
    for row, own in zip(wide, columns, strict=True):
        row[: len(own)] = own
    return Sets(
        np.array(layout.own, dtype=np.int64),
        np.array(kinds, dtype=np.int64).reshape(-1, 4),
        wide,
        np.array(motion, dtype=np.int64).reshape(-1, 6),
        size,
        scale,
    )


def count_encoded(sets: Sets) -> int:
    """Return the number of encoded numbers of a row."""
    entities = sets.kinds[:, 0]
    return int(len(sets.own) + (entities * sets.kinds[:, 2]).sum() + entities.sum())


def count_features(sets: Sets) -> int:
    """Return the number of features of a row."""
    return len(sets.own) + 2 * sets.size * len(sets.kinds)


@func
def _compress(x: float, scale: float) -> float:
    """Return sign(x) ln(1 + scale |x|), or x if the scale is 0."""
    if scale == 0.0:
        return x
    size = log1p(scale * abs(x))
    return -size if x < 0.0 else size


@kernel
def encode(rows: np.ndarray, sets: Sets, encoded: np.ndarray) -> None:
    """Encode observations.

    Args:
        rows: (M, D) float32 observations.
        sets: Layout.
        encoded: (M, E) float32, written.
    """
    scale, own = sets.scale, len(sets.own)
    entities = sets.columns.shape[0]
    for m in range(rows.shape[0]):
        for k in range(own):
            encoded[m, k] = _compress(rows[m, sets.own[k]], scale)
        place, there = own, encoded.shape[1] - entities
        for g in range(sets.kinds.shape[0]):
            count, numbers, size, first = sets.kinds[g]
            for q in range(first, first + count):
                present = 0.0
                for k in range(numbers):
                    number = rows[m, sets.columns[q, k]]
                    present = 1.0 if number != 0.0 else present
                    encoded[m, place + k] = _compress(number, scale)
                if sets.motion[g, 0] >= 0:
                    x, y, z = (
                        float(rows[m, sets.columns[q, sets.motion[g, 0]]]),
                        float(rows[m, sets.columns[q, sets.motion[g, 1]]]),
                        float(rows[m, sets.columns[q, sets.motion[g, 2]]]),
                    )
                    u, v, w = (
                        float(rows[m, sets.columns[q, sets.motion[g, 3]]]),
                        float(rows[m, sets.columns[q, sets.motion[g, 4]]]),
                        float(rows[m, sets.columns[q, sets.motion[g, 5]]]),
                    )
                    time = -(x * u + y * v + z * w) / (u * u + v * v + w * w + TINY)
                    time = min(max(time, 0.0), LOOK_AHEAD)
                    x, y, z = x + u * time, y + v * time, z + w * time
                    at = place + numbers
                    encoded[m, at] = _compress(x, 1.0)
                    encoded[m, at + 1] = _compress(y, 1.0)
                    encoded[m, at + 2] = _compress(z, 1.0)
                    encoded[m, at + 3] = log1p(np.sqrt(x * x + y * y + z * z + TINY))
                    encoded[m, at + 4] = time / (LOOK_AHEAD / 2)
                encoded[m, there + q] = present
                place += size


class SetsWork(NamedTuple):
    """Work arrays of the features of a block.

    Attributes:
        values: (entities, 3, width, `BLOCK`) activations of the network of each entity.
        changes: (3, width, `BLOCK`) gradients.
        there: (entities, `BLOCK`) presence.
        is_used: (entities,) bool, whether an entity is present in any sample of the block.
        winner: (G, size, `BLOCK`) float32, index of the entity with the maximum.
        turned: (`BLOCK`, width).
    """

    values: np.ndarray
    changes: np.ndarray
    there: np.ndarray
    is_used: np.ndarray
    winner: np.ndarray
    turned: np.ndarray


def make_sets_work(sets: Sets) -> SetsWork:
    """Allocate the work arrays."""
    entities = len(sets.columns)
    inputs = max(sets.kinds[:, 2], default=0) + len(sets.own)
    width = max(int(inputs), sets.size) if entities else 1
    return SetsWork(
        np.zeros((entities, 3, width, BLOCK), np.float32),
        np.zeros((3, width, BLOCK), np.float32),
        np.zeros((entities, BLOCK), np.float32),
        np.zeros(entities, bool),
        np.zeros((len(sets.kinds), sets.size, BLOCK), np.float32),
        np.zeros((BLOCK, width), np.float32),
    )


@func
def compute_features(
    parameters: np.ndarray,
    sets: Sets,
    starts: np.ndarray,
    widths: np.ndarray,
    encoded: np.ndarray,
    chosen: np.ndarray,
    work: SetsWork,
    features: np.ndarray,
) -> None:
    """Compute the features of a block of samples.

    Args:
        parameters: (P,) float32.
        sets: Layout.
        starts: (G,) index of the first parameter of the network of each kind.
        widths: (G, 3) widths of these networks.
        encoded: (M, E) rows of `encode`.
        chosen: (`BLOCK`,) indices of the rows of the block.
        work: Work arrays, kept for `add_features_gradient`.
        features: (>= F, `BLOCK`) written: own numbers, and for each kind the sum over entities,
            halved, and the maximum.
    """
    own, size = len(sets.own), sets.size
    entities = sets.columns.shape[0]
    for s in range(BLOCK):
        row = encoded[chosen[s]]
        for k in range(own):
            features[k, s] = row[k]
        place, there = own, len(row) - entities
        for g in range(sets.kinds.shape[0]):
            for q in range(sets.kinds[g, 3], sets.kinds[g, 3] + sets.kinds[g, 0]):
                numbers = sets.kinds[g, 2]
                for k in range(numbers):
                    work.values[q, 0, k, s] = row[place + k]
                for k in range(own):
                    work.values[q, 0, numbers + k, s] = row[k]
                work.there[q, s] = row[there + q]
                place += numbers
    for g in range(sets.kinds.shape[0]):
        first = sets.kinds[g, 3]
        for q in range(first, first + sets.kinds[g, 0]):
            # The network of an entity that no sample has is not computed
            is_used = False
            for s in range(BLOCK):
                is_used = is_used or work.there[q, s] > ZERO
            work.is_used[q] = is_used
            if is_used:
                forward(parameters, starts[g], widths[g], work.values[q], True)
        for j in range(size):
            total, most = features[own + 2 * size * g + j], features[own + (2 * g + 1) * size + j]
            winner = work.winner[g, j]
            for s in range(BLOCK):
                total[s] = ZERO
                most[s] = np.float32(-1.0)
            for q in range(first, first + sets.kinds[g, 0]):
                each, there_q, index = work.values[q, 2, j], work.there[q], np.float32(q)
                if not work.is_used[q]:
                    for s in range(BLOCK):
                        winner[s] = index if most[s] < ZERO else winner[s]
                        most[s] = most[s] if most[s] > ZERO else ZERO
                    continue
                for s in range(BLOCK):
                    one = each[s] * there_q[s]
                    total[s] += HALF * one
                    winner[s] = index if one > most[s] else winner[s]
                    most[s] = one if one > most[s] else most[s]


@func
def add_features_gradient(
    parameters: np.ndarray,
    gradient: np.ndarray,
    sets: Sets,
    starts: np.ndarray,
    widths: np.ndarray,
    work: SetsWork,
    changes: np.ndarray,
) -> None:
    """Add the gradients of the parameters of the features.

    Args:
        parameters: (P,) float32.
        gradient: (P,) added to.
        sets: Layout.
        starts: (G,) as in `compute_features`.
        widths: (G, 3) as in `compute_features`.
        work: Work arrays after `compute_features` of the block.
        changes: (>= F, `BLOCK`) gradients of the features.
    """
    own, size = len(sets.own), sets.size
    for g in range(sets.kinds.shape[0]):
        first = sets.kinds[g, 3]
        for q in range(first, first + sets.kinds[g, 0]):
            if not work.is_used[q]:
                continue
            there, index = work.there[q], np.float32(q)
            for j in range(size):
                total, most = changes[own + 2 * size * g + j], changes[own + (2 * g + 1) * size + j]
                winner, each = work.winner[g, j], work.changes[2, j]
                for s in range(BLOCK):
                    of_most = most[s] if winner[s] == index else ZERO
                    each[s] = there[s] * (HALF * total[s] + of_most)
            backward(
                parameters,
                gradient,
                starts[g],
                widths[g],
                work.values[q],
                work.changes,
                work.turned,
                True,
                False,
            )
