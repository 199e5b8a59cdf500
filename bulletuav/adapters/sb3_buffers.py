"""Buffers for stable-baselines3 that drop transitions of slots without a drone.

The reward of such transitions is NaN, see `bulletuav.adapters.sb3`.
"""

from collections.abc import Generator
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Space

from bulletuav.errors import missing_extra

try:
    import torch
    from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
    from stable_baselines3.common.type_aliases import RolloutBufferSamples
except ImportError:
    raise missing_extra("learning with stable-baselines3", "sb3") from None


class LivingRollouts(RolloutBuffer):
    """Rollout buffer of on-policy algorithms that samples only transitions of active drones.

    Minibatches have at most `batch_size` transitions, and their sizes differ by at most one. Their
    order depends on PyTorch's seed.

    Attributes:
        flown: Indices of the transitions of active drones, slot by slot.
    """

    rows: ClassVar[tuple[str, ...]] = (
        *("observations", "actions", "values", "log_probs", "advantages", "returns"),
    )

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        """Compute returns and advantages as stable-baselines3 does.

        Sets `flown`, and replaces rewards that are NaN (slots without a drone) by 0. `DroneVecEnv`
        reports done in the last transition of a drone, so that the transitions of slots without a
        drone do not affect the advantages of others.

        Args:
            last_values: (slots,) value estimates after the last step.
            dones: (slots,) bool, True where the last step ended an episode.
        """
        rewards = self.swap_and_flatten(self.rewards)
        self.flown = np.flatnonzero(~np.isnan(rewards))
        np.nan_to_num(self.rewards, copy=False)
        super().compute_returns_and_advantage(last_values, dones)

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Yield minibatches in random order.

        Args:
            batch_size: Maximum size of a minibatch; None for all transitions in one.
        """
        # Once for each rollout: concatenate all slots, without transitions of absent drones
        if not self.generator_ready:
            for name in self.rows:
                whole = self.swap_and_flatten(getattr(self, name))
                setattr(self, name, whole[self.flown])
            self.generator_ready = True
        count = len(self.flown)
        order = torch.randperm(count).numpy()
        # Number of minibatches, rounded up
        batches = -(-count // (batch_size or count))
        for indices in np.array_split(order, batches):
            yield self._get_samples(indices)


class LivingReplay(ReplayBuffer):
    """Replay buffer of off-policy algorithms that stores only transitions of active drones.

    Transitions of all slots are stored in one sequence.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: Space[Any],
        action_space: Space[Any],
        device: torch.device | str = "auto",
        **kwargs: Any,
    ) -> None:
        """Allocate the buffer.

        Args:
            buffer_size: Capacity in transitions; the oldest are overwritten.
            observation_space: Observation space of one drone.
            action_space: Action space of one drone.
            device: PyTorch's device.
            **kwargs: Other arguments of the buffer of stable-baselines3.

        Raises:
            ValueError: If `optimize_memory_usage` is True, which needs consecutive transitions.
        """
        if kwargs.get("optimize_memory_usage"):
            raise ValueError(
                "optimize_memory_usage is True: transitions of active drones alone do not follow "
                "each other"
            )
        settings = {**kwargs, "n_envs": 1}
        super().__init__(buffer_size, observation_space, action_space, device, **settings)

    def add(
        self,
        obs: np.ndarray,
        next_obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Store the transitions whose reward is not NaN.

        Args:
            obs: (slots, D) observations.
            next_obs: (slots, D) observations after the decision.
            action: (slots, A) actions, or (slots,) discrete actions.
            reward: (slots,) rewards, NaN for slots without a drone.
            done: (slots,) bool, True where an episode ended.
            infos: Infos of the slots.
        """
        # Indices in the ring buffer
        flown = np.flatnonzero(~np.isnan(reward))
        action = np.asarray(action).reshape(len(reward), self.action_dim)
        places = (self.pos + np.arange(len(flown))) % self.buffer_size
        self.observations[places, 0] = obs[flown]
        self.next_observations[places, 0] = next_obs[flown]
        self.actions[places, 0] = action[flown]
        self.rewards[places, 0] = reward[flown]
        self.dones[places, 0] = done[flown]
        self.timeouts[places, 0] = [infos[slot].get("TimeLimit.truncated", False) for slot in flown]
        self.full |= self.pos + len(flown) >= self.buffer_size
        self.pos = (self.pos + len(flown)) % self.buffer_size
