"""Features extractors of stable-baselines3: what observed numbers go through before the networks of actor and critic."""

import math

import numpy as np
from gymnasium.spaces import Box

from bulletuav.errors import missing
from bulletuav.policies.features import BLOCKED, FAR, LINE_OF_SIGHT
from bulletuav.sensors.sight import AHEAD

try:
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None


class Symlog(BaseFeaturesExtractor):
    """sign(x) ln(1 + scale |x|) of each number: metres near by count as much as those far away, with no statistics to keep.

    Where centimetres matter `scale` is to be larger than 1. D. Hafner, J. Pasukonis, J. Ba, T. Lillicrap, Mastering diverse
    domains through world models (2023), equation 9.
    """

    def __init__(self, observation_space: Box, scale: float = 1.0):
        super().__init__(observation_space, int(np.prod(observation_space.shape)))
        self.scale = scale

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """(B, D) features of observations (B, D)."""
        return torch.sign(observations) * torch.log1p(self.scale * torch.abs(observations))


class UserSum(BaseFeaturesExtractor):
    """Positions of the drones, and the sum over users of an MLP on what each user is to them, whatever their order.

    For the observation ("position", "all_neighbours", "targets", "sight_matrix", "sight_ahead"). Of each user the MLP knows
    where it is, who sees it, how loud it is at each drone, by how much louder at this one than at any other, and how that
    would change at the places of `sight_ahead`. M. Zaheer et al., Deep sets (2017).
    """

    def __init__(self, observation_space: Box, num_drones: int = 3, size: int = 48):
        """Raises ValueError for another number of drones than the observation is of."""
        parts = 4 + num_drones + len(AHEAD)  # numbers of each user
        users, rest = divmod(observation_space.shape[0] - 3 - 6 * (num_drones - 1), parts)
        if rest or users < 1:
            raise ValueError(
                f"features of {num_drones} drones and their users do not fit {observation_space.shape} numbers"
            )
        super().__init__(observation_space, 3 * num_drones + size)
        self._sizes = [3, 6 * (num_drones - 1), 4 * users, num_drones * users, len(AHEAD) * users]
        self.register_buffer("ways", torch.tensor(list(AHEAD.values())), persistent=False)
        known = 3 + 2 * num_drones + 1 + len(AHEAD)
        self.each = nn.Sequential(
            nn.Linear(known, size), nn.ReLU(), nn.Linear(size, size), nn.ReLU()
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """(B, 3 N + size) features of observations (B, D)."""
        own, others, users, sight, ahead = observations.split(self._sizes, 1)
        others, users = (
            others.unflatten(1, (-1, 6))[..., :3],
            users.unflatten(1, (-1, 4))[:, :, None, :3],
        )
        sight, ahead = (
            seen.unflatten(1, (-1, users.shape[1])).transpose(1, 2) for seen in (sight, ahead)
        )
        level = log_gain(torch.cat([users, users - others[:, None]], 2), sight)
        gain = log_gain(users - self.ways, ahead) - level[..., :1]
        lead = level[..., :1] - level[..., 1:].amax(2, keepdim=True)
        known = torch.cat(
            [users[:, :, 0] / FAR, level / 2 + 6, sight, lead / 2, gain / 2], 2
        )  # of the order of 1
        each = self.each(known).sum(1) / math.sqrt(users.shape[1])
        return torch.cat([own / FAR, others.flatten(1) / FAR, each], 1)


def log_gain(offset: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
    """Logarithm of received power over that at 1 m, for offsets (..., 3), m; see `log_distance` in `network.pathloss`."""
    return -torch.where(seen > 0.5, LINE_OF_SIGHT, BLOCKED) * torch.log(offset.norm(dim=-1) + 1)
