"""Feature extractors for stable-baselines3.

They transform observations before the networks of actor and critic.
"""

import itertools
import math

import numpy as np
from gymnasium.spaces import Box, Dict

from bulletuav.errors import missing_extra
from bulletuav.policies.features import LOS_EXPONENT, NLOS_EXPONENT, POSITION_SCALE
from bulletuav.sensors.sight import AHEAD

try:
    import torch
    from stable_baselines3.common.preprocessing import is_image_space
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


class PictureFeatures(BaseFeaturesExtractor):
    """Symlog of vectors, and three convolutions of each picture of a dict observation.

    Depths d in metres become 1 / (1 + d / depth_scale). Pictures are then reduced to about 16
    pixels a side: depths in metres to that of the nearest pixel, so that thin obstacles remain, and
    others to their mean. Frames of a stack are channels. The layers are a small form of those of
    V. Mnih et al., Human-level control through deep reinforcement learning (2015).

    Attributes:
        pictures: The layers, by name of the picture.
    """

    def __init__(
        self,
        observation_space: Dict,
        size: int = 64,
        scale: float = 1.0,
        depth_scale: float = 10.0,
    ) -> None:
        """Make the layers.

        Args:
            observation_space: Observation space of one drone, with images channels-first, as
                stable-baselines3 passes it.
            size: Number of features of each picture.
            scale: Scale of the numbers of vectors, see `SymlogFeatures`.
            depth_scale: Depth with half the value of a depth of 0, m.
        """
        boxes = {name: box for name, box in observation_space.items() if isinstance(box, Box)}
        self._vectors = [name for name, box in boxes.items() if len(box.shape) == 1]
        self._boxes = {name: box for name, box in boxes.items() if len(box.shape) > 1}
        numbers = sum(boxes[name].shape[0] for name in self._vectors)
        super().__init__(observation_space, numbers + size * len(self._boxes))
        self._scale, self._depth_scale = scale, depth_scale
        self._factors: dict[str, int] = {}
        self.pictures = nn.ModuleDict()
        for name, box in self._boxes.items():
            channels, *sides = self._channels(name, torch.zeros(1, *box.shape)).shape[1:]
            # A side of 16 pixels is enough to fly by, and the first layers take most of the time
            factor = self._factors[name] = max(1, min(sides) // 16)
            widths = (channels, 8, 16, 32)
            convolutions = []
            for inputs, outputs in itertools.pairwise(widths):
                convolution = nn.Conv2d(inputs, outputs, 3, stride=2, padding=1)
                convolutions += [convolution, nn.ReLU()]
            # Each layer halves the sides, rounded up
            cells = math.prod(math.ceil(side // factor / 8) for side in sides)
            last = (nn.Flatten(), nn.Linear(32 * cells, size), nn.ReLU())
            self.pictures[name] = nn.Sequential(*convolutions, *last)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (B, F) of a dict of vectors (B, D) and pictures (B, ...)."""
        return self.encode(self.prepare(observations))

    def prepare(self, observations: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Scale vectors, and scale and reduce pictures; uses no weights.

        Args:
            observations: Vectors (B, D) and pictures (B, ...) by name.

        Returns:
            Vectors (B, D) and pictures (B, channels, height, width) by name.
        """
        scaled = {name: observations[name] for name in self._vectors}
        scaled = {
            name: torch.sign(one) * torch.log1p(self._scale * one.abs())
            for name, one in scaled.items()
        }
        return scaled | {name: self._reduce(name, observations[name]) for name in self._boxes}

    def encode(self, prepared: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (B, F) of the result of `prepare`."""
        parts = [prepared[name] for name in self._vectors]
        parts += [layers(prepared[name]) for name, layers in self.pictures.items()]
        return torch.cat(parts, 1)

    def _channels(self, name: str, picture: torch.Tensor) -> torch.Tensor:
        """Return a picture (B, ...) as (B, channels, height, width)."""
        box = self._boxes[name]
        if len(box.shape) == 2:
            return picture[:, None]
        if box.shape[-1] == 3 and not is_image_space(box):
            picture = picture.movedim(-1, -3)
        return picture.flatten(1, -3)

    def _reduce(self, name: str, picture: torch.Tensor) -> torch.Tensor:
        """Return a picture as (B, channels, height, width) of the order of 1, reduced in size."""
        box, factor = self._boxes[name], self._factors[name]
        picture = self._channels(name, picture)
        low, high = float(box.low.min()), float(box.high.max())
        if box.dtype == np.float32 and low >= 0 and high > 1:
            return nn.functional.max_pool2d(1 / (1 + picture / self._depth_scale), factor)
        # Stable-baselines3 divides what it regards as images itself
        scale = 1 if is_image_space(box) else high
        return nn.functional.avg_pool2d(picture / scale, factor)


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
