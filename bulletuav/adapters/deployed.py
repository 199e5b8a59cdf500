"""A trained policy as a chain of layers with labelled inputs and outputs, for export.

`bulletuav.adapters.c_source` and `bulletuav.adapters.onnx` write such a policy to a file.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium.spaces import Box

from bulletuav.control.actions import Action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.errors import shown, suggest_names
from bulletuav.policies.features import dense
from bulletuav.policies.find import read_run_config
from bulletuav.policies.layers import (
    Affine,
    Clip,
    Dense,
    Layer,
    LimitNorm,
    Lookup,
    SquareRoot,
    width_after,
)
from bulletuav.policies.neural_network import Network, Weights, is_plain, read_weights
from bulletuav.policies.recurrent import RecurrentNetwork, axes_layers
from bulletuav.policies.rotor_axes import find_rotor_axes
from bulletuav.policies.run import FOUNDATION, POLICY, RunConfig
from bulletuav.sensors.base import Label
from bulletuav.tasks.observations.observer import ObservationBuilder

SETPOINTS = {
    SetpointLevel.POSITION: (("x", "m"), ("y", "m"), ("z", "m"), ("yaw", "rad")),
    SetpointLevel.VELOCITY: (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"), ("yaw", "rad")),
    SetpointLevel.ACCELERATION: (
        ("ax", "m/s^2"),
        ("ay", "m/s^2"),
        ("az", "m/s^2"),
        ("yaw", "rad"),
    ),
    SetpointLevel.ATTITUDE: (("roll", "rad"), ("pitch", "rad"), ("yaw", "rad"), ("thrust", "N")),
    SetpointLevel.RATES: (("p", "rad/s"), ("q", "rad/s"), ("r", "rad/s"), ("thrust", "N")),
}
"""Name and unit of each number of a setpoint, see `SetpointLevel`; rotor speeds are not listed"""
AFFINE_ACTIONS = ("target_position", "attitude", "rates", "rpm", "hover_rpm")
"""Actions whose setpoints are affine functions of the action"""
LIMITED_ACTIONS = ("velocity", "acceleration")
"""Actions whose setpoints are scaled actions with a limited norm"""
YAW = 3
"""Index of the yaw in position, velocity and acceleration setpoints, where it is always 0"""
NUM_SAMPLES = 256
"""Number of observations on which an exported file is compared with the policy"""


class Deployed(NamedTuple):
    """A policy as a chain of layers from one drone's observation to its setpoint.

    Attributes:
        about: Description of the policy in one line.
        inputs: Name, unit and bounds of each number of the observation, before any scaling.
        outputs: Name, unit and bounds of each number of the setpoint, in world (ENU) or body (FLU)
            axes.
        layers: The layers, from first to last.
        act: The policy as the package computes it, from (M, D) observations to (M, S) setpoints;
            with a hidden state, the observations are consecutive ones of one drone.
        memory: Number of numbers of the hidden state, 0 for none.
    """

    about: str
    inputs: tuple[Label, ...]
    outputs: tuple[Label, ...]
    layers: tuple[Layer, ...]
    act: Callable[[np.ndarray], np.ndarray]
    memory: int = 0

    def observations(self) -> np.ndarray:
        """Sample observations within the bounds and slightly beyond, with a fixed seed.

        Returns:
            (M, D) float32.
        """
        rng = np.random.default_rng(0)
        low, high = (
            np.clip([getattr(label, name) for label in self.inputs], -1e3, 1e3)
            for name in ("low", "high")
        )
        share = rng.uniform(-0.05, 1.05, (NUM_SAMPLES, len(self.inputs)))
        return np.asarray(low + share * (high - low), dtype=np.float32)


def deployed(folder: Path, trust: bool = False, airframe: str | None = None) -> Deployed:
    """Read the policy of a training run as a chain of layers.

    Args:
        folder: Folder of the run or of one of its checkpoints.
        trust: If True, modules that `run.yaml` names may be imported.
        airframe: Name or URDF of the airframe, whose rotor speeds a policy of rotors commands; None
            for that of the evaluations.

    Raises:
        ValueError: If the folder is not a run, or its network or action cannot be exported.
        FileNotFoundError: If the folder does not exist.
    """
    config = read_run_config(folder, trust)
    options = config.evaluated | ({} if airframe is None else {"airframe": airframe})
    if not isinstance(options.get("airframe", ""), str):
        raise ValueError(
            f"{folder} flies several airframes, {', '.join(map(str, options['airframe']))}: choose "
            f"one by --airframe NAME"
        )
    spec = EnvSpec(config.task, 1, options)
    # Other policies have layers that only PyTorch can compute
    if not isinstance(spec.observer.space(), Box) or not is_plain(config.algo, config.settings):
        raise ValueError(
            f"{folder} observes images or has custom PyTorch layers, which cannot be exported: "
            f"train on vectors, with policy_kwargs of net_arch alone"
        )
    if config.action_masks:
        raise ValueError(
            f"{folder} was trained with action_masks, which are computed from the state and are no "
            f"part of its network: train without action_masks to export it"
        )
    weights = read_weights(folder / POLICY)
    if config.algo == FOUNDATION:
        return _recurrent(config, spec, weights)
    network = Network(weights, config.algo, config.settings, spec.observer.labels)
    action, observer = spec.action, spec.observer
    outputs, decoding = _setpoints(action)
    layers = (*_observing(observer, config), *network.layers(), *decoding)

    def act(rows: np.ndarray) -> np.ndarray:
        given = network(_observed(observer, config, rows)).reshape(len(rows), 1, -1)
        setpoint = action.decode(given, np.zeros((len(rows), 1, 3)))
        return setpoint[:, 0, : len(outputs)]

    chain = Deployed(_describe(config, action), tuple(observer.labels), outputs, layers, act)
    _require_chain(chain)
    return chain


def _describe(config: RunConfig, action: Action) -> str:
    """Return a description of a policy in one line."""
    return f"bulletuav policy: task {config.task}, {config.algo}, action {action.name}"


def _recurrent(config: RunConfig, spec: EnvSpec, weights: Weights) -> Deployed:
    """Return the chain of a recurrent policy, for the airframe of an environment."""
    network, action, observer = RecurrentNetwork(weights), spec.action, spec.observer
    # All drones have the same one
    airframe = spec.options.airframe[0]
    to_common, to_own = axes_layers(find_rotor_axes(airframe))
    outputs, decoding = _setpoints(action)
    own = (*_observing(observer, config), to_common, *network.layers(), to_own)

    def act(rows: np.ndarray) -> np.ndarray:
        hidden, given = np.zeros((1, network.hidden_size)), []
        for row in dense(_observed(observer, config, rows), *to_common):
            actions, hidden = network.step(row[None], hidden)
            given.append(dense(actions, *to_own))
        setpoint = action.decode(np.array(given), np.zeros((len(rows), 1, 3)))
        return setpoint[:, 0, : len(outputs)]

    about = f"{_describe(config, action)}, airframe {airframe.name}"
    layers = (*own, *decoding)
    chain = Deployed(about, tuple(observer.labels), outputs, layers, act, network.hidden_size)
    _require_chain(chain)
    return chain


def _observing(observer: ObservationBuilder, config: RunConfig) -> list[Layer]:
    """Return the layers that clip raw observations and, if the run normalises, scale them."""
    low, high = _bounds(observer)
    layers: list[Layer] = [Clip(low, high)]
    if config.interface.get("normalise", False):
        half = (high - low) / 2
        layers.append(Affine(1 / half, -(low + high) / 2 / half))
    return layers


def _observed(observer: ObservationBuilder, config: RunConfig, rows: np.ndarray) -> np.ndarray:
    """Clip and scale observations, without the environment's final rounding to float32."""
    low, high = _bounds(observer)
    bounded = np.clip(np.asarray(rows, dtype=float), low, high)
    if config.interface.get("normalise", False):
        bounded = (bounded - (low + high) / 2) / ((high - low) / 2)
    return np.asarray(bounded)


def _bounds(observer: ObservationBuilder) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (D,) of raw observations, rounded to float32."""
    low, high = (
        np.array([getattr(label, name) for label in observer.labels], dtype=np.float32)
        for name in ("low", "high")
    )
    return low.astype(float), high.astype(float)


def _setpoints(action: Action) -> tuple[tuple[Label, ...], list[Layer]]:
    """Return the labels of a setpoint, and the layers that compute it from an action.

    Raises ValueError for actions whose setpoint does not depend on the last action alone.
    """
    if action.choices is not None:
        rows = _decoded(action, np.arange(action.choices)[:, None])
        width = YAW if action.level in SETPOINTS else rows.shape[1]
        layers: list[Layer] = [Lookup(rows[:, :width])]
    elif action.name in AFFINE_ACTIONS:
        layers = [_affine(action)]
    elif action.name in LIMITED_ACTIONS:
        scale = _affine(action)
        layers = [scale, LimitNorm(float(scale.scale[0]))]
    elif action.name == "rotor":
        # Rotor speed is the square root of thrust, which is 0 at -1 and maximal at 1
        most = _decoded(action, np.ones((1, action.size(0))))[0]
        half = most * most / 2
        layers = [Affine(half, half), SquareRoot()]
    else:
        known = (*AFFINE_ACTIONS, *LIMITED_ACTIONS, "rotor", "discrete", "discrete_27")
        raise ValueError(
            f"action {shown(action.name)} cannot be exported: train with one of "
            f"{', '.join(known)}{suggest_names(action.name, known)}"
        )
    return _labels(action, layers), layers


def _affine(action: Action) -> Affine:
    """Determine scale and offset of an action whose setpoint is an affine function of it."""
    size = action.size(0)
    offset = _decoded(action, np.zeros((1, size)))[0, :size]
    scale = np.diagonal(_decoded(action, np.eye(size))[:, :size]) - offset
    return Affine(scale, offset)


def _decoded(action: Action, rows: np.ndarray) -> np.ndarray:
    """Decode actions (M, A) of the first drone at rest."""
    padded = np.zeros((len(rows), len(action.labels), action.low.shape[1]))
    padded[:, 0, : rows.shape[1]] = rows
    setpoint = action.decode(padded, np.zeros((*padded.shape[:2], 3)))
    return setpoint[:, 0]


def _labels(action: Action, layers: list[Layer]) -> tuple[Label, ...]:
    """Return the labels of a setpoint, with bounds that follow from those of the action."""
    names: Any = SETPOINTS.get(action.level)
    if names is None:
        names = [(f"rotor {number}", "rad/s") for number in range(action.size(0))]
    if isinstance(layers[0], Lookup):
        ends = layers[0].rows.min(axis=0), layers[0].rows.max(axis=0)
    else:
        size = action.size(0)
        edges = np.stack([action.low[0, :size], action.high[0, :size]])
        if action.name in LIMITED_ACTIONS:
            # The norm is limited at corners only: bounds of single axes are the scale
            scale = cast(Affine, layers[0]).scale
            ends = tuple(edges * scale)
        else:
            ends = tuple(_decoded(action, edges)[:, :size])
    return tuple(
        Label(name, unit, float(low), float(high))
        for (name, unit), low, high in zip(names, *ends, strict=False)
    )


def _require_chain(chain: Deployed) -> None:
    """Raise ValueError if the network does not match the observation or the action."""
    width = len(chain.inputs)
    for layer in chain.layers:
        if isinstance(layer, Dense) and layer.weight.shape[1] != width:
            raise ValueError(
                f"the policy was trained for {layer.weight.shape[1]} numbers, and {width} are "
                f"observed: its run.yaml is of another run"
            )
        width = width_after(layer, width)
    if width != len(chain.outputs):
        raise ValueError(
            f"the policy gives {width} numbers, and {len(chain.outputs)} are needed: its run.yaml "
            f"is of another run"
        )
