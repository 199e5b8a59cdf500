"""Policies that try to be paid for service over a city without the work of a whole swarm."""

from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import sin
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.coverage import Oracle, Placement
from bulletuav.policies.coverage_geometry import (
    assign_optimally,
    pairwise_distances,
    ring_positions,
)
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.shirkers.goal_flight import CLOSE, LATE
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

RING_FRACTION = 0.6
"""Radius of the fixed places as a fraction of half of the city's side: of several, it serves most
on average"""
WORK_FRACTION = 0.5
"""Fraction of the episode in which policies that serve for a part of it do so"""
MEETING_FRACTION = 0.7
"""Distance below the place of another drone at which a drone meets it, as a fraction of d_safe"""


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


class SomeServe(Oracle):
    """Base class of policies by which some drones serve as the oracle does, and the others stay.

    Attributes:
        resting: The drones that stay.
    """

    resting: ClassVar[slice]

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return velocities that are zero for drones that stay; see `Avoidance.avoid`."""
        velocity = super().avoid(traffic, preferred, parameters)
        velocity[:, self.resting] = 0.0
        return velocity


@register("policy")
class OneServes(SomeServe):
    """Let the first drone fly to its place as the oracle does, and the others stay."""

    name = "service_by_one"
    resting = slice(1, None)


@register("policy")
class AllButOneServe(SomeServe):
    """Let all drones but the last fly to their places as the oracle does, and the last one stay."""

    name = "service_but_one"
    resting = slice(-1, None)


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


@register("policy")
class ConflictFirst(Oracle):
    """Pass another drone closely at first, then serve as the oracle does.

    The drone that is nearest to the place of another one flies there until both are in conflict.
    Only contact is avoided.
    """

    name = "service_conflict"
    remembers = (*Oracle.remembers, "_pair")

    def __init__(self, aviary: Aviary) -> None:
        """Reduce the separation that ORCA maintains, and its horizon; see `Policy`."""
        super().__init__(aviary)
        separation = 2 * aviary.task.context.collision_radius + CLOSE
        self.parameters = self.parameters._replace(separation=separation, horizon=LATE)
        # Drones that meet, the one at its place first; negative before and after the meeting
        self._pair = np.full((len(aviary.alive), 2), -1)

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Return the hover positions, or a point below that of the drone to meet, (W, N, 3) m."""
        aviary = self.aviary
        place = super().goals(swarm).copy()
        violations = aviary.scene.memory["violations"]
        for w in range(len(place)):
            if aviary.steps[w] == 0 and aviary.num_drones > 1:
                distance = pairwise_distances(place[w, :, :2], swarm.position[w, :, :2])
                np.fill_diagonal(distance, np.inf)
                self._pair[w] = np.unravel_index(distance.argmin(), distance.shape)
            at_place, visitor = self._pair[w]
            if visitor < 0:
                continue
            if violations[w].any() or not aviary.alive[w].all():
                self._pair[w] = -1
                self._count[w, visitor] = 0
                continue
            if aviary.steps[w] % self._every == 0:
                self._count[w, visitor] = 0
            drop = MEETING_FRACTION * aviary.task.config.d_safe
            place[w, visitor] = place[w, at_place] - (0.0, 0.0, drop)
        return place
