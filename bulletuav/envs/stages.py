"""Compiled stages of a decision; `envs.decisions` tells their order."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import heading, quat4
from bulletuav.vehicle.swarm import Swarm

TURN = 2 * math.pi
"""A whole turn, rad"""
MOST_LEAD = 1.0
"""How far a yaw that turns may be ahead of the drone, rad"""


@kernel
def admit(
    given: np.ndarray,
    alive: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    discrete: bool,
    action: np.ndarray,
) -> bool:
    """Clip actions to their bounds; those of drones that are not alive become 0.

    Args:
        given: (W, N, A) what was given.
        alive: (W, N) bool.
        low: (N, A) lower bounds.
        high: (N, A) upper bounds.
        discrete: Whether numbers are choices, which are whole and within the bounds.
        action: (W, N, A), written if all can be.

    Returns:
        Whether a living drone's action cannot be; nothing is written then.
    """
    # All are checked before any is written
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            if alive[w, i]:
                for k in range(given.shape[2]):
                    number = given[w, i, k]
                    if not math.isfinite(number):
                        return True
                    # A choice out of bounds is a mistake, and is not clipped
                    if discrete and not (low[i, k] <= number <= high[i, k] and number % 1 == 0):
                        return True
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            for k in range(given.shape[2]):
                number = given[w, i, k] if alive[w, i] else 0.0
                action[w, i, k] = min(max(number, low[i, k]), high[i, k])
    return False


@kernel
def begin(
    alive: np.ndarray,
    steps: np.ndarray,
    hz: float,
    flown: np.ndarray,
    flying: np.ndarray,
    time: np.ndarray,
) -> None:
    """Write who flies a decision, and when it begins.

    Args:
        alive: (W, N) bool.
        steps: (W,) decisions since the reset.
        hz: Decisions a second.
        flown: (W, N) bool, written: drones that fly.
        flying: (W,) bool, written: worlds in which any does.
        time: (W,) since the reset, s, written.
    """
    for w in range(alive.shape[0]):
        # A division each time, as sums of a period drift
        time[w] = steps[w] / hz
        flying[w] = False
        for i in range(alive.shape[1]):
            flown[w, i] = alive[w, i]
            flying[w] = flying[w] or alive[w, i]


@kernel
def keep_before(
    swarm: Swarm,
    before: Swarm,
    goal: np.ndarray,
    goal_before: np.ndarray,
    obstacle: np.ndarray,
    obstacle_before: np.ndarray,
) -> None:
    """Copy the state, goals (W, N, 3) and obstacles (W, K, 3) before a decision."""
    # Into arrays that tasks look at all the time, so in place
    for w in range(goal.shape[0]):
        for i in range(goal.shape[1]):
            for k in range(3):
                before.position[w, i, k] = swarm.position[w, i, k]
                before.velocity[w, i, k] = swarm.velocity[w, i, k]
                before.rates[w, i, k] = swarm.rates[w, i, k]
                goal_before[w, i, k] = goal[w, i, k]
            for k in range(4):
                before.quaternion[w, i, k] = swarm.quaternion[w, i, k]
            # As many rotors as the airframe with the most
            for k in range(swarm.rotor_speed.shape[2]):
                before.rotor_speed[w, i, k] = swarm.rotor_speed[w, i, k]
        # Goals and obstacles may be moved next
        for m in range(obstacle.shape[1]):
            for k in range(3):
                obstacle_before[w, m, k] = obstacle[w, m, k]


@kernel
def copy_vectors(given: np.ndarray, out: np.ndarray) -> None:
    """Copy the first three numbers of `given` (W, K, ...) to `out` (W, K or more, 3)."""
    for w in range(given.shape[0]):
        for m in range(given.shape[1]):
            for k in range(3):
                out[w, m, k] = given[w, m, k]


@kernel
def tick(
    flying: np.ndarray,
    steps: np.ndarray,
    hz: float,
    horizon: int,
    time: np.ndarray,
    last: np.ndarray,
) -> None:
    """Count a decision in the worlds that fly, and tell where the horizon is reached.

    Args:
        flying: (W,) bool.
        steps: (W,) decisions since the reset, counted on.
        hz: Decisions a second.
        horizon: Decisions until an episode is truncated.
        time: (W,) since the reset, s, written.
        last: (W,) bool, whether the horizon is reached, written.
    """
    for w in range(flying.shape[0]):
        if flying[w]:
            steps[w] += 1
        time[w] = steps[w] / hz
        last[w] = steps[w] >= horizon


@kernel
def conclude(
    ended: np.ndarray,
    charge: np.ndarray,
    flown: np.ndarray,
    last: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
    present: np.ndarray,
    alive: np.ndarray,
    left: np.ndarray,
) -> bool:
    """Tell whose episode is over.

    Args:
        ended: (W, N) bool, what the task says.
        charge: (W, N) share of the charge; an empty battery ends an episode.
        flown: (W, N) bool, drones that flew the decision.
        last: (W,) bool, whether the horizon is reached.
        terminated: (W, N) bool, written.
        truncated: (W, N) bool, written.
        present: (W, N) bool, written: drones that can still be met. The horizon takes nobody away.
        alive: (W, N) bool, written: drones whose episode goes on.
        left: (W, N) bool, written: drones that flew and are not alive any more.

    Returns:
        Whether any drone left.
    """
    any_left = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            # The task's ends, or an empty battery
            terminated[w, i] = flown[w, i] and (ended[w, i] or charge[w, i] <= 0.0)
            present[w, i] = flown[w, i] and not terminated[w, i]
            # The time is over for who is still there
            truncated[w, i] = last[w] and present[w, i]
            alive[w, i] = present[w, i] and not truncated[w, i]
            # Who flew this decision and will not fly the next
            left[w, i] = flown[w, i] and not alive[w, i]
            any_left = any_left or left[w, i]
    return any_left


@kernel
def settle(
    terms: np.ndarray,
    weights: np.ndarray,
    flown: np.ndarray,
    weighted: np.ndarray,
    reward: np.ndarray,
) -> bool:
    """Weigh the reward terms (T, W, N) and add them up; of drones that did not fly they are 0.

    Returns whether any reward is not finite.
    """
    broken = False
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            # In the order of the terms, so that sums have the same bits everywhere
            total = 0.0
            for k in range(weights.shape[0]):
                weighted[k, w, i] = weights[k] * terms[k, w, i] if flown[w, i] else 0.0
                total += weighted[k, w, i]
            reward[w, i] = total
            # Only whether: Python finds out whose it is
            broken = broken or not math.isfinite(total)
    return broken


@kernel
def tell(
    success: np.ndarray,
    flown: np.ndarray,
    touched: tuple[np.ndarray, np.ndarray, np.ndarray],
    apart: tuple[np.ndarray, np.ndarray, np.ndarray],
    energy: tuple[np.ndarray, np.ndarray],
    rows: np.ndarray,
) -> None:
    """Write infos to a table (9, W, N), in this order.

    Args:
        success: (W, N) bool, who is where the task wants it; told of who flew.
        flown: (W, N) bool, drones that flew the decision.
        touched: Collision and resting (W, N) bool, and impulse (W, N), N s.
        apart: Conflicts, separation and distance to the goal (W, N).
        energy: Power and charge (W, N).
        rows: The table.
    """
    # Row by row, in the order of `INFOS` in `bulletuav.envs.decisions`: rows may be a power of two
    # apart, and writing to all of them in turn would then push each other out of the cache
    for w in range(flown.shape[0]):
        for i in range(flown.shape[1]):
            rows[0, w, i] = 1.0 if success[w, i] and flown[w, i] else 0.0
    _copy(touched[0], rows, 1)
    _copy(touched[1], rows, 2)
    _copy(touched[2], rows, 3)
    _copy(apart[0], rows, 4)
    _copy(apart[1], rows, 5)
    _copy(apart[2], rows, 6)
    _copy(energy[0], rows, 7)
    _copy(energy[1], rows, 8)


@func
def _copy(given: np.ndarray, rows: np.ndarray, k: int) -> None:
    """Copy an array (W, N) to row k of a table (K, W, N)."""
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            rows[k, w, i] = given[w, i]


@func
def half_turn(angle: float) -> float:
    """Return the same angle within half a turn to either side, rad."""
    return angle - TURN * math.floor(angle / TURN + 0.5)


@kernel
def prepare(
    quaternion: np.ndarray,
    setpoint: np.ndarray,
    yaw_rate: np.ndarray,
    period: float,
    obstacle: np.ndarray,
    obstacle_velocity: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Tell how obstacles move in a step, and turn the yaws that drones of an airspace are to hold.

    Args:
        quaternion: (W, N, 4) attitudes.
        setpoint: (W, N, S) setpoints; the yaw of those that have one is their fourth number.
        yaw_rate: (W, N) how fast to turn it, rad/s.
        period: Duration of the step, s.
        obstacle: (W, K, 3) positions of obstacles before the step, m; moved to after it.
        obstacle_velocity: (W, K, 3) m/s.
        before: (W, K, 3) positions before, written.
        after: (W, K, 3) positions after, written.
    """
    for w in range(yaw_rate.shape[0]):
        for k in range(obstacle.shape[1]):
            for m in range(3):
                before[w, k, m] = obstacle[w, k, m]
                obstacle[w, k, m] += period * obstacle_velocity[w, k, m]
                after[w, k, m] = obstacle[w, k, m]
        # Yaws stay near those that drones have, so that who turns slowly is not overtaken
        for i in range(yaw_rate.shape[1]):
            if yaw_rate[w, i] != 0.0:
                present = heading(quat4(quaternion, w, i))
                lead = half_turn(setpoint[w, i, 3] + period * yaw_rate[w, i] - present)
                lead = min(max(lead, -MOST_LEAD), MOST_LEAD)
                setpoint[w, i, 3] = half_turn(present + lead)


@kernel
def finish(
    steps: np.ndarray,
    hz: float,
    time: np.ndarray,
    force: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Count a step of an airspace, and end the forces that were applied in it.

    Args:
        steps: (W,) steps before, counted.
        hz: Steps a second.
        time: (W,) written, s.
        force: (W, N, 3) N, cleared.
        torque: (W, N, 3) N m, cleared.
    """
    for w in range(steps.shape[0]):
        # A division each time, as sums of a period drift
        steps[w] += 1
        time[w] = steps[w] / hz
        for i in range(force.shape[1]):
            for k in range(3):
                force[w, i, k] = 0.0
                torque[w, i, k] = 0.0


@kernel
def headings(quaternion: np.ndarray, yaw: np.ndarray) -> None:
    """Write the yaw (W, N) of attitudes (W, N, 4), rad."""
    for w in range(yaw.shape[0]):
        for i in range(yaw.shape[1]):
            yaw[w, i] = heading(quat4(quaternion, w, i))
