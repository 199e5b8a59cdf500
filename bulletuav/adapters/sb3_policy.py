"""Networks of stable-baselines3's policies, made from a run's settings."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.adapters.features import Symlog, UserSum
from bulletuav.adapters.sb3 import algorithm, own_random, single_thread
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.errors import missing, unknown
from bulletuav.policies.neural_network import HIGH, LOW
from bulletuav.policies.swarm_features import find_layout
from bulletuav.sensors.base import Label

try:
    import torch
    from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
    from stable_baselines3.common.vec_env import VecTransposeImage
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None

FEATURES: dict[str | None, type | None] = {
    "symlog": Symlog,
    "swarm": SwarmFeatures,
    "user_sum": UserSum,
    None: None,
}
"""Features that observed numbers go through first, by the setting `features` of a run"""


def policy_arguments(
    model: Mapping[str, Any], num_drones: int, labels: Sequence[Label], pictures: bool
) -> dict[str, Any]:
    """Make the arguments of stable-baselines3's policy.

    Args:
        model: A run's settings of its algorithm, `features` and `policy_kwargs` among them.
        num_drones: How many drones a world has.
        labels: Labels of the numbers of an observation.
        pictures: Whether pictures are observed, which have features of their own.

    Returns:
        The arguments by name.

    Raises:
        ValueError: The settings cannot be.
    """
    features = model["features"]
    if features not in FEATURES:
        raise unknown("features", features, filter(None, FEATURES))
    given = model.get("policy_kwargs", {})
    if not isinstance(given, Mapping):
        raise ValueError(f"policy_kwargs is {given!r}: names with values are needed")
    arguments = dict(given)
    if features is not None and not pictures:
        arguments.setdefault("features_extractor_class", FEATURES[features])
    # Features of users depend on how many drones there are, those of others on where numbers are.
    told: dict[str, Any] = {}
    if features == "user_sum":
        told = {"num_drones": num_drones}
    elif features == "swarm" and not pictures:
        told = {"layout": find_layout(labels)}
    if told:
        arguments["features_extractor_kwargs"] = {
            **told,
            **arguments.get("features_extractor_kwargs", {}),
        }
    return arguments


def policy_network(
    name: str,
    model: Mapping[str, Any],
    observed: Space[Any],
    given: Space[Any],
    num_drones: int,
    labels: Sequence[Label],
    weights: Mapping[str, np.ndarray],
) -> Callable[[Any], np.ndarray]:
    """Build the network of a run's policy and fill in its weights; nothing but numbers is read.

    Args:
        name: Name of the algorithm, in lower case.
        model: The run's settings of it.
        observed: Space of one drone's observations.
        given: Space of its actions.
        num_drones: How many drones a world has.
        labels: Labels of the numbers of an observation.
        weights: Arrays by the names of the policy's `state_dict`, and the bounds of the actions.

    Returns:
        A function from rows of observations to rows of deterministic actions.

    Raises:
        ValueError: The weights do not fit.
    """
    single_thread()
    pictures = isinstance(observed, Dict)
    if isinstance(observed, Dict):
        observed = Dict({key: _channels_first(space) for key, space in observed.spaces.items()})
    if LOW in weights:
        given = Box(weights[LOW], weights[HIGH], dtype=np.float32)
    # The network as training makes it.
    arguments = policy_arguments(model, num_drones, labels, pictures)
    if name in ("ppo", "a2c", "sac"):
        arguments["use_sde"] = model.get("use_sde", False)
    with own_random():
        kind = algorithm(name).policy_aliases["MultiInputPolicy" if pictures else "MlpPolicy"]
        policy = kind(observed, given, lambda _: 0.0, **arguments)
    # Its weights.
    state = {
        known: torch.as_tensor(array)
        for known, array in weights.items()
        if known not in (LOW, HIGH)
    }
    try:
        policy.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    policy.set_training_mode(False)
    return lambda rows: policy.predict(rows, deterministic=True)[0]


def _channels_first(space: Space[Any]) -> Space[Any]:
    """Give the space as networks see it that stable-baselines3 made: it turns pictures."""
    if (
        isinstance(space, Box)
        and is_image_space(space)
        and not is_image_space_channels_first(space)
    ):
        return VecTransposeImage.transpose_space(space)
    return space
