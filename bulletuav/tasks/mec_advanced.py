"""Task `mec_advanced`: edge computing with downward antennas and tight deadlines."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from bulletuav.network.uplink import RadioConfig
from bulletuav.registry import register
from bulletuav.tasks.parts.difficulties import service_difficulties
from bulletuav.tasks.parts.edge_computing import (
    EDGE_SHOWS,
    EdgeComputing,
    EdgeOptions,
)
from bulletuav.tasks.parts.presets import URBANMARL_MEC_ADVANCED
from bulletuav.tasks.rewards.users import power_share
from bulletuav.tasks.user_service import UserService, UserServiceConfig


@dataclass(frozen=True)
class MecAdvancedConfig(EdgeOptions, RadioConfig, UserServiceConfig):
    """Options of `mec_advanced`: those of `EdgeOptions` with other defaults.

    Attributes:
        num_users: Number of users on the ground, outdoors.
        arrival_rate: Task arrival rate of each user, 1/s.
        cycles_per_bit: Processor cycles per bit of a task.
        deadline: Maximum time from the arrival of a task to its result, s.
        core_frequency: Frequency of a core, cycles/s.
        bandwidth: Bandwidth shared by all drones, Hz.
        antenna: Antenna of the drones, "isotropic" or "downward".
        wanted: Fraction of completed tasks of the episode from which the task is successful.
    """

    num_users: int = field(default=10, metadata={"most": 10_000})
    arrival_rate: float = 2.5
    cycles_per_bit: float = 800.0
    deadline: float = field(default=0.2, metadata={"most": 1e4})
    core_frequency: float = field(default=10e9, metadata={"most": 1e12})
    bandwidth: float = field(default=100e6, metadata={"most": 1e12})
    antenna: Literal["isotropic", "downward"] = "downward"
    wanted: float = 0.7


@register("task")
class MecAdvanced(UserService[MecAdvancedConfig]):
    """Drones serve few users with many urgent tasks, through directional antennas.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. 10 users stand
    still outdoors and generate tasks at random, 2.5 per second each. A task has to be uploaded and
    computed within 0.2 s. See `EdgeComputing` for the model. The drones' antennas (3GPP TR 38.901,
    8 dBi) point along the body's -z axis, so they tilt with the drone.

    Observation, Box(22) per drone with the defaults, in world axes (east, north, up): position,
    velocity, battery charge, power, the data rate of each user, utilisation of the drone's cores,
    length of its queue (in tasks of mean size), and latency and completed fraction of its users'
    tasks. The data rate of a user is the rate of its link to the drone, through the antenna, with
    the whole bandwidth. Power and all following numbers refer to the last decision, and are 0 at
    the start and if no task arrived.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There is 1 decision a second.

    Reward per decision, the weighted sum of these terms:

    - tasks 2: completed tasks divided by the expected number of tasks of all users per decision.
    - latency -1.5: sum of the latencies of the completed tasks, divided by the deadline and by the
      same expected number.
    - energy 0: power divided by 400 W.
    - service_time 0.5: tanh(0.1 s) averaged over all users, where s is the time for which a drone
      has seen the user without interruption, s.
    - dwell_time 0: tanh(0.1 s), with the mean of such times of the drone itself, s.
    - conflict -20: number of drones whose separation falls below d_safe = 2 m.
    - collision -5: 1 on contact of collision shapes.
    - out_of_bounds 0: 1 at the bounds of the airspace.

    End: terminated on contact of collision shapes and when the battery is empty. Truncated after
    100 decisions. Drones stop at the city's edges and at the ceiling.

    Success: 70 % of the episode's tasks are completed (medium 80 %, hard 82 %, extreme 78 %), and
    the drone had no conflict or collision.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    name = "mec_advanced"
    presets: ClassVar = {"urbanmarl": URBANMARL_MEC_ADVANCED}
    difficulties: ClassVar = service_difficulties(medium=0.8, hard=0.82, extreme=0.78)
    shows: ClassVar = EDGE_SHOWS
    service_kind = EdgeComputing
    observation = ("position", "velocity", "battery", "power", "link_rates", "server")
    reward: ClassVar = {
        "conflict": -20.0,
        "collision": -5.0,
        "out_of_bounds": 0.0,
        "tasks": 2.0,
        "latency": -1.5,
        "energy": (power_share, 0.0),
        "service_time": 0.5,
        "dwell_time": 0.0,
    }
