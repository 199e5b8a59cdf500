"""Kinds of layers that networks are written down with for programs of others.

Each is plain data: what writes a format has one function for each kind, see
`bulletuav.adapters.c_source` and `bulletuav.adapters.onnx`. A layer works on one vector. A new kind
takes a class here, a place in `Layer`, and a function in each writer; one that a writer lacks is
refused by name.
"""

from typing import NamedTuple

import numpy as np


class Clip(NamedTuple):
    """Cut each number to its bounds.

    Attributes:
        low: (n,) lower bounds, which may be infinite.
        high: (n,) upper bounds.
    """

    low: np.ndarray
    high: np.ndarray


class Affine(NamedTuple):
    """Scale and shift each number: scale x + offset.

    Attributes:
        scale: (n,) factors.
        offset: (n,) what is added.
    """

    scale: np.ndarray
    offset: np.ndarray


class Symlog(NamedTuple):
    """Compress each number: sign(x) ln(1 + scale |x|)."""

    scale: float


class Dense(NamedTuple):
    """Multiply by a matrix and add: W x + b.

    Attributes:
        weight: (outputs, inputs) W.
        bias: (outputs,) b.
    """

    weight: np.ndarray
    bias: np.ndarray


class Tanh(NamedTuple):
    """Apply the hyperbolic tangent to each number."""


class Relu(NamedTuple):
    """Cut off what is negative."""


class SquareRoot(NamedTuple):
    """Take the square root of each number, none of which is negative."""


class LimitNorm(NamedTuple):
    """Shorten a vector that is longer than `most`, and keep its direction."""

    most: float


class Choose(NamedTuple):
    """Give the index of the largest number, the first of those that are equal."""


class Lookup(NamedTuple):
    """Give the row of a table that a choice names.

    Attributes:
        rows: (choices, n) the table.
    """

    rows: np.ndarray


class Others(NamedTuple):
    """Others of one kind, such as neighbours, among the numbers of an observation.

    Attributes:
        columns: (K, n) int, places of the numbers of each of them.
        motion: (6,) int, places of relative position and velocity among the numbers of one; or (0,)
            where they are not told.
        layers: What each of them goes through, first to last, with `Relu` after each.
    """

    columns: np.ndarray
    motion: np.ndarray
    layers: tuple[Dense, ...]


class Swarm(NamedTuple):
    """Give features of a drone among others, see `bulletuav.policies.swarm_features`.

    Attributes:
        own: (m,) int, places of the numbers that tell of no other.
        kinds: The others.
        scale: Scale of the numbers, as that of `Symlog`.
    """

    own: np.ndarray
    kinds: tuple[Others, ...]
    scale: float


Layer = (
    Clip | Affine | Symlog | Dense | Tanh | Relu | SquareRoot | LimitNorm | Choose | Lookup | Swarm
)
"""One layer, of any kind"""


def width_after(layer: Layer, width: int) -> int:
    """Count the numbers that a layer gives.

    Args:
        layer: The layer.
        width: How many it takes.
    """
    if isinstance(layer, Dense):
        return len(layer.bias)
    if isinstance(layer, Swarm):
        return len(layer.own) + sum(2 * len(kind.layers[-1].bias) for kind in layer.kinds)
    if isinstance(layer, Choose):
        return 1
    return layer.rows.shape[1] if isinstance(layer, Lookup) else width
