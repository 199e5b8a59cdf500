"""Directions of flight and attitudes at the start: the option `heading`."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.rotation import Vec3, dot, point
from bulletuav.tasks.parts.draws import RandomSource, draw_uniform

HEADINGS = ("goal", "random")
"""Named headings"""


def check_heading(heading: Any, num_drones: int, has_goals: bool) -> None:
    """Check the option `heading`.

    Args:
        heading: Value of the option.
        num_drones: Number of drones per world.
        has_goals: Whether drones have goals.

    Raises:
        ValueError: If the heading is not in `HEADINGS`, an angle, or an angle for each drone; or if
            it is "goal" and there are no goals.
    """
    if heading is None or (isinstance(heading, str) and heading in HEADINGS):
        if heading == "goal" and not has_goals:
            raise ValueError("heading is 'goal': this task has no goals; use 'random' or angles")
        return
    try:
        angles = numbers_of("heading is", heading)
    except ValueError:
        angles = np.array(np.nan)
    if angles.shape not in ((), (num_drones,)) or not np.isfinite(angles).all():
        raise ValueError(
            f"heading is {shown(heading)}: {', '.join(map(repr, HEADINGS))}, an angle "
            f"in degrees, or one for each of {num_drones} drones is needed"
        )


def heading_directions(
    heading: Any, directions: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the directions of a heading.

    Args:
        heading: Valid value of the option.
        directions: (N, 3) vectors from the drones to their goals, m.
        rng: Generator of random headings.

    Returns:
        (N, 3) unit vectors.
    """
    if isinstance(heading, str):
        return unit_directions(
            directions if heading == "goal" else rng.normal(size=directions.shape)
        )
    angle = np.broadcast_to(np.radians(np.asarray(heading, dtype=float)), len(directions))
    return np.stack([cos(angle), sin(angle), np.zeros(len(directions))], axis=1)


@func
def _unit(directions: np.ndarray, i: int) -> Vec3:
    """Normalise the i-th of vectors (N, 3); return east for a zero vector."""
    x, y, z = point(directions, i)
    length = math.sqrt(dot((x, y, z), (x, y, z)))
    return (x / length, y / length, z / length) if length > 0.0 else (1.0, 0.0, 0.0)


@allocating
def unit_directions(directions: np.ndarray) -> np.ndarray:
    """Normalise vectors (N, 3); zero vectors become east."""
    unit = np.empty(directions.shape)
    for i in range(directions.shape[0]):
        unit[i, 0], unit[i, 1], unit[i, 2] = _unit(directions, i)
    return unit


@kernel
def draw_velocities(
    source: RandomSource,
    slowest: float,
    fastest: float,
    directions: np.ndarray,
    velocity: np.ndarray,
) -> None:
    """Draw a speed for each drone and write velocities along given directions.

    Args:
        source: Source of random numbers.
        slowest: Minimum speed, m/s.
        fastest: Maximum speed, m/s.
        directions: (N, 3) directions, of any length.
        velocity: (N, 3) output, m/s.
    """
    for i in range(directions.shape[0]):
        speed = draw_uniform(source, slowest, fastest)
        x, y, z = _unit(directions, i)
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = x * speed, y * speed, z * speed


def level_attitudes(direction: np.ndarray) -> np.ndarray:
    """Return quaternions (N, 4), body to world, of level drones that face along vectors (N, 3)."""
    half = atan2(direction[:, 1], direction[:, 0]) / 2
    zero = np.zeros(len(half))
    return np.stack([zero, zero, sin(half), cos(half)], axis=1)
