"""Directions in which drones fly, and face, at the start: the option `heading`."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.rotation import Vec3, dot, point
from bulletuav.tasks.parts.draws import RandomSource, draw_uniform

HEADINGS = ("goal", "random")
"""Headings that have names"""


def check_heading(heading: Any, num_drones: int, has_goals: bool) -> None:
    """Refuse a heading that is no direction.

    Args:
        heading: Value of the option.
        num_drones: Drones in a world.
        has_goals: Whether they have goals.

    Raises:
        ValueError: It is none of `HEADINGS`, no angle, and no angle for each drone; or it is
            "goal", and there are no goals.
    """
    if heading is None or (isinstance(heading, str) and heading in HEADINGS):
        if heading == "goal" and not has_goals:
            raise ValueError("heading is 'goal': this task has no goals; 'random' or angles can be")
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


def heading_directions(heading: Any, ways: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Make directions of a heading.

    Args:
        heading: Value of the option, one that there is.
        ways: (N, 3) from the drones to their goals, m.
        rng: Generator of random headings.

    Returns:
        (N, 3) of length 1.
    """
    if isinstance(heading, str):
        return unit_directions(ways if heading == "goal" else rng.normal(size=ways.shape))
    angle = np.broadcast_to(np.radians(np.asarray(heading, dtype=float)), len(ways))
    return np.stack([cos(angle), sin(angle), np.zeros(len(ways))], axis=1)


@func
def _unit(ways: np.ndarray, i: int) -> Vec3:
    """Shorten the i-th of ways (N, 3) to length 1; east where it has none."""
    x, y, z = point(ways, i)
    length = math.sqrt(dot((x, y, z), (x, y, z)))
    return (x / length, y / length, z / length) if length > 0.0 else (1.0, 0.0, 0.0)


@allocating
def unit_directions(ways: np.ndarray) -> np.ndarray:
    """Shorten ways (N, 3) to length 1; east where there is none."""
    unit = np.empty(ways.shape)
    for i in range(ways.shape[0]):
        unit[i, 0], unit[i, 1], unit[i, 2] = _unit(ways, i)
    return unit


@kernel
def draw_velocities(
    source: RandomSource, slowest: float, fastest: float, ways: np.ndarray, velocity: np.ndarray
) -> None:
    """Draw a speed between two for each drone, m/s, and write velocities (N, 3) along its way."""
    for i in range(ways.shape[0]):
        speed = draw_uniform(source, slowest, fastest)
        x, y, z = _unit(ways, i)
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = x * speed, y * speed, z * speed


def level_attitudes(direction: np.ndarray) -> np.ndarray:
    """Compute attitudes (N, 4), body to world, of level drones with noses along (N, 3)."""
    half = atan2(direction[:, 1], direction[:, 0]) / 2
    zero = np.zeros(len(half))
    return np.stack([zero, zero, sin(half), cos(half)], axis=1)
