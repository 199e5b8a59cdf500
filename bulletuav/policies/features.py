"""Features that observed numbers go through before a network's layers, by NumPy.

`bulletuav.adapters.features` has the same for PyTorch, to learn with.
"""

from collections.abc import Sequence

import numpy as np

from bulletuav.compiled.functions import log, log1p
from bulletuav.compiled.kernel import kernel
from bulletuav.sensors.sight import AHEAD

LINE_OF_SIGHT = 2.0
"""Path loss exponent of `mec` where a user is in sight"""
BLOCKED = 3.19
"""Path loss exponent of `mec` where a user is not in sight"""
FAR = 100.0
"""Unit of positions, m"""
Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (outputs, inputs) and biases (outputs,) of dense layers"""


def symlog(values: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Compress numbers: sign(x) ln(1 + scale |x|).

    D. Hafner, J. Pasukonis, J. Ba, T. Lillicrap, Mastering diverse domains through world models
    (2023), equation 9.

    Args:
        values: Numbers x, of any shape.
        scale: Scale; larger where small numbers matter.

    Returns:
        The compressed numbers, of the same shape.
    """
    compressed: np.ndarray = np.sign(values) * log1p(scale * np.abs(values))
    return compressed


def dense(values: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Multiply by a matrix and add, to the same bits on every processor: W x + b.

    Args:
        values: (..., inputs) vectors x.
        weight: (outputs, inputs) W.
        bias: (outputs,) b.

    Returns:
        (..., outputs).
    """
    rows = np.ascontiguousarray(values.reshape(-1, values.shape[-1]), dtype=float)
    result = np.empty((len(rows), len(bias)))
    _multiply(rows, np.ascontiguousarray(weight.T), bias, result)
    return result.reshape(*values.shape[:-1], len(bias))


@kernel
def _multiply(rows: np.ndarray, columns: np.ndarray, bias: np.ndarray, result: np.ndarray) -> None:
    """Write the products of rows (M, inputs) and columns (inputs, outputs), plus bias."""
    count, inputs = rows.shape
    for m in range(count):
        # Sums grow input by input, which BLAS does in an order of the processor's own
        for j in range(len(bias)):
            result[m, j] = bias[j]
        for k in range(inputs):
            number = rows[m, k]
            for j in range(len(bias)):
                result[m, j] += number * columns[k, j]


class UserFeatures:
    """Features of drones and their users, from layers that were learned.

    See `bulletuav.adapters.features.UserSum`.

    Attributes:
        num_drones: How many drones the layers are for.
    """

    def __init__(self, layers: Layers) -> None:
        """Take the layers that each user goes through.

        Args:
            layers: Their weights and biases, first to last.
        """
        self._layers = layers
        weights, _ = layers[0]
        self.num_drones = (weights.shape[1] - 4 - len(AHEAD)) // 2
        self._ways = np.array(list(AHEAD.values()))

    def sizes(self, count: int) -> list[int]:
        """Split an observation of `count` numbers into its blocks.

        Returns:
            How many numbers each has: position, all_neighbours, targets, sight_matrix, sight_ahead.

        Raises:
            ValueError: No number of users gives as many.
        """
        others = 6 * (self.num_drones - 1)
        numbers_each = 4 + self.num_drones + len(AHEAD)
        users, rest = divmod(count - 3 - others, numbers_each)
        if rest or users < 1:
            raise ValueError(
                f"features of {self.num_drones} drones and their users do not fit {count} numbers"
            )
        return [3, others, 4 * users, self.num_drones * users, len(AHEAD) * users]

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Compute features.

        Args:
            rows: (M, D) observations.

        Returns:
            (M, 3 N + F) features: positions of the drones, and sums over users.
        """
        count = len(rows)
        ends = np.cumsum(self.sizes(rows.shape[1]))[:-1]
        own, others, users, sight, ahead = np.split(rows, ends, axis=1)
        # Of each other drone its position, of each user its position, who sees it, and from where.
        others = others.reshape(count, -1, 6)[..., :3]
        users = users.reshape(count, -1, 4)[:, :, None, :3]
        num_users = users.shape[1]
        sight = sight.reshape(count, -1, num_users).transpose(0, 2, 1)
        ahead = ahead.reshape(count, -1, num_users).transpose(0, 2, 1)
        # How loud each user is at each drone, first the one that asks, and at the places around it.
        ways = np.concatenate([users, users - others[:, None]], axis=2)
        now = log_gain(ways, sight)
        here = now[..., :1]
        elsewhere = now[..., 1:].max(axis=2, keepdims=True)
        lead = here - elsewhere
        gain = log_gain(users - self._ways, ahead) - here
        # All of it scaled to the order of 1.
        known = np.concatenate(
            [
                users[:, :, 0] / FAR,
                now / 2 + 6,
                sight,
                lead / 2,
                gain / 2,
            ],
            axis=2,
        )
        # Through the layers, and summed over users.
        for weight, bias in self._layers:
            known = np.maximum(dense(known, weight, bias), 0)
        each = known.sum(axis=1) / np.sqrt(users.shape[1])
        flat = others.reshape(count, -1)
        return np.concatenate([own / FAR, flat / FAR, each], axis=1)


def log_gain(offset: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Compute the logarithm of received power over that at 1 m.

    See `log_distance` in `bulletuav.network.pathloss`.

    Args:
        offset: (..., 3) ways from senders to receivers, m.
        seen: (...) 1 where they see each other, else 0.

    Returns:
        (...) natural logarithms.
    """
    distance = np.sqrt((offset * offset).sum(axis=-1))
    # In single precision, as in training.
    exponent = np.where(seen > 0.5, np.float32(LINE_OF_SIGHT), np.float32(BLOCKED))
    gain: np.ndarray = -exponent * log(distance + 1)
    return gain
