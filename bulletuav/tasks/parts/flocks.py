"""Measures of flocks: order, correlation, connectivity, cohesion and separation.

Counted drones are those of a mask, as drones that have left do not belong to a flock.

References:
    T. Vicsek et al., Novel type of phase transition in a system of self-driven particles (1995).
    R. Olfati-Saber, Flocking for multi-agent dynamic systems: algorithms and theory (2006).
    G. Vasarhelyi et al., Optimized flocking of autonomous drones in confined environments (2018).
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.grid import (
    MIN_POINTS,
    cells_around,
    fill_grid,
    make_point_grid,
    num_rows,
    row_items,
)
from bulletuav.geometry.rotation import dot, point, vec3
from bulletuav.tasks.frame import Frame

NO_GROUP = -1
"""Group of drones that are not counted"""


@allocating
def measure_directions(velocity: np.ndarray, counts: np.ndarray, min_speed: float) -> np.ndarray:
    """Return the directions of motion; a slow drone has none.

    Args:
        velocity: (W, N, 3) m/s.
        counts: (W, N) bool, drones to count.
        min_speed: Speed below which a drone has no direction, m/s.

    Returns:
        (W, N, 3) unit vectors; zeros for slow drones and those that are not counted.
    """
    out = np.zeros(velocity.shape)
    for w in range(counts.shape[0]):
        for i in range(counts.shape[1]):
            own = vec3(velocity, w, i)
            speed = math.sqrt(dot(own, own))
            if counts[w, i] and speed >= min_speed and speed > 0.0:
                for k in range(3):
                    out[w, i, k] = own[k] / speed
    return out


@allocating
def measure_order(direction: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute Vicsek's order parameter, the norm of the mean direction of motion (polarisation).

    Args:
        direction: (W, N, 3) directions of `measure_directions`.
        counts: (W, N) bool, drones to count.

    Returns:
        (W,) from 0, no common direction, to 1, all drones fly in one direction; 0 without drones.
    """
    out = np.zeros(len(counts))
    for w in range(counts.shape[0]):
        number, x, y, z = 0, 0.0, 0.0, 0.0
        for i in range(counts.shape[1]):
            if counts[w, i]:
                number += 1
                x += direction[w, i, 0]
                y += direction[w, i, 1]
                z += direction[w, i, 2]
        out[w] = math.sqrt(x * x + y * y + z * z) / max(number, 1)
    return out


@func
def _find_root(group: np.ndarray, w: int, i: int) -> int:
    """Return the first drone of a drone's group, and shorten the path to it."""
    while group[w, i] != i:
        group[w, i] = group[w, group[w, i]]
        i = group[w, i]
    return i


@func
def _link(position: np.ndarray, reach: float, group: np.ndarray, w: int, i: int, j: int) -> None:
    """Join the groups of two drones if they are within `reach`, m; the lower index is the root."""
    gap = offset(position, w, i, j)
    if dot(gap, gap) <= reach * reach:
        one, two = _find_root(group, w, i), _find_root(group, w, j)
        group[w, max(one, two)] = min(one, two)


@allocating
def find_groups(position: np.ndarray, counts: np.ndarray, reach: float) -> np.ndarray:
    """Find the connected components of the graph in which drones within `reach` are linked.

    Args:
        position: (W, N, 3) m.
        counts: (W, N) bool, drones to count.
        reach: Maximum distance of two linked drones, m.

    Returns:
        (W, N) int, index of the first drone of each drone's group; NO_GROUP if it is not counted.
    """
    drones = counts.shape[1]
    group = np.full(counts.shape, NO_GROUP)
    grid = make_point_grid(drones if drones >= MIN_POINTS else 0)
    for w in range(counts.shape[0]):
        for i in range(drones):
            if counts[w, i]:
                group[w, i] = i
        by_grid = drones >= MIN_POINTS and reach < np.inf
        if by_grid:
            grid.place[:] = position[w]
            by_grid = fill_grid(grid, counts, w)
        for i in range(drones):
            if not counts[w, i]:
                continue
            if by_grid:
                box = cells_around(grid, point(grid.place, i), reach + grid.sizes[1])
                for row in range(num_rows(box)):
                    first, last = row_items(grid, box, row)
                    for m in range(first, last):
                        if grid.item[m] < i:
                            _link(position, reach, group, w, i, grid.item[m])
                continue
            for j in range(i):
                if counts[w, j]:
                    _link(position, reach, group, w, i, j)
        for i in range(drones):
            if counts[w, i]:
                group[w, i] = _find_root(group, w, i)
    return group


def linked_groups(frame: Frame, reach: float) -> np.ndarray:
    """Return the groups of drones that flew the decision; `find_groups`, once for each frame."""
    key = f"groups of links up to {reach!r} m"
    if key not in frame.derived:
        frame.derived[key] = find_groups(frame.after.position, frame.alive, reach)
    return frame.derived[key]


@allocating
def measure_group_size(group: np.ndarray) -> np.ndarray:
    """Count the drones in the group of each drone, (W, N), from groups (W, N) of `find_groups`."""
    size = np.zeros(group.shape)
    for w in range(group.shape[0]):
        for i in range(group.shape[1]):
            if group[w, i] != NO_GROUP:
                size[w, group[w, i]] += 1.0
        # From the last to the first, as the first drone holds the number of its group
        for i in range(group.shape[1] - 1, -1, -1):
            size[w, i] = size[w, group[w, i]] if group[w, i] != NO_GROUP else 0.0
    return size


@allocating
def measure_connectivity(group: np.ndarray) -> np.ndarray:
    """Compute the relative connectivity rank(L) / (n - 1) of the graph of links (Olfati-Saber).

    The rank of the Laplacian L of n drones is n minus the number of groups.

    Args:
        group: (W, N) groups of `find_groups`.

    Returns:
        (W,) from 0, no links, to 1, one group; 1 for a single drone, 0 without drones.
    """
    out = np.zeros(len(group))
    for w in range(group.shape[0]):
        number, groups = 0, 0
        for i in range(group.shape[1]):
            if group[w, i] != NO_GROUP:
                number += 1
                groups += 1 if group[w, i] == i else 0
        if number > 0:
            out[w] = (number - groups) / (number - 1) if number > 1 else 1.0
    return out


@allocating
def measure_correlation(direction: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Compute the mean cosine of the angles to the motion of others in the group (Vasarhelyi).

    Args:
        direction: (W, N, 3) directions of `measure_directions`.
        group: (W, N) groups of `find_groups`.

    Returns:
        (W, N) from -1 to 1; 0 for a drone that is slow, alone or not counted. The mean over drones
        is the paper's phi_corr.
    """
    worlds, drones = group.shape
    out = np.zeros(group.shape)
    total = np.empty((drones, 4))
    for w in range(worlds):
        total[:] = 0.0
        for i in range(drones):
            if group[w, i] != NO_GROUP:
                total[group[w, i], 3] += 1.0
                for k in range(3):
                    total[group[w, i], k] += direction[w, i, k]
        for i in range(drones):
            if group[w, i] != NO_GROUP and total[group[w, i], 3] > 1.0:
                # The sum over the group includes the drone itself
                own = 0.0
                for k in range(3):
                    own += direction[w, i, k] * (total[group[w, i], k] - direction[w, i, k])
                out[w, i] = own / (total[group[w, i], 3] - 1.0)
    return out


def measure_velocity_variance(velocity: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute the mean squared deviation of velocities from their mean.

    Args:
        velocity: (W, N, 3) m/s.
        counts: (W, N) bool, drones to count.

    Returns:
        (W,) (m/s)^2, twice Olfati-Saber's kinetic energy per drone in the moving frame; 0 without
        drones.
    """
    return _mean(_square_deviation(velocity, counts), counts)


def measure_cohesion_radius(position: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute the maximum distance of a drone from the centre of the flock (Olfati-Saber).

    Args:
        position: (W, N, 3) m.
        counts: (W, N) bool, drones to count.

    Returns:
        (W,) m; 0 without drones.
    """
    furthest: np.ndarray = np.sqrt(_square_deviation(position, counts).max(axis=1))
    return furthest


@allocating
def measure_close_pairs(position: np.ndarray, counts: np.ndarray, distance: float) -> np.ndarray:
    """Compute the fraction of pairs closer than a distance (Vasarhelyi's phi_coll at an instant).

    Args:
        position: (W, N, 3) m.
        counts: (W, N) bool, drones to count.
        distance: m.

    Returns:
        (W,) from 0 to 1; 0 for less than two drones.
    """
    out = np.zeros(len(counts))
    for w in range(counts.shape[0]):
        pairs, close = 0, 0
        for i in range(counts.shape[1]):
            for j in range(i):
                if counts[w, i] and counts[w, j]:
                    gap = offset(position, w, i, j)
                    pairs += 1
                    close += 1 if dot(gap, gap) < distance * distance else 0
        out[w] = close / max(pairs, 1)
    return out


def measure_mean_speed(velocity: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute the mean speed of the counted drones, (W,) m/s (Vasarhelyi's phi_vel)."""
    return _mean(np.sqrt((velocity * velocity).sum(axis=-1)), counts)


def _mean(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the mean of values (W, N) over counted drones, (W,); 0 without drones."""
    mean: np.ndarray = np.where(counts, values, 0.0).sum(axis=1) / np.maximum(counts.sum(axis=1), 1)
    return mean


def _square_deviation(vectors: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return squared distances (W, N) of vectors (W, N, 3) from the mean of the counted drones."""
    number = np.maximum(counts.sum(axis=1), 1)[:, None]
    mean = np.where(counts[..., None], vectors, 0.0).sum(axis=1) / number
    away = vectors - mean[:, None]
    square: np.ndarray = np.where(counts, (away * away).sum(axis=-1), 0.0)
    return square
