"""PPO on HoverAviary of gym-pybullet-drones, from a checkout whose path is the first argument."""

from learn import learn  # first: it takes care of what others print

# isort: split

import sys
from functools import partial

from stable_baselines3.common.env_util import make_vec_env

sys.path.append(sys.argv[1])

from gym_pybullet_drones.envs.HoverAviary import HoverAviary
from gym_pybullet_drones.utils.enums import ActionType, ObservationType

if __name__ == "__main__":
    # a DummyVecEnv of monitored environments, as in its examples/learn.py
    learn(
        partial(
            make_vec_env,
            HoverAviary,
            env_kwargs={"act": ActionType.RPM, "obs": ObservationType.KIN},
        ),
        HoverAviary,
    )
