"""Task `los`: airborne relays keep ground users in line of sight."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from bulletuav.registry import register
from bulletuav.tasks.families.urban import DEFAULTS
from bulletuav.tasks.families.users import UsersConfig, UsersTask


@dataclass(frozen=True)
class LosConfig(UsersConfig):
    """Options of `los`: those of `UsersConfig`."""

    boundary: Literal["end", "soft", "hard"] = "end"


@register("task")
class Los(UsersTask[LosConfig]):
    """Find places from which the users on the ground are seen, each by some drone.

    Observation, per drone, Box(108) with the defaults; `bulletuav tasks los` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer. Targets are the users, relative to the drone.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed;
    10 decisions a second.

    Reward, per decision: sight 1 times the share of users that the drone sees; served 0 times the share that any drone sees;
    collision -10; out_of_bounds -10 (weights by name).

    End: terminated on contact of collision shapes, with an empty battery, and outside the city's square or above its
    ceiling; truncated after 300 decisions. Success: 90 % of the users are seen by some drone.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on positions are
    noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "los"
    defaults: ClassVar = {**DEFAULTS, "horizon": 300}
    observation = ("position", "velocity", "battery", "neighbours", "targets")
    reward: ClassVar = {
        "collision": -10.0,
        "out_of_bounds": -10.0,
        "sight": 1.0,
        "served": 0.0,
    }
