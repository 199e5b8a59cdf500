"""Task `mec_advanced`: edge computing with antennas that look down, tight deadlines and the energy that it takes."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from bulletuav.registry import register
from bulletuav.tasks.families.edge import EdgeConfig, EdgeTask
from bulletuav.tasks.families.urbanmarl import URBANMARL
from bulletuav.tasks.rewards.users import power_share


@dataclass(frozen=True)
class MecAdvancedConfig(EdgeConfig):
    """Options of `mec_advanced`: those of `EdgeConfig`."""

    num_users: int = field(default=10, metadata={"most": 10_000})
    arrival_rate: float = 2.5
    cycles_per_bit: float = 800.0
    deadline: float = field(default=0.2, metadata={"most": 1e4})
    core_frequency: float = field(default=10e9, metadata={"most": 1e12})
    bandwidth: float = field(default=100e6, metadata={"most": 1e12})
    antenna: Literal["isotropic", "downward"] = "downward"


@register("task")
class MecAdvanced(EdgeTask[MecAdvancedConfig]):
    """Serve few users with many urgent tasks through directional antennas.

    Observation, per drone, Box(22) with the defaults; `bulletuav tasks mec_advanced` lists each number:
    World axes (east, north, up). The rate of a user is what it would reach to the drone for itself, through the drone's
    antenna (3GPP TR 38.901, 8 dBi, along the body's -z: it tilts with the drone). Utilisation of the drone's cores, tasks
    (of mean size) in its queue, latency and completed share of its users' tasks, rates and power are those of the last
    decision; 0 at the start and where no task came.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed; 1
    decision a second.

    Reward, per decision: tasks 2 times the completed tasks over those that all users are expected to have in a decision;
    latency -1.5 times the latencies of the completed tasks over the deadline, and over the same; energy 0 times power over
    400 W; dwell_time 0.5 times tanh(0.1 s), s the seconds for which it has seen a user without a break, mean of all users;
    collision -5; out_of_bounds 0 (weights by name).

    End: terminated on contact of collision shapes and with an empty battery; truncated after 100 decisions. Drones stop at
    the city's edges and at the ceiling. Success: 70 % of the episode's tasks are completed.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on positions are noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "mec_advanced"
    presets: ClassVar = {
        "urbanmarl": {
            **URBANMARL,
            "num_users": 10,
            "height": (20.0, 120.0),
            "bandwidth": 10e6,
            "n_nlos": 3.5,
            "queue": "erlang",
            "assignment": "dtlcm",
        }
    }
    observation = ("position", "velocity", "battery", "power", "link_rates", "server")
    reward: ClassVar = {
        "collision": -5.0,
        "out_of_bounds": 0.0,
        "tasks": 2.0,
        "latency": -1.5,
        "energy": (power_share, 0.0),
        "dwell_time": 0.5,
    }
