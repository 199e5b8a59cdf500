"""Policies that try to be paid for service over a city without the work of a whole swarm."""

import numpy as np

from bulletuav.compiled.functions import sin
from bulletuav.policies.coverage import Oracle, Placement
from bulletuav.policies.coverage_geometry import assign_optimally, ring_positions
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register

RING_FRACTION = 0.6
"""Radius of the fixed places as a fraction of half of the city's side: of several, it serves most
on average"""
WORK_FRACTION = 0.5
"""Fraction of the episode in which policies that serve for a part of it do so"""


@register("policy")
class FixedPlaces(Placement):
    """Hover on a ring around the centre of the city, wherever its buildings and users are."""

    name = "service_fixed"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Return the positions of the ring; see `Placement.places`."""
        low, high = self.aviary.task.arena_low[:2], self.aviary.task.arena_high[:2]
        radius = 0.5 * RING_FRACTION * float((high - low).min())
        angle = np.pi / len(position)
        ring = ring_positions(
            centre=0.5 * (low + high),
            count=len(position),
            min_spacing=2 * radius * sin(angle),
            low=low,
            high=high,
        )
        return assign_optimally(ring, position)


@register("policy")
class FollowOne(Placement):
    """Hover with all drones above the first user, and follow it."""

    name = "service_follow_one"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Return a ring around the user; see `Placement.places`."""
        low, high = self.aviary.task.arena_low[:2], self.aviary.task.arena_high[:2]
        ring = ring_positions(targets[0, :2], len(position), self.min_spacing, low, high)
        return assign_optimally(ring, position)


@register("policy")
class OneServes(Oracle):
    """Let the first drone fly to its place as the oracle does, and the others stay."""

    name = "service_by_one"

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return velocities that are zero but for the first drone; see `Avoidance.avoid`."""
        velocity = super().avoid(traffic, preferred, parameters)
        velocity[:, 1:] = 0.0
        return velocity


@register("policy")
class LateService(Oracle):
    """Stay for half of the episode, then serve as the oracle does."""

    name = "service_late"

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return velocities that are zero at first; see `Avoidance.avoid`."""
        velocity = super().avoid(traffic, preferred, parameters)
        waits = self.aviary.steps < WORK_FRACTION * self.aviary.options.horizon
        velocity[waits] = 0.0
        return velocity


@register("policy")
class HalfService(Oracle):
    """Serve as the oracle does for half of the episode, then land to rest."""

    name = "service_half"

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return velocities that are downwards at last; see `Avoidance.avoid`."""
        velocity = super().avoid(traffic, preferred, parameters)
        rests = self.aviary.steps >= WORK_FRACTION * self.aviary.options.horizon
        speed = parameters.max_speed
        down = np.maximum(-self.aviary.swarm.position[rests, :, 2], -speed)
        velocity[rests] = down[..., None] * (0.0, 0.0, 1.0)
        return velocity
