"""Task `los`: airborne relays keep ground users in line of sight."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from bulletuav.registry import register
from bulletuav.tasks.parts.difficulties import service_difficulties
from bulletuav.tasks.parts.presets import URBANMARL_LOS
from bulletuav.tasks.parts.relay import Relay, RelayOptions
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class LosConfig(RelayOptions, UserServiceConfig):
    """Options of `los`: those of `UserServiceConfig` and `RelayOptions`.

    Attributes:
        boundary: Behaviour at the bounds, by default "end": the drone's episode ends.
        wanted: Fraction of users in sight, averaged over the episode, from which the task is
            successful.
    """

    boundary: Literal["end", "soft", "hard"] = "end"
    wanted: float = 0.56


@register("task")
class Los(UserService[LosConfig]):
    """Drones position themselves so that each user on the ground is seen by at least one drone.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. 20 users stand
    still outdoors.

    Observation, Box(108) per drone with the defaults, in world axes (east, north, up): position,
    velocity, battery charge, the nearest active drones, and the users. Drones are relative to the
    drone, sorted by distance, and padded with zeros. Users are relative to the drone, each with a
    flag that is 1 if the drone sees the user.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - served 1: fraction of the users seen by at least one drone.
    - sight 0: fraction of the users that the drone itself sees.
    - conflict -100: number of drones whose separation falls below d_safe = 2 m.
    - collision -10: 1 on contact of collision shapes.
    - out_of_bounds -10: 1 outside the city's square or above its ceiling.

    End: terminated on contact, when the battery is empty, and outside the city's square or above
    its ceiling. Truncated after 600 decisions.

    Success: averaged over the episode, at least one drone sees 56 % of the users (medium 71 %, hard
    81 %, extreme 72 %), only the drone itself sees 2 % of them, and it had no conflict or
    collision. So every drone has to serve users that the others do not see.

    Infos: `contribution`, fraction of users that only the drone itself sees, averaged over the
    episode.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    difficulties: ClassVar = service_difficulties(medium=0.71, hard=0.81, extreme=0.72)
    name = "los"
    service_kind = Relay
    presets: ClassVar = {"urbanmarl": URBANMARL_LOS}
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600}
    observation = ("position", "velocity", "battery", "neighbours", "targets")
    reward: ClassVar = {
        "conflict": -100.0,
        "collision": -10.0,
        "out_of_bounds": -10.0,
        "served": 1.0,
        "sight": 0.0,
    }
    # The sight of each drone teaches it to climb and to look for users
    training_weights: ClassVar = {
        "served": 1.0,
        "sight": 0.3,
        "conflict": -2.0,
        "collision": -2.0,
        "out_of_bounds": -2.0,
    }
