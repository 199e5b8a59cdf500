"""Narrow phase of collision detection: when the pairs of the broad phase first touch.

Conservative advancement (B. Mirtich, 1996) on the engine's exact shape distances: no motion can
close a gap faster than its bound, so stepping by gap / bound skips nothing, however thin or fast.
"""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from bulletuav.dynamics.broad_phase import TOUCH, Pair, between
from bulletuav.dynamics.path import Path, inner, length
from bulletuav.engine.engine import Engine
from bulletuav.geometry.closest_approach import closest_squared
from bulletuav.geometry.rotation import Vec3, vec3
from bulletuav.kernel import func, kernel


@func
def _position_at(path: Path, w: int, i: int, time: float) -> Vec3:
    """Return where a drone is at a time, m; one that stopped stays."""
    held = min(time, path.stop[w, i]) / path.span
    piece = min(int(held), path.position.shape[0] - 2)
    share = held - piece
    one = vec3(path.position[piece], w, i)
    two = vec3(path.position[piece + 1], w, i)
    return (
        one[0] + share * (two[0] - one[0]),
        one[1] + share * (two[1] - one[1]),
        one[2] + share * (two[2] - one[2]),
    )


@func
def _gap_at(
    path: Path,
    w: int,
    i: int,
    j: int,
    time: float,
) -> Vec3:
    """Return the vector from drone i to drone j at a time, m."""
    one = _position_at(path, w, i, time)
    two = _position_at(path, w, j, time)
    return between(one, two)


@func
def _meets_held(
    path: Path,
    w: int,
    i: int,
    j: int,
    within: float,
) -> bool:
    """Tell whether two drones, which may have stopped, come closer than `within` m."""
    for piece in range(path.position.shape[0] - 1):
        begin = piece * path.span
        end = (piece + 1) * path.span
        # Cut the piece where either stops: between the cuts both move straight
        one = min(max(path.stop[w, i], begin), end)
        two = min(max(path.stop[w, j], begin), end)
        time = begin
        before = _gap_at(path, w, i, j, begin)
        for later in (min(one, two), max(one, two), end):
            if later > time:
                after = _gap_at(path, w, i, j, later)
                if closest_squared(before, after)[1] < within * within:
                    return True
                time = later
                before = after
    return False


@kernel
def _partners(
    path: Path,
    alive: np.ndarray,
    radius: np.ndarray,
    w: int,
    i: int,
) -> list[Pair]:
    """Find the drones that drone i may touch, all going as far as they do before they stop."""
    found = [(0, 0, 0) for _ in range(0)]
    for j in range(alive.shape[1]):
        within = radius[w, i] + radius[w, j] + TOUCH
        if j != i and alive[w, j] and _meets_held(path, w, i, j, within):
            found.append((w, min(i, j), max(i, j)))
    return found


def _closing_bound(
    path: Path,
    pair: Pair,
    radius: np.ndarray,
    begin: float,
    end: float,
) -> float:
    """Bound by how many metres the gap of a pair can shrink between two times within a piece.

    It is the translation of one against the other, and what the rotation of each can add.
    """
    w, one, two = pair
    piece = path.piece(begin)
    change = path.change(w, one, begin, end)
    other_change = path.change(w, two, begin, end)
    bound = length(change - other_change)
    for drone in (one, two):
        if drone >= 0 and begin < path.stop[w, drone]:
            before = path.quaternion[piece, w, drone]
            after = path.quaternion[piece + 1, w, drone]
            cosine = abs(inner(before, after))
            # No rotation moves a point by more than a diameter
            turned = min(2 * np.arccos(min(1.0, cosine)), 2.0)
            bound += float(turned * radius[w, drone])
    return bound


def first_touch(
    engine: Engine,
    path: Path,
    pair: Pair,
    radius: np.ndarray,
) -> float:
    """Find when a pair first touches, by conservative advancement.

    Args:
        engine: Engine that knows the shapes; it moves their bodies.
        path: Where both go.
        pair: World, drone and other.
        radius: (W, N) bounding spheres of the drones, m.

    Returns:
        Time in substeps; inf where they do not touch. A pair that starts in touch and parts does
        not count.
    """
    w, one, two = pair

    def gap(time: float, within: float) -> float:
        pose = path.pose(w, one, time)
        other_pose = path.pose(w, two, time)
        return engine.separation(w, pose, other_pose, within)

    breaks = path.breaks(w, (one, two))
    for begin, end in itertools.pairwise(breaks):
        time = begin
        bound = _closing_bound(path, pair, radius, time, end)
        rate = bound / (end - time)
        while time < end:
            remaining = end - time
            distance = gap(time, rate * remaining + TOUCH)
            if distance <= TOUCH:
                # In touch: it counts where they come closer, not where they part or rest
                later = end if rate * remaining <= TOUCH else time + TOUCH / rate
                if gap(later, 2 * TOUCH) < distance:
                    return time
                time = later
            elif distance >= rate * remaining:
                # Too far apart to meet within this piece
                time = end
            else:
                # As far as no motion can close the gap, and half a touch more, to arrive
                time += (distance - 0.5 * TOUCH) / rate
    return np.inf


def touches_in_order(
    path: Path,
    pairs: list[Pair],
    alive: np.ndarray,
    radius: np.ndarray,
    touch: Callable[[Pair], float],
) -> Iterator[tuple[float, Pair]]:
    """Yield touches in the order of time; after each its drones stop in the path.

    Whoever was to meet a drone that stopped, and whoever meets it now, is asked anew.

    Args:
        path: Where all go; its `stop` is written.
        pairs: Pairs of the broad phase.
        alive: (W, N) bool, drones that fly.
        radius: (W, N) bounding spheres of the drones, m.
        touch: Tells the time of a pair's touch in substeps, inf for none.

    Yields:
        Time in substeps, and the pair.
    """
    times = {pair: touch(pair) for pair in pairs}
    done: set[Pair] = set()
    while times:
        time, pair = min((time, pair) for pair, time in times.items())
        if time == np.inf:
            return
        del times[pair]
        done.add(pair)
        yield time, pair
        # Drones of the pair stay here: ask anew whoever was to meet them, or now does
        w, *ends = pair
        for drone in ends:
            if drone >= 0 and path.stop[w, drone] == np.inf:
                path.stop[w, drone] = time
                pending = [other for other in times if other[0] == w and drone in other[1:]]
                partners = _partners(path, alive, radius, w, drone)
                for met in {*pending, *partners} - done:
                    times[met] = touch(met)
