"""Feature extractors for stable-baselines3.

They transform observations before the networks of actor and critic.
"""

import math

import numpy as np
from gymnasium.spaces import Box

from bulletuav.errors import missing_extra
from bulletuav.policies.features import LOS_EXPONENT, NLOS_EXPONENT, POSITION_SCALE
from bulletuav.sensors.sight import AHEAD

try:
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError:
    raise missing_extra("learning with stable-baselines3", "sb3") from None


class SymlogFeatures(BaseFeaturesExtractor):
    """Symmetric logarithm of each number: sign(x) ln(1 + scale |x|).

    It compresses large distances, and needs no running statistics. D. Hafner, J. Pasukonis, J. Ba,
    T. Lillicrap, Mastering diverse domains through world models (2023), equation 9.

    Attributes:
        scale: Scale of the numbers.
    """

    def __init__(self, observation_space: Box, scale: float = 1.0) -> None:
        """Make the extractor.

        Args:
            observation_space: Space of one drone's observations.
            scale: Scale of the numbers; choose it larger than 1 where centimetres matter.
        """
        super().__init__(observation_space, int(np.prod(observation_space.shape)))
        self.scale = scale

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (B, D) of observations (B, D)."""
        size = torch.log1p(self.scale * torch.abs(observations))
        return torch.sign(observations) * size


class UserSum(BaseFeaturesExtractor):
    """Positions of the drones, and a permutation-invariant sum over users.

    It is for the observation ("position", "all_neighbours", "targets", "sight_matrix",
    "sight_ahead"). The features of users are the sum of an MLP over users. For each user the inputs
    of the MLP are its position, line of sight to each drone, log gain at each drone, lead of this
    drone's gain over the best other drone, and the change of the gain at the places of
    `sight_ahead`. M. Zaheer et al., Deep sets (2017).

    Attributes:
        each: The MLP of one user.
        ways: (P, 3) offsets to the places of `sight_ahead`, m.
    """

    ways: torch.Tensor

    def __init__(self, observation_space: Box, num_drones: int = 3, size: int = 48) -> None:
        """Make the layers.

        Args:
            observation_space: Space of one drone's observations.
            num_drones: Number of drones of a world.
            size: Number of features of the sum.

        Raises:
            ValueError: If the observation does not match the number of drones.
        """
        # An observation has the position, 6 numbers of each other drone, and `numbers_each` of each
        # user
        shape = observation_space.shape
        others = 6 * (num_drones - 1)
        numbers_each = 4 + num_drones + len(AHEAD)
        users, rest = divmod(shape[0] - 3 - others, numbers_each)
        if rest or users < 1:
            raise ValueError(
                f"features of {num_drones} drones and their users do not fit {shape} numbers"
            )
        super().__init__(observation_space, 3 * num_drones + size)
        # Sizes of the blocks of the observation
        self._sizes = [
            3,
            others,
            4 * users,
            num_drones * users,
            len(AHEAD) * users,
        ]
        # Constants, so not stored with the weights
        ways = torch.tensor(list(AHEAD.values()))
        self.register_buffer("ways", ways, persistent=False)
        # The same layers for each user
        known = 3 + 2 * num_drones + 1 + len(AHEAD)
        self.each = nn.Sequential(
            nn.Linear(known, size),
            nn.ReLU(),
            nn.Linear(size, size),
            nn.ReLU(),
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (B, 3 N + size) of observations (B, D)."""
        count = len(observations)
        own, others, users, sight, ahead = torch.split(observations, self._sizes, 1)
        # Positions of other drones; position and line of sight of each user, now and at places
        # ahead
        others = others.reshape(count, -1, 6)[..., :3]
        users = users.reshape(count, -1, 4)[:, :, None, :3]
        num_users = users.shape[1]
        sight = sight.reshape(count, -1, num_users).transpose(1, 2)
        ahead = ahead.reshape(count, -1, num_users).transpose(1, 2)
        # Log gain of each user at each drone, this drone first, and at the places ahead of this
        # drone
        ways = torch.cat([users, users - others[:, None]], 2)
        now = log_path_gain_tensor(ways, sight)
        here = now[..., :1]
        elsewhere = now[..., 1:].amax(2, keepdim=True)
        lead = here - elsewhere
        gain = log_path_gain_tensor(users - self.ways, ahead) - here
        # All inputs are scaled to the order of 1
        known = torch.cat(
            [
                users[:, :, 0] / POSITION_SCALE,
                now / 2 + 6,
                sight,
                lead / 2,
                gain / 2,
            ],
            2,
        )
        # Sum over users, scaled by the root of their number
        each = self.each(known).sum(1) / math.sqrt(num_users)
        flat = others.flatten(1)
        return torch.cat([own / POSITION_SCALE, flat / POSITION_SCALE, each], 1)


def log_path_gain_tensor(offset: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Return the natural logarithm of received power relative to the power at 1 m.

    See `log_distance` in `bulletuav.network.pathloss`.

    Args:
        offset: (..., 3) vectors from transmitters to receivers, m.
        seen: (...) 1 with line of sight, else 0.

    Returns:
        (...) natural logarithms.
    """
    exponent = torch.where(seen > 0.5, LOS_EXPONENT, NLOS_EXPONENT)
    return -exponent * torch.log(offset.norm(dim=-1) + 1)
