"""Features of a drone among others, whatever their number and order, to learn with PyTorch."""

from typing import Any

from gymnasium.spaces import Box

from bulletuav.errors import missing
from bulletuav.policies.swarm_features import LOOK_AHEAD, TINY, ObservationLayout

try:
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None


class SwarmFeatures(BaseFeaturesExtractor):
    """Own numbers, and of each kind of others the sum and the largest of what an MLP makes of them.

    The MLP sees what is told of one other, where and when it comes closest if both fly straight on,
    and the drone's own numbers. It is the same for all of a kind, so that their order and number do
    not matter. Others whose numbers are all zero are not there. M. Zaheer et al., Deep sets (2017).

    Attributes:
        each: The MLPs by kind.
    """

    def __init__(
        self,
        observation_space: Box,
        layout: ObservationLayout,
        size: int = 32,
        scale: float = 1.0,
    ) -> None:
        """Make the layers.

        Args:
            observation_space: Space of one drone's observations.
            layout: Where numbers are in them.
            size: How many features of others the MLPs make.
            scale: Scale of the numbers, see `Symlog`.
        """
        super().__init__(observation_space, len(layout.own) + 2 * size * len(layout.kinds))
        self._layout, self._scale = layout, scale
        self.each = nn.ModuleDict(
            {
                word: nn.Sequential(
                    nn.Linear(layout.inputs(word), size),
                    nn.ReLU(),
                    nn.Linear(size, size),
                    nn.ReLU(),
                )
                for word in layout.kinds
            }
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Compute (B, F) features of observations (B, D)."""
        own = _symlog(observations[:, self._layout.own], self._scale)
        parts = [own]
        for word, kind in self._layout.kinds.items():
            others = observations[:, torch.tensor(kind.columns)]
            is_there = (others != 0).any(-1, keepdim=True)
            known = [_symlog(others, self._scale)]
            if kind.motion:
                known += _approach(others[..., kind.motion])
            each = self._each(word, torch.cat(known, -1), own) * is_there
            parts += [each.sum(1) / 2, each.amax(1)]
        return torch.cat(parts, 1)

    def _each(
        self,
        word: str,
        known: torch.Tensor,
        own: torch.Tensor,
    ) -> torch.Tensor:
        """Pass (B, K, numbers) of others, each with the own (B, numbers), through MLPs."""
        layers: Any = self.each[word]
        first, second = layers[0], layers[2]
        # What follows from the own numbers is the same for all others, and so computed once.
        of_other, of_own = first.weight.split([known.shape[-1], own.shape[-1]], 1)
        shared = nn.functional.linear(own, of_own, first.bias)
        hidden = torch.relu(nn.functional.linear(known, of_other) + shared[:, None])
        result: torch.Tensor = torch.relu(second(hidden))
        return result


def _symlog(numbers: torch.Tensor, scale: float = 1.0) -> torch.Tensor:
    """Compress numbers, see `bulletuav.policies.features.symlog`."""
    return torch.sign(numbers) * torch.log1p(scale * numbers.abs())


def _approach(motion: torch.Tensor) -> list[torch.Tensor]:
    """Compute where others (..., 6) come closest if both fly straight on: place, distance, time."""
    position, velocity = motion[..., :3], motion[..., 3:]
    along = (position * velocity).sum(-1, keepdim=True)
    square = (velocity * velocity).sum(-1, keepdim=True)
    time = (-along / (square + TINY)).clamp(0.0, LOOK_AHEAD)
    place = position + velocity * time
    distance = ((place * place).sum(-1, keepdim=True) + TINY).sqrt()
    return [_symlog(place), torch.log1p(distance), time / (LOOK_AHEAD / 2)]
