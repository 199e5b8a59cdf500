"""Rays and the collision shapes of drones: a sphere, a cylinder along the body's z axis, or a box.

Each is convex, so a line is inside it between two points (T. Kay and J. Kajiya, Ray tracing complex scenes, 1986).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import closest_squared
from bulletuav.geometry.rotation import dot, quat4, to_body, vec3
from bulletuav.kernel import func, kernel

SPHERE, CYLINDER, BOX = range(3)


class Shape(NamedTuple):
    """`kind` SPHERE, CYLINDER or BOX; `half`: half extents of its bounding box in body axes, m."""

    kind: int
    half: tuple[float, float, float]


@func
def slab(start, change, low, high):
    """Shares t at which start + t change enters and leaves the slab from `low` to `high`; inf, -inf where it never does."""
    if change == 0.0:
        return (-np.inf, np.inf) if low <= start <= high else (np.inf, -np.inf)
    one, two = (low - start) / change, (high - start) / change
    return min(one, two), max(one, two)


@func
def inside_box(start, change, low, high):
    """Shares t between which start + t change is in the box between two corners; the first is larger where it never is."""
    enters, leaves = -np.inf, np.inf
    for k in range(3):
        one, two = slab(start[k], change[k], low[k], high[k])
        enters, leaves = max(enters, one), min(leaves, two)
    return enters, leaves


@func
def _round(along, square, outside):
    """Roots t of t^2 square + 2 t along + outside, squared distance less squared radius; inf, -inf for none."""
    if square == 0.0:
        return (-np.inf, np.inf) if outside <= 0.0 else (np.inf, -np.inf)
    root = along * along - square * outside
    if root < 0.0:
        return np.inf, -np.inf
    root = math.sqrt(root)
    return (-along - root) / square, (-along + root) / square


@func
def inside(kind, half, start, change):
    """Shares t between which start + t change (body axes) is inside the shape; the first is larger where it never is."""
    if kind == SPHERE:
        return _round(dot(start, change), dot(change, change), dot(start, start) - half[0] ** 2)
    if kind == BOX:
        return inside_box(start, change, (-half[0], -half[1], -half[2]), half)
    enters, leaves = slab(start[2], change[2], -half[2], half[2])
    along, square = start[0] * change[0] + start[1] * change[1], change[0] ** 2 + change[1] ** 2
    one, two = _round(along, square, start[0] ** 2 + start[1] ** 2 - half[0] ** 2)
    return max(enters, one), min(leaves, two)


@kernel
def meet_drones(fraction, start, end, world, swarm, mask, kind, half):
    """Lower `fraction` (M,) of rays (M, 3) in worlds (M,) to where they enter the shape of a drone of `mask` (W, N).

    kind (N,), half (N, 3) of the shapes. Drones in which a ray starts are not seen by it.
    """
    for m in range(world.shape[0]):
        w = world[m]
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            place = vec3(swarm.position, w, i)
            here = (start[m, 0] - place[0], start[m, 1] - place[1], start[m, 2] - place[2])
            there = (end[m, 0] - place[0], end[m, 1] - place[1], end[m, 2] - place[2])
            size = (half[i, 0], half[i, 1], half[i, 2])
            if closest_squared(here, there)[1] > dot(size, size):
                continue
            attitude = quat4(swarm.quaternion, w, i)
            change = (there[0] - here[0], there[1] - here[1], there[2] - here[2])
            enters, leaves = inside(
                kind[i], size, to_body(attitude, here), to_body(attitude, change)
            )
            if 0.0 <= enters <= leaves:
                fraction[m] = min(fraction[m], enters)
