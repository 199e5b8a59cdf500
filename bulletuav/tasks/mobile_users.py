"""Task `mobile_users`: airborne relays follow users on the ground, who walk."""

from dataclasses import dataclass
from typing import Any, ClassVar

from bulletuav.tasks.base import Frame, StepResult
from bulletuav.tasks.families.urbanmarl import URBANMARL
from bulletuav.tasks.families.users import UsersConfig, UsersTask, dwell_time_bonus


@dataclass(frozen=True)
class MobileUsersConfig(UsersConfig):
    """Options of `mobile_users`: those of `UsersConfig`."""

    mobility: Any = "manhattan"


class MobileUsers(UsersTask):
    """Keep users in line of sight while they walk the streets, each by one drone for as long as can be.

    Observation, per drone, Box(68) float32, clipped to its bounds (here with the defaults):
      0  position x       m  [-250, 250]
      1  position y       m  [-250, 250]
      2  position z       m  [0, 120]
      3  charge           1  [0, 1]
      4  centroid x       m  [-250, 250]
      5  centroid y       m  [-250, 250]
      6  own centroid x   m  [-250, 250]
      7  own centroid y   m  [-250, 250]
      8  own sees 1       1  [0, 1]
      9  own sees 2       1  [0, 1]
     10  own sees 3       1  [0, 1]
     11  own sees 4       1  [0, 1]
     12  own sees 5       1  [0, 1]
     13  own sees 6       1  [0, 1]
     14  own sees 7       1  [0, 1]
     15  own sees 8       1  [0, 1]
     16  own sees 9       1  [0, 1]
     17  own sees 10      1  [0, 1]
     18  own sees 11      1  [0, 1]
     19  own sees 12      1  [0, 1]
     20  own sees 13      1  [0, 1]
     21  own sees 14      1  [0, 1]
     22  own sees 15      1  [0, 1]
     23  own sees 16      1  [0, 1]
     24  own sees 17      1  [0, 1]
     25  own sees 18      1  [0, 1]
     26  own sees 19      1  [0, 1]
     27  own sees 20      1  [0, 1]
     28  other 1 sees 1   1  [0, 1]
     29  other 1 sees 2   1  [0, 1]
     30  other 1 sees 3   1  [0, 1]
     31  other 1 sees 4   1  [0, 1]
     32  other 1 sees 5   1  [0, 1]
     33  other 1 sees 6   1  [0, 1]
     34  other 1 sees 7   1  [0, 1]
     35  other 1 sees 8   1  [0, 1]
     36  other 1 sees 9   1  [0, 1]
     37  other 1 sees 10  1  [0, 1]
     38  other 1 sees 11  1  [0, 1]
     39  other 1 sees 12  1  [0, 1]
     40  other 1 sees 13  1  [0, 1]
     41  other 1 sees 14  1  [0, 1]
     42  other 1 sees 15  1  [0, 1]
     43  other 1 sees 16  1  [0, 1]
     44  other 1 sees 17  1  [0, 1]
     45  other 1 sees 18  1  [0, 1]
     46  other 1 sees 19  1  [0, 1]
     47  other 1 sees 20  1  [0, 1]
     48  other 2 sees 1   1  [0, 1]
     49  other 2 sees 2   1  [0, 1]
     50  other 2 sees 3   1  [0, 1]
     51  other 2 sees 4   1  [0, 1]
     52  other 2 sees 5   1  [0, 1]
     53  other 2 sees 6   1  [0, 1]
     54  other 2 sees 7   1  [0, 1]
     55  other 2 sees 8   1  [0, 1]
     56  other 2 sees 9   1  [0, 1]
     57  other 2 sees 10  1  [0, 1]
     58  other 2 sees 11  1  [0, 1]
     59  other 2 sees 12  1  [0, 1]
     60  other 2 sees 13  1  [0, 1]
     61  other 2 sees 14  1  [0, 1]
     62  other 2 sees 15  1  [0, 1]
     63  other 2 sees 16  1  [0, 1]
     64  other 2 sees 17  1  [0, 1]
     65  other 2 sees 18  1  [0, 1]
     66  other 2 sees 19  1  [0, 1]
     67  other 2 sees 20  1  [0, 1]
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
    Config = MobileUsersConfig
    config: MobileUsersConfig
    presets: ClassVar = {"urbanmarl": {**URBANMARL, "mobility": "manhattan"}}
    observation = ("position", "battery", "centroids", "sight_matrix")
    reward_weights: ClassVar = {
        "sight": 1.0,
        "dwell_time": 0.5,
        "collision": -2.0,
        "out_of_bounds": 0.0,
    }

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Share of users in sight, how long they have been, and ends by contact or outside the airspace."""
        ended, terms = self.ends(frame)
        terms |= {"sight": frame.seen.mean(axis=-1), "dwell_time": dwell_time_bonus(frame)}
        return StepResult(terms, ended, self.served(frame) >= self.config.wanted)
