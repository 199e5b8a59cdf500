"""Transitions of whole episodes, for datasets: observations, actions, rewards and ends."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.episodes import EpisodeJob
from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown
from bulletuav.policies.base import Policy
from bulletuav.policies.mismatch import naming_task

DATASET = "dataset.json"
"""File with the index of a dataset"""


class Transitions(NamedTuple):
    """K transitions of drones, sorted by episode, then by drone, then by time.

    Attributes:
        episode: Number of the episode, (K,).
        drone: Number of the drone, (K,).
        step: Number of earlier decisions of the episode, (K,).
        observation: Observations before the decision, (K, D) float32.
        action: Actions, (K, A) float32, or (K,) int64 choices of a discrete action.
        reward: Rewards, (K,).
        terminated: Whether the task ended the drone's episode with this decision, (K,) bool.
        truncated: Whether the horizon did, (K,) bool.
        last: Rows of the last transition of each drone in each episode, (E,).
        final_observation: Observations after those transitions, (E, D) float32.
        ends: (episode, seed, decisions, hash of the final state) of each episode.
    """

    episode: np.ndarray
    drone: np.ndarray
    step: np.ndarray
    observation: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    last: np.ndarray
    final_observation: np.ndarray
    ends: tuple[tuple[int, int, int, str], ...]


@dataclass(frozen=True)
class DatasetJob(EpisodeJob[Transitions]):
    """The episodes of a dataset; see `EpisodeJob`."""

    def _fly_batch(self, aviary: Aviary, policy: Policy, batch: range) -> Transitions:
        """Fly one batch and return its transitions."""
        observations, worlds = self.start(aviary, policy, batch)
        seen = [_vector(observations)]
        flown, actions, results = [], [], []
        # Worlds end at different times; finished ones add no rows
        while aviary.alive[worlds].any():
            flown.append(aviary.alive & worlds[:, None])
            with naming_task(policy, aviary):
                action = policy.act(observations, aviary.swarm)
            step = aviary.step(action)
            observations = step.observations
            actions.append(np.array(action, dtype=np.float32))
            results.append((step.rewards.copy(), step.terminated.copy(), step.truncated.copy()))
            seen.append(_vector(observations))
        # Axes (worlds, drones, decisions, ...), so that rows come in the documented order
        flew, did, saw = (np.stack(one, axis=2) for one in (flown, actions, seen))
        reward, terminated, truncated = (
            np.stack(one, axis=2) for one in zip(*results, strict=True)
        )
        # A row for each decision that a drone flew
        world, drone, time = np.nonzero(flew)
        # The last transition of a drone also has a final observation
        is_last = np.append((world[1:] != world[:-1]) | (drone[1:] != drone[:-1]), True)
        last = np.flatnonzero(is_last)
        action = did[world, drone, time]
        hashes = aviary.state_hash()
        decisions = flew.any(axis=1).sum(axis=1)
        return Transitions(
            episode=batch.start + world,
            drone=drone,
            step=time,
            observation=saw[world, drone, time],
            action=action if aviary.action.choices is None else action[:, 0].astype(np.int64),
            reward=reward[world, drone, time],
            terminated=terminated[world, drone, time],
            truncated=truncated[world, drone, time],
            last=last,
            final_observation=saw[world[last], drone[last], time[last] + 1],
            ends=tuple(
                (episode, self.seed + episode, int(decisions[k]), hashes[k])
                for k, episode in enumerate(batch)
            ),
        )


def _vector(observations: Any) -> np.ndarray:
    """Copy observations as float32; raise ValueError unless they are vectors."""
    if not isinstance(observations, np.ndarray) or observations.ndim != 3:
        raise ValueError(
            f"a dataset holds vectors of numbers, and drones observe {shown(type(observations))}: "
            f"choose observation_format='vector' and no pictures"
        )
    return observations.astype(np.float32)
