"""Options of free airspace, and distances between starts."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bulletuav.tasks.frame import TaskContext

LARGE_SWARM = 256
"""Number of drones above which the airspace grows if it is too small for all of them"""
ROOM = 1.05
"""Factor of distances between starts in an airspace that has grown"""


@dataclass(frozen=True)
class AirspaceOptions:
    """Options of flights through free airspace.

    Attributes:
        altitude: Altitude of starts and goals above ground, m.
        jitter: Maximum random offset of a start on each axis, m.
        margin: Distance from starts and goals to the bounds of the arena, m.
    """

    altitude: float = 40.0
    jitter: float = 1.0
    margin: float = 30.0

    def scattered(self, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Offset positions (N, 3), m, at random by up to `jitter` on each axis."""
        return places + rng.uniform(-self.jitter, self.jitter, places.shape)


class HasSeparation(Protocol):
    """Options that include `d_safe`, m."""

    @property
    def d_safe(self) -> float:
        """Separation below which two drones are in conflict, m."""


def clearance(config: HasSeparation, context: TaskContext) -> float:
    """Return the distance below which two drones are in conflict or contact, m."""
    return max(2 * context.collision_radius, config.d_safe)


def min_start_distance(config: AirspaceOptions, chord: float) -> float:
    """Return the minimum distance between two jittered starts, m.

    Args:
        config: Options with `jitter`.
        chord: Distance between the nominal starts, which have the same altitude, m.
    """
    worst_shift = 2 * np.sqrt(2) * config.jitter
    return float(chord - worst_shift)


def require_margin(config: AirspaceOptions) -> None:
    """Raise ValueError if jitter can move starts out of the arena."""
    if config.margin <= config.jitter:
        raise ValueError(
            f"margin {config.margin:g} m must exceed jitter {config.jitter:g} m: "
            f"starts must be in the arena"
        )


def circle_arena(
    config: AirspaceOptions, context: TaskContext, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the arena of drones that start on a circle around the origin.

    Args:
        config: Options of the airspace.
        context: The swarm.
        radius: Radius of the circle, m.

    Returns:
        Lower and upper corner, (3,) each, m.

    Raises:
        ValueError: If drones could start outside the arena, or touch the ground.
    """
    require_margin(config)
    if config.altitude - config.jitter <= context.collision_radius:
        raise ValueError(
            f"altitude {config.altitude:g} m is too low for jitter {config.jitter:g} m"
        )
    half_side = radius + config.margin
    low = np.array([-half_side, -half_side, 0.0])
    high = np.array([half_side, half_side, config.altitude + config.margin])
    return low, high
