"""Downward optical flow sensor and range finder, as on the Flow deck of a Crazyflie."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, exp, hypot
from bulletuav.compiled.kernel import func, kernel
from bulletuav.engine.engine import Engine
from bulletuav.errors import finite
from bulletuav.geometry.rotation import Vec3Like, axes, quat4, to_body, vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm, get_state

MIN_DISTANCE, DEFAULT_MAX_FLOW = 0.08, 7.4
"""m, rad/s; minimum distance and maximum flow of a PMW3901 (PixArt's datasheet, as in PX4)"""
DEFAULT_MAX_DISTANCE = 4.0
"""m; range of a VL53L1x (ST's datasheet)"""
DEFAULT_MAX_TILT = 45.0
"""deg; maximum tilt at which PX4 uses range finders and flow (`range_cos_max_tilt`)"""
NOISE = 0.09
"""rad/s; over good ground at 100 Hz: 0.43 counts, each of 0.1 of 35 pixels in 0.717 rad

Source: Crazyflie firmware, flowdeck_v1v2.c (fitted to flights) and mm_flow.c.
"""
RANGE_NOISE = 0.0025
"""m; near the ground, see `range_deviation`"""
LOG_80 = 4.382026634673881
MAX_DISTANCE, MAX_FLOW = 1000.0, 1000.0
"""m, rad/s; upper bounds of the limits"""


@func
def angular_flow(velocity: Vec3Like, rates: Vec3Like, distance: float) -> tuple[float, float]:
    """Compute the optical flow at the centre of a downward image.

    The flow is the angular velocity at which a purely rotating drone would see the same image
    motion.

    Args:
        velocity: Velocity above the ground, m/s, body axes.
        rates: Angular velocity, rad/s, body axes.
        distance: Distance of the ground along the body's -z axis, m.

    Returns:
        Flow about the body's x and y axes, rad/s: right-handed rotations are positive, flight to
        the left is positive about x, and forward flight is negative about y.

    References:
        D. Honegger et al., An open source and open hardware embedded metric optical flow CMOS
        camera (ICRA 2013); mm_flow.c of the Crazyflie's firmware. Signs are those of MAVLink's
        OPTICAL_FLOW_RAD, in axes forward, left, up.
    """
    return rates[0] + velocity[1] / distance, rates[1] - velocity[0] / distance


def range_deviation(distance: np.ndarray, reach: float) -> np.ndarray:
    """Return the noise factor of a range finder, which grows towards the end of its range.

    Args:
        distance: Distances, m, of any shape.
        reach: Maximum range, m.

    Returns:
        Factors on the noise near the ground: 2 at 5/8 of the range, and 81 at its end.

    References:
        zranger2.c of the Crazyflie's firmware, for a range of 4 m.
    """
    return 1.0 + exp(LOG_80 * (distance / reach - 0.625) / 0.375)


@kernel
def _look_down(
    swarm: Swarm,
    mask: np.ndarray,
    reach: float,
    start: np.ndarray,
    end: np.ndarray,
    world: np.ndarray,
) -> None:
    """Write the rays (M, 3) of the drones in `mask` (W, N), along their -z axes."""
    m = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            # The sensor is fixed to the body, so it tilts with the drone
            up = axes(quat4(swarm.quaternion, w, i))[2]
            position = vec3(swarm.position, w, i)
            for k in range(3):
                start[m, k] = position[k]
                end[m, k] = position[k] - reach * up[k]
            world[m] = w
            m += 1


@kernel
def _measure(
    swarm: Swarm,
    mask: np.ndarray,
    distance: np.ndarray,
    limits: tuple[float, float, float, float],
    error: np.ndarray,
    fails: np.ndarray,
    flow: np.ndarray,
) -> None:
    """Measure flow and quality (W, N, 3) of the drones in `mask`.

    `distance` (W, N) is the distance of the ground, `error` (W, N, 2) is added, and `fails` (W, N)
    marks drones without visual features. See `OpticalFlow` for the limits.
    """
    nearest, farthest, fastest, upright = limits
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            for k in range(3):
                flow[w, i, k] = 0.0
            # Is the ground visible and within range?
            _, quaternion, velocity, rates = get_state(swarm, w, i)
            far = distance[w, i]
            if fails[w, i] or far < nearest or far >= farthest:
                continue
            if axes(quaternion)[2][2] < upright:
                continue
            # Is the flow within the limit?
            true = angular_flow(to_body(quaternion, velocity), rates, far)
            if hypot(true[0], true[1]) > fastest:
                continue
            for k in range(2):
                flow[w, i, k] = min(max(true[k] + error[w, i, k], -fastest), fastest)
            flow[w, i, 2] = 1.0


@register("sensor")
class OpticalFlow(Sensor):
    """Optical flow of the ground and its distance, both along the body's -z axis.

    The reading "optical_flow" contains the instantaneous flow about the body's x and y axes, rad/s,
    see `angular_flow`, and its quality. The quality is 1, or 0 if flow cannot be measured, in which
    case the flow is 0: the ground is too near or out of range, the flow is too fast, or the drone
    is too tilted. The reading "ground_distance" is the range, m; `max_distance` if nothing is in
    range.

    Both use one ray from the centre of the drone, which hits the ground, buildings, obstacles and
    other drones, as those of the range finder `lidar`. Hit objects are assumed to be static.
    `Imperfect(OpticalFlow(), rate=100)` has the sample rate of a Flow deck.

    Attributes:
        noise: (W, N) standard deviation of each axis of the flow, rad/s.
        range_noise: (W, N) standard deviation of a distance near the ground, m; it grows with the
            distance, see `range_deviation`.
        dropout: (W, N) probability that there are no visual features, as above smooth or dark
            floors.
    """

    name = "optical_flow"
    gives = ("optical_flow", "ground_distance")
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 1000.0, usual=NOISE),
        "range_noise": Uncertain(0.0, 1000.0, usual=RANGE_NOISE),
        "dropout": Uncertain(0.0, 1.0),
    }

    noise: np.ndarray
    range_noise: np.ndarray
    dropout: np.ndarray

    def __init__(
        self,
        min_distance: float = MIN_DISTANCE,
        max_distance: float = DEFAULT_MAX_DISTANCE,
        max_flow: float = DEFAULT_MAX_FLOW,
        max_tilt: float = DEFAULT_MAX_TILT,
    ) -> None:
        """Set the limits of the sensor.

        Args:
            min_distance: Minimum ground distance for flow, m.
            max_distance: Maximum range, m.
            max_flow: Maximum flow about any horizontal axis, rad/s.
            max_tilt: Maximum angle between the body's z axis and the vertical, deg.

        Raises:
            ValueError: If a limit is not finite or out of bounds, or min_distance is not below
                max_distance.
        """
        self._nearest = finite("min_distance", min_distance, 1e-3, MAX_DISTANCE)
        self._reach = finite("max_distance", max_distance, 1e-3, MAX_DISTANCE)
        self._fastest = finite("max_flow", max_flow, 1e-3, MAX_FLOW)
        self._tilt = finite("max_tilt", max_tilt, 0.0, 90.0)
        if self._nearest >= self._reach:
            raise ValueError(
                f"min_distance is {self._nearest:g} and max_distance {self._reach:g}: "
                f"a greater max_distance is needed"
            )

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels and bounds of flow, quality and distance."""
        bound = self._fastest
        flow = [Label(f"flow {axis}", "rad/s", -bound, bound) for axis in "xy"]
        return {
            "optical_flow": (*flow, Label("flow quality", "1", 0.0, 1.0)),
            "ground_distance": (Label("ground distance", "m", 0.0, self._reach),),
        }

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings."""
        super().attach(setup, engine)
        upright = float(cos(np.radians(self._tilt)))
        self._limits = (self._nearest, self._reach, self._fastest, upright)
        self._flow = np.zeros((*setup.shape, 3))
        self._distance = np.full(setup.shape, self._reach)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure flow and distance for the drones in the mask; other readings do not change.

        Drones outside the mask are not hit by rays. Each world draws from its own generator if its
        noise or dropout is above 0.
        """
        swarm, mask = moment.after, moment.mask
        scales = (self.noise, self.range_noise, self.dropout)
        uncertain = np.any([scale > 0 for scale in scales], axis=(0, 2))
        normal, chance = moment._replace(mask=mask & uncertain[:, None]).draw(3)
        true = self._true_distance(swarm, mask)
        fails = chance < self.dropout
        error = self.noise[..., None] * normal[..., :2]
        _measure(swarm, mask, true, self._limits, error, fails, self._flow)
        deviation = self.range_noise * range_deviation(true, self._reach)
        measured = np.clip(true + deviation * normal[..., 2], 0.0, self._reach)
        np.copyto(self._distance, np.where(true < self._reach, measured, true), where=mask)
        return {"optical_flow": self._flow.copy(), "ground_distance": self._distance.copy()}

    def _true_distance(self, swarm: Swarm, mask: np.ndarray) -> np.ndarray:
        """Return the distance (W, N) below the drones in `mask`, at most the range, m."""
        count = np.count_nonzero(mask)
        start, end, world = np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.int64)
        _look_down(swarm, mask, self._reach, start, end, world)
        distance = np.full(mask.shape, self._reach)
        distance[mask] = self._reach * self.engine.cast_rays(start, end, world, (swarm, mask))
        return distance
