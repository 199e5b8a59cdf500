"""Trained networks, flown by NumPy alone: numbers from a safetensors file, layers from the settings of the run.

The names in the file are those of stable-baselines3's policies (`state_dict`), beside the bounds of the actions.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from bulletuav.policies.features import Layers, UserFeatures, symlog

LOW, HIGH = "action.low", "action.high"
"""Bounds of the actions, float32; a policy that chooses among discrete actions has none"""
SETTINGS = ("net_arch", "log_std_init", "ortho_init", "n_critics", "features_extractor_kwargs")
"""Arguments of stable-baselines3's policies that leave the layers of the actor as they are told here"""
STACKS = ("mlp_extractor.policy_net", "actor.latent_pi")
"""Layers before the last one, of which there may be none"""
Weights = Mapping[str, np.ndarray]


class Actor(NamedTuple):
    """Where an algorithm's file holds the network that acts.

    layers      names of its dense layers, first to last; of a stack of layers what stands before their numbers
    features    what stands before the names of the features' numbers
    activation  between layers
    squashed    whether the last layer goes through tanh, whose ends are the bounds of the actions; else it is clipped
    """

    layers: tuple[str, ...]
    features: str
    activation: Callable[[np.ndarray], np.ndarray]
    squashed: bool


def _relu(values: np.ndarray) -> np.ndarray:
    return np.maximum(values, 0.0)


_ON_POLICY = Actor(
    ("mlp_extractor.policy_net", "action_net"), "features_extractor.", np.tanh, False
)
_TD3 = Actor(("actor.mu",), "actor.features_extractor.", _relu, True)
ACTORS = {
    "ppo": _ON_POLICY,
    "a2c": _ON_POLICY,
    "sac": Actor(("actor.latent_pi", "actor.mu"), "actor.features_extractor.", _relu, True),
    "td3": _TD3,
    "ddpg": _TD3,
    "dqn": Actor(("q_net.q_net",), "q_net.features_extractor.", _relu, False),
}


def read_weights(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a safetensors file, which can hold nothing but numbers.

    Raises:
        ValueError: The file is of another kind, or holds a number that is not finite.
        FileNotFoundError: There is no such file.
    """
    try:
        weights = load_file(path)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"no policy {path}: the folder of a run that was trained holds one"
        ) from None
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is no safetensors file: {error}") from None
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise ValueError(
                f"{path}: {name} holds a number that is not finite; train the policy again"
            )
    return weights


def is_plain(algorithm: str, model: Mapping[str, Any]) -> bool:
    """Tell whether `Network` knows the layers that an algorithm with these settings learns, for vectors of numbers."""
    explored = (
        model.get("use_sde", False) and algorithm == "sac"
    )  # whose last layer has a clip of its own
    return not explored and set(model.get("policy_kwargs", {})) <= set(SETTINGS)


class Network:
    """The deterministic action for each row of observations."""

    def __init__(self, weights: Weights, algorithm: str, model: Mapping[str, Any]):
        """Take an actor out of the weights.

        Args:
            weights: Arrays by name. What they compute is computed in double precision.
            algorithm: One of `ACTORS`.
            model: The run's settings of the algorithm; `is_plain` holds for them.

        Raises:
            ValueError: The weights are not those of such an actor.
        """
        self._actor = ACTORS[algorithm]
        self._layers = [pair for name in self._actor.layers for pair in _dense(weights, name)]
        self._bounds = (weights[LOW], weights[HIGH]) if LOW in weights and HIGH in weights else None
        kind = model["features"]
        arguments = model.get("policy_kwargs", {}).get("features_extractor_kwargs", {})
        self._scale = arguments.get("scale", 1.0) if kind == "symlog" else None
        of_users = _dense(weights, f"{self._actor.features}each") if kind == "user_sum" else []
        for layers in (self._layers, of_users):
            _require_chain(layers)
        self._users = UserFeatures(of_users) if of_users else None

    @property
    def shape(self) -> str:
        """What it takes and gives, for messages."""
        inputs = "those of users" if self._users else f"{self._layers[0][0].shape[1]} numbers"
        return f"{inputs} to {len(self._layers[-1][1])} {'numbers' if self._bounds else 'choices'}"

    def fits(self, observed: int, given: int, choices: bool) -> bool:
        """Tell whether it takes `observed` numbers and gives `given` numbers, or as many `choices`."""
        expected = self._layers[0][0].shape[1]
        if self._users is not None:
            try:
                self._users.sizes(observed)
            except ValueError:
                return False
            observed = expected
        return (observed, given, choices) == (
            expected,
            len(self._layers[-1][1]),
            self._bounds is None,
        )

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Choose actions.

        Args:
            rows: (M, D) observations.

        Returns:
            (M, A) within the bounds, or (M, 1) choices.
        """
        values = np.asarray(rows, dtype=float)
        if self._scale is not None:
            values = symlog(values, self._scale)
        if self._users is not None:
            values = self._users(values)
        for k, (weight, bias) in enumerate(self._layers):
            values = (self._actor.activation(values) if k else values) @ weight.T + bias
        if self._bounds is None:
            return values.argmax(axis=1)[:, None]
        low, high = self._bounds
        if self._actor.squashed:
            return low + 0.5 * (np.tanh(values) + 1) * (high - low)
        return np.clip(values, low, high)


def _dense(weights: Weights, name: str) -> Layers:
    """The dense layers of that name, or of the stack of that name in the order of their numbers."""
    numbers = {
        int(match[1])
        for known in weights
        if (match := re.fullmatch(rf"{re.escape(name)}\.(\d+)\.weight", known))
    }
    names = [f"{name}.{number}" for number in sorted(numbers)] or ([] if name in STACKS else [name])
    try:
        layers = [
            (weights[f"{one}.weight"].astype(float), weights[f"{one}.bias"].astype(float))
            for one in names
        ]
    except KeyError as error:
        raise ValueError(f"it lacks {error.args[0]}") from None
    return layers


def _require_chain(layers: Layers) -> None:
    """Raise ValueError unless each layer takes as many numbers as the one before it gives."""
    sizes = None
    for weight, bias in layers:
        if (
            weight.ndim != 2
            or bias.shape != weight.shape[:1]
            or sizes not in (None, weight.shape[1])
        ):
            raise ValueError(
                f"a layer of weights {weight.shape} and biases {bias.shape} does not fit the one before it"
            )
        sizes = len(bias)
