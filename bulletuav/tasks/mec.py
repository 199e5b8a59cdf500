"""Task `mec`: drones carry servers for mobile edge computing to users on the ground."""

from dataclasses import dataclass
from typing import Any, ClassVar

from bulletuav.network.uplink import RadioConfig
from bulletuav.registry import register
from bulletuav.tasks.parts.difficulties import service_difficulties
from bulletuav.tasks.parts.edge_computing import (
    EDGE_SHOWS,
    EdgeComputing,
    EdgeOptions,
)
from bulletuav.tasks.parts.presets import URBANMARL_MEC
from bulletuav.tasks.rewards.users import power_share
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class MecConfig(EdgeOptions, RadioConfig, UserServiceConfig):
    """Options of `mec`: those of `EdgeOptions` with other defaults.

    Attributes:
        city: The city, see `CityOptions`, by default "urban": links are weak in denser ones.
        wanted: Fraction of completed tasks of the episode from which the task is successful.
    """

    city: Any = "urban"
    wanted: float = 0.67


@register("task")
class Mec(UserService[MecConfig]):
    """Drones carry edge servers to places where users can offload their tasks in time.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. 50 users stand
    still outdoors and generate tasks at random, 0.15 per second each. A task has to be uploaded and
    computed within 1 s. See `EdgeComputing` for the model.

    Observation, Box(8) per drone with the defaults, in world axes (east, north, up): position,
    battery charge, utilisation of the drone's cores, length of its queue (in tasks of mean size),
    and latency and completed fraction of its users' tasks. The last four refer to the last
    decision, and are 0 at the start and if no task arrived.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There is 1 decision a second.

    Reward per decision, the weighted sum of these terms:

    - tasks 1: completed tasks divided by the expected number of tasks of all users per decision.
    - latency -0.5: sum of the latencies of the completed tasks, divided by the deadline and by the
      same expected number.
    - energy -0.1: power divided by 400 W.
    - service_time 0.3: tanh(0.1 s) averaged over all users, where s is the time for which a drone
      has seen the user without interruption, s.
    - dwell_time 0: tanh(0.1 s), where s is the mean of such times of the drone itself, s.
    - conflict -10: number of drones whose separation falls below d_safe = 2 m.
    - collision -2: 1 on contact of collision shapes.
    - out_of_bounds 0: 1 at the bounds of the airspace.

    End: terminated on contact of collision shapes and when the battery is empty. Truncated after
    100 decisions. Drones stop at the city's edges and at the ceiling.

    Success: 67 % of the episode's tasks are completed (medium 74 %, hard 71 %, extreme 75 %), and
    the drone had no conflict or collision.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    name = "mec"
    presets: ClassVar = {"urbanmarl": URBANMARL_MEC}
    difficulties: ClassVar = service_difficulties(medium=0.74, hard=0.71, extreme=0.75)
    shows: ClassVar = EDGE_SHOWS
    service_kind = EdgeComputing
    observation = ("position", "battery", "server")
    reward: ClassVar = {
        "conflict": -10.0,
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "tasks": 1.0,
        "latency": -0.5,
        "energy": (power_share, -0.1),
        "service_time": 0.3,
        "dwell_time": 0.0,
    }
