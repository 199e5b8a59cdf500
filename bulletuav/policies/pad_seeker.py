"""Policy `pad_seeker`: finds landing pads in its depth pictures, and lands on them."""

from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import axes, from_euler, heading, product
from bulletuav.policies.base import Policy, require_supported_task
from bulletuav.policies.pad_approach import LEAD, PadTarget, approach_pads, keep_apart, match_pads
from bulletuav.policies.pad_vision import PadTracks, find_pads, picture_rays
from bulletuav.policies.readings import require_blocks
from bulletuav.registry import register
from bulletuav.sensors.camera import Camera
from bulletuav.sensors.mounts import as_mounts
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.observations.pads import PER_PAD
from bulletuav.tasks.pad_landing import PadLanding
from bulletuav.vehicle.swarm import Swarm

NEEDED = ("attitude", "velocity", "pad_clue", "claimed_pads", "neighbours")
"""Blocks that the policy reads, beside the picture"""
LOOKS = 10.0
"""Pictures that it evaluates in a second, far from pads"""
NEAR = 3.0
"""Distance to the pad below which it evaluates every picture, m"""
MIN_HEIGHT = 0.12
"""Height above ground from which pixels may belong to pads, m"""
MAX_RANGE = 60.0
"""Depth up to which pixels are evaluated, m"""
CLEAR = 3.0
"""Distance to the east of the start from which pixels may belong to pads, m: not to platforms"""
DRONE = 0.5
"""Distance from other drones within which pixels belong to them, m"""
CLAIM = 2.0
"""Distance from a claimed pad within which a track is that pad, m"""
CRUISE_MARGIN, SEARCH_MARGIN = 1.0, 2.0
"""Cruise height above the highest pad, known or possible, and search height above that, m"""
ARRIVED = 1.5
"""Distance at which a point of the search is reached, m"""
SEARCH_GAIN = 1.0
"""Gain from distance to speed in the search, 1/s"""
NO_PICTURE = np.zeros((0, 0))
"""Picture of a policy that does not look"""
PATTERN = np.array(
    [(-1.0, 0.0), (-1.0, 1.0), (-1.0, -1.0), (0.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-2.0, 0.0)]
)
"""Points of the search around the clue, east and north, by the size of the search"""


class _Sight(NamedTuple):
    """What a drone knows of itself and others, relative to the clue.

    Attributes:
        place: (3,) own position, m.
        attitude: Own attitude.
        velocity: (3,) m/s.
        others: (K, 3) positions of other drones, m.
        claimed: (M, 3) positions of claimed pads, m.
    """

    place: np.ndarray
    attitude: tuple[float, float, float, float]
    velocity: np.ndarray
    others: np.ndarray
    claimed: np.ndarray


@register("policy")
class PadSeeker(Policy):
    """Search around the clue until a pad is in the picture, then approach and touchdown.

    The drone maps pads relative to the clue, which is common to all drones: it takes what is above
    the ground, as the pictures show it, for pads. Of these it approaches the one that the order of
    nearest pairs of drones and pads gives to it. Pads in whose places others claim one are dropped.
    In the last centimetres, where no picture shows the pad, it moves as the pad did.

    Attributes:
        looks: Whether the policy reads pictures.
    """

    name = "pad_seeker"
    actions = ("velocity",)
    reads_swarm = False
    remembers = ("_tracks", "_start", "_ground", "_leg")
    looks: ClassVar[bool] = True

    def __init__(self, aviary: Aviary) -> None:
        """Find the observations; see `Policy`.

        Raises:
            ValueError: If the task is not `pad_landing`, or a block, the picture or its direction
                is not usable.
        """
        super().__init__(aviary)
        self._task = require_supported_task(self, PadLanding)
        observer, options = aviary.observer, aviary.options
        require_blocks(self.name, aviary, NEEDED)
        mount = as_mounts(options.camera_mounts)
        if isinstance(mount, tuple) or (self.looks and "depth" not in observer.images):
            raise ValueError(
                f"policy {self.name!r} reads the depths of one camera: observe 'depth', with one "
                f"of camera_mounts"
            )
        if options.normalise or options.camera_depth != "metres" or options.frame_stack > 1:
            raise ValueError(
                f"policy {self.name!r} reads metres and single pictures: leave out normalise, "
                f"camera_depth and frame_stack"
            )
        self._mount = mount
        self._rays = picture_rays(options.camera_size, np.radians(Camera.uncertain["fov"].usual))
        # Pictures are held between exposures
        hz = options.camera_hz or options.decision_hz
        self._every = max(round(options.decision_hz / hz), 1)
        self._far_every = self._every * max(round(hz / LOOKS), 1)
        shape = aviary.alive.shape
        self._start = np.zeros((*shape, 3))
        self._ground = np.zeros(shape)
        self._leg = np.zeros(shape, dtype=np.int64)
        config = self._task.config
        moves = config.pad_speed > 0
        turn_rate = config.pad_speed / config.pad_circle if moves else 0.0
        self._motion = config.pad_speed, turn_rate
        worlds, drones = shape
        self._tracks = [[PadTracks(*self._motion) for _ in range(drones)] for _ in range(worlds)]
        side = config.pad_spacing * np.sqrt(self._task.pads.count)
        self._search = config.clue_noise + side / 2 + (config.pad_circle if moves else 0.0)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the pads in the worlds of `mask` (W,)."""
        for w in np.flatnonzero(mask).tolist():
            self._tracks[w] = [PadTracks(*self._motion) for _ in self._tracks[w]]
        self._start[mask] = np.nan
        self._ground[mask] = np.inf
        # Drones search in different orders
        self._leg[mask] = np.arange(self.aviary.num_drones) % 3

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities of the search or of the approach; see `Policy.act`."""
        aviary = self.aviary
        blocks = aviary.observer.split(observations)
        velocity = np.zeros((*aviary.alive.shape, 3))
        for w, i in np.argwhere(aviary.alive).tolist():
            own = {name: np.asarray(blocks[name][w, i], dtype=float) for name in NEEDED}
            picture = observations["depth"][w, i] if isinstance(observations, dict) else NO_PICTURE
            velocity[w, i] = self._fly(w, i, _read(own), picture)
        return self.encoded(limit_norm(velocity, aviary.options.max_speed))

    def _fly(self, w: int, i: int, sight: _Sight, picture: np.ndarray) -> np.ndarray:
        """Return the velocity (3,) of drone i of world w, m/s."""
        if np.isnan(self._start[w, i, 0]):
            self._start[w, i] = sight.place
        steps, tracks = int(self.aviary.steps[w]), self._tracks[w][i]
        now = steps / self.aviary.options.decision_hz
        place = tracks.predict(now)
        distance = np.sqrt(((place - sight.place) ** 2).sum(axis=1))
        every = self._every if distance.min(initial=np.inf) < NEAR else self._far_every
        if steps % every == 0:
            tracks.update(self._look(w, i, sight, picture), sight.place, now)
        place = tracks.predict(now)
        ahead = tracks.velocity_at(np.array([now + LEAD]))
        gap = np.sqrt(((place[:, None] - sight.claimed) ** 2).sum(axis=-1))
        free = gap.min(axis=1, initial=np.inf) > CLAIM
        chosen = -1
        if free.any():
            drones = np.concatenate([sight.place[None], sight.others])
            chosen = int(match_pads(drones, place[free])[0])
        if chosen < 0:
            wanted = self._wander(w, i, sight)
        else:
            highest = float(max(place[:, 2].max(), self._start[w, i, 2]))
            if len(place) < self._task.pads.count:
                # The camera does not show pads at the height of the drone
                highest = max(highest, self._ground[w, i] + self._task.config.pad_height[1])
            target = PadTarget(
                place[free][chosen, None],
                ahead,
                np.array([highest + CRUISE_MARGIN]),
            )
            wanted = approach_pads(sight.place[None], target)[0]
        push: np.ndarray = wanted + keep_apart(sight.place[None], sight.others[None])[0]
        return push

    def _wander(self, w: int, i: int, sight: _Sight) -> np.ndarray:
        """Return the velocity (3,) of the search, m/s."""
        point = np.zeros(3)
        point[:2] = self._search * PATTERN[self._leg[w, i] % len(PATTERN)]
        ground = self._ground[w, i]
        highest = self._task.config.pad_height[1] + SEARCH_MARGIN
        point[2] = ground + highest if np.isfinite(ground) else sight.place[2] + SEARCH_MARGIN
        offset = point - sight.place
        if offset[0] ** 2 + offset[1] ** 2 < ARRIVED**2:
            self._leg[w, i] += 1
        velocity: np.ndarray = SEARCH_GAIN * offset
        # Climb from the platform before flying on
        if sight.place[2] < self._start[w, i, 2] + CRUISE_MARGIN and offset[2] > 0:
            velocity[:2] *= 0.2
        return velocity

    def _look(self, w: int, i: int, sight: _Sight, picture: np.ndarray) -> np.ndarray:
        """Return the pads (M, 3) in a picture, relative to the clue, m."""
        mount = self._mount
        base = sight.attitude
        if mount.stabilized:
            base = from_euler(0.0, 0.0, heading(base))
        frame = np.array(axes(product(base, mount.quaternion)))
        radius = self._task.context.collision_radius
        offset = np.array((radius, 0.0, 0.0) if mount.offset is None else mount.offset)
        eye = sight.place + offset @ np.array(axes(sight.attitude))
        depth = picture.astype(float)
        points = eye + (depth[..., None] * self._rays) @ frame
        is_seen = depth < MAX_RANGE
        if is_seen.any():
            lowest = float(np.percentile(points[is_seen, 2], 2))
            self._ground[w, i] = min(self._ground[w, i], lowest)
        is_pad = is_seen & (points[..., 2] > self._ground[w, i] + MIN_HEIGHT)
        is_pad &= points[..., 0] > self._start[w, i, 0] + CLEAR
        for other in sight.others:
            is_pad &= ((points - other) ** 2).sum(axis=-1) > DRONE**2
        return find_pads(points, is_pad, self._task.config.pad_tilt)


@register("policy")
class PadBlind(PadSeeker):
    """The flight of `pad_seeker` without pictures: down at the clue, whatever is there."""

    name = "pad_blind"
    looks = False

    def _look(self, w: int, i: int, sight: _Sight, picture: np.ndarray) -> np.ndarray:
        """Take the clue for a pad, and places next to it for those of other drones."""
        self._ground[w, i] = -self._task.config.pad_height[1]
        aside = np.zeros((self.aviary.num_drones, 3))
        aside[:, 1] = self._task.config.pad_spacing * np.arange(len(aside))
        return aside


def _read(own: dict[str, np.ndarray]) -> _Sight:
    """Convert the blocks of one drone."""
    place = -own["pad_clue"]
    neighbours = own["neighbours"].reshape(-1, 7)
    neighbours = neighbours[neighbours[:, 0] > 0]
    claims = own["claimed_pads"].reshape(-1, PER_PAD)
    claims = claims[claims[:, 3] > 0]
    x, y, z, w = own["attitude"].tolist()
    return _Sight(
        place,
        (x, y, z, w),
        own["velocity"],
        place + neighbours[:, 1:4],
        place + claims[:, :3],
    )
