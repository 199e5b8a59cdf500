"""Contacts of drones: where they stop, what they touch, and what the engine would have missed.

In the dynamics that Bullet does not integrate a drone stops at its first touch and never passes
through. In `bullet`, `catch_fast` puts drones back that would have jumped over a contact. Both use
the broad phase and, for the few pairs that it finds, the exact time of the first touch.
"""

import numpy as np

from bulletuav.dynamics.broad_phase import FAST, TOUCH, Pair, any_fast, candidates, crowded
from bulletuav.dynamics.first_touch import first_touch, touches_in_order
from bulletuav.dynamics.path import Path, length
from bulletuav.engine.engine import Engine
from bulletuav.vehicle.swarm import CITY, Contacts, Swarm


def stop_at_first_touch(
    engine: Engine,
    path: Path,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> Contacts:
    """Stop every drone that touches something where it does, in the order of time.

    Args:
        engine: Engine that knows the shapes and where the city stands.
        path: Where all went during the decision; its `stop` is written.
        swarm: State at the end of the path; drones that touched stand still where they stopped.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.

    Returns:
        The contacts. The impulse is that of a stop: mass times the speed at the touch, N s.
    """
    radius = parameters["collision_radius"]
    pairs = candidates(
        path.position,
        path.obstacle,
        alive,
        radius,
        engine.obstacle_radius,
        engine.city_grid,
    )

    def touch(pair: Pair) -> float:
        return first_touch(engine, path, pair, radius)

    rows: dict[Pair, float] = {}
    for time, (w, one, two) in touches_in_order(path, pairs, alive, radius, touch):
        for drone, other in _both_sides(one, two):
            # Speed along the piece in which they touch; a drone that stopped before has none
            begin = path.piece(time) * path.span
            moved = length(path.change(w, drone, begin, begin + path.span))
            speed = moved / (path.span * engine.dt)
            mass = float(parameters["mass"][w, drone])
            rows[w, drone, other] = mass * speed * (time < path.stop[w, drone])

    # Who touched something stands still where its path ends
    for w, i, _ in rows:
        _, position, quaternion = path.pose(w, i, np.inf)
        swarm.position[w, i] = position
        swarm.quaternion[w, i] = quaternion
        swarm.velocity[w, i] = 0
        swarm.rates[w, i] = 0
    return Contacts.merge(rows)


def overlaps(
    engine: Engine,
    swarm: Swarm,
    moved: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> Contacts:
    """Find what drones touch that were put somewhere else.

    Args:
        engine: Engine that knows the shapes and where the city stands.
        swarm: State of all drones; nothing is written.
        moved: (W, N) bool, drones that were moved.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.

    Returns:
        The contacts of `moved` drones with other drones and with the city, without impulse.
    """
    # Bounding spheres first, then the exact shapes
    radius = parameters["collision_radius"]
    pairs = crowded(swarm.position, moved, alive, radius, engine.city_grid)
    rows: dict[Pair, float] = {}
    for w, one, two in pairs:
        here = (
            one,
            swarm.position[w, one],
            swarm.quaternion[w, one],
        )
        if two == CITY:
            gap = engine.separation(w, here, (two, None, None), TOUCH)
        else:
            there = (
                two,
                swarm.position[w, two],
                swarm.quaternion[w, two],
            )
            gap = engine.separation(w, here, there, TOUCH)
        if gap <= TOUCH:
            rows |= {(w, drone, other): 0.0 for drone, other in _both_sides(one, two)}
    return Contacts.merge(rows)


def catch_fast(
    engine: Engine,
    path: Path,
    swarm: Swarm,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> list[Pair]:
    """Let no drone jump over a contact in one engine substep (continuous collision detection).

    The engine looks for contacts only where a substep begins. Pairs that moved against each other
    by more than a quarter of the drone's thinnest extent are checked along the way. Those that
    touched are put back to where they did, with their velocities, for the engine to resolve the
    contact in its next substep. Pairs that were in touch already are held only where they would
    go deeper.

    Args:
        engine: Engine that flew the substep; drones that were asked for are set anew in it.
        path: One piece (S = 1) of one substep; its `stop` is written.
        swarm: State after the substep; poses of drones that were caught are written.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.

    Returns:
        World, drone and other of what was caught, both sides of a pair.
    """
    if not any_fast(path.position, path.obstacle, alive, parameters):
        return []
    path.stop[:] = np.inf
    radius = parameters["collision_radius"]
    far = FAST * parameters["thinnest"]
    asked = np.zeros(alive.shape, dtype=bool)

    def touch(pair: Pair) -> float:
        return _fast_touch(engine, path, pair, radius, far, asked)

    pairs = candidates(
        path.position,
        path.obstacle,
        alive,
        radius,
        engine.obstacle_radius,
        engine.city_grid,
    )
    caught = [
        (w, drone, other)
        for _, (w, one, two) in touches_in_order(path, pairs, alive, radius, touch)
        for drone, other in _both_sides(one, two)
    ]
    # Back to where they touched; bodies that were moved for asking return to the swarm
    for w, drone, _ in caught:
        _, position, quaternion = path.pose(w, drone, 1.0)
        swarm.position[w, drone] = position
        swarm.quaternion[w, drone] = quaternion
    if asked.any():
        engine.set_states(swarm, asked)
    return caught


def _fast_touch(
    engine: Engine,
    path: Path,
    pair: Pair,
    radius: np.ndarray,
    far: np.ndarray,
    asked: np.ndarray,
) -> float:
    """Return when a pair touches that moved by more than `far` (W, N) m, inf for never.

    `asked` (W, N) marks the drones whose bodies are moved to find out.
    """
    w, one, two = pair
    change = path.change(w, one, 0.0, 1.0)
    other_change = path.change(w, two, 0.0, 1.0)
    if length(change - other_change) <= far[w, one]:
        return np.inf
    for drone, _ in _both_sides(one, two):
        asked[w, drone] = True

    def gap(time: float) -> float:
        pose = path.pose(w, one, time)
        other_pose = path.pose(w, two, time)
        return engine.separation(w, pose, other_pose, 2 * TOUCH)

    before = gap(0.0)
    after = gap(1.0)
    if before > TOUCH:
        return first_touch(engine, path, pair, radius)
    # In touch before: held where it presses deeper
    return 0.0 if after < before - far[w, one] else np.inf


def _both_sides(one: int, two: int) -> list[tuple[int, int]]:
    """Return (drone, other) for each drone of a pair."""
    sides = [(one, two), (two, one)]
    return [(drone, other) for drone, other in sides if drone >= 0]
