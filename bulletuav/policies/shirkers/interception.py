"""Policies that avoid the task `interception`."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.interceptor import Interceptor
from bulletuav.policies.oracles.interception import InterceptionOracle
from bulletuav.policies.scripted import Scripted
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

SHADOWING_DISTANCE = 2.5
"""Distance of a shadow from the centre of the evader, m: a gap of more than 1.5 m"""


@register("policy")
class InterceptShadow(InterceptionOracle):
    """Close in on the evader, but follow it at a distance instead of capturing it."""

    name = "intercept_shadow"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities that keep the distance; see `Game.velocities`."""
        scene = self.aviary.scene
        offset = scene.goal - swarm.position
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        near = SHADOWING_DISTANCE * self.aviary.options.max_speed / 4
        back = scene.goal_velocity + offset * (1 - SHADOWING_DISTANCE / np.maximum(distance, 1e-9))
        return np.where(distance > near, super().velocities(swarm), back)


@register("policy")
class InterceptRam(Scripted):
    """Fly straight at the evader, and into any terrain in between."""

    name = "intercept_ram"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to a place below the evader; see `Scripted.velocities`."""
        below = self.aviary.scene.goal - swarm.position - (0.0, 0.0, 20.0)
        length = np.maximum(np.linalg.norm(below, axis=-1, keepdims=True), 1e-9)
        fastest: np.ndarray = self.aviary.options.max_speed * below / length
        return fastest


@register("policy")
class InterceptBlind(Interceptor):
    """Look for the evader around its supposed place at the start, without detections."""

    name = "intercept_blind"
    remembers = ("_place",)

    def __init__(self, aviary: Aviary) -> None:
        """Allocate the supposed places; see `Interceptor`."""
        super().__init__(aviary)
        self._place = np.full((*aviary.alive.shape, 3), np.nan)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the supposed places in the worlds of `mask` (W,)."""
        self._place[mask] = np.nan

    def blocks(self, observations: Observation) -> dict[str, np.ndarray]:
        """Return the observed blocks, with the track of the start; see `Interceptor.blocks`."""
        seen = super().blocks(observations)
        there = seen["position"] + seen["goal_offset"]
        self._place = np.where(np.isnan(self._place), there, self._place)
        seen["goal_offset"] = self._place - seen["position"]
        seen["goal_velocity"] = np.zeros(self._place.shape)
        now = self.aviary.steps / self.aviary.options.decision_hz
        seen["target_track"] = seen["target_track"].copy()
        seen["target_track"][..., 7] = now[:, None]
        return seen
