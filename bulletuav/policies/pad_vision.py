"""Landing pads in depth pictures, and their tracks."""

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.tasks.parts.pads import PAD_RADIUS

MIN_PIXELS = 4
"""Minimum number of pixels of a pad"""
MAX_PADS = 64
"""Maximum number of pads in a picture"""
REACH = 1.3
"""Horizontal distance within which pixels belong to one pad, m: a diameter, less than the gaps"""
DIRECTIONS = 16
"""Number of directions in which the edge of a pad is found"""
TOP = 0.12
"""Depth of the pixels below the highest ones that belong to the top, m; rocking adds to it"""


def picture_rays(size: tuple[int, int], fov: float) -> np.ndarray:
    """Return the rays of pixels in the axes of a camera, for a depth of 1 m: forward, left, up.

    Args:
        size: Width and height, pixels.
        fov: Vertical field of view, rad.

    Returns:
        (height, width, 3) m; rays go through the upper left corners of pixels, as in `Camera`.
    """
    width, height = size
    tangent = float(sin(fov / 2) / cos(fov / 2))
    rays = np.ones((height, width, 3))
    rays[..., 1] = tangent * width / height * (1 - 2 * np.arange(width) / width)
    rays[..., 2] = tangent * (1 - 2 * (np.arange(height)[:, None] + 1) / height)
    return rays


def find_pads(points: np.ndarray, is_candidate: np.ndarray, tilt: float) -> np.ndarray:
    """Find the centres of the tops of pads in a picture.

    The centre is the point that is one radius from the edge in all directions in which the edge is
    in the picture.

    Args:
        points: (height, width, 3) points of the picture, world axes, m.
        is_candidate: (height, width) bool, pixels that may belong to pads.
        tilt: Maximum tilt of pads, rad.

    Returns:
        (M, 3) centres, m.
    """
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    direction = np.stack([cos(angle), sin(angle)])
    height, width = is_candidate.shape
    row, column = np.nonzero(is_candidate)
    place = points[row, column]
    is_inside = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    found: list[np.ndarray] = []
    left = np.arange(len(place))
    while len(left) >= MIN_PIXELS and len(found) < MAX_PADS:
        seed = place[left[place[left, 2].argmax()]]
        near = ((place[left, :2] - seed[:2]) ** 2).sum(axis=1) < REACH**2
        group, left = left[near], left[~near]
        if len(group) < MIN_PIXELS:
            continue
        top = group[place[group, 2] >= seed[2] - TOP - 2 * PAD_RADIUS * float(sin(tilt))]
        extent = place[top, :2] @ direction
        last = extent.argmax(axis=0)
        seen = is_inside[top[last]]
        if seen.sum() < DIRECTIONS // 4:
            continue
        edge = extent.max(axis=0)[seen] - PAD_RADIUS
        axes = direction[:, seen]
        across = axes @ axes.T
        if across[0, 0] * across[1, 1] - across[0, 1] ** 2 < 0.1:
            continue
        centre = np.linalg.solve(across, axes @ edge)
        found.append(np.append(centre, np.median(place[top, 2])))
    return np.array(found).reshape(-1, 3)


class PadTracks:
    """Tracks of the pads that one drone has seen, at most K; pads move together on circles.

    Attributes:
        place: (K, 3) m, at `time`.
        time: (K,) time of the last sight, s.
        velocity: (2,) velocity of all pads at `now`, east and north, m/s.
        turn_rate: Rate at which it turns, rad/s.
        now: Time of the last update, s.
    """

    ALPHA, BETA = 0.5, 0.3
    """Gains of positions, and of the velocity"""
    SHARP = 4.0
    """Distance up to which these gains apply, m; beyond it that of the velocity falls"""
    GATE = 1.5
    """Maximum distance of a pad from its predicted place, m: nearer tracks are one"""
    MAX_AGE = 6.0
    """Time after which a moving pad that is not seen is forgotten, s"""
    MEMORY = 1.0
    """Time constant of the mean velocity, from which the sense of rotation follows, s"""

    def __init__(self, speed: float, turn_rate: float) -> None:
        """Start without tracks.

        Args:
            speed: Speed of the pads, m/s.
            turn_rate: Rate at which their velocity turns to the left or to the right, rad/s.
        """
        self._speed, self._rate = speed, turn_rate
        self.place, self.time = np.zeros((0, 3)), np.zeros(0)
        self.velocity, self._mean = np.zeros((2, 2))
        self.turn_rate, self._sense, self.now = 0.0, 0.0, 0.0

    def velocity_at(self, time: np.ndarray) -> np.ndarray:
        """Return the velocities (..., 3) of pads at times (...), s."""
        angle = self.turn_rate * (time - self.now)
        x, y = self.velocity
        c, s = cos(angle), sin(angle)
        return np.stack([c * x - s * y, s * x + c * y, np.zeros(np.shape(time))], axis=-1)

    def predict(self, time: float) -> np.ndarray:
        """Return the places (K, 3) at a time, s: moved at the velocities half of the way, m."""
        lapse = (time - self.time)[:, None]
        moved: np.ndarray = self.place + lapse * self.velocity_at((self.time + time) / 2)
        return moved

    def update(self, found: np.ndarray, own: np.ndarray, time: float) -> None:
        """Update tracks by the pads (M, 3), m, found from a place (3,), m, at a time, s."""
        place, changes = self.predict(time), []
        for pad in found:
            distance = np.sqrt(((pad - place) ** 2).sum(axis=1))
            k = int(distance.argmin()) if len(distance) else -1
            if k < 0 or distance[k] > self.GATE:
                self.place = np.concatenate([self.place, pad[None]])
                self.time = np.append(self.time, time)
                place = np.concatenate([place, pad[None]])
                continue
            error = pad - place[k]
            lapse = time - float(self.time[k])
            if 0.0 < lapse < self.MEMORY:
                far = np.sqrt(((pad - own) ** 2).sum())
                changes.append(self.BETA * min(1.0, self.SHARP / far) / max(lapse, 0.1) * error[:2])
            self.place[k] = place[k] = place[k] + self.ALPHA * error
            self.time[k] = time
        if self._speed:
            self._turn(np.mean(changes, axis=0) if changes else np.zeros(2), time)
            self.keep(time - self.time < self.MAX_AGE)
        self.now = time

    def _turn(self, change: np.ndarray, time: float) -> None:
        """Update the velocity, which has the speed of the pads at most, and how it turns."""
        velocity = self.velocity_at(np.array(time))[:2] + change
        speed = np.sqrt((velocity**2).sum())
        self.velocity = velocity * min(1.0, self._speed / max(speed, 1e-9))
        lapse = min((time - self.now) / self.MEMORY, 1.0)
        self._mean = self._mean + lapse * (self.velocity - self._mean)
        x, y = self._mean
        # Ahead of its mean by the angle of a time constant
        ahead = float(x * self.velocity[1] - y * self.velocity[0]) / self._speed**2
        expected = max(min(self._rate * self.MEMORY, 1.0), 1e-9)
        self._sense += lapse * (min(max(ahead / expected, -1.0), 1.0) - self._sense)
        self.turn_rate = self._rate * self._sense

    def keep(self, which: np.ndarray) -> None:
        """Drop all tracks but those of a mask (K,)."""
        self.place, self.time = self.place[which], self.time[which]
