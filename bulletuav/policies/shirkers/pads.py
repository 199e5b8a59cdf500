"""Policies that avoid the task `pad_landing`: they fly as `pad_pilot` does but for the landing."""

from abc import abstractmethod

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.policies.oracles.pads import PadPilot
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

ABOVE = 0.5
"""Horizontal distance from the pad within which policies change the flight, m"""
HOVER_HEIGHT, GAIN = 0.3, 1.5
"""Height of hovering above pads, m, and gain from height to speed, 1/s"""
ASIDE = 1.5
"""Distance to the west of the pad at which drones land on the ground, m"""
DROP_HEIGHT = 3.0
"""Height above pads below which drones fall onto them, m"""
CLIMB = 0.5
"""Height above the start to which drones that wait climb first, m"""
LATE = 2.0
"""Time that drones which land late leave for it, by the time of a flight across the arena"""
TOUCH_TIME = 0.3
"""Time of contact after which drones that only touch pads leave them, s"""


class _ChangedLanding(PadPilot):
    """Base class of policies that change the last part of the flight to a pad."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the changed velocities; see `Policy.act`."""
        velocity, offset = self.plan(swarm)
        velocity = self.change(velocity, offset)
        return self.encoded(limit_norm(velocity, self.aviary.options.max_speed))

    @abstractmethod
    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the changed velocities (W, N, 3), m/s.

        Args:
            velocity: (W, N, 3) velocities of `pad_pilot`, m/s.
            offset: (W, N, 3) offsets to the tops of the pads, m.
        """


def _is_above(offset: np.ndarray) -> np.ndarray:
    """Return which drones are above their pads, (W, N) bool, by offsets (W, N, 3), m."""
    is_above: np.ndarray = (offset[..., :2] ** 2).sum(axis=-1) < ABOVE**2
    return is_above


@register("policy")
class PadHover(_ChangedLanding):
    """Hover above a pad without landing."""

    name = "pad_hover"

    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Hold the height above the pad; see `_ChangedLanding.change`."""
        hover = GAIN * (HOVER_HEIGHT + offset[..., 2])
        velocity[..., 2] = np.where(_is_above(offset), hover, velocity[..., 2])
        return velocity


@register("policy")
class PadGround(_ChangedLanding):
    """Land on the ground next to a pad."""

    name = "pad_ground"

    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Fly to the west of the pad and descend; see `_ChangedLanding.change`."""
        west = offset - (ASIDE, 0.0, 0.0)
        distance = np.sqrt((offset[..., :2] ** 2).sum(axis=-1))
        is_near = distance < 2 * ASIDE
        velocity[is_near, :2] = GAIN * west[is_near, :2]
        down = np.where(_is_above(west), -0.5, GAIN * (1.0 + offset[..., 2]))
        velocity[..., 2] = np.where(is_near, down, velocity[..., 2])
        return velocity


@register("policy")
class PadDrop(_ChangedLanding):
    """Fall onto a pad at full speed."""

    name = "pad_drop"

    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Climb on the way, and dive above the pad; see `_ChangedLanding.change`."""
        dives = _is_above(offset)
        climb = GAIN * (DROP_HEIGHT + offset[..., 2])
        fall = np.where(dives, -self.aviary.options.max_speed, np.maximum(climb, velocity[..., 2]))
        velocity[..., 2] = fall
        return velocity


@register("policy")
class PadTouch(_ChangedLanding):
    """Touch a pad for less than the time of a landing, climb, and touch it again."""

    name = "pad_touch"
    remembers = ("_climbs",)

    def reset(self, mask: np.ndarray) -> None:
        """End the climbs in the worlds of `mask` (W,)."""
        if not hasattr(self, "_climbs"):
            self._climbs = np.zeros(self.aviary.alive.shape, dtype=bool)
        self._climbs[mask] = False

    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Climb after a short contact; see `_ChangedLanding.change`."""
        self._climbs |= self.aviary.scene.memory["stable_time"] > TOUCH_TIME
        self._climbs &= offset[..., 2] > -HOVER_HEIGHT
        velocity[..., 2] = np.where(self._climbs, 1.0, velocity[..., 2])
        return velocity


@register("policy")
class PadLate(_ChangedLanding):
    """Hover at the start, and land on a pad at the end of the episode."""

    name = "pad_late"

    def change(self, velocity: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Wait above the start; see `_ChangedLanding.change`."""
        options, position = self.aviary.options, self.aviary.swarm.position
        needed = LATE * float(self._task.arena_high[0]) / options.max_speed
        late = self.aviary.steps >= options.horizon - needed * options.decision_hz
        above = self.aviary.scene.start + np.array((0.0, 0.0, CLIMB))
        return np.where(late[:, None, None], velocity, GAIN * (above - position))


@register("policy")
class PadSame(PadPilot):
    """Land with all drones on the pad that is nearest to the first drone's start."""

    name = "pad_same"

    def choose(self, w: int, position: np.ndarray, pads: np.ndarray) -> np.ndarray:
        """Return the same pad for all drones, claimed or not; see `PadPilot.choose`."""
        places = self.aviary.scene.memory["pad_place"][w]
        distance = ((places - self.aviary.scene.start[w, 0]) ** 2).sum(axis=-1)
        return np.full(len(position), distance.argmin())
