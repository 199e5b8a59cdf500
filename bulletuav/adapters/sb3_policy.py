"""Policy networks of stable-baselines3, built from the settings of a run."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.adapters.features import PictureFeatures, SymlogFeatures, UserSum
from bulletuav.adapters.sb3 import algorithm, preserve_random_state, single_thread
from bulletuav.adapters.swarm_features import SwarmFeatures
from bulletuav.errors import missing_extra, unknown
from bulletuav.policies.neural_network import HIGH, LOW
from bulletuav.policies.swarm_features import find_layout
from bulletuav.sensors.base import Label

try:
    import torch
    from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
    from stable_baselines3.common.vec_env import VecTransposeImage
except ImportError:
    raise missing_extra("learning with stable-baselines3", "sb3") from None

FEATURES: dict[str | None, type | None] = {
    "symlog": SymlogFeatures,
    "swarm": SwarmFeatures,
    "user_sum": UserSum,
    None: None,
}
"""Feature extractors of observations, by the setting `features` of a run"""


def policy_arguments(
    model: Mapping[str, Any], num_drones: int, labels: Sequence[Label], pictures: bool
) -> dict[str, Any]:
    """Return the arguments of the policy class of stable-baselines3.

    Args:
        model: Settings of the algorithm of a run, with `features` and `policy_kwargs`.
        num_drones: Number of drones of a world.
        labels: Labels of the numbers of an observation.
        pictures: If True, observations are dicts with images: features "symlog" are then
            `PictureFeatures`, and None those of stable-baselines3.

    Returns:
        The keyword arguments.

    Raises:
        ValueError: If a setting is invalid.
    """
    features = model["features"]
    if features not in FEATURES:
        raise unknown("features", features, filter(None, FEATURES))
    given = model.get("policy_kwargs", {})
    if not isinstance(given, Mapping):
        raise ValueError(f"policy_kwargs is {given!r}: names with values are needed")
    if pictures and features not in ("symlog", None):
        raise ValueError(
            f"features is {features!r}: observations with images need 'symlog' or None"
        )
    arguments = dict(given)
    if features is not None:
        kind = PictureFeatures if pictures else FEATURES[features]
        arguments.setdefault("features_extractor_class", kind)
    # "user_sum" depends on the number of drones, "swarm" on the layout of the observation
    extra: dict[str, Any] = {}
    if features == "user_sum":
        extra = {"num_drones": num_drones}
    elif features == "swarm":
        extra = {"layout": find_layout(labels)}
    if extra:
        arguments["features_extractor_kwargs"] = {
            **extra,
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
    masked: bool = False,
) -> Callable[..., np.ndarray]:
    """Build the policy network of a run and load its weights, without unpickling.

    Args:
        name: Name of the algorithm, in lower case.
        model: Settings of the algorithm of the run.
        observed: Observation space of one drone.
        given: Action space of one drone.
        num_drones: Number of drones of a world.
        labels: Labels of the numbers of an observation.
        weights: Arrays of the `state_dict` of the policy by name, and the bounds of the actions.
        masked: Whether the policy is one of MaskablePPO.

    Returns:
        A function from observations (M, D), and masks (M, C) if masked, to deterministic actions
        (M, A).

    Raises:
        ValueError: If the weights do not match the network.
    """
    single_thread()
    pictures = isinstance(observed, Dict)
    if isinstance(observed, Dict):
        observed = Dict({key: _channels_first(space) for key, space in observed.spaces.items()})
    if LOW in weights:
        given = Box(weights[LOW], weights[HIGH], dtype=np.float32)
    # Create the network as in training
    arguments = policy_arguments(model, num_drones, labels, pictures)
    if name in ("ppo", "a2c", "sac") and not masked:
        arguments["use_sde"] = model.get("use_sde", False)
    with preserve_random_state():
        kind = algorithm(name, masked)
        named = kind.policy_aliases["MultiInputPolicy" if pictures else "MlpPolicy"]
        policy = named(observed, given, lambda _: 0.0, **arguments)
    # Load its weights
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
    if masked:
        return lambda rows, valid: policy.predict(rows, deterministic=True, action_masks=valid)[0]
    return lambda rows: policy.predict(rows, deterministic=True)[0]


def _channels_first(space: Space[Any]) -> Space[Any]:
    """Return the space with images channels-first, as stable-baselines3 transposes them."""
    if (
        isinstance(space, Box)
        and is_image_space(space)
        and not is_image_space_channels_first(space)
    ):
        return VecTransposeImage.transpose_space(space)
    return space
