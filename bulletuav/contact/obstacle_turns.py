"""Rotation of the task's obstacles in a decision, about their positions at constant rates."""

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.contact_state import ObstacleTurns
from bulletuav.contact.spin import compute_rotation_between, rotate_by_fraction
from bulletuav.geometry.rotation import normalise_quaternion, quat4, vec3
from bulletuav.geometry.scenery import Scenery


@kernel
def start_turns(scenery: Scenery, attitude: np.ndarray, turns: ObstacleTurns) -> None:
    """Set the rotation of all obstacles in a decision from their present and their next attitudes.

    Args:
        scenery: Shapes with their attitudes at the beginning of the decision.
        attitude: (W, K, 4) attitudes at the end of the decision, body to world.
        turns: Rotations, written.
    """
    for w in range(attitude.shape[0]):
        for k in range(attitude.shape[1]):
            before = quat4(scenery.quaternion, w, k)
            rotation = compute_rotation_between(before, quat4(attitude, w, k))
            for m in range(3):
                turns.rotation[w, k, m] = rotation[m]
            for m in range(4):
                turns.before[w, k, m] = before[m]


@func
def turn_obstacle(
    scenery: Scenery, turns: ObstacleTurns, w: int, k: int, fraction: float, period: float
) -> None:
    """Set obstacle k of world w to its attitude after a fraction of the decision, and its spin.

    Args:
        scenery: All shapes, written.
        turns: Rotations of the obstacles in the decision.
        w: Index of the world.
        k: Index of the obstacle.
        fraction: Elapsed fraction of the decision.
        period: Length of the decision, s.
    """
    rotation = vec3(turns.rotation, w, k)
    turn = normalise_quaternion(rotate_by_fraction(rotation, fraction, quat4(turns.before, w, k)))
    for m in range(3):
        scenery.spin[w, k, m] = rotation[m] / period
    for m in range(4):
        scenery.quaternion[w, k, m] = turn[m]


@kernel
def finish_turns(scenery: Scenery, attitude: np.ndarray, turns: ObstacleTurns) -> None:
    """Set all obstacles to their attitudes (W, K, 4) at the end of the decision, without spin."""
    for w in range(attitude.shape[0]):
        for k in range(attitude.shape[1]):
            for m in range(3):
                scenery.spin[w, k, m] = turns.rotation[w, k, m] = 0.0
            for m in range(4):
                scenery.quaternion[w, k, m] = attitude[w, k, m]
