"""Last part of a flight to a landing pad: choice of pads, approach from above, and touchdown."""

from typing import NamedTuple

import numpy as np

GAIN = 1.8
"""Gain from horizontal distance to speed, 1/s"""
BRAKING = 2.0
"""Deceleration of the horizontal approach, m/s^2"""
CONE, CONE_SLOPE = 3.0, 3.0
"""Horizontal distance from the pad below which a drone descends, m: other pads are farther away;
and height that it may have above the pad per distance"""
CENTRED = 0.3
"""Horizontal distance within which a drone descends onto the pad, m"""
WAIT_HEIGHT = 0.5
"""Height above the pad at which a drone that is not centred waits, m"""
TOUCHDOWN_SPEED = 0.3
"""Descent speed at the pad, m/s"""
DESCENT_GAIN, MAX_DESCENT = 0.8, 2.0
"""Gain from height to descent speed, 1/s, and maximum descent speed, m/s"""
CUSHION, CUSHION_SPEED = 0.08, 1.0
"""Height above the pad below which the ground effect carries a drone, m, and descent speed that it
then commands, m/s"""
PRESSED, PRESSING_SPEED = 0.022, 10.0
"""Height above the pad at which a drone stops its thrust to stand on it, m, by commanding a descent
beyond any limit, m/s"""
LEAD = 0.3
"""Lag of the velocity loop, s"""
SAFE_DISTANCE, PUSH = 2.0, 2.0
"""Distance below which drones avoid each other, m, and gain from missing distance to speed, 1/s"""


class PadTarget(NamedTuple):
    """Pads that drones approach.

    Attributes:
        place: (M, 3) centres of the tops, m.
        velocity: (M, 3) velocities in `LEAD`, m/s.
        cruise: (M,) height at which drones fly to them, m.
    """

    place: np.ndarray
    velocity: np.ndarray
    cruise: np.ndarray


def approach_pads(position: np.ndarray, target: PadTarget) -> np.ndarray:
    """Return velocities of drones towards pads: at cruise height, in a cone, and down to the pad.

    Args:
        position: (M, 3) positions of the drones, m.
        target: The pad of each drone.

    Returns:
        (M, 3) velocities, m/s.
    """
    offset = target.place - position
    distance = np.sqrt((offset[:, :2] ** 2).sum(axis=1))
    height = -offset[:, 2]
    speed = np.minimum(GAIN * distance, np.sqrt(2 * BRAKING * distance))
    velocity = target.velocity.copy()
    velocity[:, :2] += offset[:, :2] * (speed / np.maximum(distance, 1e-9))[:, None]
    # Height above the pad that the distance allows
    cruise = np.maximum(target.cruise - target.place[:, 2], WAIT_HEIGHT)
    cone = WAIT_HEIGHT + CONE_SLOPE * np.maximum(distance - CENTRED, 0.0)
    wanted = np.where(distance < CONE, np.minimum(cone, cruise), cruise)
    climb = np.clip(1.5 * (wanted - height), -MAX_DESCENT, MAX_DESCENT)
    down = -np.minimum(TOUCHDOWN_SPEED + DESCENT_GAIN * np.maximum(height - 0.2, 0.0), MAX_DESCENT)
    down = np.where(height < CUSHION, -CUSHION_SPEED, down)
    down = np.where(height < PRESSED, -PRESSING_SPEED, down)
    velocity[:, 2] += np.where(distance < CENTRED, down, climb)
    # Far below the cruise height, climb before flying on
    low = (distance >= CONE) & (wanted - height > 1.0)
    velocity[low, :2] *= 0.2
    return velocity


def match_pads(position: np.ndarray, pads: np.ndarray) -> np.ndarray:
    """Return a pad for each drone: the nearest pair of drone and pad first, then the next.

    Args:
        position: (M, 3) positions of the drones, m.
        pads: (P, 3) positions of the pads, m; M or more, or some drones get none.

    Returns:
        (M,) indices of pads, -1 for none.
    """
    distance = np.sqrt(((pads - position[:, None]) ** 2).sum(axis=-1))
    chosen = np.full(len(position), -1)
    for _ in range(min(distance.shape)):
        i, p = np.unravel_index(distance.argmin(), distance.shape)
        chosen[i] = p
        distance[i], distance[:, p] = np.inf, np.inf
    return chosen


def keep_apart(position: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return velocities away from other drones that are near.

    Args:
        position: (M, 3) positions of the drones, m.
        others: (M, K, 3) positions of the drones that each avoids, m; far away for none.

    Returns:
        (M, 3) velocities, m/s.
    """
    away = position[:, None] - others
    distance = np.maximum(np.sqrt((away**2).sum(axis=-1, keepdims=True)), 1e-9)
    push: np.ndarray = (PUSH * np.maximum(SAFE_DISTANCE - distance, 0.0) * away / distance).sum(1)
    return push
