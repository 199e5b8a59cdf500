"""Track of a target: estimate of its position and velocity from the drones' detections."""

import math
from collections.abc import Mapping

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import kernel
from bulletuav.tasks.frame import Frame, TaskContext
from bulletuav.tasks.parts.base import Part, Rngs

ACCELERATION = 2.0
"""Spectral density of the target's acceleration, as its standard deviation after 1 s, m/s"""
RELATIVE_NOISE, MIN_NOISE = 0.02, 0.05
"""Assumed standard deviation of a detection, as a fraction of its distance, and at least, m"""
FIRST_SPEED = 3.0
"""Standard deviation of the target's velocity before the first detection, m/s"""
COASTING = 4.0
"""Time constant with which the estimated velocity vanishes without detections, s"""


class TargetTrack(Part):
    """Track that the drones of a world share, from the reading "detection" of the first target.

    A Kalman filter with a constant velocity model (white noise acceleration), equal for the three
    axes. In each decision it uses the detection of the nearest drone that detects the target.
    Without detections the estimated velocity decays.

    The memory of each world is "track" (6,), estimated position, m, and velocity, m/s;
    "track_variance" (3,), variance of position, m^2, covariance, m^2/s, and variance of velocity,
    m^2/s^2; "track_detected" (), 1 if the target is detected now; and "track_age" (), time since
    the last detection or the start, s. The start sets position and variance (`start`).

    References:
        Y. Bar-Shalom, X. Li, T. Kirubarajan, Estimation with applications to tracking and
        navigation (2001), sections 5.2 and 6.2.2.
    """

    def __init__(self, context: TaskContext) -> None:
        """Set the time between decisions.

        Args:
            context: Swarm and time between decisions.
        """
        self._period = context.period

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the arrays; see the class."""
        return {"track": (6,), "track_variance": (3,), "track_detected": (), "track_age": ()}

    @staticmethod
    def start(position: np.ndarray, deviation: float) -> dict[str, np.ndarray]:
        """Return the memory of a track that starts without a detection.

        Args:
            position: (3,) supposed position, m.
            deviation: Standard deviation of this position on each axis, m.
        """
        return {
            "track": np.concatenate([position, np.zeros(3)]),
            "track_variance": np.array([deviation**2, 0.0, FIRST_SPEED**2]),
        }

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Predict the tracks, and correct them by the detections of the decision."""
        flying: np.ndarray = np.any(frame.alive, axis=1)
        self._update(frame, np.where(flying, self._period, 0.0), flying, frame.alive)

    def first_update(self, frame: Frame) -> None:
        """Correct the tracks of worlds that were reset by the first detections."""
        everyone = np.ones(frame.alive.shape, dtype=bool)
        self._update(frame, np.zeros(len(frame.time)), np.equal(frame.time, 0.0), everyone)

    def _update(self, frame: Frame, dt: np.ndarray, where: np.ndarray, drones: np.ndarray) -> None:
        memory = frame.scene.memory
        update_tracks(
            dt,
            where,
            frame.readings["detection"],
            frame.known_position,
            drones,
            memory["track"],
            memory["track_variance"],
            memory["track_detected"],
            memory["track_age"],
        )


@kernel
def update_tracks(
    dt: np.ndarray,
    where: np.ndarray,
    detection: np.ndarray,
    position: np.ndarray,
    alive: np.ndarray,
    track: np.ndarray,
    variance: np.ndarray,
    detected: np.ndarray,
    age: np.ndarray,
) -> None:
    """Predict and correct the tracks of worlds; see `TargetTrack`.

    Args:
        dt: (W,) time since the last update, s.
        where: (W,) bool, worlds to update.
        detection: (W, N, 4 or more) whether a drone detects the target, and its offset, m.
        position: (W, N, 3) positions of the drones as they measure them, m.
        alive: (W, N) bool, drones whose detections count.
        track: (W, 6) position, m, and velocity, m/s; updated.
        variance: (W, 3) variance of position, covariance, variance of velocity; updated.
        detected: (W,) 1 if the target is detected; written.
        age: (W,) time since the last detection, s; updated.
    """
    for w in range(where.size):
        if not where[w]:
            continue
        # Prediction, with the process noise of white acceleration
        step = dt[w]
        density = ACCELERATION * ACCELERATION
        fade = exp(-step / COASTING) if detected[w] == 0.0 else 1.0
        for k in range(3):
            track[w, k] += step * track[w, 3 + k]
            track[w, 3 + k] *= fade
        place, cross, speed = variance[w, 0], variance[w, 1], variance[w, 2]
        place += 2.0 * step * cross + step * step * speed + density * step**3 / 3.0
        cross += step * speed + density * step * step / 2.0
        speed += density * step
        # The nearest detection is the most precise
        nearest, best = np.inf, -1
        for i in range(alive.shape[1]):
            if alive[w, i] and detection[w, i, 0] > 0.0:
                square = 0.0
                for k in range(3):
                    square += detection[w, i, 1 + k] ** 2
                if square < nearest:
                    nearest, best = square, i
        age[w] += step
        detected[w] = 0.0
        if best >= 0:
            detected[w] = 1.0
            age[w] = 0.0
            noise = max(RELATIVE_NOISE * math.sqrt(nearest), MIN_NOISE)
            total = place + noise * noise
            gain, gain_speed = place / total, cross / total
            for k in range(3):
                error = position[w, best, k] + detection[w, best, 1 + k] - track[w, k]
                track[w, k] += gain * error
                track[w, 3 + k] += gain_speed * error
            speed -= gain_speed * cross
            cross *= 1.0 - gain
            place *= 1.0 - gain
        variance[w, 0], variance[w, 1], variance[w, 2] = place, cross, speed
