"""Parts that all actions are made of."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.airframe import Airframe

Decoder = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Makes setpoints (W, N, S) of actions (W, N, A) and commanded velocities (W, N, 3)"""
Encoder = Callable[..., np.ndarray]
"""Makes actions of the first three numbers of setpoints (W, N, 3) and commanded velocities"""


@dataclass(frozen=True)
class ActionContext:
    """Facts about an environment that the makers of actions may use.

    Attributes:
        airframes: Airframe of each of N drones.
        max_speed: Speed limit, m/s.
        max_climb: Limit of the vertical velocity, m/s; at most `max_speed`.
        arena_low: (3,) lower corner of the arena, m.
        arena_high: (3,) upper corner of the arena, m.
        period: Time between decisions, s.
        gravity: Gravitational acceleration, m/s^2.
    """

    airframes: Sequence[Airframe]
    max_speed: float
    max_climb: float
    arena_low: np.ndarray
    arena_high: np.ndarray
    period: float
    gravity: float


@dataclass(frozen=True)
class Action:
    """A kind of action: A numbers of each of N drones become setpoints at one level.

    Attributes:
        name: Name by which users choose it.
        level: Level of the setpoints.
        labels: For each drone, the meaning and scale of each number that it reads. Drones with
            fewer rotors than others read fewer than A.
        low: (N, A) lower bounds.
        high: (N, A) upper bounds.
        decode: Makes setpoints (W, N, S) of actions (W, N, A), already clipped to the bounds, and
            the velocities (W, N, 3) that were commanded last, m/s. One that is `Compiled` is fast.
        encode: Inverse of `decode` on the setpoint's first three numbers, for policies that think
            in metres; None where there is none. It takes the same velocities where the action is
            relative to them.
        choices: Number of discrete actions; A is 1 then, and the number is the choice. None for
            actions that are continuous.
    """

    name: str
    level: SetpointLevel
    labels: tuple[tuple[str, ...], ...]
    low: np.ndarray
    high: np.ndarray
    decode: Decoder
    encode: Encoder | None = None
    choices: int | None = None

    def size(self, drone: int) -> int:
        """Count the numbers that a drone reads."""
        return len(self.labels[drone])


ActionMaker = Callable[[ActionContext], Action]
"""Makes one kind of action for the drones of an environment"""


class Compiled:
    """A decoder that is a compiled function, which programs call without Python."""

    def __init__(self, kernel: Callable[..., None], width: int, *numbers: Any) -> None:
        """Keep the function and what it needs.

        Args:
            kernel: Writes setpoints (W, N, `width`), its third argument, of actions (W, N, A) and
                commanded velocities (W, N, 3); the numbers come after.
            width: Numbers of a setpoint.
            *numbers: Numbers and arrays.
        """
        self.kernel, self.width, self.numbers = kernel, width, numbers

    def __call__(self, action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        """Make setpoints (W, N, width)."""
        setpoint = np.zeros((*action.shape[:2], self.width))
        self.kernel(action, commanded, setpoint, *self.numbers)
        return setpoint


@func
def limit_drone(vector: np.ndarray, limit: float, w: int, i: int) -> None:
    """Do what `limit_norm` does with the vector of one drone, in place."""
    square = 0.0
    for k in range(3):
        square += vector[w, i, k] ** 2
    # At most 1, and no division by a length of 0
    share = limit / max(math.sqrt(square), limit)
    for k in range(3):
        vector[w, i, k] = share * vector[w, i, k]


@kernel
def _limit_all(vector: np.ndarray, limit: float) -> None:
    """Do what `limit_norm` does, in place."""
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            limit_drone(vector, limit, w, i)


@kernel
def limit_each(vector: np.ndarray, limit: np.ndarray) -> None:
    """Shorten the first three numbers of vectors (W, N, S) to limits (N,), in place."""
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            limit_drone(vector, limit[i], w, i)


def limit_norm(vector: np.ndarray, limit: float) -> np.ndarray:
    """Shorten vectors that are longer than a limit; their direction stays.

    Args:
        vector: (W, N, 3) vectors.
        limit: Largest norm, above 0.

    Returns:
        (W, N, 3) vectors no longer than the limit.
    """
    result = np.array(vector, dtype=float)
    _limit_all(result, limit)
    return result


def within_climb(velocity: np.ndarray, most: float) -> np.ndarray:
    """Shorten velocities (..., 3) whose vertical part is above `most`; their direction stays."""
    excess = np.abs(velocity[..., 2:]) / most
    result: np.ndarray = velocity / np.maximum(excess, 1.0)
    return result


def with_yaw(vector: np.ndarray, yaw: np.ndarray | float = 0.0) -> np.ndarray:
    """Append a yaw to vectors (W, N, 3)."""
    setpoint = np.zeros((*vector.shape[:-1], 4))
    setpoint[..., :3] = vector
    setpoint[..., 3] = yaw
    return setpoint


def normalised(
    context: ActionContext,
    name: str,
    level: SetpointLevel,
    labels: tuple[str, ...],
    decode: Decoder,
    encode: Encoder | None = None,
) -> Action:
    """Make an action whose numbers are from -1 to 1 and the same for every drone."""
    drones = len(context.airframes)
    ones = np.ones((drones, len(labels)))
    return Action(
        name=name,
        level=level,
        labels=(labels,) * drones,
        low=-ones,
        high=ones,
        decode=decode,
        encode=encode,
    )
