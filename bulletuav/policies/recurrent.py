"""Recurrent policies of rotor commands, in NumPy, for quadrotors of any kind.

A policy observes each drone in the axes of `bulletuav.policies.rotor_axes`, and keeps a hidden
state for each drone, from which it infers the airframe. It is trained by the algorithm
`FOUNDATION`, see `bulletuav.training.foundation`.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin, tanh
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.features import dense
from bulletuav.policies.layers import Affine, Clip, Dense, Gru, Layer, Tanh
from bulletuav.policies.neural_network import HIGH, LOW, Weights, read_weights
from bulletuav.policies.rotor_axes import RotorAxes, find_rotor_axes
from bulletuav.policies.trained import SharedPolicy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

BLOCKS = ("body_goal_offset", "body_velocity", "body_up", "rates", "last_action")
"""Blocks of the observation"""
NUM_VECTORS, NUM_ROTORS = 4, 4
"""Numbers of vectors and of rotors in the observation"""
NUM_INPUTS = 3 * NUM_VECTORS + NUM_ROTORS
"""Number of observed numbers of a drone"""
LABELS = tuple(
    f"{name} {axis}"
    for name in ("body goal offset", "body velocity", "body up", "rates")
    for axis in "xyz"
) + tuple(f"action {k}" for k in range(NUM_ROTORS))
"""Names of the observed numbers"""
LIMIT, SCALE = "input.limit", "input.scale"
"""Array names of the largest magnitude of each observed number, and of the factor on it"""


class RecurrentNetwork:
    """Network with a dense layer, a gated recurrent unit and a dense layer.

    Attributes:
        hidden_size: Number H of hidden numbers of a drone.
    """

    def __init__(self, weights: Weights) -> None:
        """Load the network from its weights.

        Args:
            weights: Arrays by name, those of `bulletuav.training.foundation.gru.gru_arrays` with
                `LIMIT`, `SCALE` and the bounds of the actions; inference is in double precision.

        Raises:
            ValueError: If an array is missing, or has another shape.
        """
        encoder = weights.get("encoder.bias")
        size = self.hidden_size = 0 if encoder is None else encoder.size
        gates = (3 * size, size)
        shapes = {
            LIMIT: (NUM_INPUTS,),
            SCALE: (NUM_INPUTS,),
            "encoder.weight": (size, NUM_INPUTS),
            "encoder.bias": (size,),
            "gru.weight_ih_l0": gates,
            "gru.bias_ih_l0": gates[:1],
            "gru.weight_hh_l0": gates,
            "gru.bias_hh_l0": gates[:1],
            "decoder.weight": (NUM_ROTORS, size),
            "decoder.bias": (NUM_ROTORS,),
            LOW: (NUM_ROTORS,),
            HIGH: (NUM_ROTORS,),
        }
        for name, shape in shapes.items():
            if name not in weights:
                raise ValueError(f"the file lacks {name}")
            if weights[name].shape != shape:
                raise ValueError(f"{name} has the shape {weights[name].shape}, not {shape}")
        own = {name: weights[name].astype(float) for name in shapes}
        self._limit, self._scale, self._low, self._high = (
            own[name] for name in (LIMIT, SCALE, LOW, HIGH)
        )
        if (self._limit < 0).any() or (self._low >= self._high).any():
            raise ValueError(f"{LIMIT} must not be negative, and {LOW} must be below {HIGH}")
        self._encoder = Dense(own["encoder.weight"], own["encoder.bias"])
        self._gru = Gru(
            *(own[f"gru.{name}"] for name in ("weight_ih_l0", "bias_ih_l0")),
            *(own[f"gru.{name}"] for name in ("weight_hh_l0", "bias_hh_l0")),
        )
        self._decoder = Dense(own["decoder.weight"], own["decoder.bias"])

    def step(self, rows: np.ndarray, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute actions, and the next hidden states.

        Args:
            rows: (M, D) observations in common axes.
            hidden: (M, H) hidden states, zero at the start of an episode.

        Returns:
            (M, 4) actions within their bounds, and (M, H) hidden states.
        """
        values = np.clip(np.asarray(rows, dtype=float), -self._limit, self._limit) * self._scale
        hidden = step_gru(self._gru, np.asarray(tanh(dense(values, *self._encoder))), hidden)
        actions: np.ndarray = np.clip(dense(hidden, *self._decoder), self._low, self._high)
        return actions, hidden

    def layers(self) -> list[Layer]:
        """Return the layers of the network, first to last, for export to other formats."""
        return [
            Clip(-self._limit, self._limit),
            Affine(self._scale, np.zeros(NUM_INPUTS)),
            self._encoder,
            Tanh(),
            self._gru,
            self._decoder,
            Clip(self._low, self._high),
        ]


def step_gru(gru: Gru, values: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Compute the next hidden states of a gated recurrent unit.

    Args:
        gru: The unit.
        values: (M, inputs) inputs.
        hidden: (M, H) hidden states.

    Returns:
        (M, H) next hidden states.
    """
    size = hidden.shape[1]
    given = dense(values, gru.weight_in, gru.bias_in)
    parts = dense(hidden, gru.weight_hidden, gru.bias_hidden)
    # The logistic function of x is (1 + tanh(x / 2)) / 2
    gates = 0.5 + 0.5 * np.asarray(tanh(0.5 * (given[:, : 2 * size] + parts[:, : 2 * size])))
    reset, update = gates[:, :size], gates[:, size:]
    candidate = np.asarray(tanh(given[:, 2 * size :] + reset * parts[:, 2 * size :]))
    after: np.ndarray = (1.0 - update) * candidate + update * hidden
    return after


class AxesOfDrones(NamedTuple):
    """Common axes of N drones.

    Attributes:
        cosine: (N,) cosine of the yaw of each drone's common axes.
        sine: (N,) sine of that yaw.
        order: (N, 4) index of each common rotor in the airframe.
        place: (N, 4) index of each rotor of the airframe in the common order.
    """

    cosine: np.ndarray
    sine: np.ndarray
    order: np.ndarray
    place: np.ndarray

    @classmethod
    def of(cls, axes: list[RotorAxes]) -> "AxesOfDrones":
        """Gather the axes of single drones."""
        yaw, order = np.array([one.yaw for one in axes]), np.array([one.order for one in axes])
        return cls(np.asarray(cos(yaw)), np.asarray(sin(yaw)), order, np.argsort(order, axis=1))

    def observe(self, observations: np.ndarray) -> np.ndarray:
        """Return observations (..., N, D) in common axes."""
        common = observations.astype(float)
        for k in range(0, 3 * NUM_VECTORS, 3):
            x, y = observations[..., k], observations[..., k + 1]
            common[..., k] = self.cosine * x + self.sine * y
            common[..., k + 1] = self.cosine * y - self.sine * x
        common[..., 3 * NUM_VECTORS :] = _reorder(observations[..., 3 * NUM_VECTORS :], self.order)
        return common

    def command(self, actions: np.ndarray) -> np.ndarray:
        """Return actions (..., N, 4) in common order in the order of the airframes."""
        return _reorder(actions, self.place)


def _reorder(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Reorder the last axis of (..., N, 4) by the indices (N, 4) of each drone."""
    return np.take_along_axis(values, np.broadcast_to(order, values.shape), axis=-1)


class RecurrentPolicy(SharedPolicy):
    """Policy of a training run of `FOUNDATION`, from a safetensors file."""

    remembers = ("_hidden",)

    def __init__(self, aviary: Aviary, path: str | Path) -> None:
        """Read the policy.

        Args:
            aviary: The worlds to control.
            path: The policy.safetensors of the run or of a checkpoint.

        Raises:
            ValueError: If the file contains another policy, an airframe is no quadrotor, or the
                observations or actions do not match.
        """
        super().__init__(aviary)
        axes = {id(one): find_rotor_axes(one) for one in aviary.options.airframe}
        self._axes = AxesOfDrones.of([axes[id(one)] for one in aviary.options.airframe])
        if tuple(label.name for label in aviary.observer.labels) != LABELS:
            raise ValueError(f"this policy observes {', '.join(BLOCKS)}: set observation to these")
        if aviary.options.normalise:
            raise ValueError("this policy observes numbers in their units: leave normalise out")
        try:
            self._network = RecurrentNetwork(read_weights(Path(path)))
        except ValueError as error:
            raise ValueError(f"{path} is not a recurrent policy: {error}") from None
        self._hidden = np.zeros((*aviary.alive.shape, self._network.hidden_size))

    def reset(self, mask: np.ndarray) -> None:
        """Set the hidden states of the worlds in `mask` (W,) to zero."""
        self._hidden[mask] = 0.0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose each drone's action from its own observations so far; see `Policy.act`."""
        assert not isinstance(observations, dict)  # has the labels of vectors
        return self._axes.command(super().act(self._axes.observe(observations), swarm))

    def _choose(self, rows: np.ndarray) -> np.ndarray:
        shape = self._hidden.shape
        actions, hidden = self._network.step(rows, self._hidden.reshape(-1, shape[-1]))
        self._hidden = hidden.reshape(shape)
        return actions


def axes_layers(axes: RotorAxes) -> tuple[Dense, Dense]:
    """Return layers that convert observations to common axes, and actions to the airframe's order.

    Args:
        axes: Common axes of the airframe.
    """
    drones = AxesOfDrones.of([axes])
    observing = drones.observe(np.eye(NUM_INPUTS)[:, None])[:, 0].T
    commanding = drones.command(np.eye(NUM_ROTORS)[:, None])[:, 0].T
    return Dense(observing, np.zeros(NUM_INPUTS)), Dense(commanding, np.zeros(NUM_ROTORS))
