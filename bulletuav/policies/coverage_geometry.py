"""Places over points on the ground, and which drone takes which; all in the plane, m.

Places come from rings, clusters and greedy coverage.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin

ROUNDS = 100
"""Greatest number of rounds of Lloyd's iteration, which is done after some ten"""


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Measure the distances (M, K) between points (M, 2) and others (K, 2), m."""
    from scipy.spatial.distance import cdist  # which takes long to import

    found: np.ndarray = cdist(points, others)
    return found


def ring(
    centre: np.ndarray, count: int, apart: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Space places evenly on a circle, the first one east of its centre.

    The circle is moved into a rectangle, and shrunk where it must be. One place is the centre
    itself.

    Args:
        centre: (2,) centre of the circle, m.
        count: How many places.
        apart: Distance between neighbours, m.
        low: (2,) lower corner of the rectangle, m.
        high: (2,) upper corner of the rectangle, m.

    Returns:
        (count, 2) places, m.
    """
    # Neighbours are `apart` on a circle of this radius, as far as the rectangle has room.
    radius = 0.0
    if count > 1:
        largest = 0.5 * float((high - low).min())
        radius = min(0.5 * apart / sin(math.pi / count), largest)
    angle = 2 * np.pi * np.arange(count) / count
    circle = np.stack([cos(angle), sin(angle)], axis=1)
    middle = np.clip(centre, low + radius, high - radius)
    places: np.ndarray = middle + radius * circle
    return places


def farthest_first(points: np.ndarray, count: int) -> np.ndarray:
    """Take the point nearest to the mean, then each time the one farthest from those taken.

    T. Gonzalez, Clustering to minimize the maximum intercluster distance (1985).

    Args:
        points: (M, 2) points, m.
        count: How many to take; some are taken again where there are too few.

    Returns:
        (count, 2) of the points, m.
    """
    mean = points.mean(axis=0)
    from_mean = distances(points, mean[None])
    taken = [int(from_mean.argmin())]
    while len(taken) < count:
        from_taken = distances(points, points[taken])
        taken.append(int(from_taken.min(axis=1).argmax()))
    return points[taken]


def kmeans(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Find the means of clusters of points.

    S. Lloyd, Least squares quantization in PCM (1982).

    Args:
        points: (M, 2) points, m.
        centres: (K, 2) first guess of the means, m.

    Returns:
        (K, 2) means, m; one without points is where it was guessed.
    """
    for _ in range(ROUNDS):
        # Each point belongs to the nearest centre.
        nearest = distances(points, centres).argmin(axis=1)
        member = nearest == np.arange(len(centres))[:, None]
        # Each centre moves to the mean of its points, summed up in their order.
        count = member.sum(axis=1, keepdims=True)
        total = np.where(member[..., None], points, 0.0).sum(axis=1)
        means = total / np.maximum(count, 1)
        means = np.where(count > 0, means, centres)
        is_done = (means == centres).all()
        centres = means
        if is_done:
            break
    return centres


def greedy_coverage(
    serves: np.ndarray, distance: np.ndarray, places: np.ndarray, count: int, apart: float
) -> np.ndarray:
    """Take one place after the other, that which adds most to what is served.

    Each target is served by the best of the places taken. Places keep `apart` from each other as
    long as there is room. Among equals the place nearest to its targets is taken. When nothing is
    left to add, all counts again.

    Without `apart` the targets are served at least 1 - 1/e as well as by any choice: G. Nemhauser,
    L. Wolsey, M. Fisher, An analysis of approximations for maximizing submodular set functions
    (1978).

    Args:
        serves: (C, U) how well each place would serve each target, from 0 to 1.
        distance: (C, U) distance between them, m.
        places: (C, 2) places, m.
        count: How many to take.
        apart: Least distance between places, m.

    Returns:
        (count,) indices of the places taken.
    """
    taken: list[int] = []
    room = np.full(len(places), apart)
    served = np.zeros(serves.shape[1])
    while len(taken) < count:
        # Nothing is left to add: all counts again.
        if not (serves > served).any():
            served[:] = 0.0
        adds = np.maximum(serves - served, 0.0)
        # By room, then by what is added, then by distance.
        ways = (adds * distance).sum(axis=1)
        order = np.lexsort((ways, -adds.sum(axis=1), -room))
        best = int(order[0])
        taken.append(best)
        # What it serves, and how near it is, counts for the next ones.
        served = np.maximum(served, serves[best])
        from_best = distances(places, places[best][None])
        room = np.minimum(room, from_best[:, 0])
    return np.array(taken)


def best_responses(
    serves: np.ndarray, places: np.ndarray, taken: np.ndarray, apart: float
) -> np.ndarray:
    """Let each drone, in turn, leave its place for a better one.

    Better is what adds more to what the others serve. Among equals a drone takes the nearest, so
    it stays at a place that is no worse.

    Args:
        serves: (C, U) how well each place would serve each target, from 0 to 1.
        places: (C, 2) places, m.
        taken: (K,) index of the place of each drone.
        apart: Least distance between places, m.

    Returns:
        (K,) indices of the places afterwards.
    """
    taken = taken.copy()
    for i, here in enumerate(taken):
        # What this drone would add to what the others serve.
        others = np.delete(taken, i)
        served = serves[others].max(axis=0, initial=0.0)
        adds = np.maximum(serves - served, 0.0).sum(axis=1)
        from_others = distances(places, places[others])
        room = from_others.min(axis=1, initial=apart)
        # By room, then by what is added, then by the way there.
        ways = distances(places, places[here][None])
        order = np.lexsort((ways[:, 0], -adds, -room))
        taken[i] = order[0]
    return taken


def matched(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Give each drone a place, with the least sum of distances: no two ways cross.

    H. Kuhn, The Hungarian method for the assignment problem (1955).

    Args:
        places: (K, 2) places, m.
        position: (K, 2) positions of the drones, m.

    Returns:
        (K, 2) the place of each drone, m.
    """
    from scipy.optimize import linear_sum_assignment  # which takes long to import

    _, chosen = linear_sum_assignment(distances(position, places))
    given: np.ndarray = places[chosen]
    return given


def nearest_left(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Give each drone, in turn, the nearest place that is left.

    Args:
        places: (K, 2) places, m.
        position: (K, 2) positions of the drones, m.

    Returns:
        (K, 2) the place of each drone, m.
    """
    taken: list[int] = []
    for row in distances(position, places):
        row[taken] = np.inf
        taken.append(int(row.argmin()))
    return places[taken]
