"""Actions: what an agent's numbers mean, and their decoding into setpoints."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.control.levels import Level
from bulletuav.errors import pick
from bulletuav.physics.airframe import Airframe

RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True)
class Flyable:
    """What a decoder may know: the swarm's airframes, the speed limit (m/s) and the arena's corners (3,), m."""

    airframes: Sequence[Airframe]
    max_speed: float
    arena_low: np.ndarray
    arena_high: np.ndarray


@dataclass(frozen=True)
class Action:
    """A kind of action: (W, N, A) numbers within [low, high] (A,) become (W, N, S) setpoints at one level.

    `labels` name and scale each number; `decode` takes actions already clipped to the bounds; `encode` is its inverse on
    the setpoint's first three numbers, for policies that think in metres.
    """

    name: str
    level: Level
    labels: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    decode: Callable[[np.ndarray], np.ndarray]
    encode: Callable[[np.ndarray], np.ndarray] | None = None


def _with_yaw(vector: np.ndarray) -> np.ndarray:
    """(W, N, 3) to (W, N, 4): yaw held at 0, the nose to the east."""
    return np.concatenate([vector, np.zeros_like(vector[..., :1])], axis=-1)


def _unit(name: str, level: Level, labels: tuple[str, ...], decode, encode=None) -> Action:
    """An action normalised to [-1, 1]."""
    return Action(name, level, labels, -np.ones(len(labels)), np.ones(len(labels)), decode, encode)


def limit_norm(vector: np.ndarray, limit: float) -> np.ndarray:
    """(..., 3) vectors, those longer than `limit` shortened to it."""
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * (limit / np.maximum(size, limit))


def velocity(flyable: Flyable) -> Action:
    """Velocity east, north, up over max_speed; the speed is limited to max_speed, direction kept. Yaw is held at 0."""
    speed = flyable.max_speed
    labels = tuple(f"v{axis} / {speed:g} m/s" for axis in "xyz")
    decode = lambda action: _with_yaw(limit_norm(action * speed, speed))  # noqa: E731
    return _unit("velocity", Level.VELOCITY, labels, decode, lambda velocity: velocity / speed)


def target_position(flyable: Flyable) -> Action:
    """Position to fly to and stop at: -1 and 1 are the arena's lower and upper bounds of each axis. Yaw is held at 0."""
    centre, half = (flyable.arena_low + flyable.arena_high) / 2, (flyable.arena_high - flyable.arena_low) / 2
    labels = tuple(f"{axis} = {c:g} + {h:g} a m" for axis, c, h in zip("xyz", centre, half, strict=True))
    decode = lambda action: _with_yaw(centre + half * action)  # noqa: E731
    return _unit("target_position", Level.POSITION, labels, decode, lambda position: (position - centre) / half)


def rotor(flyable: Flyable) -> Action:
    """Thrust of each rotor: -1 none, 1 the most; the speed is max_rotor_speed sqrt((a + 1) / 2)."""
    most = flyable.airframes[0].max_rotor_speed
    labels = tuple(f"rotor {r}: 2 thrust / max thrust - 1" for r in range(len(flyable.airframes[0].rotors)))
    return _unit("rotor", Level.ROTOR, labels, lambda action: most * np.sqrt(0.5 * (action + 1)))


def rpm(flyable: Flyable) -> Action:
    """Speed of each rotor in revolutions per minute, raw."""
    labels = tuple(f"rotor {r}, rpm" for r in range(len(flyable.airframes[0].rotors)))
    high = np.full(len(labels), flyable.airframes[0].max_rotor_speed / RPM)
    return Action("rpm", Level.ROTOR, labels, np.zeros(len(labels)), high, lambda action: action * RPM)


ACTIONS: dict[str, Callable[[Flyable], Action]] = {
    "velocity": velocity,
    "target_position": target_position,
    "rotor": rotor,
    "rpm": rpm,
}


def make_action(name: str, flyable: Flyable) -> Action:
    """The action `name` for this swarm. Raises ValueError for an unknown name."""
    return pick("action", name, ACTIONS)(flyable)
