"""Task `mobile_users`: airborne relays follow users on the ground, who walk."""

from dataclasses import dataclass
from typing import Any, ClassVar

from bulletuav.registry import register
from bulletuav.tasks.parts.presets import URBANMARL_MOBILE_USERS
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class MobileUsersConfig(UserServiceConfig):
    """Options of `mobile_users`, those of `UserServiceConfig`.

    Attributes:
        mobility: How users walk, by default "manhattan": along the streets.
    """

    mobility: Any = "manhattan"


@register("task")
class MobileUsers(UserService[MobileUsersConfig]):
    """Search for users who walk the streets, each to be seen by some drone for as long as can be.

    Drones start at rest at random places outdoors, 20 to 60 m high. 20 users walk along the
    streets.

    Observation, Box(68) per drone with the defaults, in world axes (east, north, up): position,
    charge of the battery, centroid of all users over ground, centroid of the drone's own users, and
    which drone sees which user. The own users are those nearer to the drone over ground than to
    other living drones, or all users where there is none. Of the sights the drone's own come first,
    then those of the other drones by index.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s.
    Its norm is limited to max_speed. There is 1 decision a second.

    Reward per decision, the sum of these terms times their weights:

    - served 1: share of the users that some drone sees.
    - service_time 0.5: tanh(0.1 s), where s are the seconds for which a drone has seen a user
      without a break, averaged over all users.
    - sight 0, dwell_time 0: the same of what the drone itself sees.
    - collision -2: 1 on contact of collision shapes.
    - out_of_bounds 0: 1 where the bounds hold the drone back.

    End: terminated on contact of collision shapes and with an empty battery. Truncated after 100
    decisions. Drones stop at the city's edges and at the ceiling.

    Success: 90 % of the users are seen by some drone.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/service.md).
    """

    name = "mobile_users"
    presets: ClassVar = {"urbanmarl": URBANMARL_MOBILE_USERS}
    observation = ("position", "battery", "centroids", "sight_matrix")
    reward: ClassVar = {
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "served": 1.0,
        "service_time": 0.5,
        "sight": 0.0,
        "dwell_time": 0.0,
    }
