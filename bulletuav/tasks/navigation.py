"""Task `navigation`: everyone to its own goal through a city, without touching it or each other."""

from bulletuav.tasks.families.urban import UrbanFlight


class Navigation(UrbanFlight):
    """Through a city to a goal, knowing where one is but seeing no building.

    Observation, per drone, Box(32) float32, clipped to its bounds (here with the defaults):
      0  position x              m    [-250, 250]
      1  position y              m    [-250, 250]
      2  position z              m    [0, 120]
      3  velocity x              m/s  [-30, 30]
      4  velocity y              m/s  [-30, 30]
      5  velocity z              m/s  [-30, 30]
      6  goal direction x        1    [-1, 1]
      7  goal direction y        1    [-1, 1]
      8  goal direction z        1    [-1, 1]
      9  goal distance           m    [0, 717.217]
     10  charge                  1    [0, 1]
     11  neighbour 1 distance    m    [0, 717.217]
     12  neighbour 1 position x  m    [-500, 500]
     13  neighbour 1 position y  m    [-500, 500]
     14  neighbour 1 position z  m    [-120, 120]
     15  neighbour 1 velocity x  m/s  [-60, 60]
     16  neighbour 1 velocity y  m/s  [-60, 60]
     17  neighbour 1 velocity z  m/s  [-60, 60]
     18  neighbour 2 distance    m    [0, 717.217]
     19  neighbour 2 position x  m    [-500, 500]
     20  neighbour 2 position y  m    [-500, 500]
     21  neighbour 2 position z  m    [-120, 120]
     22  neighbour 2 velocity x  m/s  [-60, 60]
     23  neighbour 2 velocity y  m/s  [-60, 60]
     24  neighbour 2 velocity z  m/s  [-60, 60]
     25  neighbour 3 distance    m    [0, 717.217]
     26  neighbour 3 position x  m    [-500, 500]
     27  neighbour 3 position y  m    [-500, 500]
     28  neighbour 3 position z  m    [-120, 120]
     29  neighbour 3 velocity x  m/s  [-60, 60]
     30  neighbour 3 velocity y  m/s  [-60, 60]
     31  neighbour 3 velocity z  m/s  [-60, 60]
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every flight through a city, see `UrbanFlight`, and in every shared
    airspace, see `Airspace`.
    """

    name = "navigation"
    observation = ("position", "velocity", "goal", "battery", "neighbours")
