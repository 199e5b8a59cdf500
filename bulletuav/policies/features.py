"""Feature extraction in front of a policy network, in NumPy.

`bulletuav.adapters.features` implements the same features in PyTorch for training.
"""

from collections.abc import Sequence

import numpy as np

from bulletuav.compiled.functions import log, log1p
from bulletuav.compiled.kernel import kernel
from bulletuav.sensors.sight import AHEAD

LOS_EXPONENT = 2.0
"""Path loss exponent of task `mec` for users in line of sight"""
NLOS_EXPONENT = 3.19
"""Path loss exponent of task `mec` for users without line of sight"""
POSITION_SCALE = 100.0
"""Scale of positions, m"""
Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (outputs, inputs) and biases (outputs,) of dense layers"""


def symlog(values: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Compute the symmetric logarithm `sign(x) ln(1 + scale |x|)`.

    References:
        D. Hafner, J. Pasukonis, J. Ba, T. Lillicrap, Mastering diverse domains through world models
        (2023), equation 9.

    Args:
        values: Numbers x, of any shape.
        scale: Scale of x; larger values resolve smaller numbers.

    Returns:
        The compressed numbers, of the same shape.
    """
    # A kernel, as numba compiles elementwise functions of arrays in each process
    numbers = np.ascontiguousarray(values, dtype=float)
    compressed = np.empty_like(numbers)
    _write_symlog(numbers.reshape(-1), scale, compressed.reshape(-1))
    return compressed


@kernel
def _write_symlog(values: np.ndarray, scale: float, compressed: np.ndarray) -> None:
    for k in range(len(values)):
        compressed[k] = np.sign(values[k]) * log1p(scale * abs(values[k]))


def dense(values: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Compute the dense layer W x + b with a fixed order of summation.

    The result has the same bits on every processor, unlike that of BLAS.

    Args:
        values: (..., inputs) vectors x.
        weight: (outputs, inputs) W.
        bias: (outputs,) b.

    Returns:
        (..., outputs) results.
    """
    rows = np.ascontiguousarray(values.reshape(-1, values.shape[-1]), dtype=float)
    result = np.empty((len(rows), len(bias)))
    _multiply(rows, np.ascontiguousarray(weight.T), bias, result)
    return result.reshape(*values.shape[:-1], len(bias))


@kernel
def _multiply(rows: np.ndarray, columns: np.ndarray, bias: np.ndarray, result: np.ndarray) -> None:
    """Write the product of rows (M, inputs) and columns (inputs, outputs), plus bias."""
    count, inputs = rows.shape
    for m in range(count):
        # Fixed order of summation; that of BLAS depends on the processor
        for j in range(len(bias)):
            result[m, j] = bias[j]
        for k in range(inputs):
            number = rows[m, k]
            for j in range(len(bias)):
                result[m, j] += number * columns[k, j]


class UserFeatures:
    """Features of drones and ground users, from trained layers.

    See `bulletuav.adapters.features.UserSum`.

    Attributes:
        num_drones: Number of drones that the layers expect.
    """

    def __init__(self, layers: Layers) -> None:
        """Set the layers that encode each user.

        Args:
            layers: Weights and biases, first to last.
        """
        self._layers = layers
        weights, _ = layers[0]
        self.num_drones = (weights.shape[1] - 4 - len(AHEAD)) // 2
        self._offsets = np.array(list(AHEAD.values()))

    def sizes(self, count: int) -> list[int]:
        """Split the length of an observation into the lengths of its blocks.

        Returns:
            The lengths of position, all_neighbours, targets, sight_matrix and sight_ahead.

        Raises:
            ValueError: If no number of users matches `count`.
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
        # Positions of the other drones; for each user its position, and its lines of sight.
        others = others.reshape(count, -1, 6)[..., :3]
        users = users.reshape(count, -1, 4)[:, :, None, :3]
        num_users = users.shape[1]
        sight = sight.reshape(count, -1, num_users).transpose(0, 2, 1)
        ahead = ahead.reshape(count, -1, num_users).transpose(0, 2, 1)
        # Path gain of each user at each drone, own drone first, and at positions around it.
        offsets = np.concatenate([users, users - others[:, None]], axis=2)
        now = log_path_gain(offsets, sight)
        here = now[..., :1]
        elsewhere = now[..., 1:].max(axis=2, keepdims=True)
        lead = here - elsewhere
        gain = log_path_gain(users - self._offsets, ahead) - here
        # Scale all inputs to the order of 1.
        known = np.concatenate(
            [
                users[:, :, 0] / POSITION_SCALE,
                now / 2 + 6,
                sight,
                lead / 2,
                gain / 2,
            ],
            axis=2,
        )
        for weight, bias in self._layers:
            known = np.maximum(dense(known, weight, bias), 0)
        each = known.sum(axis=1) / np.sqrt(users.shape[1])
        flat = others.reshape(count, -1)
        return np.concatenate([own / POSITION_SCALE, flat / POSITION_SCALE, each], axis=1)


def log_path_gain(offset: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Compute the natural logarithm of the path gain relative to a distance of 1 m.

    See `log_distance` in `bulletuav.network.pathloss`.

    Args:
        offset: (..., 3) offsets from transmitter to receiver, m.
        seen: (...) 1 for line of sight, else 0.

    Returns:
        (...) natural logarithms of the gain.
    """
    distance = np.sqrt((offset * offset).sum(axis=-1))
    # In single precision, as in training.
    exponent = np.where(seen > 0.5, np.float32(LOS_EXPONENT), np.float32(NLOS_EXPONENT))
    gain: np.ndarray = -exponent * log(distance + 1)
    return gain
