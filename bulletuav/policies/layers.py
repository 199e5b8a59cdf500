"""Layer types in which networks are exported to other formats.

Each layer is plain data and operates on one vector. Each exporter has one function per layer type,
see `bulletuav.adapters.c_source` and `bulletuav.adapters.onnx`. A new layer type needs a class
here, a place in `Layer`, and a function in each exporter; an exporter raises an error for a layer
type that it does not support.
"""

from typing import NamedTuple

import numpy as np


class Clip(NamedTuple):
    """Clip each number to its bounds.

    Attributes:
        low: (n,) lower bounds, which may be infinite.
        high: (n,) upper bounds.
    """

    low: np.ndarray
    high: np.ndarray


class Affine(NamedTuple):
    """Apply the element-wise affine map scale x + offset.

    Attributes:
        scale: (n,) factors.
        offset: (n,) offsets.
    """

    scale: np.ndarray
    offset: np.ndarray


class SymlogLayer(NamedTuple):
    """Apply the symmetric logarithm sign(x) ln(1 + scale |x|) to each number."""

    scale: float


class Dense(NamedTuple):
    """Apply the dense layer W x + b.

    Attributes:
        weight: (outputs, inputs) W.
        bias: (outputs,) b.
    """

    weight: np.ndarray
    bias: np.ndarray


class Gru(NamedTuple):
    """Apply a gated recurrent unit, whose output is its next hidden state h.

    With (r, z) = sigmoid(W x + b + U h + c) of the first rows and n = tanh(W x + b + r (U h + c))
    of the last ones, the next state is (1 - z) n + z h.

    Attributes:
        weight_in: (3 H, inputs) W.
        bias_in: (3 H,) b.
        weight_hidden: (3 H, H) U.
        bias_hidden: (3 H,) c.
    """

    weight_in: np.ndarray
    bias_in: np.ndarray
    weight_hidden: np.ndarray
    bias_hidden: np.ndarray


class Tanh(NamedTuple):
    """Apply the hyperbolic tangent to each number."""


class Relu(NamedTuple):
    """Apply max(x, 0) to each number."""


class SquareRoot(NamedTuple):
    """Take the square root of each number, which must not be negative."""


class LimitNorm(NamedTuple):
    """Scale a vector with a norm above `max_norm` to that norm."""

    max_norm: float


class Argmax(NamedTuple):
    """Return the index of the largest number, the first one in case of ties."""


class Lookup(NamedTuple):
    """Return the row of a table that an index selects.

    Attributes:
        rows: (choices, n) the table.
    """

    rows: np.ndarray


class EntityGroup(NamedTuple):
    """Entities of one kind, such as neighbours, in an observation.

    Attributes:
        columns: (K, n) int, indices of the numbers of each entity.
        motion: (6,) int, indices of relative position and velocity among the numbers of an entity;
            (0,) if they are not observed.
        layers: Encoder of each entity, first to last, with `Relu` after each layer.
    """

    columns: np.ndarray
    motion: np.ndarray
    layers: tuple[Dense, ...]


class SwarmLayer(NamedTuple):
    """Extract permutation-invariant swarm features, see `bulletuav.policies.swarm_features`.

    Attributes:
        own: (m,) int, indices of the numbers that describe no other entity.
        kinds: Entities by kind.
        scale: Scale of the symmetric logarithm.
    """

    own: np.ndarray
    kinds: tuple[EntityGroup, ...]
    scale: float


Layer = (
    Clip
    | Affine
    | SymlogLayer
    | Dense
    | Gru
    | Tanh
    | Relu
    | SquareRoot
    | LimitNorm
    | Argmax
    | Lookup
    | SwarmLayer
)
"""A layer of any type"""


def width_after(layer: Layer, width: int) -> int:
    """Return the number of outputs of a layer.

    Args:
        layer: The layer.
        width: Number of inputs.
    """
    if isinstance(layer, Dense):
        return len(layer.bias)
    if isinstance(layer, Gru):
        return int(layer.weight_hidden.shape[1])
    if isinstance(layer, SwarmLayer):
        return len(layer.own) + sum(2 * len(kind.layers[-1].bias) for kind in layer.kinds)
    if isinstance(layer, Argmax):
        return 1
    return layer.rows.shape[1] if isinstance(layer, Lookup) else width
