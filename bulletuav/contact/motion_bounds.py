"""Motion bounds: skip drones that cannot reach anything.

Each drone has a motion budget: the distance that it may move before it can touch anything. Only
drones whose budget is used up are checked. For a drone close to the ground, rotation uses up
budget, too: as much as its outermost point can move. Budgets do not change any motion, because no
contact is possible while both bodies of a pair have budget left.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.broad_phase import bound_body_distance, compute_piece_distance
from bulletuav.contact.contact_state import ContactState
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld
from bulletuav.contact.spin import bound_angle
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.geometry.city_grid import NO_LAYOUT, cells_in_rectangle
from bulletuav.geometry.closest_approach import closest_squared_distances, offset
from bulletuav.geometry.minkowski import shape_margin, support_point
from bulletuav.geometry.rotation import axes, dot, minus, quat4, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

BUDGET_MARGIN = 1e-3
"""Distance that budgets leave beyond `CONTACT_DISTANCE` for rounding errors, m"""
MAX_BUDGET = 20.0
"""Largest budget, m"""
MAX_CITY_RANGE = 5.0
"""Distance within which buildings are searched for a budget, m"""
SHARE_SPEED_OFFSET = 0.2
"""Speed added to the speeds by which two drones divide the distance between them, m/s"""


@deferred(types.float64)
@kernel
def _bound_rotation_sweep(contact: ContactState, swarm: Swarm, w: int, i: int) -> float:
    """Return an upper bound of the distance that any point of a drone moves by rotation, m.

    The rotation is that of one substep, from `contact.start` to `swarm`.
    """
    before, after = quat4(contact.start.quaternion, w, i), quat4(swarm.quaternion, w, i)
    return float(contact.scenery.table.radius[i]) * bound_angle(before, after)


@func
def update_budgets(
    contact: ContactState, swarm: Swarm, alive: np.ndarray, w: int, dt: float
) -> bool:
    """Subtract the motion of a substep from the budgets, and check whether any is used up.

    The motion of the fastest obstacle is subtracted, too.

    Args:
        contact: State of all contacts; `budget` is changed, and `changed` is cleared.
        swarm: State at the end of the substep.
        alive: (W, N) bool, drones that can be touched.
        w: Index of the world.
        dt: Length of the substep, s.

    Returns:
        True if the world needs contact detection in this substep: a budget is used up, or an
        obstacle moves and may reach a sleeping drone.
    """
    found = False
    before = contact.start.position
    obstacle_displacement = contact.speed[w] * dt
    for i in range(alive.shape[1]):
        contact.changed[w, i] = False
        if not alive[w, i]:
            continue
        if contact.asleep[w, i]:
            # A moving obstacle may reach a sleeping drone
            found = found or obstacle_displacement > 0.0
            continue
        moved = minus(vec3(swarm.position, w, i), vec3(before, w, i))
        contact.budget[w, i] -= math.sqrt(dot(moved, moved)) + obstacle_displacement
        if contact.uses_rotation[w, i]:
            contact.budget[w, i] -= _bound_rotation_sweep(contact, swarm, w, i)
        found = found or contact.budget[w, i] < 0.0
    return found


@func
def _compute_share_speed(swarm: Swarm, w: int, i: int) -> float:
    """Return the speed of a drone plus `SHARE_SPEED_OFFSET`, m/s: a slow drone may speed up."""
    velocity = vec3(swarm.velocity, w, i)
    return math.sqrt(dot(velocity, velocity)) + SHARE_SPEED_OFFSET


@deferred(types.float64)
@kernel
def _compute_lowest_height(scenery: Scenery, swarm: Swarm, w: int, i: int) -> float:
    """Return the height of the lowest point of drone i of world w above the ground, m."""
    turn = axes(quat4(swarm.quaternion, w, i))
    lowest = support_point(scenery.table, i, turn, (0.0, 0.0, -1.0))[2] - shape_margin(
        scenery.table, i
    )
    return float(swarm.position[w, i, 2] + lowest)


@kernel
def compute_budget(
    scenery: Scenery, swarm: Swarm, uses_rotation: np.ndarray, w: int, i: int
) -> float:
    """Compute how far drone i of world w may move until it can touch anything but drones, m.

    Args:
        scenery: Shapes of the worlds.
        swarm: State of all drones.
        uses_rotation: (W, N) bool; the entry of drone i is set to whether rotation uses up its
            budget.
        w: Index of the world.
        i: Index of the drone.
    """
    here = vec3(swarm.position, w, i)
    own = scenery.table.radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN
    least = min(MAX_BUDGET, here[2] - own)
    # Close to the ground the bounding sphere overlaps it: use the lowest point instead
    uses_rotation[w, i] = least < 0.0
    if uses_rotation[w, i]:
        least = _compute_lowest_height(scenery, swarm, w, i) - CONTACT_DISTANCE - BUDGET_MARGIN
    for k in range(scenery.place.shape[1]):
        least = min(least, bound_body_distance(scenery, w, k, here) - own)
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout != NO_LAYOUT and least > 0.0:
        far = min(MAX_CITY_RANGE, least) + own
        least = min(least, MAX_CITY_RANGE)
        left, right, bottom, top = cells_in_rectangle(
            city_grid, here[0] - far, here[0] + far, here[1] - far, here[1] + far
        )
        for column in range(left, right):
            for row in range(bottom, top):
                cell = column * city_grid.cells + row
                for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                    distance = compute_piece_distance(city_grid, city_grid.item[m], here)
                    least = min(least, distance - own)
    return float(least)


@func
def are_bounds_clear(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    budget: np.ndarray,
    uses_rotation: np.ndarray,
) -> bool:
    """Check whether no drone to be checked can touch anything in a substep.

    This is so if their bounding spheres stay away from the ground, obstacles, buildings and the
    bounding spheres of other drones.

    Args:
        space: Arrays to work on; of its motions, `is_due` (the drone has to be checked) and `range`
            (the distance that it may move, m) are read.
        world: The world, with the state at the beginning of the substep.
        end: State at the end of the substep.
        budget: (W, N) m; set to `compute_budget` for the checked drones, up to the first that may
            touch something.
        uses_rotation: (W, N) bool; set together with the budget, see `compute_budget`.
    """
    w = world.w
    scenery = world.scenery
    radius = scenery.table.radius
    drones = world.alive.shape[1]
    for i in range(drones):
        motion = space.motions[i]
        if not motion.is_due:
            continue
        if end.position[w, i, 2] < radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN:
            return False
        budget[w, i] = compute_budget(scenery, end, uses_rotation, w, i)
        if budget[w, i] < motion.range + world.obstacle_displacement:
            return False
        for j in range(drones):
            if j == i or not world.alive[w, j]:
                continue
            within = radius[i] + radius[j] + CONTACT_DISTANCE + BUDGET_MARGIN
            before, after = offset(world.start.position, w, i, j), offset(end.position, w, i, j)
            if closest_squared_distances(before, after)[1] < within * within:
                return False
    return True


@kernel
def share_budgets(
    scenery: Scenery,
    swarm: Swarm,
    alive: np.ndarray,
    budget: np.ndarray,
    order: np.ndarray,
    w: int,
    i: int,
) -> None:
    """Divide the distances between drone i of world w and the other drones among their budgets.

    The faster drone of a pair gets the larger fraction. Drone i also takes what the other drone
    does not need.

    Args:
        scenery: Shapes of the worlds.
        swarm: State of all drones.
        alive: (W, N) bool, drones that can be touched.
        budget: (W, N) m; all budgets are read, that of drone i being the one without other drones;
            all may be reduced.
        order: (N,) drones of the world sorted by position; earlier drones take their part first.
        w: Index of the world.
        i: Index of the drone.
    """
    own = scenery.table.radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN
    least = budget[w, i]
    # The faster drone gets the larger fraction of the distance between two drones
    speed = _compute_share_speed(swarm, w, i)
    for rank in range(order.shape[0]):
        j = order[rank]
        if j != i and alive[w, j]:
            between = offset(swarm.position, w, i, j)
            left = math.sqrt(dot(between, between)) - own - scenery.table.radius[j]
            # The budget of a drone that sleeps close to something is negative: count it as zero
            other = max(0.0, budget[w, j])
            if least + other > left:
                fraction = speed / (speed + _compute_share_speed(swarm, w, j))
                # Use all that the other drone does not need, if that is more
                least = min(least, max(fraction * left, left - other))
                budget[w, j] = min(budget[w, j], left - least)
    budget[w, i] = least
