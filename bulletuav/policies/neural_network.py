"""Trained networks, flown by NumPy alone.

Numbers come from a safetensors file, layers from the settings of the run. The names in the file
are those of stable-baselines3's policies (`state_dict`), beside the bounds of the actions.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors.numpy import load_file

from bulletuav.compiled.functions import tanh
from bulletuav.errors import reason_of
from bulletuav.policies.features import Layers, UserFeatures, dense, symlog
from bulletuav.policies.layers import Affine, Choose, Clip, Dense, Layer, Relu, Symlog, Tanh
from bulletuav.policies.swarm_features import SwarmFeatures, find_layout
from bulletuav.sensors.base import Label

LOW = "action.low"
"""Name of the lower bounds of the actions, float32; a policy of discrete actions has none"""
HIGH = "action.high"
"""Name of their upper bounds"""
SETTINGS = ("net_arch", "log_std_init", "ortho_init", "n_critics", "features_extractor_kwargs")
"""Arguments of stable-baselines3's policies that leave the layers of the actor as told here"""
STACKS = ("mlp_extractor.policy_net", "actor.latent_pi")
"""Names of layers before the last one, of which there may be none"""
Weights = Mapping[str, np.ndarray]
"""Arrays of a policy by their names in its file"""


class Actor(NamedTuple):
    """Where an algorithm's file holds the network that acts, and how it acts.

    Attributes:
        layers: Names of its dense layers, first to last; of a stack of layers what stands before
            their numbers.
        features: What stands before the names of the features' numbers.
        activation: Function between layers.
        squashed: Whether the last layer goes through tanh, whose ends are the bounds of the
            actions; else it is clipped to them.
    """

    layers: tuple[str, ...]
    features: str
    activation: Callable[[np.ndarray], np.ndarray]
    squashed: bool


def _tanh(values: np.ndarray) -> np.ndarray:
    """Apply the hyperbolic tangent."""
    return np.asarray(tanh(values))


def _relu(values: np.ndarray) -> np.ndarray:
    """Cut off what is negative."""
    return np.asarray(np.maximum(values, 0.0))


_ON_POLICY = Actor(
    layers=("mlp_extractor.policy_net", "action_net"),
    features="features_extractor.",
    activation=_tanh,
    squashed=False,
)
_SAC = Actor(
    layers=("actor.latent_pi", "actor.mu"),
    features="actor.features_extractor.",
    activation=_relu,
    squashed=True,
)
_TD3 = Actor(
    layers=("actor.mu",), features="actor.features_extractor.", activation=_relu, squashed=True
)
_DQN = Actor(
    layers=("q_net.q_net",), features="q_net.features_extractor.", activation=_relu, squashed=False
)
ACTORS = {
    "ppo": _ON_POLICY,
    "a2c": _ON_POLICY,
    "sac": _SAC,
    "td3": _TD3,
    "ddpg": _TD3,
    "dqn": _DQN,
}
"""Actors of the algorithms by their names"""


def read_weights(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a safetensors file, which can hold nothing but numbers.

    Args:
        path: The file.

    Returns:
        Arrays by name.

    Raises:
        ValueError: The file is of another kind, or holds a number that is not finite.
        FileNotFoundError: There is no such file.
    """
    try:
        weights: dict[str, np.ndarray] = load_file(path)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"no policy {path}: the folder of a run that was trained holds one"
        ) from None
    # Besides SafetensorError, NumPy raises errors of types and sizes
    except Exception as error:
        raise ValueError(f"{path} is no safetensors file: {reason_of(error)}") from None
    for name, array in weights.items():
        if array.dtype.kind != "f":
            raise ValueError(
                f"{path}: {name} is of {array.dtype}, and floats are needed; train the policy again"
            )
        if not np.isfinite(array).all():
            raise ValueError(
                f"{path}: {name} holds a number that is not finite; train the policy again"
            )
    return weights


def is_plain(algorithm: str, model: Mapping[str, Any]) -> bool:
    """Tell whether `Network` knows the layers that an algorithm learns, for vectors of numbers.

    Args:
        algorithm: One of `ACTORS`.
        model: The run's settings of the algorithm.
    """
    # With noise of states, SAC's last layer has a clip of its own.
    explored = model.get("use_sde", False) and algorithm == "sac"
    return not explored and set(model.get("policy_kwargs", {})) <= set(SETTINGS)


class Network:
    """A network that chooses the deterministic action for each row of observations."""

    def __init__(
        self,
        weights: Weights,
        algorithm: str,
        model: Mapping[str, Any],
        labels: Sequence[Label] = (),
    ) -> None:
        """Take an actor out of the weights.

        Args:
            weights: Arrays by name. What they compute is computed in double precision.
            algorithm: One of `ACTORS`.
            model: The run's settings of the algorithm; `is_plain` holds for them.
            labels: Labels of the numbers of an observation, for features of a swarm.

        Raises:
            ValueError: The weights are not those of such an actor.
        """
        # Layers of the actor, and the bounds of its actions
        actor = self._actor = ACTORS[algorithm]
        self._layers = [pair for name in actor.layers for pair in _dense(weights, name)]
        has_bounds = LOW in weights and HIGH in weights
        self._bounds = (weights[LOW], weights[HIGH]) if has_bounds else None
        # What the observation goes through before
        kind = model["features"]
        arguments = model.get("policy_kwargs", {}).get("features_extractor_kwargs", {})
        scale = arguments.get("scale", 1.0)
        self._scale = scale if kind == "symlog" else None
        of_users = _dense(weights, f"{actor.features}each") if kind == "user_sum" else []
        of_others = _kinds(weights, f"{actor.features}each.") if kind == "swarm" else {}
        # Widths must fit, or the file is of something else
        for layers in (self._layers, of_users, *of_others.values()):
            _require_chain(layers)
        if not self._layers:
            raise ValueError("it has no layers")
        given = self._layers[-1][1].shape
        if self._bounds is not None and any(bound.shape != given for bound in self._bounds):
            raise ValueError(f"{LOW} and {HIGH} need the shape {given}")
        if self._bounds is not None and (self._bounds[0] >= self._bounds[1]).any():
            raise ValueError(f"{LOW} must be below {HIGH}")
        self._users = UserFeatures(of_users) if of_users else None
        is_swarm = kind == "swarm"
        self._swarm = SwarmFeatures(find_layout(labels), of_others, scale) if is_swarm else None

    @property
    def shape(self) -> str:
        """What it takes and gives, for messages."""
        inputs = "those of users" if self._users else f"{self._layers[0][0].shape[1]} numbers"
        return f"{inputs} to {len(self._layers[-1][1])} {'numbers' if self._bounds else 'choices'}"

    def fits(self, observed: int, given: int, choices: bool) -> bool:
        """Tell whether it fits an environment.

        Args:
            observed: How many numbers a drone observes.
            given: How many numbers its action has, or how many choices there are.
            choices: Whether its action is a choice.
        """
        expected = self._layers[0][0].shape[1]
        # Features of others were compared to the labels, and take any number of others.
        if self._swarm is not None:
            observed = expected
        if self._users is not None:
            try:
                self._users.sizes(observed)
            except ValueError:
                return False
            # Features of users take any number of users.
            observed = expected
        own = (expected, len(self._layers[-1][1]), self._bounds is None)
        return (observed, given, choices) == own

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Choose actions.

        Args:
            rows: (M, D) observations.

        Returns:
            (M, A) within the bounds, or (M, 1) choices.
        """
        values = np.asarray(rows, dtype=float)
        # Features.
        if self._scale is not None:
            values = symlog(values, self._scale)
        if self._users is not None:
            values = self._users(values)
        if self._swarm is not None:
            values = self._swarm(values)
        # Layers.
        for k, (weight, bias) in enumerate(self._layers):
            values = dense(self._actor.activation(values) if k else values, weight, bias)
        # Actions.
        if self._bounds is None:
            best: np.ndarray = values.argmax(axis=1)
            return best[:, None]
        low, high = self._bounds
        if self._actor.squashed:
            share = 0.5 * (tanh(values) + 1)
            squashed: np.ndarray = low + share * (high - low)
            return squashed
        clipped: np.ndarray = np.clip(values, low, high)
        return clipped

    def layers(self) -> list[Layer]:
        """List what it computes, first to last, for writers of other formats.

        Raises:
            ValueError: It has features of users, for which there is no layer.
        """
        if self._users is not None:
            raise ValueError(
                "features 'user_sum' have no form for other programs: train with features 'symlog'"
            )
        # Features first, if there are any
        layers: list[Layer] = [] if self._scale is None else [Symlog(self._scale)]
        layers += [] if self._swarm is None else [self._swarm.layer()]
        # Dense layers with an activation between each two
        between = Tanh() if self._actor.activation is _tanh else Relu()
        for k, (weight, bias) in enumerate(self._layers):
            layers += [between, Dense(weight, bias)] if k else [Dense(weight, bias)]
        # Choices have no bounds, and clipped actions no squashing
        if self._bounds is None:
            return [*layers, Choose()]
        low, high = (bound.astype(float) for bound in self._bounds)
        if not self._actor.squashed:
            return [*layers, Clip(low, high)]
        half = (high - low) / 2
        return [*layers, Tanh(), Affine(half, low + half)]


def _dense(weights: Weights, name: str) -> Layers:
    """Take out the dense layer of that name, or the stack of layers by their numbers."""
    numbers = {
        int(match[1])
        for known in weights
        if (match := re.fullmatch(rf"{re.escape(name)}\.(\d+)\.weight", known))
    }
    names = [f"{name}.{number}" for number in sorted(numbers)]
    if not names and name not in STACKS:
        names = [name]
    try:
        return [
            (weights[f"{one}.weight"].astype(float), weights[f"{one}.bias"].astype(float))
            for one in names
        ]
    except KeyError as error:
        raise ValueError(f"it lacks {error.args[0]}") from None


def _kinds(weights: Weights, begin: str) -> dict[str, Layers]:
    """Take out the stacks of layers by what stands between `begin` and their numbers."""
    found = {name.removeprefix(begin).split(".")[0] for name in weights if name.startswith(begin)}
    return {word: _dense(weights, f"{begin}{word}") for word in sorted(found)}


def _require_chain(layers: Layers) -> None:
    """Raise ValueError unless each layer takes as many numbers as the one before it gives."""
    given = None
    for weight, bias in layers:
        is_layer = weight.ndim == 2 and bias.shape == weight.shape[:1]
        if not is_layer or given not in (None, weight.shape[1]):
            raise ValueError(
                f"a layer of weights {weight.shape} and biases {bias.shape} "
                f"does not fit the one before it"
            )
        given = len(bias)
