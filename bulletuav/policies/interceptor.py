"""Policy `interceptor`: intercepts an evader over terrain, by what the drones observe."""

from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.intercept import interception
from bulletuav.policies.mvp import ModifiedVoltagePotential
from bulletuav.policies.observed import Observed
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

BRAKING = 1.0
"""Minimum time to reach a surface at the chosen velocity, s"""
SURFACE_MARGIN = 0.7
"""Distance of a drone's shape from surfaces, m"""
EVADER_SIZE = 2.5
"""Distance from the track within which hits of beams are those of the evader, m"""
FRESH = 1.0
"""Age up to which a track is followed as a detection, s"""
CRUISE = 6.0
"""Height above obstacles ahead at which a drone flies until it is near the evader, m"""
NEAR = 12.0
"""Distance to the evader below which a drone flies straight at it, m"""
LOOKOUT, LOOKOUT_RATE = 15.0, 4.0
"""Maximum height above a lost track, m, and its growth with the age of the track, m/s"""
FLIGHT = 3.0
"""Supposed speed of an evader whose track is lost, m/s"""
EDGE = 15.0
"""Supposed distance of such an evader from the bounds of the arena, at least, m"""
SEARCH_RATE, SEARCH_TURN = 1.0, 0.5
"""Growth of the radius of the search around a lost track, m/s, and its angular velocity, rad/s"""
PATROL_AFTER, PATROL_RADIUS, PATROL_SPEED = 15.0, 40.0, 5.0
"""Age of a track after which drones patrol around the middle of the arena, s, the radius of their
circle, m, and its speed, m/s"""
MAX_SEARCH = 30.0
"""Maximum radius of the search, m"""


@register("policy")
class Interceptor(Observed, ModifiedVoltagePotential):
    """Flight to the intercept point of the track by `constant_bearing`, above terrain.

    Far from the evader a drone climbs before hills and trees that its beams hit ahead. It flies to
    a place above a lost track, and then in growing circles around it. The hits of beams are planes
    that it does not fly through.
    """

    name = "interceptor"
    avoids_obstacles = False
    needed: ClassVar = (("position",), ("velocity",), ("target_track",), ("lidar",))

    def __init__(self, aviary: Aviary) -> None:
        """Find the blocks, and compute the directions of the beams; see `Observed`."""
        super().__init__(aviary)
        self.parameters = self.parameters._replace(braking_time=BRAKING, recovery_time=BRAKING)
        beams = np.radians(np.array(aviary.task.context.beams, dtype=float))
        azimuth, elevation = beams[:, 0], beams[:, 1]
        level = cos(elevation)
        parts = (level * cos(azimuth), level * sin(azimuth), sin(elevation))
        self._directions = np.stack(parts, axis=1)

    def blocks(self, observations: Observation) -> dict[str, np.ndarray]:
        """Return the observed blocks, and the offset and velocity of the track as the goal's."""
        seen = super().blocks(observations)
        track = seen["target_track"]
        seen["goal_offset"], seen["goal_velocity"] = track[..., 1:4], track[..., 4:7]
        return seen

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the observed traffic, with the planes of beams' hits; see `Observed.traffic`."""
        traffic = super().traffic(observations, swarm)
        seen = self.blocks(observations)
        self._age, self._position = seen["target_track"][..., 7], seen["position"]
        hit = self._directions * seen["lidar"][..., None]
        self._hit = np.where(self._is_terrain(traffic, seen["lidar"], hit)[..., None], hit, np.inf)
        left = np.linalg.norm(self._hit, axis=-1) - self.clearance.body - SURFACE_MARGIN
        normal = np.broadcast_to(-self._directions, hit.shape)
        planes = np.concatenate([normal, left[..., None]], axis=-1)
        return traffic._replace(surface=np.concatenate([traffic.surface, planes], axis=2))

    def _is_terrain(self, traffic: Traffic, ranges: np.ndarray, hit: np.ndarray) -> np.ndarray:
        """Return which beams hit something other than the evader, (W, N, B) bool."""
        gap = np.linalg.norm(hit - traffic.goal[:, :, None], axis=-1)
        is_evader = (gap < EVADER_SIZE) & (self._age < FRESH)[..., None]
        terrain: np.ndarray = (ranges < self.aviary.task.context.max_range) & ~is_evader
        return terrain

    def preferred(self, traffic: Traffic, swarm: Swarm) -> np.ndarray:
        """Return velocities to the intercept point, or around a lost track; see `Avoidance`."""
        fastest = self.parameters.max_speed
        speed = np.full(self.aviary.num_drones, fastest)
        lost = self._age > FRESH
        offset = np.where(lost[..., None], self._search(traffic.goal), traffic.goal)
        nowhere = np.zeros(offset.shape)
        velocity = interception(nowhere, offset, traffic.goal_velocity, speed)
        distance = np.linalg.norm(offset, axis=-1)
        climb = self._climb(velocity)
        is_far = (distance > NEAR) | lost
        velocity[..., 2] = np.where(is_far, np.maximum(velocity[..., 2], climb), velocity[..., 2])
        return limit_norm(velocity, fastest)

    def _search(self, goal: np.ndarray) -> np.ndarray:
        """Return offsets (W, N, 3), m, to the places where drones look for evaders.

        The evader is supposed to flee from the drone, in the arena. Drones are evenly spaced on a
        circle around that place, later around the middle of the arena.

        Args:
            goal: (W, N, 3) offsets to the lost tracks, m.
        """
        spread = 2 * np.pi * np.arange(self.aviary.num_drones) / self.aviary.num_drones
        angle = SEARCH_TURN * self._age + spread
        radius = np.minimum(SEARCH_RATE * self._age, MAX_SEARCH)
        above = np.minimum(LOOKOUT_RATE * self._age, LOOKOUT)
        around = np.stack([radius * cos(angle), radius * sin(angle), above], axis=-1)
        away = goal * (1.0, 1.0, 0.0)
        away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
        there = self._position + goal + FLIGHT * self._age[..., None] * away
        low, high = self.box
        there = np.clip(there, low + EDGE, high - EDGE) + around
        # The track is of no use any more: patrol around the middle of the arena
        middle = (low + high) / 2
        turn = spread + PATROL_SPEED / PATROL_RADIUS * self._age
        patrol = middle + PATROL_RADIUS * np.stack([cos(turn), sin(turn), 0.0 * turn], axis=-1)
        is_useless = (self._age > PATROL_AFTER)[..., None]
        offset: np.ndarray = np.where(is_useless, patrol, there) - self._position
        return offset

    def _climb(self, velocity: np.ndarray) -> np.ndarray:
        """Return the vertical speed (W, N), m/s, that passes CRUISE above all hits ahead."""
        course = velocity[..., :2]
        speed = np.linalg.norm(course, axis=-1, keepdims=True)
        unit = course / np.maximum(speed, 1e-9)
        hit = np.nan_to_num(self._hit[..., :2], posinf=0.0)
        ahead = (hit * unit[:, :, None]).sum(axis=-1)
        level = np.linalg.norm(self._hit[..., :2], axis=-1)
        matters = np.isfinite(level) & (ahead > 0.5 * level)
        time = np.maximum(ahead, 1.0) / self.parameters.max_speed
        rise = np.where(matters, (self._hit[..., 2] + CRUISE) / time, -np.inf)
        climb: np.ndarray = rise.max(axis=-1)
        return climb
