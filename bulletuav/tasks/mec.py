"""Task `mec`: drones carry servers for mobile edge computing to users on the ground."""

from dataclasses import dataclass
from typing import ClassVar

from bulletuav.network.uplink import RadioConfig
from bulletuav.registry import register
from bulletuav.tasks.parts.edge_computing import (
    EDGE_DIFFICULTIES,
    EDGE_SHOWS,
    EdgeComputing,
    EdgeOptions,
)
from bulletuav.tasks.parts.presets import URBANMARL_MEC
from bulletuav.tasks.rewards.users import power_share
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class MecConfig(EdgeOptions, RadioConfig, UserServiceConfig):
    """Options of `mec`, those of `EdgeOptions`."""


@register("task")
class Mec(UserService[MecConfig]):
    """Search for places to which users can offload their tasks, so that most are done in time.

    Drones start at rest at random places outdoors, 20 to 60 m high. 50 users stand still outdoors
    and have tasks at random, 0.15 a second each. A task is to be uploaded and computed within 1 s.
    See `EdgeComputing` for what becomes of it.

    Observation, Box(8) per drone with the defaults, in world axes (east, north, up): position,
    charge of the battery, utilisation of the drone's cores, tasks (of mean size) in its queue, and
    latency and completed share of its users' tasks. The last four are those of the last decision,
    and 0 at the start and where no task came.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s.
    Its norm is limited to max_speed. There is 1 decision a second.

    Reward per decision, the sum of these terms times their weights:

    - tasks 1: completed tasks over those that all users are expected to have in a decision.
    - latency -0.5: latencies of the completed tasks over the deadline, and over the same number.
    - energy -0.1: power over 400 W.
    - service_time 0.3: tanh(0.1 s), where s are the seconds for which a drone has seen a user
      without a break, averaged over all users.
    - dwell_time 0: the same of what the drone itself sees.
    - collision -2: 1 on contact of collision shapes.
    - out_of_bounds 0: 1 where the bounds hold the drone back.

    End: terminated on contact of collision shapes and with an empty battery. Truncated after 100
    decisions. Drones stop at the city's edges and at the ceiling.

    Success: 70 % of the episode's tasks are completed.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/service.md).
    """

    name = "mec"
    presets: ClassVar = {"urbanmarl": URBANMARL_MEC}
    difficulties: ClassVar = EDGE_DIFFICULTIES
    shows: ClassVar = EDGE_SHOWS
    service_kind = EdgeComputing
    observation = ("position", "battery", "server")
    reward: ClassVar = {
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "tasks": 1.0,
        "latency": -0.5,
        "energy": (power_share, -0.1),
        "service_time": 0.3,
        "dwell_time": 0.0,
    }
