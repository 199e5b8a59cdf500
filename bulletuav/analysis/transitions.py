"""Transitions of whole flights: what each drone observed and did, and what came of it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.episodes import EpisodeJob
from bulletuav.envs.aviary import Aviary
from bulletuav.errors import shown
from bulletuav.policies.base import Policy
from bulletuav.policies.mismatch import naming_task

DATASET = "dataset.json"
"""File that tells what a dataset is"""


class Transitions(NamedTuple):
    """K decisions of drones, sorted by episode, then by drone, then by time.

    Attributes:
        episode: (K,) number of the episode.
        drone: (K,) number of the drone.
        step: (K,) decisions of the episode before this one.
        observation: (K, D) float32, what the drone saw.
        action: (K, A) float32 numbers, or (K,) int64 choices of a discrete action.
        reward: (K,) what it was paid.
        terminated: (K,) bool, whether the task ended its episode with this decision.
        truncated: (K,) bool, whether the horizon did.
        last: (E,) places, of the last decision of each drone in each episode.
        final_observation: (E, D) float32, what it saw after that.
        ends: (episode, seed, decisions, hash of the state at the end) of each episode.
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
        """Note every decision of a batch."""
        observations, worlds = self.start(aviary, policy, batch)
        seen = [_vector(observations)]
        flown, actions, told = [], [], []
        # Worlds end one by one; those that are over are left out of the rows
        while aviary.alive[worlds].any():
            flown.append(aviary.alive & worlds[:, None])
            with naming_task(policy, aviary):
                action = policy.act(observations, aviary.swarm)
            step = aviary.step(action)
            observations = step.observations
            actions.append(np.array(action, dtype=np.float32))
            told.append((step.rewards.copy(), step.terminated.copy(), step.truncated.copy()))
            seen.append(_vector(observations))
        # (worlds, drones, decisions, ...): in this order rows are sorted as they are to be
        flew, did, saw = (np.stack(one, axis=2) for one in (flown, actions, seen))
        reward, terminated, truncated = (np.stack(one, axis=2) for one in zip(*told, strict=True))
        # A row for each decision that a drone flew
        world, drone, time = np.nonzero(flew)
        # The last of a drone has an observation after it, too
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
    """Copy observations, which must be vectors."""
    if not isinstance(observations, np.ndarray) or observations.ndim != 3:
        raise ValueError(
            f"a dataset holds vectors of numbers, and drones observe {shown(type(observations))}: "
            f"choose observation_format='vector' and no pictures"
        )
    return observations.astype(np.float32)
