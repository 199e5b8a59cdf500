"""Models of stable-baselines3 from a run's settings."""

import inspect
import itertools
import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, flatdim

from bulletuav.adapters.sb3 import DroneVecEnv, LivingReplay, LivingRollouts, algorithm
from bulletuav.adapters.sb3_policy import FEATURES, policy_arguments
from bulletuav.errors import as_int, as_sequence, choose, finite, require_memory, shown, unknown
from bulletuav.policies.run import RunConfig, whole_number

OURS = ("policy", "env", "seed", "device", "tensorboard_log", "_init_setup_model")
"""Arguments that a run gives itself"""
LEAST = {"gradient_steps": -1, "learning_starts": 0}
MOST, MOST_LAYERS = 10**12, 100
SHARES = ("gamma", "gae_lambda", "tau")
NUMBER_BYTES, OTHERS = 4, 6
"""Of a number in buffers and networks, and how many beside what is seen and done are kept of a transition"""
ON_POLICY = ("ppo", "a2c")


def make_model(config: RunConfig, env: DroneVecEnv) -> Any:
    """A model with the weights that the run's seed gives.

    Settings are the arguments of the algorithm's class, and besides: `learning_rate` [a, b] falls linearly from a to b over
    the run; `action_noise` is the deviation of Gaussian noise on each number of an action; `features` names what observed
    numbers go through first, of `bulletuav.adapters.features`: "symlog", also the default, "user_sum", or None. Raises
    ValueError for what the algorithm does not take.
    """
    settings = config.settings
    pictures, kind = isinstance(env.observation_space, Dict), algorithm(config.algo)
    if settings["features"] is not None:
        choose(
            "features",
            settings["features"],
            {name: one for name, one in FEATURES.items() if name is not None},
        )
    arguments = policy_arguments(settings, env.num_drones, pictures)
    del settings["features"]
    _check(kind, settings)
    settings["policy_kwargs"] = arguments
    _require_memory(config.algo, settings, env)
    _translate(settings, env)
    if not pictures:
        on_policy = ("rollout_buffer_class", LivingRollouts)
        settings.setdefault(
            *on_policy if config.algo in ON_POLICY else ("replay_buffer_class", LivingReplay)
        )
    elif env.num_drones > 1:
        raise ValueError(
            "pictures are learned from with one drone a world: SB3's buffers for them know of no empty slots"
        )
    try:
        with (
            warnings.catch_warnings()
        ):  # of minibatches that do not divide the rollout: those of living drones never do
            warnings.filterwarnings("ignore", message="(?s).*mini-batch")
            return kind(
                "MultiInputPolicy" if pictures else "MlpPolicy",
                env,
                seed=config.seed,
                device="cpu",
                **settings,
            )
    except (TypeError, AssertionError, RuntimeError) as error:
        remedy = "; choose another algorithm, or action" if "action spaces" in str(error) else ""
        raise ValueError(f"model {config.algo}: {error}{remedy}") from None


def _check(kind: Any, settings: dict[str, Any]) -> None:
    """Raise ValueError for settings that the algorithm's class does not take, or numbers of another kind than its own."""
    known = {
        name: one.default
        for name, one in inspect.signature(kind).parameters.items()
        if name not in OURS
    }
    for name, value in settings.items():
        if name not in known:
            raise unknown(f"setting of {kind.__name__}:", name, [*known, "features"])
        default = known[name]
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise ValueError(f"{name} is {value!r}: True or False is needed")
        elif isinstance(default, int) and not isinstance(value, list | tuple):
            settings[name] = as_int(
                name, whole_number(value), LEAST.get(name, min(default, 1)), MOST
            )
        elif isinstance(default, float) and not isinstance(value, list | tuple):
            settings[name] = finite(name, value, *((0, 1) if name in SHARES else ()))


def _require_memory(algo: str, settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Raise ValueError, with both figures, for buffers or networks that do not fit into the machine."""
    observed, acted = flatdim(env.observation_space), math.prod(env.action_space.shape or (1,))
    if algo in ON_POLICY:
        name, rows = "n_steps", settings["n_steps"] * env.num_envs
        what = f"rollouts of n_steps {settings['n_steps']} in {env.num_envs} slots (worlds times drones)"
        require_memory(
            what, rows * (observed + acted + OTHERS) * NUMBER_BYTES, f"lower {name} or worlds"
        )
    else:
        for name in ("buffer_size", "batch_size"):
            row = (2 * observed + acted + OTHERS) * NUMBER_BYTES
            require_memory(
                f"transitions of {name} {settings[name]}", settings[name] * row, f"lower {name}"
            )
    widths = settings["policy_kwargs"].get("net_arch", [])
    lists = list(widths.values()) if isinstance(widths, Mapping) else [widths]
    for layers in lists:
        sizes = [
            as_int("net_arch", size, 1, MOST)
            for size in as_sequence("net_arch of policy_kwargs", layers, most=MOST_LAYERS)
        ]
        weights = sum(one * two for one, two in itertools.pairwise([observed, *sizes]))
        require_memory(
            f"networks of net_arch {shown(widths)}",
            weights * NUMBER_BYTES,
            "lower net_arch in policy_kwargs",
        )


def _translate(settings: dict[str, Any], env: DroneVecEnv) -> None:
    """Make objects of the settings that stand for some."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    if isinstance(settings["learning_rate"], list | tuple):
        first, last = (
            finite("learning_rate", rate)
            for rate in as_sequence("learning_rate", settings["learning_rate"], 2)
        )
        settings["learning_rate"] = LinearSchedule(first, last, 1.0)
    if isinstance(settings.get("train_freq"), list):
        settings["train_freq"] = tuple(settings["train_freq"])
    noise = settings.get("action_noise")
    if noise is not None and isinstance(env.action_space, Box):
        size = env.action_space.shape[0]
        settings["action_noise"] = NormalActionNoise(
            np.zeros(size), np.full(size, finite("action_noise", noise))
        )
