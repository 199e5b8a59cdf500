"""What observed numbers go through before a network's layers, by NumPy; `adapters.features` has the same to learn with."""

from collections.abc import Sequence

import numpy as np

from bulletuav.sensors.sight import AHEAD

LINE_OF_SIGHT, BLOCKED = 2.0, 3.19  # path loss exponents of `mec`
FAR = 100.0  # m, unit of positions
Layers = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (outputs, inputs) and biases (outputs,) of dense layers"""


def symlog(values: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Compress numbers: sign(x) ln(1 + scale |x|), of the shape of `values`.

    D. Hafner, J. Pasukonis, J. Ba, T. Lillicrap, Mastering diverse domains through world models (2023), equation 9.
    """
    return np.sign(values) * np.log1p(scale * np.abs(values))


class UserFeatures:
    """What `adapters.features.UserSum` tells of drones and their users, from the layers that it learned.

    Public state, to read: `num_drones` that the layers are for.
    """

    def __init__(self, layers: Layers):
        self._layers = layers
        self.num_drones = (layers[0][0].shape[1] - 4 - len(AHEAD)) // 2
        self._ways = np.array(list(AHEAD.values()))

    def sizes(self, count: int) -> list[int]:
        """Split an observation of `count` numbers into its blocks.

        Returns:
            How many numbers each has: position, all_neighbours, targets, sight_matrix, sight_ahead.

        Raises:
            ValueError: No number of users gives as many.
        """
        others, parts = 6 * (self.num_drones - 1), 4 + self.num_drones + len(AHEAD)
        users, rest = divmod(count - 3 - others, parts)
        if rest or users < 1:
            raise ValueError(
                f"features of {self.num_drones} drones and their users do not fit {count} numbers"
            )
        return [3, others, 4 * users, self.num_drones * users, len(AHEAD) * users]

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Compute (M, 3 N + F) features of observations (M, D)."""
        count = len(rows)
        own, others, users, sight, ahead = np.split(
            rows, np.cumsum(self.sizes(rows.shape[1]))[:-1], axis=1
        )
        others = others.reshape(count, -1, 6)[..., :3]
        users = users.reshape(count, -1, 4)[:, :, None, :3]
        sight, ahead = (
            seen.reshape(count, -1, users.shape[1]).transpose(0, 2, 1) for seen in (sight, ahead)
        )
        # How loud each user is at each drone, first the one that asks, and at the places around it.
        now = log_gain(np.concatenate([users, users - others[:, None]], axis=2), sight)
        gain = log_gain(users - self._ways, ahead) - now[..., :1]
        lead = now[..., :1] - now[..., 1:].max(axis=2, keepdims=True)
        known = np.concatenate(
            [users[:, :, 0] / FAR, now / 2 + 6, sight, lead / 2, gain / 2], axis=2
        )
        for weight, bias in self._layers:
            known = np.maximum(known @ weight.T + bias, 0)
        each = known.sum(axis=1) / np.sqrt(users.shape[1])
        return np.concatenate([own / FAR, others.reshape(count, -1) / FAR, each], axis=1)


def log_gain(offset: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Logarithm of received power over that at 1 m, for offsets (..., 3), m; see `log_distance` in `network.pathloss`."""
    distance = np.sqrt((offset * offset).sum(axis=-1))
    exponent = np.where(
        seen > 0.5, np.float32(LINE_OF_SIGHT), np.float32(BLOCKED)
    )  # as in training
    return -exponent * np.log(distance + 1)
