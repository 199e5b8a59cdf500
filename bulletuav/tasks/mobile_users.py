"""Task `mobile_users`: airborne relays follow walking users on the ground."""

from dataclasses import dataclass
from typing import Any, ClassVar

from bulletuav.registry import register
from bulletuav.tasks.parts.difficulties import service_difficulties
from bulletuav.tasks.parts.presets import URBANMARL_MOBILE_USERS
from bulletuav.tasks.parts.relay import Relay, RelayOptions
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class MobileUsersConfig(RelayOptions, UserServiceConfig):
    """Options of `mobile_users`: those of `UserServiceConfig` and `RelayOptions`.

    Attributes:
        mobility: Mobility model of the users, by default "manhattan": along the streets.
        wanted: Fraction of users in sight, averaged over the episode, from which the task is
            successful.
    """

    mobility: Any = "manhattan"
    wanted: float = 0.5


@register("task")
class MobileUsers(UserService[MobileUsersConfig]):
    """Drones follow users who walk along the streets and keep each of them in sight.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. 20 users walk along
    the streets.

    Observation, Box(68) per drone with the defaults, in world axes (east, north, up): position,
    battery charge, horizontal centroid of all users, horizontal centroid of the drone's own users,
    and which drone sees which user. The drone's own users are those that are horizontally closer to
    it than to other active drones, or all users if there are none. The matrix of visibility starts
    with the row of the drone itself, followed by those of the other drones by index.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There is 1 decision a second.

    Reward per decision, the weighted sum of these terms:

    - served 1: fraction of the users seen by at least one drone.
    - service_time 0.5: tanh(0.1 s) averaged over all users, where s is the time for which a drone
      has seen the user without interruption, s.
    - sight 0: fraction of the users that the drone itself sees.
    - dwell_time 0: tanh(0.1 s), where s is the mean of such times of the drone itself, s.
    - conflict -20: number of drones whose separation falls below d_safe = 2 m.
    - collision -2: 1 on contact of collision shapes.
    - out_of_bounds 0: 1 at the bounds of the airspace.

    End: terminated on contact of collision shapes and when the battery is empty. Truncated after
    100 decisions. Drones stop at the city's edges and at the ceiling.

    Success: averaged over the episode, at least one drone sees 50 % of the users (medium 63 %, hard
    72 %, extreme 65 %), and the drone itself had no conflict or collision.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    difficulties: ClassVar = service_difficulties(medium=0.63, hard=0.72, extreme=0.65)
    name = "mobile_users"
    service_kind = Relay
    presets: ClassVar = {"urbanmarl": URBANMARL_MOBILE_USERS}
    observation = ("position", "battery", "centroids", "sight_matrix")
    reward: ClassVar = {
        "conflict": -20.0,
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "served": 1.0,
        "service_time": 0.5,
        "sight": 0.0,
        "dwell_time": 0.0,
    }
