"""Task `mec`: drones carry servers for mobile edge computing to users on the ground."""

from dataclasses import dataclass
from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.families.edge import EdgeConfig, EdgeTask
from bulletuav.tasks.families.urbanmarl import URBANMARL
from bulletuav.tasks.rewards.users import power_share


@dataclass(frozen=True)
class MecConfig(EdgeConfig):
    """Options of `mec`: those of `EdgeConfig`."""


@register("task")
class Mec(EdgeTask[MecConfig]):
    """Be where users can offload their tasks, so that as many as can be are computed in time.

    Observation, per drone, Box(8) with the defaults; `bulletuav tasks mec` lists each number:
    World axes (east, north, up). Utilisation of the drone's cores, tasks (of mean size) in its queue, latency and completed
    share of its users' tasks are those of the last decision; 0 at the start and where no task came.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed; 1
    decision a second.

    Reward, per decision: tasks 1 times the completed tasks over those that all users are expected to have in a decision;
    latency -0.5 times the latencies of the completed tasks over the deadline, and over the same; energy -0.1 times power
    over 400 W; dwell_time 0.3 times tanh(0.1 s), s the seconds for which it has seen a user without a break, mean of all users;
    collision -2; out_of_bounds 0 (weights by name).

    End: terminated on contact of collision shapes and with an empty battery; truncated after 100 decisions. Drones stop at
    the city's edges and at the ceiling. Success: 70 % of the episode's tasks are completed.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on positions are noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "mec"
    presets: ClassVar = {
        "urbanmarl": {
            **URBANMARL,
            "arrival_rate": 0.1,
            "n_nlos": 3.5,
            "queue": "erlang",
            "assignment": "dtlcm",
        }
    }
    observation = ("position", "battery", "server")
    reward: ClassVar = {
        "collision": -2.0,
        "out_of_bounds": 0.0,
        "tasks": 1.0,
        "latency": -0.5,
        "energy": (power_share, -0.1),
        "dwell_time": 0.3,
    }
