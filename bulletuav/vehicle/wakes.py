"""The wakes of drones on each other, summed over the pairs of some worlds.

Most pairs are too far from each other for a wake, and stay so for a while. So those that may blow
on each other are listed once, with some leeway, and anew when a drone has moved farther than that.
What wakes do is worked out for `WIDTH` pairs at once.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_of
from bulletuav.geometry.rotation import quat4, to_body
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import rotor_wrench
from bulletuav.vehicle.wake import WAKE_EDGE, is_in_wake, jet, wake_width_squared

LEEWAY = 0.25
"""How far drones may move along each axis before pairs are listed anew, m"""
_ROUNDED = 1.0 + 1e-9
"""Factor that keeps pairs at the edge of a wake in the list, however distances are rounded"""
_WIDTH, _SQUARE, _STRENGTH, _X, _Y, _ARM = range(6)
"""Rows of `Wakes.numbers`: what `jet` takes, the way to the axis, and the arm squared"""


class Wakes(NamedTuple):
    """Wakes in a group of G worlds of N drones, and room to compute them.

    Attributes:
        felt: (G, N, 4) downward force (N) and torque about the body's axes (N m) on each drone.
        pairs: (P, 3) world of the group and indices of two drones that may blow on each other.
        listed: (1,) how many pairs are listed.
        place: (G, N, 3) where drones were when they were listed, m.
        numbers: (6, `WIDTH`) what a wake depends on, of pairs that are computed together.
        below: (`WIDTH`, 2) world of the group and index of the lower drone of each.
    """

    felt: np.ndarray
    pairs: np.ndarray
    listed: np.ndarray
    place: np.ndarray
    numbers: np.ndarray
    below: np.ndarray

    @classmethod
    def of(cls, num_worlds: int, num_drones: int) -> "Wakes":
        """Make room for a group of worlds; of pairs, only what is used takes memory."""
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
def _has_moved(position: np.ndarray, place: np.ndarray, first: int, last: int) -> bool:
    """Tell whether a drone is farther than `LEEWAY` from where it was when pairs were listed."""
    # A sum without branches, which compiles to several numbers at once; NaN counts as moved
    near = 0
    for w in range(first, last):
        for i in range(position.shape[1]):
            for k in range(3):
                near += abs(position[w, i, k] - place[w - first, i, k]) <= LEEWAY
    moved: bool = near < 3 * (last - first) * position.shape[1]
    return moved


@func
def _edge(width_squared: float, leeway: float) -> float:
    """Return the squared distance beyond which no pair feels a wake while drones have a leeway.

    Two drones come nearer to each other by at most 2 sqrt(2) leeways.
    """
    reach = math.sqrt(WAKE_EDGE * width_squared) + 3.0 * leeway
    return reach * reach * _ROUNDED


@func
def _widest_squared(drop: float, row: ParameterRow) -> float:
    """Return the square of a wake's width so far below; 0 for a drone without a wake."""
    return wake_width_squared(drop, row) if row.wake_share > 0.0 else 0.0


@func
def _has_company(
    position: np.ndarray,
    w: int,
    i: int,
    edge: float,
) -> bool:
    """Tell whether a drone of higher index is within a squared horizontal distance of drone i."""
    # A sum without branches, which compiles to several pairs at once
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
    leeway: float,
    wakes: Wakes,
) -> None:
    """List those pairs of world w that may blow on each other while no drone leaves its leeway.

    Args:
        position: (W, N, 3) positions, m.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        w: Index of the world.
        world: Its index in the group.
        leeway: How far drones may move along each axis, m.
        wakes: What is filled.
    """
    num_drones = position.shape[1]
    place, pairs = wakes.place, wakes.pairs
    lowest = np.inf
    highest = -np.inf
    for i in range(num_drones):
        for k in range(3):
            place[world, i, k] = position[w, i, k]
        if alive[w, i]:
            lowest = min(lowest, position[w, i, 2])
            highest = max(highest, position[w, i, 2])
    # How far the widest wake of this world reaches: who is farther from all others is passed over
    widest = 0.0
    for i in range(num_drones):
        if alive[w, i]:
            drop = highest - lowest + 3.0 * leeway
            widest = max(widest, _widest_squared(drop, parameters[w, i]))
    edge = _edge(widest, leeway)
    count = wakes.listed[0]
    for i in range(num_drones):
        if not alive[w, i] or not _has_company(position, w, i, edge):
            continue
        for j in range(i + 1, num_drones):
            dx = position[w, j, 0] - position[w, i, 0]
            dy = position[w, j, 1] - position[w, i, 1]
            square = dx * dx + dy * dy
            if square > edge or not alive[w, j]:
                continue
            # Either may be the upper one by then
            drop = abs(position[w, j, 2] - position[w, i, 2]) + 3.0 * leeway
            wide = max(
                _widest_squared(drop, parameters[w, i]), _widest_squared(drop, parameters[w, j])
            )
            # Also where a position is NaN, with which nobody knows how far drones will move
            if wide > 0.0 and not square > _edge(wide, leeway):
                pairs[count, 0] = world
                pairs[count, 1] = i
                pairs[count, 2] = j
                count += 1
    wakes.listed[0] = count


@func
def _take(
    position: np.ndarray,
    rotor_speed: np.ndarray,
    w: int,
    above: int,
    below: int,
    parameters: np.ndarray,
    numbers: np.ndarray,
    lane: int,
) -> bool:
    """Take what the wake of a drone on another depends on into a lane; tell whether there is one.

    Args:
        position: (W, N, 3) positions, m.
        rotor_speed: (W, N, R) rotor speeds, rad/s.
        w: Index of the world.
        above: Index of the upper drone.
        below: Index of the lower drone.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        numbers: (6, `WIDTH`) where it is written.
        lane: The lane.
    """
    row = parameters[w, above]
    # From the lower drone to the axis of the wake
    x = position[w, above, 0] - position[w, below, 0]
    y = position[w, above, 1] - position[w, below, 1]
    drop = position[w, above, 2] - position[w, below, 2]
    square = x * x + y * y
    if not is_in_wake(square, drop, row):
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
def _blow(
    quaternion: np.ndarray,
    first: int,
    count: int,
    numbers: np.ndarray,
    below: np.ndarray,
    felt: np.ndarray,
) -> None:
    """Add the wakes of the first so many lanes to what their lower drones feel."""
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
    leeway: float,
    wakes: Any,
) -> None:
    """Sum the wakes of all living drones of some worlds on each of them.

    Args:
        swarm: `Swarm`, state of all drones.
        alive: (W, N) bool.
        parameters: (W, N) rows of `parameters.PARAMETERS`.
        first: Index of the group's first world.
        last: That after its last one.
        is_listed: Whether the pairs were listed with `LEEWAY` before, with the same drones alive.
        leeway: `LEEWAY` for a list that is used again, 0 for one that is not.
        wakes: `Wakes` of the group; `felt` is filled.
    """
    position = swarm.position
    if not is_listed or _has_moved(position, wakes.place, first, last):
        wakes.listed[0] = 0
        for w in range(first, last):
            _list_pairs(position, alive, parameters, w, w - first, leeway, wakes)
    # Where arrays are is read once: what is written could be that for all the compiler knows
    rotor_speed, quaternion = swarm.rotor_speed, swarm.quaternion
    felt, pairs, numbers, lower = wakes.felt, wakes.pairs, wakes.numbers, wakes.below
    for world in range(last - first):
        for i in range(position.shape[1]):
            for k in range(4):
                felt[world, i, k] = 0.0
    # Of each pair the upper drone blows on the lower one
    lane = 0
    for p in range(wakes.listed[0]):
        world, above, below = pairs[p, 0], pairs[p, 1], pairs[p, 2]
        w = first + world
        if position[w, below, 2] > position[w, above, 2]:
            above, below = below, above
        if _take(position, rotor_speed, w, above, below, parameters, numbers, lane):
            lower[lane, 0] = world
            lower[lane, 1] = below
            lane += 1
            if lane == WIDTH:
                _blow(quaternion, first, lane, numbers, lower, felt)
                lane = 0
    if lane > 0:
        _blow(quaternion, first, lane, numbers, lower, felt)
