"""Feature extractor for PyTorch that is invariant to number and order of other drones."""

from typing import Any, cast

from gymnasium.spaces import Box

from bulletuav.errors import missing_extra
from bulletuav.policies.swarm_features import LOOK_AHEAD, TINY, ObservationLayout

try:
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError:
    raise missing_extra("learning with stable-baselines3", "sb3") from None


class SwarmFeatures(BaseFeaturesExtractor):
    """Own numbers, and sum and maximum over others of the output of an MLP, for each kind.

    The inputs of the MLP are the observed numbers of one other, its closest approach on straight
    paths (relative position, distance, time), and the drone's own numbers. All others of a kind
    share the MLP, so that their order and number do not matter. Others whose numbers are all zero
    are absent. M. Zaheer et al., Deep sets (2017).

    Attributes:
        each: The MLPs by kind.
    """

    def __init__(
        self, observation_space: Box, layout: ObservationLayout, size: int = 32, scale: float = 1.0
    ) -> None:
        """Make the layers.

        Args:
            observation_space: Observation space of one drone.
            layout: Indices of own numbers and of others in an observation.
            size: Number of outputs of each MLP.
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
        """Return features (B, F) of observations (B, D)."""
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

    def reset_parameters(self) -> None:
        """Set initial weights: PyTorch's, with small outputs, so that own numbers come first."""
        for layer in self.each.modules():
            if isinstance(layer, nn.Linear):
                layer.reset_parameters()
        for layers in self.each.values():
            last: Any = cast(Any, layers)[2]
            nn.init.uniform_(last.weight, -0.02, 0.02)
            nn.init.zeros_(last.bias)

    def _each(self, word: str, known: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """Apply the MLP to features (B, K, F) of others, each with the own numbers (B, D)."""
        layers: Any = self.each[word]
        first, second = layers[0], layers[2]
        # The part of the own numbers is the same for all others, and is computed once
        of_other, of_own = first.weight.split([known.shape[-1], own.shape[-1]], 1)
        shared = nn.functional.linear(own, of_own, first.bias)
        hidden = torch.relu(nn.functional.linear(known, of_other) + shared[:, None])
        result: torch.Tensor = torch.relu(second(hidden))
        return result


def _symlog(numbers: torch.Tensor, scale: float = 1.0) -> torch.Tensor:
    """Return the symlog of numbers, see `bulletuav.policies.features.symlog`."""
    return torch.sign(numbers) * torch.log1p(scale * numbers.abs())


def _approach(motion: torch.Tensor) -> list[torch.Tensor]:
    """Return closest approach of others (..., 6): relative position, distance and time."""
    position, velocity = motion[..., :3], motion[..., 3:]
    along = (position * velocity).sum(-1, keepdim=True)
    square = (velocity * velocity).sum(-1, keepdim=True)
    time = (-along / (square + TINY)).clamp(0.0, LOOK_AHEAD)
    place = position + velocity * time
    distance = ((place * place).sum(-1, keepdim=True) + TINY).sqrt()
    return [_symlog(place), torch.log1p(distance), time / (LOOK_AHEAD / 2)]
