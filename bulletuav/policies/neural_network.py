"""Inference of trained policy networks in NumPy.

Weights are read from a safetensors file, the layers follow from the configuration of the run. Array
names are those of stable-baselines3's `state_dict`, plus the bounds of the actions.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from bulletuav.compiled.functions import tanh
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import reason_of
from bulletuav.files import whole_file
from bulletuav.policies.features import Layers, UserFeatures, dense, symlog
from bulletuav.policies.layers import Affine, Argmax, Clip, Dense, Layer, Relu, SymlogLayer, Tanh
from bulletuav.policies.swarm_features import NumpySwarmFeatures, find_layout
from bulletuav.sensors.base import Label

LOW = "action.low"
"""Array name of the lower bounds of the actions, float32; absent for discrete actions"""
HIGH = "action.high"
"""Array name of the upper bounds of the actions"""
SETTINGS = ("net_arch", "log_std_init", "ortho_init", "n_critics", "features_extractor_kwargs")
"""Arguments of stable-baselines3 policies that `Network` supports"""
STACKS = ("mlp_extractor.policy_net", "actor.latent_pi")
"""Names of hidden layer stacks, which may be empty"""
Weights = Mapping[str, np.ndarray]
"""Arrays of a policy by their names in the file"""


class Actor(NamedTuple):
    """Names and output of the actor network of an algorithm.

    Attributes:
        layers: Names of the dense layers, first to last; for a stack of layers, the prefix of their
            indices.
        features: Prefix of the array names of the feature extractor.
        activation: Activation between layers.
        squashed: Whether tanh scales the output to the bounds of the actions; otherwise the output
            is clipped to them.
    """

    layers: tuple[str, ...]
    features: str
    activation: Callable[[np.ndarray], np.ndarray]
    squashed: bool


def _tanh(values: np.ndarray) -> np.ndarray:
    # A kernel, as numba compiles elementwise functions of arrays in each process
    numbers = np.ascontiguousarray(values)
    result = np.empty_like(numbers)
    _write_tanh(numbers.reshape(-1), result.reshape(-1))
    return result


@kernel
def _write_tanh(values: np.ndarray, result: np.ndarray) -> None:
    for k in range(len(values)):
        result[k] = tanh(values[k])


def _relu(values: np.ndarray) -> np.ndarray:
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
    "fast_ppo": _ON_POLICY,
    "a2c": _ON_POLICY,
    "sac": _SAC,
    "td3": _TD3,
    "ddpg": _TD3,
    "dqn": _DQN,
}
"""Actor networks by algorithm"""


def read_weights(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a safetensors file, a format that contains numbers only.

    Args:
        path: The file.

    Returns:
        Arrays by name.

    Raises:
        ValueError: If the file is of another kind, or contains a number that is not finite.
        FileNotFoundError: If there is no such file.
    """
    try:
        weights: dict[str, np.ndarray] = load_file(path)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"no policy {path}: the folder of a completed training run is needed"
        ) from None
    # Besides SafetensorError, NumPy raises errors of types and sizes
    except Exception as error:
        raise ValueError(f"{path} is not a safetensors file: {reason_of(error)}") from None
    for name, array in weights.items():
        if array.dtype.kind != "f":
            raise ValueError(
                f"{path}: {name} is of {array.dtype}, and floats are needed; train the policy again"
            )
        if not np.isfinite(array).all():
            raise ValueError(
                f"{path}: {name} contains a number that is not finite; train the policy again"
            )
    return weights


def write_weights(
    arrays: Mapping[str, np.ndarray], path: Path, about: dict[str, str] | None = None
) -> None:
    """Write arrays to a safetensors file.

    Args:
        arrays: Arrays by name.
        path: The file.
        about: Metadata.

    Raises:
        OSError: If the file cannot be written.
    """
    with whole_file(path) as part:
        # safetensors raises its own error, as for a full disk
        try:
            save_file(dict(arrays), part, about)
        except SafetensorError as error:
            raise OSError(str(error)) from None


def is_plain(algorithm: str, model: Mapping[str, Any]) -> bool:
    """Return True if `Network` supports the layers of an algorithm, for vector observations.

    Args:
        algorithm: One of `ACTORS`.
        model: Algorithm settings of the run.
    """
    # With state-dependent exploration, SAC clips its last layer.
    explored = model.get("use_sde", False) and algorithm == "sac"
    return not explored and set(model.get("policy_kwargs", {})) <= set(SETTINGS)


class Network:
    """Policy network that maps each row of observations to its deterministic action."""

    def __init__(
        self,
        weights: Weights,
        algorithm: str,
        model: Mapping[str, Any],
        labels: Sequence[Label] = (),
    ) -> None:
        """Load the actor from the weights.

        Args:
            weights: Arrays by name; inference is in double precision.
            algorithm: One of `ACTORS`.
            model: Algorithm settings of the run, for which `is_plain` is True.
            labels: Labels of the numbers of an observation, for swarm features.

        Raises:
            ValueError: If the weights do not match the actor.
        """
        # Layers of the actor, and the bounds of its actions
        actor = self._actor = ACTORS[algorithm]
        self._layers = [pair for name in actor.layers for pair in _dense(weights, name)]
        has_bounds = LOW in weights and HIGH in weights
        self._bounds = (weights[LOW], weights[HIGH]) if has_bounds else None
        # Feature extractor
        kind = model["features"]
        arguments = model.get("policy_kwargs", {}).get("features_extractor_kwargs", {})
        scale = arguments.get("scale", 1.0)
        self._scale = scale if kind == "symlog" else None
        of_users = _dense(weights, f"{actor.features}each") if kind == "user_sum" else []
        of_others = _kinds(weights, f"{actor.features}each.") if kind == "swarm" else {}
        # Layer widths must be consistent
        for layers in (self._layers, of_users, *of_others.values()):
            _require_chain(layers)
        if not self._layers:
            raise ValueError("the file has no layers")
        given = self._layers[-1][1].shape
        if self._bounds is not None and any(bound.shape != given for bound in self._bounds):
            raise ValueError(f"{LOW} and {HIGH} need the shape {given}")
        if self._bounds is not None and (self._bounds[0] >= self._bounds[1]).any():
            raise ValueError(f"{LOW} must be below {HIGH}")
        self._users = UserFeatures(of_users) if of_users else None
        is_swarm = kind == "swarm"
        self._swarm = (
            NumpySwarmFeatures(find_layout(labels), of_others, scale) if is_swarm else None
        )

    @property
    def shape(self) -> str:
        """Inputs and outputs of the network, for messages."""
        inputs = "those of users" if self._users else f"{self._layers[0][0].shape[1]} numbers"
        return f"{inputs} to {len(self._layers[-1][1])} {'numbers' if self._bounds else 'choices'}"

    def fits(self, observed: int, given: int, choices: bool) -> bool:
        """Return True if the network matches an environment.

        Args:
            observed: Number of observed numbers of a drone.
            given: Number of numbers of an action, or number of discrete choices.
            choices: Whether actions are discrete.
        """
        expected = self._layers[0][0].shape[1]
        # Swarm features accept any number of entities; the labels were checked before.
        if self._swarm is not None:
            observed = expected
        if self._users is not None:
            try:
                self._users.sizes(observed)
            except ValueError:
                return False
            # User features accept any number of users.
            observed = expected
        own = (expected, len(self._layers[-1][1]), self._bounds is None)
        return (observed, given, choices) == own

    def __call__(self, rows: np.ndarray, valid: np.ndarray | None = None) -> np.ndarray:
        """Compute actions.

        Args:
            rows: (M, D) observations.
            valid: (M, C) bool, choices that are possible; None for all.

        Returns:
            (M, A) actions within the bounds, or (M, 1) discrete choices.
        """
        values = np.asarray(rows, dtype=float)
        if self._scale is not None:
            values = symlog(values, self._scale)
        if self._users is not None:
            values = self._users(values)
        if self._swarm is not None:
            values = self._swarm(values)
        for k, (weight, bias) in enumerate(self._layers):
            values = dense(self._actor.activation(values) if k else values, weight, bias)
        if self._bounds is None:
            if valid is not None:
                values = np.where(valid, values, -np.inf)
            best: np.ndarray = values.argmax(axis=1)
            return best[:, None]
        low, high = self._bounds
        if self._actor.squashed:
            fraction = 0.5 * (tanh(values) + 1)
            squashed: np.ndarray = low + fraction * (high - low)
            return squashed
        clipped: np.ndarray = np.clip(values, low, high)
        return clipped

    def layers(self) -> list[Layer]:
        """Return the layers of the network, first to last, for export to other formats.

        Raises:
            ValueError: If the network has features of users, for which there is no layer type.
        """
        if self._users is not None:
            raise ValueError("features 'user_sum' cannot be exported: train with features 'symlog'")
        # Features first, if there are any
        layers: list[Layer] = [] if self._scale is None else [SymlogLayer(self._scale)]
        layers += [] if self._swarm is None else [self._swarm.layer()]
        # Dense layers with an activation between each two
        between = Tanh() if self._actor.activation is _tanh else Relu()
        for k, (weight, bias) in enumerate(self._layers):
            layers += [between, Dense(weight, bias)] if k else [Dense(weight, bias)]
        # Choices have no bounds, and clipped actions no squashing
        if self._bounds is None:
            return [*layers, Argmax()]
        low, high = (bound.astype(float) for bound in self._bounds)
        if not self._actor.squashed:
            return [*layers, Clip(low, high)]
        half = (high - low) / 2
        return [*layers, Tanh(), Affine(half, low + half)]


def _dense(weights: Weights, name: str) -> Layers:
    """Return the dense layer with that name, or the stack of layers with that prefix."""
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
        raise ValueError(f"the file lacks {error.args[0]}") from None


def _kinds(weights: Weights, prefix: str) -> dict[str, Layers]:
    """Return the layer stacks whose names start with `prefix`, by the word that follows."""
    found = {name.removeprefix(prefix).split(".")[0] for name in weights if name.startswith(prefix)}
    return {word: _dense(weights, f"{prefix}{word}") for word in sorted(found)}


def _require_chain(layers: Layers) -> None:
    """Raise ValueError unless the widths of consecutive layers match."""
    given = None
    for weight, bias in layers:
        is_layer = weight.ndim == 2 and bias.shape == weight.shape[:1]
        if not is_layer or given not in (None, weight.shape[1]):
            raise ValueError(
                f"a layer of weights {weight.shape} and biases {bias.shape} "
                f"does not match the layer before"
            )
        given = len(bias)
