"""Task `obstacles`: drones fly among static and moving spheres and boxes."""

from dataclasses import dataclass, field
from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import FlightConfig, GoalFlight
from bulletuav.tasks.parts.difficulties import UNCERTAINTY
from bulletuav.tasks.parts.free_space import FreeSpace, FreeSpaceOptions


@dataclass(frozen=True)
class ObstaclesConfig(FreeSpaceOptions, FlightConfig):
    """Options of `obstacles`, in addition to those of free space (`FreeSpaceOptions`).

    Attributes:
        altitude_spread: Range of altitudes of drones, goals and obstacles, centred at `altitude`,
            m.
        num_obstacles: Number of obstacles; every second one is a cube, the others are spheres.
        num_moving: Number of moving obstacles, or the minimum and maximum of the number that is
            drawn in each episode. They are reflected at the bounds of their space.
        start_speed: Minimum and maximum speed at the start, m/s: slow enough to stop before an
            obstacle.
    """

    altitude_spread: float = 30.0
    num_obstacles: int = field(default=25, metadata={"least": 0, "most": 10_000})
    num_moving: int | tuple[int, int] = 12
    start_speed: tuple[float, float] = (0.0, 5.0)


@register("task")
class Obstacles(GoalFlight[ObstaclesConfig]):
    """Drones fly from random starts to random goals among static and moving obstacles.

    Drones, goals and obstacles start at random positions in a square of 200 m, at heights of 25 to
    55 m. Every second obstacle is a cube, the others are spheres; all are solid.

    Observation, Box(55) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the nearest active drones, and the nearest
    obstacles. Drones and obstacles are relative to the drone, sorted by distance, and padded with
    zeros. Obstacles are sorted by the distance to their bounding spheres.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - progress 5: decrease of the distance to the goal, m.
    - goal 50: 1 in the decision in which the drone reaches the goal.
    - conflict -200: number of drones whose separation falls below d_safe = 5 m.
    - warning -5: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the goal is reached; if the episode ends otherwise, also 1 per
      remaining decision.
    - obstacle_warning -5: sum over obstacles of their proximity, linear from 0 at d_safe from the
      bounding sphere to 1 at contact.

    End: terminated within 2 m of the goal, on contact, when the battery is empty, or outside the
    arena. Truncated after 500 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.
    """

    name = "obstacles"
    has_absent = True
    version = 2
    shirkers = ("stop_short", "ignore_obstacles", "leave_near_goal")
    oracle = "reflecting_orca"
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, "num_obstacles": 35, "num_moving": 0, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {"num_drones": 20, "num_moving": 16, **UNCERTAINTY["hard"]},
        "extreme": {
            "num_drones": 100,
            "area": 300.0,
            "num_obstacles": 40,
            "num_moving": 30,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: ObstaclesConfig, context: TaskContext) -> None:
        """Set up the free space.

        Raises:
            ValueError: If drones and obstacles do not fit, or starts could touch the ground.
        """
        super().__init__(config, context)
        self.starts = FreeSpace(self, self.field)
