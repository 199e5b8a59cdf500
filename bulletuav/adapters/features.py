"""Features extractors of stable-baselines3.

Observed numbers go through them before the networks of actor and critic.
"""

import math

import numpy as np
from gymnasium.spaces import Box

from bulletuav.errors import missing
from bulletuav.policies.features import LOS_EXPONENT, NLOS_EXPONENT, POSITION_SCALE
from bulletuav.sensors.sight import AHEAD

try:
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None


class Symlog(BaseFeaturesExtractor):
    """Compression of each number: sign(x) ln(1 + scale |x|).

    Metres near by count as much as those far away, with no statistics to keep. D. Hafner,
    J. Pasukonis, J. Ba, T. Lillicrap, Mastering diverse domains through world models (2023),
    equation 9.

    Attributes:
        scale: Scale of the numbers.
    """

    def __init__(self, observation_space: Box, scale: float = 1.0) -> None:
        """Take the space of observations.

        Args:
            observation_space: Space of one drone's observations.
            scale: Scale of the numbers; to be larger than 1 where centimetres matter.
        """
        super().__init__(observation_space, int(np.prod(observation_space.shape)))
        self.scale = scale

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute (B, D) features of observations (B, D)."""
        size = torch.log1p(self.scale * torch.abs(observations))
        return torch.sign(observations) * size


class UserSum(BaseFeaturesExtractor):
    """Positions of the drones, and a sum over users, whatever their order.

    It is for the observation ("position", "all_neighbours", "targets", "sight_matrix",
    "sight_ahead"). What is summed is an MLP of what each user is to the drones. Of each user the
    MLP knows where it is, who sees it, how loud it is at each drone, by how much louder at this
    one than at any other, and how that would change at the places of `sight_ahead`.
    M. Zaheer et al., Deep sets (2017).

    Attributes:
        each: The MLP.
        ways: (P, 3) ways to the places of `sight_ahead`, m.
    """

    ways: torch.Tensor

    def __init__(
        self,
        observation_space: Box,
        num_drones: int = 3,
        size: int = 48,
    ) -> None:
        """Make the layers.

        Args:
            observation_space: Space of one drone's observations.
            num_drones: How many drones a world has.
            size: How many features the sum has.

        Raises:
            ValueError: The observation is of another number of drones.
        """
        # Numbers of an observation: position, others, and so many of each user
        shape = observation_space.shape
        others = 6 * (num_drones - 1)
        numbers_each = 4 + num_drones + len(AHEAD)
        users, rest = divmod(shape[0] - 3 - others, numbers_each)
        if rest or users < 1:
            raise ValueError(
                f"features of {num_drones} drones and their users do not fit {shape} numbers"
            )
        super().__init__(observation_space, 3 * num_drones + size)
        # Numbers of each block of the observation.
        self._sizes = [
            3,
            others,
            4 * users,
            num_drones * users,
            len(AHEAD) * users,
        ]
        # Ways that the drone may fly; no weights, so they are not stored
        ways = torch.tensor(list(AHEAD.values()))
        self.register_buffer("ways", ways, persistent=False)
        # The same layers for each user, whose features are summed
        known = 3 + 2 * num_drones + 1 + len(AHEAD)
        self.each = nn.Sequential(
            nn.Linear(known, size),
            nn.ReLU(),
            nn.Linear(size, size),
            nn.ReLU(),
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute (B, 3 N + size) features of observations (B, D)."""
        count = len(observations)
        own, others, users, sight, ahead = torch.split(observations, self._sizes, 1)
        # Of each other drone its position, of each user its position, who sees it, and from where.
        others = others.reshape(count, -1, 6)[..., :3]
        users = users.reshape(count, -1, 4)[:, :, None, :3]
        num_users = users.shape[1]
        sight = sight.reshape(count, -1, num_users).transpose(1, 2)
        ahead = ahead.reshape(count, -1, num_users).transpose(1, 2)
        # How loud each user is at each drone, first the one that asks, and at the places around it.
        ways = torch.cat([users, users - others[:, None]], 2)
        now = log_gain(ways, sight)
        here = now[..., :1]
        elsewhere = now[..., 1:].amax(2, keepdim=True)
        lead = here - elsewhere
        gain = log_gain(users - self.ways, ahead) - here
        # All of it scaled to the order of 1.
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
        # Through the MLP, and summed over users.
        each = self.each(known).sum(1) / math.sqrt(num_users)
        flat = others.flatten(1)
        return torch.cat([own / POSITION_SCALE, flat / POSITION_SCALE, each], 1)


def log_gain(offset: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Compute the logarithm of received power over that at 1 m.

    See `log_distance` in `bulletuav.network.pathloss`.

    Args:
        offset: (..., 3) ways from senders to receivers, m.
        seen: (...) 1 where they see each other, else 0.

    Returns:
        (...) natural logarithms.
    """
    exponent = torch.where(seen > 0.5, LOS_EXPONENT, NLOS_EXPONENT)
    return -exponent * torch.log(offset.norm(dim=-1) + 1)
