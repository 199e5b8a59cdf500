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
from bulletuav.geometry.grid import (
    PATHS,
    cells_around,
    fill_grid,
    fill_path_grid,
    num_rows,
    row_items,
    sort_ascending,
)
from bulletuav.geometry.minkowski import shape_margin, support_point
from bulletuav.geometry.rotation import axes, dot, minus, point, quat4, vec3
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

MIN_DUE = 8
"""Number of drones to be checked from which on a grid is faster than loops over all drones"""


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
    contact: ContactState,
    swarm: Swarm,
    alive: np.ndarray,
    w: int,
    dt: float,
    low: int,
    high: int,
) -> bool:
    """Subtract the motion of a substep from the budgets, and check whether any is used up.

    The motion of the fastest obstacle is subtracted, too.

    Args:
        contact: State of all contacts; `budget` is changed, and `changed` is cleared.
        swarm: State at the end of the substep.
        alive: (W, N) bool, drones that can be touched.
        w: Index of the world.
        dt: Length of the substep, s.
        low: Index of the first drone.
        high: Index after the last drone.

    Returns:
        True if the world needs contact detection in this substep: a budget is used up, or an
        obstacle moves and may reach a sleeping drone.
    """
    found = False
    before = contact.start.position
    obstacle_displacement = contact.speed[w] * dt
    for i in range(low, high):
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
    drones = world.alive.shape[1]
    if uses_grid(space) and _fill_bounds_grid(space, world, end):
        return _are_bounds_clear_in_grid(space, world, end, budget, uses_rotation)
    for i in range(drones):
        if not space.motions[i].is_due:
            continue
        if not _is_scene_clear(space, world, end, budget, uses_rotation, i):
            return False
        for j in range(drones):
            if j == i or not world.alive[w, j]:
                continue
            if _may_meet(world, end, i, j):
                return False
    return True


@func
def _is_scene_clear(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    budget: np.ndarray,
    uses_rotation: np.ndarray,
    i: int,
) -> bool:
    """Check whether drone i can touch nothing but drones; see `are_bounds_clear`."""
    w = world.w
    radius = world.scenery.table.radius
    if end.position[w, i, 2] < radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN:
        return False
    budget[w, i] = compute_budget(world.scenery, end, uses_rotation, w, i)
    return bool(budget[w, i] >= space.motions[i].range + world.obstacle_displacement)


@func
def _may_meet(world: ContactWorld, end: Swarm, i: int, j: int) -> bool:
    """Check whether the bounding spheres of two drones meet in the substep."""
    radius = world.scenery.table.radius
    within = radius[i] + radius[j] + CONTACT_DISTANCE + BUDGET_MARGIN
    before = offset(world.start.position, world.w, i, j)
    after = offset(end.position, world.w, i, j)
    return bool(closest_squared_distances(before, after)[1] < within * within)


@func
def uses_grid(space: ContactWorkspace) -> bool:
    """Check whether enough drones have to be checked that a grid is worth filling."""
    due = 0
    if space.grid.place.shape[0] > 0:
        for i in range(space.motions.shape[0]):
            due += space.motions[i].is_due
    return due >= MIN_DUE


@deferred(types.boolean)
@kernel
def _fill_bounds_grid(space: ContactWorkspace, world: ContactWorld, end: Swarm) -> bool:
    """Fill the grid of the paths of bounding spheres, whose radii are added to the reaches.

    Returns False if a position is not finite.
    """
    w, grid = world.w, space.grid
    if not fill_path_grid(grid, world.start.position, end.position, PATHS, world.alive, w):
        return False
    radius = world.scenery.table.radius
    most = 0.0
    for i in range(grid.reach.shape[0]):
        grid.reach[i] += radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN
        most = max(most, grid.reach[i])
    grid.sizes[2] = most
    return True


@deferred(types.boolean)
@kernel
def _are_bounds_clear_in_grid(
    space: ContactWorkspace,
    world: ContactWorld,
    end: Swarm,
    budget: np.ndarray,
    uses_rotation: np.ndarray,
) -> bool:
    """Return the same as `are_bounds_clear`, from the grid of `_fill_bounds_grid`."""
    grid = space.grid
    for i in range(world.alive.shape[1]):
        if not space.motions[i].is_due:
            continue
        if not _is_scene_clear(space, world, end, budget, uses_rotation, i):
            return False
        box = cells_around(grid, point(grid.place, i), grid.reach[i] + grid.sizes[2])
        for row in range(num_rows(box)):
            first, last = row_items(grid, box, row)
            for m in range(first, last):
                if grid.item[m] != i and _may_meet(world, end, i, grid.item[m]):
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
    least = budget[w, i]
    # The faster drone gets the larger fraction of the distance between two drones
    speed = _compute_share_speed(swarm, w, i)
    for rank in range(order.shape[0]):
        j = order[rank]
        if j != i and alive[w, j]:
            left = _compute_gap(scenery, swarm, w, i, j)
            # The budget of a drone that sleeps close to something is negative: count it as zero
            if least + max(0.0, budget[w, j]) > left:
                least = _share_gap(swarm, budget, w, j, left, speed, least)
    budget[w, i] = least


@func
def _compute_gap(scenery: Scenery, swarm: Swarm, w: int, i: int, j: int) -> float:
    """Return the distance between the bounding spheres of two drones, less margins, m."""
    own = scenery.table.radius[i] + CONTACT_DISTANCE + BUDGET_MARGIN
    between = offset(swarm.position, w, i, j)
    return float(math.sqrt(dot(between, between)) - own - scenery.table.radius[j])


@func
def _share_gap(
    swarm: Swarm, budget: np.ndarray, w: int, j: int, left: float, speed: float, least: float
) -> float:
    """Divide the distance to drone j, m, and reduce its budget.

    Args:
        swarm: State of all drones.
        budget: (W, N) m; that of drone j may be reduced.
        w: Index of the world.
        j: Index of the other drone.
        left: The distance, m.
        speed: Speed of the drone that takes its part, see `_compute_share_speed`, m/s.
        least: Its budget so far, m.

    Returns:
        Its new budget, m.
    """
    other = max(0.0, budget[w, j])
    fraction = speed / (speed + _compute_share_speed(swarm, w, j))
    # Use all that the other drone does not need, if that is more
    least = min(least, max(fraction * left, left - other))
    budget[w, j] = min(budget[w, j], left - least)
    return least


@deferred(types.boolean)
@kernel
def share_budgets_in_grid(
    space: ContactWorkspace, world: ContactWorld, swarm: Swarm, budget: np.ndarray
) -> bool:
    """Do the same as `share_budgets` for all checked drones, in the order of their ranks.

    Returns False, and changes nothing, if a position is not finite.
    """
    w, grid, near = world.w, space.grid, space.near
    radius = world.scenery.table.radius
    for i in range(grid.place.shape[0]):
        here = vec3(swarm.position, w, i)
        for k in range(3):
            grid.place[i, k] = here[k]
    if not fill_grid(grid, world.alive, w):
        return False
    # Budgets only decrease: a drone farther than the largest of them has no effect
    most = 0.0
    for i in range(grid.place.shape[0]):
        if world.alive[w, i]:
            most = max(most, radius[i] + max(0.0, budget[w, i]))
    most += CONTACT_DISTANCE + BUDGET_MARGIN + grid.sizes[1]
    for rank in range(grid.place.shape[0]):
        i = space.order[rank]
        if not (space.motions[i].is_due and world.alive[w, i]):
            continue
        least = budget[w, i]
        box = cells_around(grid, point(grid.place, i), radius[i] + max(0.0, least) + most)
        count = 0
        for row in range(num_rows(box)):
            first, last = row_items(grid, box, row)
            for m in range(first, last):
                j = grid.item[m]
                left = _compute_gap(world.scenery, swarm, w, i, j)
                if j != i and least + max(0.0, budget[w, j]) > left:
                    near[count] = space.rank[j]
                    count += 1
        sort_ascending(near, count)
        speed = _compute_share_speed(swarm, w, i)
        for k in range(count):
            j = space.order[near[k]]
            left = _compute_gap(world.scenery, swarm, w, i, j)
            if least + max(0.0, budget[w, j]) > left:
                least = _share_gap(swarm, budget, w, j, left, speed, least)
        budget[w, i] = least - world.obstacle_displacement
    return True
