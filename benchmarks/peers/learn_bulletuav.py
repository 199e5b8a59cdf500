"""PPO on `hover` of bulletuav, set up as HoverAviary of gym-pybullet-drones.

Frequencies, horizon and action are the same.
"""

from learn import learn  # first: it takes care of what others print

# isort: split

from functools import partial

from bulletuav import Aviary
from bulletuav.adapters.sb3 import DroneVecEnv

if __name__ == "__main__":
    learn(partial(DroneVecEnv, "hover", preset="hover_aviary", dynamics="bullet"), Aviary)
