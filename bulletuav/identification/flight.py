"""One log made ready: on one clock, at even times, smoothed, cut into windows."""

import math
from dataclasses import dataclass

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.identification.attitude import frame_of, rates_of, slope, smooth
from bulletuav.identification.logs import OTHER, POSITION, QUATERNION, RATES, VELOCITY, Log
from bulletuav.identification.rollout import Track
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.battery import battery_speed_ratio
from bulletuav.vehicle.rotors import RPM

FINEST = 0.005
"""Least time between samples, s: faster logs are thinned"""
POSITION_SPAN, ATTITUDE_SPAN, GYRO_SPAN = 0.21, 0.09, 0.09
"""Time over which positions, attitudes and rates are smoothed, s"""
DEGREES = (5, 5, 4)
"""Degrees of their polynomials"""
FARTHEST_CLOCK = 0.25
"""Greatest delay between gyroscope and attitude that is looked for, s"""
LEAST_GAIN = 0.1
"""Share by which another clock must lessen the squares of the gyroscope's errors"""
LEAST_THRUST = 0.3
"""Thrust in weights below which a drone does not fly"""
CLEARANCE = 0.008
"""Height above standing at which a drone flies, m"""
WARM_UP = 0.4
"""Time at both ends of a log that no window uses, s"""


@dataclass(frozen=True)
class Flight:
    """A log on the clock of its attitude.

    Attributes:
        log: The log.
        dt: Time between samples, s.
        track: What was measured, smoothed.
        gyro_delay: By how much the gyroscope lags behind the attitude, s; 0 without one.
        gyro_bias: (3,) what the gyroscope measures at rest, rad/s; taken off.
        windows: (K,) index of the sample at which each window starts.
        steps: Samples in a window.
    """

    log: Log
    dt: float
    track: Track
    gyro_delay: float
    gyro_bias: np.ndarray
    windows: np.ndarray
    steps: int

    @property
    def grid(self) -> np.ndarray:
        """Times of the samples (n,), s."""
        times: np.ndarray = self.log.time[0] + self.dt * np.arange(len(self.track.position))
        return times

    def commands(self, airframe: Airframe, delay: float) -> np.ndarray:
        """Return the rotor speeds that are commanded, averaged from each sample to the next.

        Args:
            airframe: Its PWM map and battery count for motor commands.
            delay: How late commands arrive, s.

        Returns:
            (n, R), rad/s.
        """
        time = self.log.time
        speeds = logged_speeds(self.log, airframe)
        # A command holds until the next: its integral is a broken line.
        held = np.diff(time)[:, None] * speeds[:-1]
        total = np.concatenate([np.zeros((1, speeds.shape[1])), np.cumsum(held, axis=0)])
        edges = np.append(self.grid, self.grid[-1] + self.dt) - delay
        ahead = np.maximum(time[0] - edges, 0.0)[:, None] * speeds[0]
        after = np.maximum(edges - time[-1], 0.0)[:, None] * speeds[-1]
        passed = np.stack([np.interp(edges, time, column) for column in total.T], axis=1)
        mean = np.diff(passed - ahead + after, axis=0) / self.dt
        commands: np.ndarray = np.maximum(mean, 0.0)
        return commands


@kernel
def _speed_shares(
    volts: np.ndarray,
    nominal: float,
    share: np.ndarray,
) -> None:
    """Fill in the share of a commanded speed that motors reach at voltages (n,)."""
    for k in range(volts.size):
        share[k] = battery_speed_ratio(volts[k], nominal)


def logged_speeds(log: Log, airframe: Airframe) -> np.ndarray:
    """Return the rotor speeds that a log's commands mean, (n, R), rad/s."""
    kind = log.kind
    commands = log.stack([f"{kind}{r + 1}" for r in range(len(airframe.rotors))])
    if kind == "w":
        return commands
    if kind == "rpm":
        return commands * RPM
    assert airframe.pwm is not None  # `checks` saw to it
    speeds = RPM * (airframe.pwm.slope * commands + airframe.pwm.intercept)
    if "vbat" in log and airframe.pack is not None:
        share = np.empty(len(commands))
        _speed_shares(log.columns["vbat"], airframe.pack.voltage, share)
        speeds = speeds * share[:, None]
    turning: np.ndarray = np.where(commands > 0, speeds, 0.0)
    return turning


def prepare(
    log: Log,
    airframe: Airframe,
    window: float,
) -> Flight:
    """Bring a log onto one clock, and cut it into windows.

    Args:
        log: A log that `checks.checked` has passed.
        airframe: The drone that flew.
        window: Duration of a window, s.

    Raises:
        ValueError: The drone does not fly in it.
    """
    time = log.time
    dt = max(float(np.median(np.diff(time))), FINEST)
    grid = time[0] + dt * np.arange(int((time[-1] - time[0]) / dt) + 1)
    position = smooth(_at(grid, log, POSITION), POSITION_SPAN, dt, DEGREES[0])
    quaternion = smooth(_at(grid, log, QUATERNION), ATTITUDE_SPAN, dt, DEGREES[1])
    quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
    turning = rates_of(grid, _at(grid, log, QUATERNION))
    delay, bias = 0.0, np.zeros(3)
    rates = turning
    if RATES[0] in log:
        delay, bias = _clock(grid, log, turning, dt)
        gyro = np.stack([np.interp(grid + delay, time, log.columns[name]) for name in RATES], 1)
        rates = smooth(gyro - bias, GYRO_SPAN, dt, DEGREES[2])
    if VELOCITY[0] in log:
        velocity = smooth(_at(grid, log, VELOCITY), GYRO_SPAN, dt, degree=2)
    else:
        velocity = slope(_at(grid, log, POSITION), POSITION_SPAN, dt, DEGREES[0])
    other = _at(grid, log, OTHER) if OTHER[0] in log else np.zeros((0, 3))
    track = Track(*map(np.ascontiguousarray, (position, quaternion, velocity, rates, other)))
    steps = max(round(window / dt), 4)
    starts = _windows(log, airframe, grid, position, steps)
    if not len(starts):
        stands = airframe.standing_height + CLEARANCE
        raise ValueError(
            f"{log.path}: there is no flight of {window:g} s: commands must carry at least "
            f"{LEAST_THRUST:g} weights, and z must be above {stands:.3g} m, where {airframe.name} "
            f"stands; its z goes from {position[:, 2].min():.3g} to {position[:, 2].max():.3g} m"
        )
    return Flight(log, dt, track, delay, bias, starts, steps)


def _at(
    grid: np.ndarray,
    log: Log,
    names: tuple[str, ...],
) -> np.ndarray:
    """Return columns at even times, (n, len(names))."""
    return np.stack([np.interp(grid, log.time, log.columns[name]) for name in names], axis=1)


def _clock(
    grid: np.ndarray,
    log: Log,
    turning: np.ndarray,
    dt: float,
) -> tuple[float, np.ndarray]:
    """Return by how much the gyroscope lags behind the attitude, s, and its bias (3,)."""
    inner = slice(frame_of(FARTHEST_CLOCK * 2, dt), -frame_of(FARTHEST_CLOCK * 2, dt))

    def compare(delay: float) -> tuple[float, np.ndarray]:
        gyro = np.stack([np.interp(grid + delay, log.time, log.columns[name]) for name in RATES], 1)
        # As smooth as the rates that it is compared with
        error = (smooth(gyro, 0.07, dt) - turning)[inner]
        bias = np.median(error, axis=0)
        return float(np.mean(np.minimum(np.abs(error - bias), 1.0) ** 2)), bias

    delays = np.arange(-FARTHEST_CLOCK, FARTHEST_CLOCK + dt / 2, dt)
    costs = np.array([compare(delay)[0] for delay in delays])
    best = int(np.argmin(costs))
    now = len(delays) // 2
    if costs[best] > (1 - LEAST_GAIN) * costs[now]:
        best = now
    if best in (0, len(delays) - 1):
        raise ValueError(
            f"{log.path}: the gyroscope's clock is {FARTHEST_CLOCK:g} s or more off that of the "
            f"attitude: shift p, q, r by what you know of it"
        )
    # The vertex of the parabola through the best and its neighbours
    before, at, after = costs[best - 1 : best + 2]
    bend = before - 2 * at + after
    delay = float(delays[best] + dt * (0.5 * (before - after) / bend if bend > 0 else 0.0))
    return delay, compare(delay)[1]


def _windows(
    log: Log,
    airframe: Airframe,
    grid: np.ndarray,
    position: np.ndarray,
    steps: int,
) -> np.ndarray:
    """Return where windows of flight start, (K,)."""
    speeds = logged_speeds(log, airframe)
    thrust = airframe.thrust_coefficient * np.interp(grid, log.time, (speeds**2).sum(axis=1))
    flies = thrust > LEAST_THRUST * airframe.mass * STANDARD_GRAVITY
    flies &= position[:, 2] > airframe.standing_height + CLEARANCE
    dt = grid[1] - grid[0]
    edge = math.ceil(WARM_UP / dt)
    flies[:edge] = flies[len(flies) - edge :] = False
    starts = []
    k = edge
    while k + steps < len(grid):
        # Also a while before, so that the rotors' speeds are known
        if flies[k - edge // 2 : k + steps + 1].all():
            starts.append(k)
            k += steps
        else:
            k += 1
    return np.array(starts, dtype=np.int64)
