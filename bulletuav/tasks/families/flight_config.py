"""Options of flights to goals, and the distances that follow from them."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bulletuav.tasks.families.obstacle_field import ObstacleConfig
from bulletuav.tasks.frame import TaskContext


@dataclass(frozen=True)
class FlightConfig(ObstacleConfig):
    """Options of all flights to goals, beside those of obstacles (`ObstacleConfig`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Least and greatest speed at the start, m/s; by default cut to max_speed.
        goal_radius: Distance from the goal at which it counts as reached, m.
        at_goal: What happens at the goal. "leave": the drone leaves the airspace. "land": it has
            to land on the ground below first, see `Frame.landed`. "hold": it stays, until all
            that fly are at their goals.
        boundary: What happens outside the arena. "end": the drone's episode ends. "soft": it is
            thrown back with 0.8 of its speed. "hard": it stops at the wall. "open": nothing.
        contact_ends: Whose episode a contact of collision shapes ends: that of the "drone", or
            of its whole "world".
        conflict_ends: Whose episode a separation below `d_safe` ends: "nothing", "drone" or
            "world".
        warning_zone: Separation at which the warning zone begins, as a multiple of `d_safe`.
        fairness_range: Distance up to which the term `fairness` compares rewards, m.
        discount: Discount of the term `shaping`, from 0 to 1.
    """

    d_safe: float = 5.0
    start_speed: tuple[float, float] = (5.0, 15.0)
    goal_radius: float = 2.0
    at_goal: Literal["leave", "land", "hold"] = "leave"
    boundary: Literal["end", "soft", "hard", "open"] = "end"
    contact_ends: Literal["drone", "world"] = "drone"
    conflict_ends: Literal["nothing", "drone", "world"] = "nothing"
    warning_zone: float = 2.0
    fairness_range: float = 50.0
    discount: float = 0.99

    def check(self, context: TaskContext) -> None:
        """Refuse options that contradict each other.

        Args:
            context: The swarm that the options are for.

        Raises:
            ValueError: A start speed is one that no drone has, the warning zone ends where it
                begins, or the discount is above 1.
        """
        slowest, fastest = self.start_speed
        usual = self.start_speed == type(self).start_speed
        if not (0 <= slowest <= fastest and (usual or fastest <= context.max_speed)):
            raise ValueError(
                f"start_speed is {self.start_speed}: "
                f"from low to high within 0 and max_speed {context.max_speed:g}"
            )
        if self.warning_zone <= 1:
            raise ValueError(
                f"warning_zone is {self.warning_zone:g}: it must end beyond d_safe, at more than 1"
            )
        if self.discount > 1:
            raise ValueError(f"discount is {self.discount:g}: from 0 to 1 is needed")


@dataclass(frozen=True)
class AirspaceConfig(FlightConfig):
    """Options of flights through free airspace, beside those of `FlightConfig`.

    Attributes:
        altitude: Height above ground of starts and goals, m.
        jitter: Largest random shift of a start on each axis, m.
        margin: Distance from starts and goals to the bounds of the arena, m.
    """

    altitude: float = 40.0
    jitter: float = 1.0
    margin: float = 30.0

    def check(self, context: TaskContext) -> None:
        """Refuse what `FlightConfig.check` does, and jitter that reaches beyond the bounds.

        Args:
            context: The swarm that the options are for.

        Raises:
            ValueError: Options contradict each other.
        """
        super().check(context)
        if self.margin <= self.jitter:
            raise ValueError(
                f"margin {self.margin:g} m must exceed jitter {self.jitter:g} m: "
                f"starts must be in the arena"
            )

    def scattered(self, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Shift places (N, 3), m, at random by up to `jitter` on each axis."""
        return places + rng.uniform(-self.jitter, self.jitter, places.shape)


def clearance(config: FlightConfig, context: TaskContext) -> float:
    """Return the distance between two drones below which they conflict or touch, m."""
    return max(2 * context.collision_radius, config.d_safe)


def least_distance(config: AirspaceConfig, chord: float) -> float:
    """Return how near to each other two drones may start, m.

    Args:
        config: Options, of which `jitter` counts.
        chord: Distance between their undisturbed places, which are at the same height, m.
    """
    worst_shift = 2 * np.sqrt(2) * config.jitter
    return float(chord - worst_shift)


def circle_arena(
    config: AirspaceConfig,
    context: TaskContext,
    radius: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the arena of drones that start on a circle about the origin.

    Args:
        config: Options of the airspace.
        context: The swarm.
        radius: Radius of the circle, m.

    Returns:
        Lower and upper corner, (3,) each, m.

    Raises:
        ValueError: Drones could touch the ground at the start.
    """
    if config.altitude - config.jitter <= context.collision_radius:
        raise ValueError(
            f"altitude {config.altitude:g} m is too low for jitter {config.jitter:g} m"
        )
    reach = radius + config.margin
    low = np.array([-reach, -reach, 0.0])
    high = np.array([reach, reach, config.altitude + config.margin])
    return low, high
