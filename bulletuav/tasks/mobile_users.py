"""Task `mobile_users`: airborne relays follow users on the ground, who walk."""

from dataclasses import dataclass
from typing import Any, ClassVar

from bulletuav.registry import register
from bulletuav.tasks.families.urbanmarl import URBANMARL
from bulletuav.tasks.families.users import UsersConfig, UsersTask


@dataclass(frozen=True)
class MobileUsersConfig(UsersConfig):
    """Options of `mobile_users`: those of `UsersConfig`."""

    mobility: Any = "manhattan"


@register("task")
class MobileUsers(UsersTask[MobileUsersConfig]):
    """Keep users in line of sight while they walk the streets, each by one drone for as long as can be.

    Observation, per drone, Box(68) with the defaults; `bulletuav tasks mobile_users` lists each number:
    World axes (east, north, up). The own centroid is that of the users that are nearer to the drone over ground than to
    other living drones, of all users where there is none. The others are drones by index.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed; 1
    decision a second.

    Reward, per decision: sight 1 times the share of users that the drone sees; dwell_time 0.5 times tanh(0.1 s), s the seconds
    for which it has seen a user without a break, mean of all users; collision -2; out_of_bounds 0 (weights by name).

    End: terminated on contact of collision shapes and with an empty battery; truncated after 100 decisions. Drones stop at
    the city's edges and at the ceiling. Success: 90 % of the users are seen by some drone.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on positions are noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "mobile_users"
    presets: ClassVar = {"urbanmarl": {**URBANMARL, "mobility": "manhattan"}}
    observation = ("position", "battery", "centroids", "sight_matrix")
    reward: ClassVar = {
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "sight": 1.0,
        "dwell_time": 0.5,
    }
