"""Compiled functions of an airspace's step."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import heading, quat4

TURN = 2 * math.pi
"""A whole turn, rad"""
MOST_LEAD = 1.0
"""How far a yaw that turns may be ahead of the drone, rad"""


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
    """Move obstacles through a step, and turn the yaws that drones of an airspace are to hold.

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
        # Yaws stay near those that drones have, so that a drone that turns slowly is not overtaken
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
