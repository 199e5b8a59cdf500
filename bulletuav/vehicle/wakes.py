"""Downwash between all pairs of drones of some worlds.

Most pairs are too far apart for a wake, and stay so for a while. Pairs that may interact are kept
in a Verlet list (neighbour list with a skin), which is rebuilt when a drone has moved farther than
the skin. The wakes of `WIDTH` pairs are computed in one vector operation.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_of
from bulletuav.geometry.grid import (
    MIN_POINTS,
    Grid,
    cells_around,
    clear_grid,
    fill_grid,
    is_grid_filled,
    make_point_grid,
    new_point_grid,
    num_rows,
    row_items,
    sort_ascending,
)
from bulletuav.geometry.rotation import point, quat4, to_body
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import rotor_wrench
from bulletuav.vehicle.wake import WAKE_EDGE, is_in_wake, jet, wake_width_squared

LIST_SKIN = 0.25
"""Distance that drones may move along each axis before the list of pairs is rebuilt, m"""
_ROUNDED = 1.0 + 1e-9
"""Factor that keeps pairs at the edge of a wake in the list despite rounding errors of distances"""
FAR = 1e30
"""Largest radius of a search, m"""
_WIDTH, _SQUARE, _STRENGTH, _X, _Y, _ARM = range(6)
"""Rows of `Wakes.numbers`: the arguments of `jet`, the vector to the axis, and the squared arm"""


class Wakes(NamedTuple):
    """Wakes in a group of G worlds of N drones, with scratch arrays.

    Attributes:
        felt: (G, N, 4) downward force (N) and torque about the body's axes (N m) on each drone.
        pairs: (P, 3) world of the group and indices of two drones whose wakes may interact.
        listed: (1,) number of pairs in the list.
        place: (G, N, 3) positions of the drones when the list was built, m.
        numbers: (6, `WIDTH`) inputs of the wakes of pairs that are computed together.
        below: (`WIDTH`, 2) world of the group and index of the lower drone of each of these pairs.
    """

    felt: np.ndarray
    pairs: np.ndarray
    listed: np.ndarray
    place: np.ndarray
    numbers: np.ndarray
    below: np.ndarray

    @classmethod
    def of(cls, num_worlds: int, num_drones: int) -> "Wakes":
        """Allocate arrays for a group of worlds; pairs use memory only when they are listed."""
        most = num_worlds * num_drones * (num_drones - 1) // 2
        return cls(
            felt=np.zeros((num_worlds, num_drones, 4)),
            pairs=np.zeros((most, 3), dtype=np.int32),
            listed=np.zeros(1, dtype=np.int64),
            place=np.zeros((num_worlds, num_drones, 3)),
            numbers=lane_zeros(6),
            below=np.zeros((WIDTH, 2), dtype=np.int64),
        )


@func
def _is_list_stale(position: np.ndarray, place: np.ndarray, first: int, last: int) -> bool:
    """Return True if a drone moved farther than `LIST_SKIN` since the list of pairs was built."""
    # A sum without branches, which the compiler vectorises; NaN counts as moved
    near = 0
    for w in range(first, last):
        for i in range(position.shape[1]):
            for k in range(3):
                near += abs(position[w, i, k] - place[w - first, i, k]) <= LIST_SKIN
    moved: bool = near < 3 * (last - first) * position.shape[1]
    return moved


@func
def _list_range_squared(width_squared: float, skin: float) -> float:
    """Return the squared distance beyond which a pair needs no entry in the list.

    Two drones approach each other by at most 2 sqrt(2) skins.
    """
    reach = math.sqrt(WAKE_EDGE * width_squared) + 3.0 * skin
    return reach * reach * _ROUNDED


@func
def _max_width_squared(drop: float, row: ParameterRow) -> float:
    """Return the squared width of a wake at a distance below; 0 for a drone without a wake."""
    return wake_width_squared(drop, row) if row.wake_share > 0.0 else 0.0


@func
def _has_neighbour(position: np.ndarray, w: int, i: int, edge: float) -> bool:
    """Return True if a drone of higher index is within a squared horizontal distance of drone i."""
    # A sum without branches, which the compiler vectorises
    far = 0
    for j in range(i + 1, position.shape[1]):
        dx = position[w, j, 0] - position[w, i, 0]
        dy = position[w, j, 1] - position[w, i, 1]
        far += dx * dx + dy * dy > edge
    near: bool = far < position.shape[1] - i - 1
    return near


@func
def _list_pairs(
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    world: int,
    skin: float,
    wakes: Wakes,
) -> None:
    """Add the pairs of world w to the list that may interact while no drone leaves its skin.

    Args:
        position: (W, N, 3) positions, m.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        w: Index of the world.
        world: Its index in the group.
        skin: Skin: distance that drones may move along each axis, m.
        wakes: Arrays of the group; the list is extended.
    """
    num_drones, pairs = position.shape[1], wakes.pairs
    edge = _start_list(position, alive, parameters, w, world, skin, wakes.place)
    if num_drones >= MIN_POINTS and _list_pairs_in_grid(
        position, alive, parameters, w, world, skin, edge, wakes.pairs, wakes.listed
    ):
        return
    count = wakes.listed[0]
    for i in range(num_drones):
        if not alive[w, i] or not _has_neighbour(position, w, i, edge):
            continue
        for j in range(i + 1, num_drones):
            if alive[w, j] and _may_interact(position, parameters, w, i, j, skin, edge):
                pairs[count, 0] = world
                pairs[count, 1] = i
                pairs[count, 2] = j
                count += 1
    wakes.listed[0] = count


@func
def _start_list(
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    world: int,
    skin: float,
    place: np.ndarray,
) -> float:
    """Write the positions at which the list of world w is built.

    Returns:
        Square of the range of the widest wake of this world, m^2.
    """
    lowest = np.inf
    highest = -np.inf
    for i in range(position.shape[1]):
        for k in range(3):
            place[world, i, k] = position[w, i, k]
        if alive[w, i]:
            lowest = min(lowest, position[w, i, 2])
            highest = max(highest, position[w, i, 2])
    widest = 0.0
    for i in range(position.shape[1]):
        if alive[w, i]:
            drop = highest - lowest + 3.0 * skin
            widest = max(widest, _max_width_squared(drop, parameters[w, i]))
    return _list_range_squared(widest, skin)


@func
def _may_interact(
    position: np.ndarray,
    parameters: np.ndarray,
    w: int,
    i: int,
    j: int,
    skin: float,
    edge: float,
) -> bool:
    """Return True if a drone may enter the wake of another while none leaves its skin."""
    dx = position[w, j, 0] - position[w, i, 0]
    dy = position[w, j, 1] - position[w, i, 1]
    square = dx * dx + dy * dy
    if square > edge:
        return False
    # Either drone may become the upper one
    drop = abs(position[w, j, 2] - position[w, i, 2]) + 3.0 * skin
    wide = max(
        _max_width_squared(drop, parameters[w, i]),
        _max_width_squared(drop, parameters[w, j]),
    )
    # Pairs with a NaN position are listed, too
    return bool(wide > 0.0 and not square > _list_range_squared(wide, skin))


@deferred(types.boolean)
@allocating
def _list_pairs_in_grid(
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    world: int,
    skin: float,
    edge: float,
    pairs: np.ndarray,
    listed: np.ndarray,
) -> bool:
    """Do the same as `_list_pairs` on a horizontal grid.

    Args:
        position: (W, N, 3) positions, m.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        w: Index of the world.
        world: Its index in the group.
        skin: Skin: distance that drones may move along each axis, m.
        edge: Square of the range of the widest wake, m^2.
        pairs: (P, 3) list of pairs, extended.
        listed: (1,) number of pairs in the list, increased.

    Returns:
        False if the position of an active drone is not finite; nothing is listed then.
    """
    grid = make_point_grid(position.shape[1])
    near = np.empty(position.shape[1], dtype=np.int64)
    if not _fill_flat_grid(position, alive, w, grid):
        return False
    given, low, high = (position, alive, parameters), 0, position.shape[1]
    listed[0] = _list_near_pairs(
        *given, w, world, skin, edge, grid, near, pairs, listed[0], low, high
    )
    return True


@func
def _fill_flat_grid(position: np.ndarray, alive: np.ndarray, w: int, grid: Grid) -> bool:
    """Fill a horizontal grid of the drones of world w; return False if a position is invalid."""
    for i in range(position.shape[1]):
        # A drone with an invalid height has no grid either
        grid.place[i, 0] = position[w, i, 0]
        grid.place[i, 1] = position[w, i, 1]
        grid.place[i, 2] = 0.0 * position[w, i, 2]
    return bool(fill_grid(grid, alive, w))


@kernel
def _list_near_pairs(
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    w: int,
    world: int,
    skin: float,
    edge: float,
    grid: Grid,
    near: np.ndarray,
    pairs: np.ndarray,
    total: int,
    low: int,
    high: int,
) -> int:
    """List the pairs of a filled grid whose lower index is from `low` to before `high`.

    See `_list_pairs_in_grid`; the pairs are written from index `total` on, whose end is returned.
    """
    radius = min(math.sqrt(edge), FAR)
    for i in range(low, high):
        if not alive[w, i]:
            continue
        box = cells_around(grid, point(grid.place, i), radius)
        count = 0
        for row in range(num_rows(box)):
            first, last = row_items(grid, box, row)
            for m in range(first, last):
                j = grid.item[m]
                if j > i and _may_interact(position, parameters, w, i, j, skin, edge):
                    near[count] = j
                    count += 1
        # Effects are summed in the order of the drones
        sort_ascending(near, count)
        for k in range(count):
            pairs[total, 0] = world
            pairs[total, 1] = i
            pairs[total, 2] = near[k]
            total += 1
    return total


@func
def _load_lane(
    position: np.ndarray,
    rotor_speed: np.ndarray,
    w: int,
    above: int,
    below: int,
    parameters: np.ndarray,
    numbers: np.ndarray,
    lane: int,
) -> bool:
    """Write the inputs of one drone's wake on another to a lane; return True if there is a wake.

    Args:
        position: (W, N, 3) positions, m.
        rotor_speed: (W, N, R) rotor speeds, rad/s.
        w: Index of the world.
        above: Index of the upper drone.
        below: Index of the lower drone.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        numbers: (6, `WIDTH`) array to write to.
        lane: Index of the lane.
    """
    row = parameters[w, above]
    # From the lower drone to the axis of the wake
    x = position[w, above, 0] - position[w, below, 0]
    y = position[w, above, 1] - position[w, below, 1]
    drop = position[w, above, 2] - position[w, below, 2]
    square = x * x + y * y
    # The fit of the wake is for drones: loads feel none
    if not is_in_wake(square, drop, row) or parameters[w, below].num_rotors == 0:
        return False
    thrust = rotor_wrench(rotor_speed[w, above], 0.0, row)[0]
    arm = parameters[w, below].arm
    numbers[_WIDTH, lane] = wake_width_squared(drop, row)
    numbers[_SQUARE, lane] = square
    numbers[_STRENGTH, lane] = row.wake_share * thrust * row.wake_radius
    numbers[_X, lane] = x
    numbers[_Y, lane] = y
    numbers[_ARM, lane] = arm * arm
    return True


@func
def _apply_lanes(
    quaternion: np.ndarray,
    first: int,
    count: int,
    numbers: np.ndarray,
    below: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Compute the wakes of the first `count` lanes, and add them to the lower drones."""
    lanes = lanes_of(numbers, 0)
    push, tip = jet(lanes[_SQUARE], lanes[_WIDTH], lanes[_STRENGTH])
    tip *= lanes[_ARM]
    # Torque about x and y in the world
    about_x = -tip * lanes[_Y]
    about_y = tip * lanes[_X]
    lanes[_WIDTH] = push
    lanes[_X] = about_x
    lanes[_Y] = about_y
    for lane in range(count):
        world, i = below[lane, 0], below[lane, 1]
        about = (numbers[_X, lane], numbers[_Y, lane], 0.0)
        torque = to_body(quat4(quaternion, first + world, i), about)
        felt[world, i, 0] += numbers[_WIDTH, lane]
        for k in range(3):
            felt[world, i, 1 + k] += torque[k]


@deferred(types.none)
@kernel
def sum_wakes(
    swarm: Any,
    alive: np.ndarray,
    parameters: np.ndarray,
    first: int,
    last: int,
    is_listed: bool,
    skin: float,
    wakes: Any,
) -> None:
    """Sum the wakes of all active drones of some worlds on each drone.

    Args:
        swarm: `Swarm`, state of all drones.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        first: Index of the group's first world.
        last: Index after the group's last world.
        is_listed: Whether the list was built with `LIST_SKIN` before, with the same drones alive.
        skin: `LIST_SKIN` for a list that is used again, 0 for a list that is not.
        wakes: `Wakes` of the group; `felt` is written.
    """
    position = swarm.position
    if not is_listed or _is_list_stale(position, wakes.place, first, last):
        wakes.listed[0] = 0
        for w in range(first, last):
            _list_pairs(position, alive, parameters, w, w - first, skin, wakes)
    _sum_listed(swarm, parameters, first, last, wakes)


@func
def _sum_listed(swarm: Any, parameters: np.ndarray, first: int, last: int, wakes: Any) -> None:
    """Sum the wakes of the listed pairs; see `sum_wakes`."""
    position = swarm.position
    # Read array pointers once: the compiler must assume that writes may alias them
    rotor_speed, quaternion = swarm.rotor_speed, swarm.quaternion
    felt, pairs, numbers, lower = wakes.felt, wakes.pairs, wakes.numbers, wakes.below
    for world in range(last - first):
        for i in range(position.shape[1]):
            for k in range(4):
                felt[world, i, k] = 0.0
    # In each pair the wake of the upper drone acts on the lower one
    lane = 0
    for p in range(wakes.listed[0]):
        world, above, below = pairs[p, 0], pairs[p, 1], pairs[p, 2]
        w = first + world
        if position[w, below, 2] > position[w, above, 2]:
            above, below = below, above
        if _load_lane(position, rotor_speed, w, above, below, parameters, numbers, lane):
            lower[lane, 0] = world
            lower[lane, 1] = below
            lane += 1
            if lane == WIDTH:
                _apply_lanes(quaternion, first, lane, numbers, lower, felt)
                lane = 0
    if lane > 0:
        _apply_lanes(quaternion, first, lane, numbers, lower, felt)


class WakeSearch(NamedTuple):
    """Work arrays with which several threads list the pairs of a single world.

    Each range of drones has its own range of `Wakes.pairs` at first: that of all its pairs.

    Attributes:
        grid: Horizontal grid of the drones.
        edge: (1,) square of the range of the widest wake, m^2.
        end: (N,) index after the last drone of the range that starts with this drone.
        listed: (N,) number of pairs of that range.
    """

    grid: Grid
    edge: np.ndarray
    end: np.ndarray
    listed: np.ndarray

    @classmethod
    def of(cls, num_drones: int) -> "WakeSearch":
        """Allocate arrays for a number of drones."""
        each = np.zeros((2, num_drones), dtype=np.int64)
        return cls(new_point_grid(num_drones), np.zeros(1), *each)


@func
def _first_pair(num_drones: int, i: int) -> int:
    """Return the number of pairs whose lower index is below i."""
    return i * (2 * num_drones - i - 1) // 2


@kernel
def start_pairs(
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    skin: float,
    wakes: Wakes,
    search: WakeSearch,
) -> None:
    """Start a list of the pairs of a single world; see `sum_wakes` for the arguments."""
    search.edge[0] = _start_list(position, alive, parameters, 0, 0, skin, wakes.place)
    if not _fill_flat_grid(position, alive, 0, search.grid):
        clear_grid(search.grid)


@kernel
def list_pairs_of_drones(
    low: int,
    high: int,
    position: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
    skin: float,
    wakes: Wakes,
    search: WakeSearch,
    near: np.ndarray,
) -> None:
    """List the pairs whose lower index is from `low` to before `high`; `near` (N,) is scratch."""
    if is_grid_filled(search.grid):
        first = _first_pair(alive.shape[1], low)
        given, edge = (position, alive, parameters), search.edge[0]
        end = _list_near_pairs(
            *given, 0, 0, skin, edge, search.grid, near, wakes.pairs, first, low, high
        )
        search.end[low], search.listed[low] = high, end - first


@kernel
def sum_listed_wakes(
    swarm: Any,
    alive: np.ndarray,
    parameters: np.ndarray,
    skin: float,
    wakes: Any,
    search: WakeSearch,
) -> None:
    """Join the lists of `list_pairs_of_drones` in their order, and do the same as `sum_wakes`."""
    if not is_grid_filled(search.grid):
        sum_wakes(swarm, alive, parameters, 0, 1, False, skin, wakes)
        return
    pairs, low, total, num_drones = wakes.pairs, 0, 0, alive.shape[1]
    while low < num_drones:
        first = _first_pair(num_drones, low)
        for p in range(first, first + search.listed[low]):
            for k in range(3):
                pairs[total, k] = pairs[p, k]
            total += 1
        low = search.end[low]
    wakes.listed[0] = total
    _sum_listed(swarm, parameters, 0, 1, wakes)
