"""A trained policy written down for programs of others: what goes in, what is done, what comes out.

`bulletuav.adapters.c_source` and `bulletuav.adapters.onnx` write one as a file.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium.spaces import Box

from bulletuav.control.actions import Action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.errors import nearest, shown
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
from bulletuav.policies.neural_network import Network, is_plain, read_weights
from bulletuav.policies.run import POLICY, RunConfig
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
"""Name and unit of each number of a setpoint, see `SetpointLevel`; rotors are not counted here"""
AFFINE = ("target_position", "attitude", "rates", "rpm", "hover_rpm")
"""Actions whose setpoints are scaled and shifted numbers"""
LIMITED = ("velocity", "acceleration")
"""Actions whose setpoints are scaled numbers, of a limited norm"""
YAW = 3
"""Number of a setpoint of motion that is its yaw, always 0"""
TRIED = 256
"""Observations on which a file is compared with the policy"""


class Deployed(NamedTuple):
    """A policy as a chain of layers from one drone's observation to its setpoint.

    Attributes:
        about: What it is, in a line.
        inputs: Name, unit and bounds of each number of the observation, before any scaling.
        outputs: The same of each number of the setpoint, in world axes ENU or body axes FLU.
        layers: What is computed, first to last.
        act: The same by the package itself: (M, D) observations to (M, S) setpoints.
    """

    about: str
    inputs: tuple[Label, ...]
    outputs: tuple[Label, ...]
    layers: tuple[Layer, ...]
    act: Callable[[np.ndarray], np.ndarray]

    def observations(self) -> np.ndarray:
        """Draw observations within the bounds and a little beyond, always the same ones.

        Returns:
            (M, D) float32.
        """
        rng = np.random.default_rng(0)
        low, high = (
            np.clip([getattr(label, name) for label in self.inputs], -1e3, 1e3)
            for name in ("low", "high")
        )
        share = rng.uniform(-0.05, 1.05, (TRIED, len(self.inputs)))
        return np.asarray(low + share * (high - low), dtype=np.float32)


def deployed(folder: Path, trust: bool = False) -> Deployed:
    """Read the policy of a training run as layers.

    Args:
        folder: Folder of the run, or of one of its checkpoints.
        trust: Whether modules that its `run.yaml` names may be imported.

    Raises:
        ValueError: It is no such folder, or its network or action has no form for other programs.
        FileNotFoundError: There is no such folder.
    """
    config = read_run_config(folder, trust)
    spec = EnvSpec(config.task, 1, config.evaluated)
    # What PyTorch alone can fly is of unknown layers.
    if not isinstance(spec.observer.space(), Box) or not is_plain(config.algo, config.settings):
        raise ValueError(
            f"{folder} observes pictures or has layers of PyTorch's own, which have no form for "
            f"other programs: train on vectors, with policy_kwargs of net_arch alone"
        )
    weights = read_weights(folder / POLICY)
    network = Network(weights, config.algo, config.settings, spec.observer.labels)
    action, observer = spec.action, spec.observer
    outputs, decoding = _setpoints(action)
    layers = (*_observing(observer, config), *network.layers(), *decoding)

    def act(rows: np.ndarray) -> np.ndarray:
        given = network(_observed(observer, config, rows)).reshape(len(rows), 1, -1)
        setpoint = action.decode(given, np.zeros((len(rows), 1, 3)))
        return setpoint[:, 0, : len(outputs)]

    about = f"bulletuav policy: task {config.task}, {config.algo}, action {action.name}"
    chain = Deployed(about, tuple(observer.labels), outputs, layers, act)
    _require_chain(chain)
    return chain


def _observing(observer: ObservationBuilder, config: RunConfig) -> list[Layer]:
    """List the layers that bound raw numbers, and scale them where the run wants it."""
    low, high = _bounds(observer)
    layers: list[Layer] = [Clip(low, high)]
    if config.interface.get("normalise", False):
        half = (high - low) / 2
        layers.append(Affine(1 / half, -(low + high) / 2 / half))
    return layers


def _observed(observer: ObservationBuilder, config: RunConfig, rows: np.ndarray) -> np.ndarray:
    """Bound and scale rows, without the environment's rounding to single precision after it."""
    low, high = _bounds(observer)
    bounded = np.clip(np.asarray(rows, dtype=float), low, high)
    if config.interface.get("normalise", False):
        bounded = (bounded - (low + high) / 2) / ((high - low) / 2)
    return np.asarray(bounded)


def _bounds(observer: ObservationBuilder) -> tuple[np.ndarray, np.ndarray]:
    """Give the bounds (D,) of raw numbers, as single precision knows them."""
    low, high = (
        np.array([getattr(label, name) for label in observer.labels], dtype=np.float32)
        for name in ("low", "high")
    )
    return low.astype(float), high.astype(float)


def _setpoints(action: Action) -> tuple[tuple[Label, ...], list[Layer]]:
    """List the numbers of a setpoint, and the layers that make them of an action.

    Raises ValueError for actions whose setpoints are no function of the last action alone.
    """
    if action.choices is not None:
        rows = _decoded(action, np.arange(action.choices)[:, None])
        width = YAW if action.level in SETPOINTS else rows.shape[1]
        layers: list[Layer] = [Lookup(rows[:, :width])]
    elif action.name in AFFINE:
        layers = [_affine(action)]
    elif action.name in LIMITED:
        scale = _affine(action)
        layers = [scale, LimitNorm(float(scale.scale[0]))]
    elif action.name == "rotor":
        # Speeds go with the root of the thrusts, from none at -1 to the most at 1.
        most = _decoded(action, np.ones((1, action.size(0))))[0]
        half = most * most / 2
        layers = [Affine(half, half), SquareRoot()]
    else:
        known = (*AFFINE, *LIMITED, "rotor", "discrete", "discrete_27")
        raise ValueError(
            f"action {shown(action.name)} has no form for other programs: train with one of "
            f"{', '.join(known)}{nearest(action.name, known)}"
        )
    return _labels(action, layers), layers


def _affine(action: Action) -> Affine:
    """Find the factors and shifts of an action whose setpoints are scaled numbers."""
    size = action.size(0)
    offset = _decoded(action, np.zeros((1, size)))[0, :size]
    scale = np.diagonal(_decoded(action, np.eye(size))[:, :size]) - offset
    return Affine(scale, offset)


def _decoded(action: Action, rows: np.ndarray) -> np.ndarray:
    """Decode rows of actions of the first drone, at rest."""
    padded = np.zeros((len(rows), len(action.labels), action.low.shape[1]))
    padded[:, 0, : rows.shape[1]] = rows
    setpoint = action.decode(padded, np.zeros((*padded.shape[:2], 3)))
    return setpoint[:, 0]


def _labels(action: Action, layers: list[Layer]) -> tuple[Label, ...]:
    """Label a setpoint, with the bounds that follow from those of the action."""
    names: Any = SETPOINTS.get(action.level)
    if names is None:
        names = [(f"rotor {number}", "rad/s") for number in range(action.size(0))]
    if isinstance(layers[0], Lookup):
        ends = layers[0].rows.min(axis=0), layers[0].rows.max(axis=0)
    else:
        size = action.size(0)
        edges = np.stack([action.low[0, :size], action.high[0, :size]])
        if action.name in LIMITED:
            # At a corner of the action the norm is limited, which shortens each number.
            scale = cast(Affine, layers[0]).scale
            ends = tuple(edges * scale)
        else:
            ends = tuple(_decoded(action, edges)[:, :size])
    return tuple(
        Label(name, unit, float(low), float(high))
        for (name, unit), low, high in zip(names, *ends, strict=False)
    )


def _require_chain(chain: Deployed) -> None:
    """Raise ValueError where the network does not fit what is observed or done."""
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
