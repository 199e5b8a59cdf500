"""Models of stable-baselines3 from a run's settings."""

import warnings
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict

from bulletuav.adapters.features import Symlog, UserSum
from bulletuav.adapters.sb3 import DroneVecEnv, LivingReplay, LivingRollouts, algorithm
from bulletuav.errors import unknown
from bulletuav.policies.run import RunConfig

FEATURES = {"symlog": Symlog, "user_sum": UserSum}
ON_POLICY = ("ppo", "a2c")
_REPLAY = {"learning_starts": 10_000, "batch_size": 1024, "buffer_size": 300_000, "train_freq": 1, "gamma": 0.99}
DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 64,
        "batch_size": 2048,
        "n_epochs": 5,
        "learning_rate": [1e-3, 1e-5],
        "gamma": 0.99,
        "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.0},
    },
    "a2c": {"n_steps": 16, "learning_rate": 7e-4, "gamma": 0.99},
    "sac": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4},
    "td3": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "ddpg": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "dqn": {**_REPLAY, "learning_rate": 5e-4, "gradient_steps": 4, "target_update_interval": 5_000},
}
"""Settings that work with some hundred slots; those of a run go before them"""


def make_model(config: RunConfig, env: DroneVecEnv) -> Any:
    """A model with the weights that the run's seed gives.

    Settings are the arguments of the algorithm's class, and besides: `learning_rate` [a, b] falls linearly from a to b over
    the run; `action_noise` is the deviation of Gaussian noise on each number of an action; `features` names what observed
    numbers go through first, of `bulletuav.adapters.features`: "symlog", also the default, "user_sum", or None. Raises
    ValueError for what the algorithm does not take.
    """
    settings = {**DEFAULTS[config.algo], "features": "symlog", **config.model}
    settings["policy_kwargs"] = dict(settings.get("policy_kwargs", {}))
    pictures = isinstance(env.observation_space, Dict)
    features = settings.pop("features")
    if features not in (None, *FEATURES):
        raise unknown("features", features, FEATURES)
    if features is not None and not pictures:
        settings["policy_kwargs"].setdefault("features_extractor_class", FEATURES[features])
    _translate(settings, env)
    if not pictures:
        buffer = (
            ("rollout_buffer_class", LivingRollouts) if config.algo in ON_POLICY else ("replay_buffer_class", LivingReplay)
        )
        settings.setdefault(*buffer)
    elif env.num_drones > 1:
        raise ValueError("pictures are learned from with one drone a world: SB3's buffers for them know of no empty slots")
    kind = algorithm(config.algo)
    try:
        with warnings.catch_warnings():  # of minibatches that do not divide the rollout: those of living drones never do
            warnings.filterwarnings("ignore", message="(?s).*mini-batch")
            return kind("MultiInputPolicy" if pictures else "MlpPolicy", env, seed=config.seed, device="cpu", **settings)
    except TypeError as error:
        raise ValueError(f"settings of model {config.algo}: {error}") from None
    except AssertionError as error:
        raise ValueError(f"model {config.algo}: {error}; choose another algorithm, or action") from None


def _translate(settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Make objects of the settings that stand for some."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    rate = settings["learning_rate"]
    if isinstance(rate, list | tuple):
        settings["learning_rate"] = LinearSchedule(rate[0], rate[-1], 1.0)
    if isinstance(settings.get("action_noise"), float | int) and isinstance(env.action_space, Box):
        size = env.action_space.shape[0]
        settings["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, float(settings["action_noise"])))
