"""Creation of stable-baselines3 models from the settings of a run."""

import importlib
import inspect
import itertools
import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, flatdim

from bulletuav.adapters.sb3 import (
    MASKS,
    DroneVecEnv,
    LivingReplay,
    LivingRollouts,
    algorithm,
)
from bulletuav.adapters.sb3_policy import FEATURES, policy_arguments
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.errors import (
    as_int,
    as_sequence,
    find_choice,
    finite,
    require_available_memory,
    shown,
    unknown,
)
from bulletuav.policies.run import RunConfig, whole_number

RESERVED_ARGUMENTS = (
    "policy",
    "env",
    "seed",
    "device",
    "tensorboard_log",
    "_init_setup_model",
)
"""Arguments that the run sets and users cannot"""
MIN_INTEGERS = {"gradient_steps": -1, "learning_starts": 0}
"""Minimum of integer settings; for others it is 1, or the default if smaller"""
MAX_INTEGER = 10**12
"""Maximum of integer settings"""
MAX_LAYERS = 100
"""Maximum number of layers of a network"""
FRACTIONS = ("gamma", "gae_lambda", "tau")
"""Settings with values from 0 to 1"""
NUMBER_BYTES = 4
"""Size of a number in buffers and networks, bytes"""
NUM_EXTRA = 6
"""Numbers stored for each transition besides observations and actions"""
ON_POLICY = ("ppo", "a2c")
"""On-policy algorithms, which learn from rollouts"""


def make_model(config: RunConfig, env: DroneVecEnv) -> Any:
    """Create a model with initial weights from the seed of the run.

    Settings are the arguments of the class of the algorithm, with these exceptions: `learning_rate`
    [a, b] falls linearly from a to b over the run. `action_noise` is the standard deviation of
    Gaussian noise on each number of an action. `features` names the feature extractor of
    `bulletuav.adapters`: "symlog" (the default), "swarm", "user_sum", or None.

    Args:
        config: Settings of the run.
        env: The training environment.

    Returns:
        The model, an instance of the class of the algorithm.

    Raises:
        ValueError: If the algorithm has no such setting, or the model exceeds the memory.
    """
    settings = config.settings
    kind = algorithm(config.algo, config.action_masks)
    pictures = isinstance(env.observation_space, Dict)
    if not pictures and len(env.observation_space.shape or ()) != 1:
        raise ValueError(
            "a picture alone is observed as an array: set observation_format='dict' to train on it"
        )
    features = settings["features"]
    if features is not None:
        named = {name: one for name, one in FEATURES.items() if name is not None}
        find_choice("features", features, named)
    arguments = policy_arguments(settings, env.num_drones, env.labels, pictures)
    del settings["features"]
    # Check settings before anything large is allocated
    _check(kind, settings)
    settings["policy_kwargs"] = arguments
    _require_memory(config.algo, settings, env)
    _translate(settings, env)
    if not pictures:
        # Buffers that drop slots without a drone
        if config.action_masks:
            masks = importlib.import_module(MASKS)
            settings.setdefault("rollout_buffer_class", masks.LivingMaskableRollouts)
        elif config.algo in ON_POLICY:
            settings.setdefault("rollout_buffer_class", LivingRollouts)
        else:
            settings.setdefault("replay_buffer_class", LivingReplay)
    elif env.num_drones > 1:
        raise ValueError(
            "training on images needs one drone in each world: "
            "SB3's buffers for images cannot drop empty slots"
        )
    try:
        # SB3 warns if minibatches do not divide the rollout, which never holds here
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="(?s).*mini-batch")
            model = kind(
                "MultiInputPolicy" if pictures else "MlpPolicy",
                env,
                seed=config.seed,
                device="cpu",
                **settings,
            )
    except (TypeError, AssertionError, RuntimeError) as error:
        remedy = "; choose another algorithm, or action" if "action spaces" in str(error) else ""
        raise ValueError(f"model {config.algo}: {error}{remedy}") from None
    # SB3 initialises feature extractors of on-policy algorithms with orthogonal weights of large
    # outputs, with which drones did not learn `crossing`; see docs/lab/training_weights.md
    for module in model.policy.modules():
        if isinstance(module, SwarmFeatures) and config.algo in ON_POLICY:
            module.reset_parameters()
    return model


def check_settings(config: RunConfig) -> None:
    """Check the algorithm settings of a run, without creating a model.

    Raises:
        ValueError: If the algorithm has no such setting. The message suggests the closest names.
        ImportError: If the extra `sb3` is not installed.
    """
    settings = config.settings
    del settings["features"]
    _check(algorithm(config.algo, config.action_masks), settings)


def _check(kind: Any, settings: dict[str, Any]) -> None:
    """Check the settings, and convert numbers to the types of their defaults.

    Raises ValueError for settings that the class of the algorithm does not have, and for values of
    another type.
    """
    known = {
        name: one.default
        for name, one in inspect.signature(kind).parameters.items()
        if name not in RESERVED_ARGUMENTS
    }
    for name, value in settings.items():
        if name not in known:
            raise unknown(f"setting of {kind.__name__}:", name, [*known, "features"])
        # Check bools first, as they are ints in Python; `_translate` handles lists
        default = known[name]
        is_list = isinstance(value, list | tuple)
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise ValueError(f"{name} is {value!r}: True or False is needed")
        elif isinstance(default, int) and not is_list:
            minimum = MIN_INTEGERS.get(name, min(default, 1))
            settings[name] = as_int(name, whole_number(value), minimum, MAX_INTEGER)
        elif isinstance(default, float) and not is_list:
            bounds = (0, 1) if name in FRACTIONS else ()
            settings[name] = finite(name, value, *bounds)


def _require_memory(algo: str, settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Raise ValueError if buffers or networks exceed the memory of this machine."""
    observed = flatdim(env.observation_space)
    acted = math.prod(env.action_space.shape or (1,))
    if algo in ON_POLICY:
        steps = settings["n_steps"]
        row = (observed + acted + NUM_EXTRA) * NUMBER_BYTES
        require_available_memory(
            f"rollouts of n_steps {steps} in {env.num_envs} slots (worlds times drones)",
            steps * env.num_envs * row,
            "lower n_steps or worlds",
        )
    else:
        # A transition has the observations before and after the step
        row = (2 * observed + acted + NUM_EXTRA) * NUMBER_BYTES
        for name in ("buffer_size", "batch_size"):
            size = settings[name]
            require_available_memory(f"transitions of {name} {size}", size * row, f"lower {name}")
    _require_networks(settings["policy_kwargs"].get("net_arch", []), observed)


def _require_networks(widths: Any, observed: int) -> None:
    """Raise ValueError if networks exceed the memory of this machine."""
    lists = list(widths.values()) if isinstance(widths, Mapping) else [widths]
    for layers in lists:
        named = as_sequence("net_arch of policy_kwargs", layers, most=MAX_LAYERS)
        sizes = [as_int("net_arch", size, 1, MAX_INTEGER) for size in named]
        weights = sum(one * two for one, two in itertools.pairwise([observed, *sizes]))
        require_available_memory(
            f"networks of net_arch {shown(widths)}",
            weights * NUMBER_BYTES,
            "lower net_arch in policy_kwargs",
        )


def _translate(settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Convert settings to objects of stable-baselines3: schedules and noise."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    rate = settings["learning_rate"]
    if isinstance(rate, list | tuple):
        first, last = (
            finite("learning_rate", one) for one in as_sequence("learning_rate", rate, 2)
        )
        settings["learning_rate"] = LinearSchedule(first, last, 1.0)
    if isinstance(settings.get("train_freq"), list):
        settings["train_freq"] = tuple(settings["train_freq"])
    # Discrete actions have no noise
    noise = settings.get("action_noise")
    if noise is not None and isinstance(env.action_space, Box):
        size = env.action_space.shape[0]
        deviation = np.full(size, finite("action_noise", noise))
        settings["action_noise"] = NormalActionNoise(np.zeros(size), deviation)
