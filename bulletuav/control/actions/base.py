"""Common parts of all action types."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.airframe import Airframe

Decoder = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Converts actions (W, N, A) and commanded velocities (W, N, 3) to setpoints (W, N, S)"""
Encoder = Callable[..., np.ndarray]
"""Converts the first three numbers of setpoints (W, N, 3) and commanded velocities to actions"""


@dataclass(frozen=True)
class ActionContext:
    """Properties of an environment that action makers may use.

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
    """An action type, which converts A numbers of each of N drones to setpoints at one level.

    Attributes:
        name: Name by which users select it.
        level: Level of the setpoints.
        labels: For each drone, the meaning and scale of each number that it reads. Drones with
            fewer rotors than others read fewer than A.
        low: (N, A) lower bounds.
        high: (N, A) upper bounds.
        decode: Converts actions (W, N, A), already clipped to the bounds, and the last commanded
            velocities (W, N, 3), m/s, to setpoints (W, N, S). A `Compiled` decoder is fast.
        encode: Inverse of `decode` on the setpoint's first three numbers, for policies that work in
            metres; None if there is none. It also takes the last commanded velocities if the action
            is relative to them.
        choices: Number of discrete actions; A is 1 then, and the number is the choice. None for
            continuous actions.
        parts: The kinds of action, if drones have different ones; see
            `bulletuav.control.actions.mixed.mix_actions`. `level` is the highest of theirs then.
        part_of: Index of the kind of each drone, if drones have different ones.
    """

    name: str
    level: SetpointLevel
    labels: tuple[tuple[str, ...], ...]
    low: np.ndarray
    high: np.ndarray
    decode: Decoder
    encode: Encoder | None = None
    choices: int | None = None
    parts: tuple["Action", ...] = ()
    part_of: tuple[int, ...] = ()

    @property
    def kinds(self) -> tuple["Action", ...]:
        """The kinds of action of the drones: the action itself if all have the same."""
        return self.parts or (self,)

    @cached_property
    def levels(self) -> np.ndarray:
        """Level of each drone's setpoint, (N,)."""
        part_of = self.part_of or (0,) * len(self.labels)
        return np.array([self.kinds[k].level for k in part_of])

    @property
    def kind_levels(self) -> dict[str, SetpointLevel]:
        """Level of the setpoints of each kind of action, by its name."""
        return {kind.name: kind.level for kind in self.kinds}

    def size(self, drone: int) -> int:
        """Count the numbers that a drone reads."""
        return len(self.labels[drone])


ActionMaker = Callable[[ActionContext], Action]
"""Creates an action type for the drones of an environment"""


class Compiled:
    """A compiled decoder, which programs call without Python."""

    def __init__(self, kernel: Callable[..., None], width: int, *numbers: Any) -> None:
        """Store the function and its further arguments.

        Args:
            kernel: Compiled function of actions (W, N, A), commanded velocities (W, N, 3), the
                setpoints (W, N, `width`) that it writes, and `numbers`.
            width: Number of values in a setpoint.
            *numbers: Further arguments, numbers and arrays.
        """
        self.kernel, self.width, self.numbers = kernel, width, numbers

    def __call__(self, action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        """Convert actions to setpoints (W, N, width)."""
        setpoint = np.zeros((*action.shape[:2], self.width))
        self.kernel(action, commanded, setpoint, *self.numbers)
        return setpoint


@func
def limit_drone(vector: np.ndarray, size: int, limit: float, w: int, i: int) -> None:
    """Limit the norm of the first `size` numbers of one drone, in place; see `limit_norm`."""
    square = 0.0
    for k in range(size):
        square += vector[w, i, k] ** 2
    # At most 1, without a division by zero
    share = limit / max(math.sqrt(square), limit)
    for k in range(size):
        vector[w, i, k] = share * vector[w, i, k]


@kernel
def _limit_all(vector: np.ndarray, limit: float) -> None:
    """Limit the norm of vectors in place; see `limit_norm`."""
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            limit_drone(vector, vector.shape[2], limit, w, i)


@kernel
def limit_each(vector: np.ndarray, limit: np.ndarray) -> None:
    """Limit the norm of the first three numbers of vectors (W, N, S) to limits (N,), in place."""
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            limit_drone(vector, 3, limit[i], w, i)


def limit_norm(vector: np.ndarray, limit: float) -> np.ndarray:
    """Limit the norm of vectors; their direction does not change.

    Args:
        vector: (W, N, K) vectors.
        limit: Maximum norm, above 0.

    Returns:
        (W, N, K) vectors no longer than the limit.
    """
    result = np.array(vector, dtype=float)
    _limit_all(result, limit)
    return result


def within_climb(velocity: np.ndarray, most: float) -> np.ndarray:
    """Scale velocities (..., 3) so that the vertical part is at most `most`."""
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
    """Create an action with numbers from -1 to 1, which are the same for every drone."""
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
