"""Export of trained policies as ONNX models."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.deployed import Deployed
from bulletuav.errors import missing_extra
from bulletuav.files import whole_file
from bulletuav.policies.layers import (
    Affine,
    Argmax,
    Clip,
    Dense,
    EntityGroup,
    Gru,
    Layer,
    LimitNorm,
    Lookup,
    Relu,
    SquareRoot,
    SwarmLayer,
    SymlogLayer,
    Tanh,
)
from bulletuav.policies.swarm_features import LOOK_AHEAD, TINY
from bulletuav.sensors.base import Label

try:
    import onnx
    import onnxruntime
    from onnx import TensorProto, checker, helper, numpy_helper
except ImportError:
    raise missing_extra("writing ONNX", "onnx") from None

OPSET = 17
"""ONNX operator set, which runtimes since 2022 support"""
IR_VERSION = 8
"""Version of the ONNX format that belongs to the operator set"""


class _Graph:
    """Builder of an ONNX graph."""

    def __init__(self, kind: type[np.floating[Any]]) -> None:
        """Make an empty graph; `kind` is the type of its numbers."""
        self.kind = kind
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.next_hidden: str | None = None

    def constant(self, values: Any) -> str:
        """Add a constant and return its name; integers become int64."""
        name = f"constant_{len(self.constants)}"
        array = np.asarray(values)
        array = array.astype(np.int64 if array.dtype.kind == "i" else self.kind)
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add an operator on named values, and return the name of its result."""
        name = f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name


def write_onnx(policy: Deployed, path: Path, precision: str = "float") -> list[Path]:
    """Write a policy as an ONNX model: (drones, D) "observation" to (drones, S) "setpoint".

    A policy with a hidden state has the further input "hidden", zeros at first, and the output
    "next_hidden", both (drones, H).

    Args:
        policy: The policy. Names, units and bounds of its numbers are stored as metadata of the
            model.
        path: The file.
        precision: "float" or "double".

    Returns:
        The file.

    Raises:
        ValueError: If a layer cannot be written in ONNX.
        OSError: If the file cannot be written.
    """
    # Each layer adds its nodes, and returns the name of its output
    graph = _Graph(np.float32 if precision == "float" else np.float64)
    value = "observation"
    for layer in policy.layers:
        write = LAYERS.get(type(layer))
        if write is None:
            raise ValueError(f"a layer {type(layer).__name__} cannot be written in ONNX")
        value = write(graph, value, layer)
    # Rename the output of the last layer
    graph.nodes.append(helper.make_node("Identity", [value], ["setpoint"]))
    if graph.next_hidden is not None:
        graph.nodes.append(helper.make_node("Identity", [graph.next_hidden], ["next_hidden"]))
    # The first axis is the number of drones, which is free
    kind = TensorProto.FLOAT if precision == "float" else TensorProto.DOUBLE
    inputs, outputs = {"observation": len(policy.inputs)}, {"setpoint": len(policy.outputs)}
    if policy.memory:
        inputs["hidden"] = outputs["next_hidden"] = policy.memory
    given, out = (
        [helper.make_tensor_value_info(name, kind, ["drones", one[name]]) for name in one]
        for one in (inputs, outputs)
    )
    body = helper.make_graph(graph.nodes, "policy", given, out, graph.constants)
    model = helper.make_model(
        body,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="bulletuav",
        doc_string=policy.about,
    )
    # Labels of the numbers, as metadata
    metadata = {
        "observation": _describe_labels(policy.inputs),
        "setpoint": _describe_labels(policy.outputs),
    }
    helper.set_model_props(model, metadata)
    # Validate the model before the file is replaced
    checker.check_model(model, full_check=True)
    with whole_file(path) as part:
        onnx.save(model, part)
    return [path]


def run_onnx(path: Path, rows: np.ndarray, policy: Deployed, precision: str) -> np.ndarray:
    """Run an ONNX file of `write_onnx` with onnxruntime.

    Args:
        path: The file.
        rows: (M, D) observations; with a hidden state, consecutive ones of one drone.
        policy: The policy that the file was written from.
        precision: Precision of the file, "float" or "double".

    Returns:
        (M, S) setpoints.
    """
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    kind = np.float32 if precision == "float" else np.float64
    rows = rows.astype(kind)
    if not policy.memory:
        (given,) = session.run(["setpoint"], {"observation": rows})
        return np.asarray(given, dtype=float)
    hidden, setpoints = np.zeros((1, policy.memory), kind), []
    for row in rows:
        feeds = {"observation": row[None], "hidden": hidden}
        setpoint, hidden = session.run(["setpoint", "next_hidden"], feeds)
        setpoints.append(setpoint[0])
    return np.array(setpoints, dtype=float)


def _describe_labels(labels: Iterable[Label]) -> str:
    """Return one line for each label, with name, unit and bounds."""
    return "\n".join(f"{one.name}, {one.unit}, {one.low:.9g} to {one.high:.9g}" for one in labels)


def _clip(graph: _Graph, value: str, layer: Clip) -> str:
    above = graph.add("Max", value, graph.constant(layer.low))
    return graph.add("Min", above, graph.constant(layer.high))


def _affine(graph: _Graph, value: str, layer: Affine) -> str:
    scaled = graph.add("Mul", value, graph.constant(layer.scale))
    return graph.add("Add", scaled, graph.constant(layer.offset))


def _symlog(graph: _Graph, value: str, layer: SymlogLayer) -> str:
    size = graph.add("Mul", graph.add("Abs", value), graph.constant(layer.scale))
    grown = graph.add("Log", graph.add("Add", size, graph.constant(1.0)))
    return graph.add("Mul", graph.add("Sign", value), grown)


def _dense(graph: _Graph, value: str, layer: Dense) -> str:
    product = graph.add("MatMul", value, graph.constant(layer.weight.T))
    return graph.add("Add", product, graph.constant(layer.bias))


def _gru(graph: _Graph, value: str, layer: Gru) -> str:
    given, parts = (
        [
            _dense(graph, source, Dense(rows, biases))
            for rows, biases in zip(np.split(weight, 3), np.split(bias, 3), strict=True)
        ]
        for source, weight, bias in (
            (value, layer.weight_in, layer.bias_in),
            ("hidden", layer.weight_hidden, layer.bias_hidden),
        )
    )
    reset, update = (graph.add("Sigmoid", graph.add("Add", given[k], parts[k])) for k in (0, 1))
    kept = graph.add("Mul", reset, parts[2])
    candidate = graph.add("Tanh", graph.add("Add", given[2], kept))
    fresh = graph.add("Mul", graph.add("Sub", graph.constant(1.0), update), candidate)
    graph.next_hidden = graph.add("Add", fresh, graph.add("Mul", update, "hidden"))
    return graph.next_hidden


def _tanh(graph: _Graph, value: str, layer: Tanh) -> str:
    return graph.add("Tanh", value)


def _relu(graph: _Graph, value: str, layer: Relu) -> str:
    return graph.add("Max", value, graph.constant(0.0))


def _square_root(graph: _Graph, value: str, layer: SquareRoot) -> str:
    return graph.add("Sqrt", graph.add("Max", value, graph.constant(0.0)))


def _limit_norm(graph: _Graph, value: str, layer: LimitNorm) -> str:
    most = graph.constant(layer.max_norm)
    norm = graph.add("ReduceL2", value, axes=[-1], keepdims=1)
    share = graph.add("Div", most, graph.add("Max", norm, most))
    return graph.add("Mul", value, share)


def _choose(graph: _Graph, value: str, layer: Argmax) -> str:
    return graph.add("ArgMax", value, axis=-1, keepdims=0)


def _lookup(graph: _Graph, value: str, layer: Lookup) -> str:
    return graph.add("Gather", graph.constant(layer.rows), value)


def _swarm(graph: _Graph, value: str, layer: SwarmLayer) -> str:
    parts = []
    if len(layer.own):
        parts.append(_columns(graph, value, layer.own, layer.scale))
    for kind in layer.kinds:
        each = _each_other(graph, value, kind, layer)
        summed = graph.add("ReduceSum", each, graph.constant([1]), keepdims=0)
        parts.append(graph.add("Div", summed, graph.constant(2.0)))
        parts.append(graph.add("ReduceMax", each, axes=[1], keepdims=0))
    return graph.add("Concat", *parts, axis=1)


def _columns(graph: _Graph, value: str, columns: np.ndarray, scale: float) -> str:
    """Add the symlog of some columns of an observation."""
    return _symlog(
        graph, graph.add("Gather", value, graph.constant(columns), axis=1), SymlogLayer(scale)
    )


def _each_other(graph: _Graph, value: str, kind: EntityGroup, layer: SwarmLayer) -> str:
    """Add the features of each other of a kind, (drones, K, F); zeros for absent ones."""
    others = graph.add("Gather", value, graph.constant(kind.columns), axis=1)
    parts = [_symlog(graph, others, SymlogLayer(layer.scale))]
    if len(kind.motion):
        parts += _approach(graph, others, kind.motion)
    if len(layer.own):
        shared = np.tile(layer.own, (len(kind.columns), 1))
        parts.append(_columns(graph, value, shared, layer.scale))
    each = graph.add("Concat", *parts, axis=-1)
    for dense in kind.layers:
        each = _relu(graph, _dense(graph, each, dense), Relu())
    size = graph.add("ReduceMax", graph.add("Abs", others), axes=[-1], keepdims=1)
    return graph.add("Mul", each, graph.add("Sign", size))


def _approach(graph: _Graph, others: str, motion: np.ndarray) -> list[str]:
    """Add the closest approach to others on straight paths: relative position, distance, time."""
    # Relative position and velocity of each other drone
    position, velocity = (
        graph.add("Gather", others, graph.constant(part), axis=2)
        for part in (motion[:3], motion[3:])
    )
    # Dot products of position and velocity, and of velocity with itself
    tiny, last = graph.constant(TINY), graph.constant([-1])
    along, square = (
        graph.add("ReduceSum", graph.add("Mul", velocity, other), last, keepdims=1)
        for other in (position, velocity)
    )
    # Time of the minimum distance on straight paths, clipped to [0, LOOK_AHEAD]
    soon = graph.add("Div", graph.add("Neg", along), graph.add("Add", square, tiny))
    soon = graph.add("Max", soon, graph.constant(0.0))
    time = graph.add("Min", soon, graph.constant(LOOK_AHEAD))
    # Relative position and distance at that time
    place = graph.add("Add", position, graph.add("Mul", velocity, time))
    far = graph.add("ReduceSum", graph.add("Mul", place, place), last, keepdims=1)
    distance = graph.add("Sqrt", graph.add("Add", far, tiny))
    # Scales of the trained network: log(1 + m), and time from 0 to 2
    grown = graph.add("Log", graph.add("Add", distance, graph.constant(1.0)))
    share = graph.add("Div", time, graph.constant(LOOK_AHEAD / 2))
    return [_symlog(graph, place, SymlogLayer(1.0)), grown, share]


LAYERS: dict[type[Layer], Callable[[_Graph, str, Any], str]] = {
    Clip: _clip,
    Affine: _affine,
    SymlogLayer: _symlog,
    Dense: _dense,
    Gru: _gru,
    Tanh: _tanh,
    Relu: _relu,
    SquareRoot: _square_root,
    LimitNorm: _limit_norm,
    Argmax: _choose,
    Lookup: _lookup,
    SwarmLayer: _swarm,
}
"""Functions that add each type of layer to a graph, from the name of its input to its output"""
