"""Where to hover over points on the ground: rings, clusters, greedy coverage; and who hovers where. All in the plane, m."""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

ROUNDS = 100  # of Lloyd's iteration, which is done after some ten


def ring(
    centre: np.ndarray, count: int, apart: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """(count, 2) places about `centre` (2,), evenly on a circle whose neighbours are `apart`, the first one east of it.

    The circle is moved, and where it must be shrunk, into the rectangle with corners `low`, `high` (2,). One place is the
    centre itself.
    """
    radius = (
        0.0
        if count == 1
        else min(0.5 * apart / math.sin(math.pi / count), 0.5 * float((high - low).min()))
    )
    angle = 2 * np.pi * np.arange(count) / count
    return np.clip(centre, low + radius, high - radius) + radius * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )


def farthest_first(points: np.ndarray, count: int) -> np.ndarray:
    """(count, 2) of the points (M, 2): the one nearest to their mean, then each time the one farthest from those taken.

    T. Gonzalez, Clustering to minimize the maximum intercluster distance (1985). Repeats points where there are too few.
    """
    taken = [int(cdist(points, points.mean(axis=0)[None]).argmin())]
    while len(taken) < count:
        taken.append(int(cdist(points, points[taken]).min(axis=1).argmax()))
    return points[taken]


def kmeans(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(K, 2) means of K clusters of the points (M, 2), found from `centres` (K, 2); one without points stays.

    S. Lloyd, Least squares quantization in PCM (1982).
    """
    for _ in range(ROUNDS):
        nearest = cdist(points, centres).argmin(axis=1)
        member = nearest == np.arange(len(centres))[:, None]
        count = member.sum(axis=1, keepdims=True)
        before, centres = (
            centres,
            np.where(count > 0, member @ points / np.maximum(count, 1), centres),
        )
        if (centres == before).all():
            break
    return centres


def greedy_coverage(
    serves: np.ndarray, distance: np.ndarray, places: np.ndarray, count: int, apart: float
) -> np.ndarray:
    """(count,) indices of places (C, 2), one after the other that which adds most; among equals the nearest to its targets.

    `serves` (C, U): how well, from 0 to 1, each place would serve each target, which the best of those taken serves;
    `distance` (C, U) between them. Places keep `apart` from each other as long as there is room. When nothing is left to
    add, all counts again. Without `apart` the targets are served at least 1 - 1/e as well as by any choice: G. Nemhauser,
    L. Wolsey, M. Fisher, An analysis of approximations for maximizing submodular set functions (1978).
    """
    taken: list[int] = []
    room, served = np.full(len(places), apart), np.zeros(serves.shape[1])
    while len(taken) < count:
        if not (serves > served).any():
            served[:] = 0.0
        adds = np.maximum(serves - served, 0.0)
        best = int(np.lexsort(((adds * distance).sum(axis=1), -adds.sum(axis=1), -room))[0])
        taken.append(best)
        served = np.maximum(served, serves[best])
        room = np.minimum(room, cdist(places, places[best][None])[:, 0])
    return np.array(taken)


def best_responses(
    serves: np.ndarray, places: np.ndarray, taken: np.ndarray, apart: float
) -> np.ndarray:
    """(K,) indices of places (C, 2) after each of K drones, in turn, left its one of `taken` (K,) for a better one.

    Better is what adds more to what the others serve; among equals it takes the nearest, so it stays at no worse a
    place. `serves` and `apart` are those of `greedy_coverage`.
    """
    taken = taken.copy()
    for i, here in enumerate(taken):
        others = np.delete(taken, i)
        adds = np.maximum(serves - serves[others].max(axis=0, initial=0.0), 0.0).sum(axis=1)
        room = cdist(places, places[others]).min(axis=1, initial=apart)
        taken[i] = np.lexsort((cdist(places, places[here][None])[:, 0], -adds, -room))[0]
    return taken


def matched(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The places (K, 2), one for each of K drones at `position` (K, 2), with the least sum of distances: no two ways cross.

    H. Kuhn, The Hungarian method for the assignment problem (1955).
    """
    return places[linear_sum_assignment(cdist(position, places))[1]]


def nearest_left(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The places (K, 2), one for each of K drones at `position` (K, 2): in turn each takes the nearest that is left."""
    taken: list[int] = []
    for row in cdist(position, places):
        row[taken] = np.inf
        taken.append(int(row.argmin()))
    return places[taken]
