"""Budgets: how long a drone needs no look at what it may touch.

Every drone has a budget: how far it may move before anything can be near. Only drones that have
used it up are looked at. Turns of a drone that flies low count as ways of its outermost points.
Budgets change no motion: no touch is possible while both of a pair have some left.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.pairs import body_distance, piece_distance
from bulletuav.contact.points import Workspace, World
from bulletuav.contact.rest import Contact
from bulletuav.contact.spin import angle_at_most
from bulletuav.contact.touch import TOUCH
from bulletuav.geometry.city_grid import NO_LAYOUT, cells_in_rectangle
from bulletuav.geometry.closest_approach import closest_squared_distances, offset
from bulletuav.geometry.minkowski import shape_margin, support_point
from bulletuav.geometry.rotation import axes, dot, minus, quat4, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

SPARE = 1e-3
"""Metres that budgets leave, beside a touch, for rounding"""
FARTHEST = 20.0
"""Greatest budget, m"""
VIEW = 5.0
"""Distance within which a city is looked at for a budget, m"""
SOON = 0.2
"""Speed that is added to those by which drones share what is between them, m/s"""


@deferred(types.float64)
@kernel
def _swept(contact: Contact, swarm: Swarm, w: int, i: int) -> float:
    """Return how far the outermost points of a drone got by its turn in a substep, at most, m."""
    before, after = quat4(contact.start.quaternion, w, i), quat4(swarm.quaternion, w, i)
    return float(contact.scenery.table.radius[i]) * angle_at_most(before, after)


@func
def is_due(contact: Contact, swarm: Swarm, alive: np.ndarray, w: int, dt: float) -> bool:
    """Take what drones moved off their budgets; tells whether the world needs a closer look."""
    found = False
    before = contact.start.position
    way = contact.speed[w] * dt
    for i in range(alive.shape[1]):
        contact.changed[w, i] = False
        if not alive[w, i]:
            continue
        if contact.asleep[w, i]:
            # Obstacles that move may come near to who sleeps
            found = found or way > 0.0
            continue
        moved = minus(vec3(swarm.position, w, i), vec3(before, w, i))
        contact.budget[w, i] -= math.sqrt(dot(moved, moved)) + way
        if contact.turns[w, i]:
            contact.budget[w, i] -= _swept(contact, swarm, w, i)
        found = found or contact.budget[w, i] < 0.0
    return found


@func
def _pace(
    swarm: Swarm,
    w: int,
    i: int,
) -> float:
    """Return the speed of a drone, and some more, as even a slow one will have, m/s."""
    velocity = vec3(swarm.velocity, w, i)
    return math.sqrt(dot(velocity, velocity)) + SOON


@deferred(types.float64)
@kernel
def _height(scenery: Scenery, swarm: Swarm, w: int, i: int) -> float:
    """Return how high the lowest point of drone i of world w is above the ground, m."""
    turn = axes(quat4(swarm.quaternion, w, i))
    lowest = support_point(scenery.table, i, turn, (0.0, 0.0, -1.0))[2] - shape_margin(
        scenery.table, i
    )
    return float(swarm.position[w, i, 2] + lowest)


@kernel
def free_way(
    scenery: Scenery,
    swarm: Swarm,
    turns: np.ndarray,
    w: int,
    i: int,
) -> float:
    """Return how far drone i of world w may move before it can touch what does not fly, m.

    Args:
        scenery: What stands.
        swarm: State of all drones.
        turns: (W, N) bool; for drone i it is set whether its turns count as ways, too.
        w: The world.
        i: The drone.
    """
    here = vec3(swarm.position, w, i)
    own = scenery.table.radius[i] + TOUCH + SPARE
    least = min(FARTHEST, here[2] - own)
    # The sphere about a drone that flies low reaches into the ground; its shape may turn there
    turns[w, i] = least < 0.0
    if turns[w, i]:
        least = _height(scenery, swarm, w, i) - TOUCH - SPARE
    # Bodies may be many: none nearer than what is known already needs its box
    for k in range(scenery.place.shape[1]):
        least = min(least, body_distance(scenery, w, k, here) - own)
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout != NO_LAYOUT and least > 0.0:
        far = min(VIEW, least) + own
        least = min(least, VIEW)
        left, right, bottom, top = cells_in_rectangle(
            city_grid, here[0] - far, here[0] + far, here[1] - far, here[1] + far
        )
        for column in range(left, right):
            for row in range(bottom, top):
                cell = column * city_grid.cells + row
                for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                    distance = piece_distance(city_grid, city_grid.item[m], here)
                    least = min(least, distance - own)
    return float(least)


@func
def are_clear(
    space: Workspace,
    world: World,
    end: Swarm,
    budget: np.ndarray,
    turns: np.ndarray,
) -> bool:
    """Tell whether the spheres about all drones to be looked at touched nothing in a substep.

    Args:
        space: Of its motions due and reach are read.
        world: The world, and the state at the beginning of the substep.
        end: State at its end.
        budget: (W, N) m; those of drones to be looked at are set to `free_way`, up to the first
            that is not clear.
        turns: See `free_way`; set with them.
    """
    w = world.w
    scenery = world.scenery
    radius = scenery.table.radius
    drones = world.alive.shape[1]
    for i in range(drones):
        motion = space.motions[i]
        if not motion.due:
            continue
        if end.position[w, i, 2] < radius[i] + TOUCH + SPARE:
            return False
        budget[w, i] = free_way(scenery, end, turns, w, i)
        if budget[w, i] < motion.reach + world.speed:
            return False
        for j in range(drones):
            if j == i or not world.alive[w, j]:
                continue
            within = radius[i] + radius[j] + TOUCH + SPARE
            before, after = offset(world.start.position, w, i, j), offset(end.position, w, i, j)
            if closest_squared_distances(before, after)[1] < within * within:
                return False
    return True


@kernel
def share_gaps(
    scenery: Scenery,
    swarm: Swarm,
    alive: np.ndarray,
    budget: np.ndarray,
    order: np.ndarray,
    w: int,
    i: int,
) -> None:
    """Share what is between drone i of world w and others out among their budgets.

    Args:
        scenery: What stands.
        swarm: State of all drones.
        alive: (W, N) bool, drones that can be touched.
        budget: (W, N) m; that of drone i is what it has without others.
        order: (N,) drones of the world by place: whoever comes first takes first.
        w: The world.
        i: The drone.
    """
    own = scenery.table.radius[i] + TOUCH + SPARE
    least = budget[w, i]
    # What is between two drones is for both, more of it for the faster one
    pace = _pace(swarm, w, i)
    for rank in range(order.shape[0]):
        j = order[rank]
        if j != i and alive[w, j]:
            gap = offset(swarm.position, w, i, j)
            left = math.sqrt(dot(gap, gap)) - own - scenery.table.radius[j]
            # Who sleeps close by something has less than nothing, which is nothing
            other = max(0.0, budget[w, j])
            if least + other > left:
                share = pace / (pace + _pace(swarm, w, j))
                # All that the other one does not have, if that is more
                least = min(least, max(share * left, left - other))
                budget[w, j] = min(budget[w, j], left - least)
    budget[w, i] = least
