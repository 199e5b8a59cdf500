"""Task `los`: airborne relays keep ground users in line of sight."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from bulletuav.tasks.base import Frame, StepResult
from bulletuav.tasks.families.urban import DEFAULTS
from bulletuav.tasks.families.users import UsersConfig, UsersTask


@dataclass(frozen=True)
class LosConfig(UsersConfig):
    """Options of `los`: those of `UsersConfig`."""

    boundary: Literal["end", "soft", "hard"] = "end"


class Los(UsersTask):
    """Find places from which the users on the ground are seen, each by some drone.

    Observation, per drone, Box(108) float32, clipped to its bounds (here with the defaults):
      0  position x              m    [-250, 250]
      1  position y              m    [-250, 250]
      2  position z              m    [0, 120]
      3  velocity x              m/s  [-30, 30]
      4  velocity y              m/s  [-30, 30]
      5  velocity z              m/s  [-30, 30]
      6  charge                  1    [0, 1]
      7  neighbour 1 distance    m    [0, 717.217]
      8  neighbour 1 position x  m    [-500, 500]
      9  neighbour 1 position y  m    [-500, 500]
     10  neighbour 1 position z  m    [-120, 120]
     11  neighbour 1 velocity x  m/s  [-60, 60]
     12  neighbour 1 velocity y  m/s  [-60, 60]
     13  neighbour 1 velocity z  m/s  [-60, 60]
     14  neighbour 2 distance    m    [0, 717.217]
     15  neighbour 2 position x  m    [-500, 500]
     16  neighbour 2 position y  m    [-500, 500]
     17  neighbour 2 position z  m    [-120, 120]
     18  neighbour 2 velocity x  m/s  [-60, 60]
     19  neighbour 2 velocity y  m/s  [-60, 60]
     20  neighbour 2 velocity z  m/s  [-60, 60]
     21  neighbour 3 distance    m    [0, 717.217]
     22  neighbour 3 position x  m    [-500, 500]
     23  neighbour 3 position y  m    [-500, 500]
     24  neighbour 3 position z  m    [-120, 120]
     25  neighbour 3 velocity x  m/s  [-60, 60]
     26  neighbour 3 velocity y  m/s  [-60, 60]
     27  neighbour 3 velocity z  m/s  [-60, 60]
     28  target 1 x              m    [-500, 500]
     29  target 1 y              m    [-500, 500]
     30  target 1 z              m    [-120, 120]
     31  target 1 seen           1    [0, 1]
     32  target 2 x              m    [-500, 500]
     33  target 2 y              m    [-500, 500]
     34  target 2 z              m    [-120, 120]
     35  target 2 seen           1    [0, 1]
     36  target 3 x              m    [-500, 500]
     37  target 3 y              m    [-500, 500]
     38  target 3 z              m    [-120, 120]
     39  target 3 seen           1    [0, 1]
     40  target 4 x              m    [-500, 500]
     41  target 4 y              m    [-500, 500]
     42  target 4 z              m    [-120, 120]
     43  target 4 seen           1    [0, 1]
     44  target 5 x              m    [-500, 500]
     45  target 5 y              m    [-500, 500]
     46  target 5 z              m    [-120, 120]
     47  target 5 seen           1    [0, 1]
     48  target 6 x              m    [-500, 500]
     49  target 6 y              m    [-500, 500]
     50  target 6 z              m    [-120, 120]
     51  target 6 seen           1    [0, 1]
     52  target 7 x              m    [-500, 500]
     53  target 7 y              m    [-500, 500]
     54  target 7 z              m    [-120, 120]
     55  target 7 seen           1    [0, 1]
     56  target 8 x              m    [-500, 500]
     57  target 8 y              m    [-500, 500]
     58  target 8 z              m    [-120, 120]
     59  target 8 seen           1    [0, 1]
     60  target 9 x              m    [-500, 500]
     61  target 9 y              m    [-500, 500]
     62  target 9 z              m    [-120, 120]
     63  target 9 seen           1    [0, 1]
     64  target 10 x             m    [-500, 500]
     65  target 10 y             m    [-500, 500]
     66  target 10 z             m    [-120, 120]
     67  target 10 seen          1    [0, 1]
     68  target 11 x             m    [-500, 500]
     69  target 11 y             m    [-500, 500]
     70  target 11 z             m    [-120, 120]
     71  target 11 seen          1    [0, 1]
     72  target 12 x             m    [-500, 500]
     73  target 12 y             m    [-500, 500]
     74  target 12 z             m    [-120, 120]
     75  target 12 seen          1    [0, 1]
     76  target 13 x             m    [-500, 500]
     77  target 13 y             m    [-500, 500]
     78  target 13 z             m    [-120, 120]
     79  target 13 seen          1    [0, 1]
     80  target 14 x             m    [-500, 500]
     81  target 14 y             m    [-500, 500]
     82  target 14 z             m    [-120, 120]
     83  target 14 seen          1    [0, 1]
     84  target 15 x             m    [-500, 500]
     85  target 15 y             m    [-500, 500]
     86  target 15 z             m    [-120, 120]
     87  target 15 seen          1    [0, 1]
     88  target 16 x             m    [-500, 500]
     89  target 16 y             m    [-500, 500]
     90  target 16 z             m    [-120, 120]
     91  target 16 seen          1    [0, 1]
     92  target 17 x             m    [-500, 500]
     93  target 17 y             m    [-500, 500]
     94  target 17 z             m    [-120, 120]
     95  target 17 seen          1    [0, 1]
     96  target 18 x             m    [-500, 500]
     97  target 18 y             m    [-500, 500]
     98  target 18 z             m    [-120, 120]
     99  target 18 seen          1    [0, 1]
    100  target 19 x             m    [-500, 500]
    101  target 19 y             m    [-500, 500]
    102  target 19 z             m    [-120, 120]
    103  target 19 seen          1    [0, 1]
    104  target 20 x             m    [-500, 500]
    105  target 20 y             m    [-500, 500]
    106  target 20 z             m    [-120, 120]
    107  target 20 seen          1    [0, 1]
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
    Config = LosConfig
    config: LosConfig
    defaults: ClassVar = {**DEFAULTS, "horizon": 300}
    observation = ("position", "velocity", "battery", "neighbours", "targets")
    reward_weights: ClassVar = {
        "sight": 1.0,
        "served": 0.0,
        "collision": -10.0,
        "out_of_bounds": -10.0,
    }

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Shares of users in sight, and ends by contact or outside the airspace."""
        served, (ended, terms) = self.served(frame), self.ends(frame)
        terms |= {"sight": frame.seen.mean(axis=-1), "served": served}
        return StepResult(terms, ended, served >= self.config.wanted)
