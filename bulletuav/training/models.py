"""Models of stable-baselines3 from a run's settings."""

import inspect
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict

from bulletuav.adapters.features import Symlog, UserSum
from bulletuav.adapters.sb3 import DroneVecEnv, LivingReplay, LivingRollouts, algorithm
from bulletuav.errors import finite, several, unknown, whole
from bulletuav.policies.run import RunConfig, whole_number

OURS = ("policy", "env", "seed", "device", "tensorboard_log", "_init_setup_model")
"""Arguments that a run gives itself"""
LEAST = {"gradient_steps": -1, "learning_starts": 0}
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
    pictures, kind = isinstance(env.observation_space, Dict), algorithm(config.algo)
    features = settings.pop("features")
    if features not in (None, *FEATURES):
        raise unknown("features", features, FEATURES)
    _check(kind, settings)
    layers = settings["policy_kwargs"] = dict(settings.get("policy_kwargs", {}))
    if features is not None and not pictures:
        layers.setdefault("features_extractor_class", FEATURES[features])
    if features == "user_sum":
        layers["features_extractor_kwargs"] = {"num_drones": env.num_drones, **layers.get("features_extractor_kwargs", {})}
    _translate(settings, env)
    if not pictures:
        on_policy = ("rollout_buffer_class", LivingRollouts)
        settings.setdefault(*on_policy if config.algo in ON_POLICY else ("replay_buffer_class", LivingReplay))
    elif env.num_drones > 1:
        raise ValueError("pictures are learned from with one drone a world: SB3's buffers for them know of no empty slots")
    try:
        with warnings.catch_warnings():  # of minibatches that do not divide the rollout: those of living drones never do
            warnings.filterwarnings("ignore", message="(?s).*mini-batch")
            return kind("MultiInputPolicy" if pictures else "MlpPolicy", env, seed=config.seed, device="cpu", **settings)
    except (TypeError, AssertionError) as error:
        remedy = "; choose another algorithm, or action" if "action spaces" in str(error) else ""
        raise ValueError(f"model {config.algo}: {error}{remedy}") from None


def _check(kind: Any, settings: dict[str, Any]) -> None:
    """Raise ValueError for settings that the algorithm's class does not take, or numbers of another kind than its own."""
    known = {name: one.default for name, one in inspect.signature(kind).parameters.items() if name not in OURS}
    for name, value in settings.items():
        if name not in known:
            raise unknown(f"setting of {kind.__name__}:", name, [*known, "features"])
        default = known[name]
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise ValueError(f"{name} is {value!r}: True or False is needed")
        elif isinstance(default, int) and not isinstance(value, list | tuple):
            settings[name] = whole(name, whole_number(value), LEAST.get(name, min(default, 1)))
        elif isinstance(default, float) and not isinstance(value, list | tuple):
            finite(name, value)
        elif name == "policy_kwargs" and not isinstance(value, Mapping):
            raise ValueError(f"policy_kwargs is {value!r}: names with values are needed")


def _translate(settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Make objects of the settings that stand for some."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    if isinstance(settings["learning_rate"], list | tuple):
        first, last = (finite("learning_rate", rate) for rate in several("learning_rate", settings["learning_rate"], 2))
        settings["learning_rate"] = LinearSchedule(first, last, 1.0)
    if isinstance(settings.get("train_freq"), list):
        settings["train_freq"] = tuple(settings["train_freq"])
    noise = settings.get("action_noise")
    if noise is not None and isinstance(env.action_space, Box):
        size = env.action_space.shape[0]
        settings["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, finite("action_noise", noise)))
