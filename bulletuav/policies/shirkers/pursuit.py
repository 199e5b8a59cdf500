"""Shirkers of `pursuit`: they try to be paid without overtaking, or without flying the laps."""

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.policies.circular_track import TrackPolicy
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

ORBIT_FRACTION = 0.25
"""Radius of the inner orbit as a fraction of that of the track"""
CUT_FRACTION = 0.8
"""Radius of the shortcut as a fraction of that of the track"""
INNER_LANES = (16.0, 10.0)
"""Distances of lanes inside the track, m"""
LANE_HEIGHTS = (-9.5, -3.2, 3.2, 9.5)
"""Heights of lanes above the track, m"""
STOP_FRACTION = 0.85
"""Fraction of the laps after which a drone stops"""
FINAL_DISTANCE = 10.0
"""Distance to the end of the laps at which a drone waits, m"""
QUEUE_MARGIN = 3.0
"""Distance between drones in a queue beyond d_safe, and from the slack, m"""
GOAL_GAIN = 1.0
"""Gain from the distance to a moving goal to the speed, 1/s"""


@register("policy")
class PursuitConvoy(TrackPolicy):
    """Fly around the track at the mean of all cruising speeds, so that no drone overtakes."""

    name = "pursuit_convoy"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        return self.around(swarm, self.cruising_speed.mean(axis=1, keepdims=True))


@register("policy")
class PursuitSlowConvoy(TrackPolicy):
    """Fly around the track at the lowest cruising speed, so that no drone overtakes."""

    name = "pursuit_slow_convoy"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        return self.around(swarm, self.cruising_speed.min(axis=1, keepdims=True))


@register("policy")
class PursuitFastConvoy(TrackPolicy):
    """Fly around the track at the highest cruising speed, so that no drone overtakes."""

    name = "pursuit_fast_convoy"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        return self.around(swarm, self.cruising_speed.max(axis=1, keepdims=True))


@register("policy")
class PursuitQueue(TrackPolicy):
    """Keep the order of the start: lead the goal by up to the slack, behind the drone ahead."""

    name = "pursuit_queue"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to places in the queue on the track; see `Scripted.velocities`."""
        config, aviary = self.task.config, self.aviary
        gap = config.d_safe + QUEUE_MARGIN
        start = -config.spacing * np.arange(aviary.num_drones)
        place = start + self.flown + config.slack - QUEUE_MARGIN
        place = np.where(aviary.alive, place, np.inf)
        # Each drone stays behind all drones ahead that still fly
        limit = np.minimum.accumulate(place + gap * np.arange(aviary.num_drones), axis=1)
        place = np.where(aviary.alive, limit - gap * np.arange(aviary.num_drones), 0.0)
        angle = -place / config.radius
        target = np.stack(
            [
                config.radius * cos(angle),
                config.radius * sin(angle),
                np.full_like(angle, config.altitude),
            ],
            axis=-1,
        )
        velocity: np.ndarray = GOAL_GAIN * (target - swarm.position) + aviary.scene.goal_velocity
        return velocity


@register("policy")
class PursuitSprintAndWait(TrackPolicy):
    """Fly in convoy at full speed, and wait before the end of the laps until they are due."""

    name = "pursuit_sprint_and_wait"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the end of the laps; see `Scripted.velocities`."""
        speed = self.aviary.options.max_speed
        time = self.aviary.steps[:, None] * self.task.context.period
        waits = speed * time > self.task.track_length - FINAL_DISTANCE
        is_due = self.flown >= self.task.track_length - FINAL_DISTANCE
        return self.around(swarm, np.where(waits & ~is_due, 0.0, speed))


@register("policy")
class PursuitWaitAndSprint(TrackPolicy):
    """Stay at the start until full speed is needed to complete the laps in time."""

    name = "pursuit_wait_and_sprint"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        speed, track = self.aviary.options.max_speed, self.task.track_length
        time = self.aviary.steps[:, None] * self.task.context.period
        # The time left until the end of the laps is that which they take at full speed
        is_due = track - self.cruising_speed * time <= track * self.cruising_speed / speed
        return self.around(swarm, np.where(is_due, speed, 0.0))


@register("policy")
class PursuitStop(TrackPolicy):
    """Fly in convoy at the mean of all cruising speeds, and stop after 0.85 of the laps."""

    name = "pursuit_stop"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        speed = self.cruising_speed.mean(axis=1, keepdims=True)
        stops = self.flown > STOP_FRACTION * self.task.track_length
        return self.around(swarm, np.where(stops, 0.0, speed))


@register("policy")
class PursuitShortcut(TrackPolicy):
    """Fly around inside the track, each drone at its cruising speed, for a shorter lap."""

    name = "pursuit_shortcut"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along an inner circle; see `Scripted.velocities`."""
        aside = (CUT_FRACTION - 1) * self.task.config.radius
        return self.around(swarm, self.cruising_speed, aside)


@register("policy")
class PursuitInnerLanes(TrackPolicy):
    """Fly in eight lanes far inside the track, for shorter laps without overtaking in any lane."""

    name = "pursuit_inner_lanes"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the lanes, next to the goals; see `Scripted.velocities`."""
        scene, radius = self.aviary.scene, self.task.config.radius
        index = np.arange(self.aviary.num_drones)
        inside = np.array(INNER_LANES)[index // len(LANE_HEIGHTS) % len(INNER_LANES)]
        scale = 1 - inside[:, None] / radius
        height = np.array(LANE_HEIGHTS)[index % len(LANE_HEIGHTS), None] * (0.0, 0.0, 1.0)
        place = scene.goal * (scale * (1.0, 1.0, 0.0) + (0.0, 0.0, 1.0)) + height
        velocity: np.ndarray = GOAL_GAIN * (place - swarm.position) + scale * scene.goal_velocity
        return velocity


@register("policy")
class PursuitOrbit(TrackPolicy):
    """Fly laps on a small circle around the centre at the angular speed of the goals."""

    name = "pursuit_orbit"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along a small circle; see `Scripted.velocities`."""
        aside = (ORBIT_FRACTION - 1) * self.task.config.radius
        return self.around(swarm, ORBIT_FRACTION * self.cruising_speed, aside)


@register("policy")
class PursuitClimb(TrackPolicy):
    """Follow the goals near the ceiling, far above the track."""

    name = "pursuit_climb"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to points above the goals; see `Scripted.velocities`."""
        scene, margin = self.aviary.scene, self.task.config.margin
        place = scene.goal + np.array((0.0, 0.0, margin - 1.0))
        velocity: np.ndarray = GOAL_GAIN * (place - swarm.position) + scene.goal_velocity
        return velocity


@register("policy")
class PursuitBackwards(TrackPolicy):
    """Fly around the track counterclockwise, each drone at its cruising speed."""

    name = "pursuit_backwards"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities along the track; see `Scripted.velocities`."""
        return self.around(swarm, -self.cruising_speed)
