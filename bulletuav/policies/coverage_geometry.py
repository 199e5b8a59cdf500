"""Hover positions above ground points, and their assignment to drones; all in the plane, m.

Positions are computed by rings, clusters and greedy coverage.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin

MAX_ITERATIONS = 100
"""Maximum number of Lloyd iterations; about ten are usually enough"""


def pairwise_distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Compute the pairwise distances (M, K) between points (M, 2) and others (K, 2), m."""
    from scipy.spatial.distance import cdist  # lazy: slow to import

    found: np.ndarray = cdist(points, others)
    return found


def ring_positions(
    centre: np.ndarray, count: int, min_spacing: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Compute evenly spaced positions on a circle, the first one east of the centre.

    The circle is shifted into a rectangle, and shrunk if necessary. A single position is the centre
    itself.

    Args:
        centre: (2,) centre of the circle, m.
        count: Number of positions.
        min_spacing: Distance between neighbours, m.
        low: (2,) lower corner of the rectangle, m.
        high: (2,) upper corner of the rectangle, m.

    Returns:
        (count, 2) positions, m.
    """
    # Radius of the circle with the requested spacing, limited by the rectangle.
    radius = 0.0
    if count > 1:
        largest = 0.5 * float((high - low).min())
        radius = min(0.5 * min_spacing / sin(math.pi / count), largest)
    angle = 2 * np.pi * np.arange(count) / count
    circle = np.stack([cos(angle), sin(angle)], axis=1)
    middle = np.clip(centre, low + radius, high - radius)
    places: np.ndarray = middle + radius * circle
    return places


def grid_positions(count: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Compute positions in rows that divide a rectangle evenly, row by row from the south-west.

    Args:
        count: Number of positions, at least 1.
        low: (2,) lower corner of the rectangle, m.
        high: (2,) upper corner of the rectangle, m.

    Returns:
        (count, 2) positions, m: the centres of equal parts of each row.
    """
    rows = round(math.sqrt(count))
    sizes = [count // rows + (row < count % rows) for row in range(rows)]
    cells = [
        ((column + 0.5) / size, (row + 0.5) / rows)
        for row, size in enumerate(sizes)
        for column in range(size)
    ]
    places: np.ndarray = low + np.array(cells) * (high - low)
    return places


def farthest_first(points: np.ndarray, count: int) -> np.ndarray:
    """Select points by farthest-first traversal, starting with the point nearest to the mean.

    References:
        T. Gonzalez, Clustering to minimize the maximum intercluster distance (1985).

    Args:
        points: (M, 2) points, m.
        count: Number of points to select; points repeat if there are too few.

    Returns:
        (count, 2) selected points, m.
    """
    mean = points.mean(axis=0)
    from_mean = pairwise_distances(points, mean[None])
    taken = [int(from_mean.argmin())]
    while len(taken) < count:
        from_taken = pairwise_distances(points, points[taken])
        taken.append(int(from_taken.min(axis=1).argmax()))
    return points[taken]


def kmeans(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Compute the k-means centres of points by Lloyd's algorithm.

    References:
        S. Lloyd, Least squares quantization in PCM (1982).

    Args:
        points: (M, 2) points, m.
        centres: (K, 2) initial centres, m.

    Returns:
        (K, 2) centres, m; the centre of an empty cluster does not move.
    """
    for _ in range(MAX_ITERATIONS):
        nearest = pairwise_distances(points, centres).argmin(axis=1)
        member = nearest == np.arange(len(centres))[:, None]
        # Sum in the order of the points, so that the result is reproducible.
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
    service: np.ndarray, distance: np.ndarray, places: np.ndarray, count: int, min_spacing: float
) -> np.ndarray:
    """Select positions greedily, each time the one with the largest marginal gain in service.

    Each target is served by the best selected position. Positions keep the minimum spacing as long
    as possible. Ties are broken by the gain-weighted distance to the targets. When no position adds
    anything, the served state is reset and the selection continues.

    Without a minimum spacing, the selection achieves at least 1 - 1/e of the optimum.

    References:
        G. Nemhauser, L. Wolsey, M. Fisher, An analysis of approximations for maximizing submodular
        set functions (1978).

    Args:
        service: (C, U) service quality of each target from each position, 0 to 1.
        distance: (C, U) distance between positions and targets, m.
        places: (C, 2) candidate positions, m.
        count: Number of positions to select.
        min_spacing: Minimum distance between positions, m.

    Returns:
        (count,) indices of the selected positions.
    """
    taken: list[int] = []
    spacing = np.full(len(places), min_spacing)
    served = np.zeros(service.shape[1])
    while len(taken) < count:
        # All targets are served as well as possible: start again.
        if not (service > served).any():
            served[:] = 0.0
        gain = np.maximum(service - served, 0.0)
        # Sort by spacing, then by gain, then by distance.
        weighted_distance = (gain * distance).sum(axis=1)
        order = np.lexsort((weighted_distance, -gain.sum(axis=1), -spacing))
        best = int(order[0])
        taken.append(best)
        served = np.maximum(served, service[best])
        from_best = pairwise_distances(places, places[best][None])
        spacing = np.minimum(spacing, from_best[:, 0])
    return np.array(taken)


def best_responses(
    service: np.ndarray, places: np.ndarray, taken: np.ndarray, min_spacing: float
) -> np.ndarray:
    """Move each drone in turn to its best position, given the positions of all others.

    The best position has the largest marginal gain over what the other drones serve. Ties are
    broken by distance, so a drone stays unless another position is strictly better.

    Args:
        service: (C, U) service quality of each target from each position, 0 to 1.
        places: (C, 2) candidate positions, m.
        taken: (K,) index of the current position of each drone.
        min_spacing: Minimum distance between positions, m.

    Returns:
        (K,) indices of the new positions.
    """
    taken = taken.copy()
    for i, here in enumerate(taken):
        # Marginal gain over the other drones.
        others = np.delete(taken, i)
        served = service[others].max(axis=0, initial=0.0)
        gain = np.maximum(service - served, 0.0).sum(axis=1)
        from_others = pairwise_distances(places, places[others])
        spacing = from_others.min(axis=1, initial=min_spacing)
        # Sort by spacing, then by gain, then by distance.
        weighted_distance = pairwise_distances(places, places[here][None])
        order = np.lexsort((weighted_distance[:, 0], -gain, -spacing))
        taken[i] = order[0]
    return taken


def assign_optimally(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Assign positions to drones with the minimum sum of distances, so that no two paths cross.

    References:
        H. Kuhn, The Hungarian method for the assignment problem (1955).

    Args:
        places: (K, 2) hover positions, m.
        position: (K, 2) positions of the drones, m.

    Returns:
        (K, 2) hover position of each drone, m.
    """
    from scipy.optimize import linear_sum_assignment  # lazy: slow to import

    _, chosen = linear_sum_assignment(pairwise_distances(position, places))
    given: np.ndarray = places[chosen]
    return given


def assign_greedily(places: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Assign to each drone in turn the nearest unassigned position.

    Args:
        places: (K, 2) hover positions, m.
        position: (K, 2) positions of the drones, m.

    Returns:
        (K, 2) hover position of each drone, m.
    """
    taken: list[int] = []
    for row in pairwise_distances(position, places):
        row[taken] = np.inf
        taken.append(int(row.argmin()))
    return places[taken]
