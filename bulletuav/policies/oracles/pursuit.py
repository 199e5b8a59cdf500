"""Oracle of `pursuit`: each drone flies in a lane in which it meets no other drone."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.circular_track import TrackPolicy
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

LANE_MARGIN = 2.5
"""Distance between lanes beyond d_safe, m"""
LAG_MARGIN = 3.0
"""Distance of the outermost lanes from the slack, and of drones in one lane beyond d_safe, m"""
CUT_MARGIN = 1.5
"""Distance of the innermost lanes from max_cut, m"""
MAX_SPEED_FRACTION = 0.95
"""Maximum speed in outer lanes, as a fraction of max_speed"""
LANE_GAIN = 1.5
"""Gain from the offset from the place in the lane to the speed, 1/s"""


@register("policy")
class PursuitOracle(TrackPolicy):
    """Flight in lanes along the track of `pursuit`, each of which has drones that never meet.

    Lanes are the points of a triangular grid in the plane across the track. The fastest drone
    chooses first: the lane nearest to the track in which it stays separated from all drones that
    are there already, as computed from the cruising speeds; the track itself if there is none.

    Attributes:
        lanes: (W, N, 2) offsets of each drone's lane from the track, outward and up, m.
    """

    name = "pursuit_oracle"
    remembers = ("lanes",)

    def __init__(self, aviary: Aviary) -> None:
        """Place the lanes; see `TrackPolicy`."""
        super().__init__(aviary)
        config = self.task.config
        self.lanes = np.zeros((aviary.num_worlds, aviary.num_drones, 2))
        grid = lane_grid(config.d_safe + LANE_MARGIN, config.slack - LAG_MARGIN)
        self._grid = grid[grid[:, 0] >= CUT_MARGIN - config.max_cut]

    def reset(self, mask: np.ndarray) -> None:
        """Choose the lanes of the worlds in `mask` (W,)."""
        for w in np.flatnonzero(mask).tolist():
            self.lanes[w] = self._choose_lanes(self.cruising_speed[w])

    def _choose_lanes(self, speed: np.ndarray) -> np.ndarray:
        """Return the lanes (N, 2), m, of drones with cruising speeds (N,), m/s."""
        config, limit = self.task.config, MAX_SPEED_FRACTION * self.aviary.options.max_speed
        circle = 2 * np.pi * config.radius
        # Offsets along the track at the start, and when the first drone of a pair has finished
        place = -config.spacing * np.arange(len(speed))
        start = place - place[:, None]
        time = self.task.track_length / np.maximum(speed, speed[:, None])
        finish = start + (speed - speed[:, None]) * time
        low, high = np.minimum(start, finish), np.maximum(start, finish)
        lanes = np.zeros((len(speed), 2))
        members: list[list[int]] = [[] for _ in self._grid]
        for i in np.argsort(-speed, kind="stable").tolist():
            for lane, drones in zip(self._grid, members, strict=True):
                scale = 1 + lane[0] / config.radius
                margin = (config.d_safe + LAG_MARGIN) / scale
                # Two drones meet if their offset passes zero or a multiple of the circle
                first, last = low[i, drones] - margin, high[i, drones] + margin
                is_free = (np.floor(last / circle) < np.ceil(first / circle)).all()
                if is_free and (speed[i] * scale <= limit or lane[0] <= 0.0):
                    lanes[i] = lane
                    drones.append(i)
                    break
        return lanes

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return the velocities along the lanes, next to the goals; see `Scripted.velocities`."""
        scene, radius = self.aviary.scene, self.task.config.radius
        aside, up = self.lanes[..., :1], self.lanes[..., 1:]
        outward = scene.goal * (1.0, 1.0, 0.0) / radius
        place = scene.goal + aside * outward + up * (0.0, 0.0, 1.0)
        along = scene.goal_velocity * (1 + aside / radius)
        velocity: np.ndarray = along + LANE_GAIN * (place - swarm.position)
        return velocity


def lane_grid(spacing: float, max_distance: float) -> np.ndarray:
    """Return the points of a triangular grid around the origin, the nearest first.

    Args:
        spacing: Distance between neighbours, m.
        max_distance: Maximum distance from the origin, m.

    Returns:
        (M, 2) m.
    """
    count = int(2 * max(max_distance, 0.0) / spacing) + 1
    first, second = np.mgrid[-count : count + 1, -count : count + 1].reshape(2, -1)
    points = spacing * np.stack([first + second / 2, second * np.sqrt(3) / 2], axis=1)
    distance = np.linalg.norm(points, axis=1)
    order = np.argsort(distance, kind="stable")
    nearest: np.ndarray = points[order[distance[order] <= max(max_distance, 0.0)]]
    return nearest
