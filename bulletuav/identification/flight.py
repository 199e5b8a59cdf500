"""Preparation of a log: one clock, equally spaced and smoothed samples, windows of flight."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from bulletuav.compiled.kernel import kernel
from bulletuav.identification.logs import OTHER, POSITION, QUATERNION, RATES, VELOCITY, Log
from bulletuav.identification.rollout import Track
from bulletuav.identification.smoothing import (
    compute_body_rates,
    savgol_derivative,
    savgol_smooth,
    savgol_window,
)
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.battery import battery_speed_ratio
from bulletuav.vehicle.rotors import RPM

MIN_SAMPLE_INTERVAL = 0.005
"""Minimum sample interval, s; faster logs are resampled to it"""
POSITION_SPAN, ATTITUDE_SPAN, GYRO_SPAN = 0.21, 0.09, 0.09
"""Durations of the smoothing windows of positions, attitudes and rates, s"""
DEGREES = (5, 5, 4)
"""Degrees of their smoothing polynomials"""
MAX_GYRO_DELAY = 0.25
"""Maximum delay between gyroscope and attitude that the search considers, s"""
MIN_IMPROVEMENT = 0.1
"""Fraction by which another delay must reduce the squared gyroscope errors to be accepted"""
MIN_THRUST = 0.3
"""Thrust, in weights, below which a drone counts as not flying"""
CLEARANCE = 0.008
"""Height above the standing height at which a drone counts as flying, m"""
WARM_UP = 0.4
"""Time at both ends of a log that is not used for windows, s"""


@dataclass(frozen=True)
class LoggedFlight:
    """A log resampled on the clock of its attitude, with the windows of flight.

    Attributes:
        log: The log.
        dt: Sample interval, s.
        track: The smoothed measurements.
        gyro_delay: Delay of the gyroscope behind the attitude, s; 0 without a gyroscope.
        gyro_bias: Bias of the gyroscope, (3,), rad/s, which is subtracted from `track.rates`.
        windows: Index of the first sample of each window, (K,).
        steps: Number of samples in a window.
        measured: Whether the rotor speeds of the log were measured, not commanded.
    """

    log: Log
    dt: float
    track: Track
    gyro_delay: float
    gyro_bias: np.ndarray
    windows: np.ndarray
    steps: int
    measured: bool = False

    @property
    def grid(self) -> np.ndarray:
        """Times of the samples, (n,), s."""
        times: np.ndarray = self.log.time[0] + self.dt * np.arange(len(self.track.position))
        return times

    def align_track(self, position_delay: float, velocity_delay: float) -> Track:
        """Return the measurements with positions and velocities shifted to the attitude's clock.

        Args:
            position_delay: Delay of positions, including those of another drone, behind the
                attitude, s.
            velocity_delay: Delay of logged velocities, s; ignored if the velocity is computed from
                the position, whose delay it then has.

        Returns:
            The measurements, interpolated by cubic splines and constant beyond the ends of the log;
            `track` itself if nothing is delayed.
        """
        if VELOCITY[0] not in self.log:
            velocity_delay = position_delay
        track = self.track
        if position_delay:
            track = track._replace(position=self._shift(track.position, position_delay))
            if len(track.other):
                track = track._replace(other=self._shift(track.other, position_delay))
        if velocity_delay:
            track = track._replace(velocity=self._shift(track.velocity, velocity_delay))
        return track

    def _shift(self, values: np.ndarray, delay: float) -> np.ndarray:
        """Return the values (n, 3) at a time `delay` after each sample."""
        grid = self.grid
        shifted: np.ndarray = CubicSpline(grid, values)(np.clip(grid + delay, grid[0], grid[-1]))
        return shifted

    def commands(self, airframe: Airframe, delay: float) -> np.ndarray:
        """Return the commanded rotor speeds, averaged over each sample interval.

        Args:
            airframe: The airframe, whose PWM map and battery convert motor commands.
            delay: Delay of the commands, s.

        Returns:
            Rotor speeds, (n, R), rad/s.
        """
        time = self.log.time
        speeds = logged_speeds(self.log, airframe)
        # Commands are piecewise constant (zero-order hold), so their integral is piecewise linear.
        held = np.diff(time)[:, None] * speeds[:-1]
        total = np.concatenate([np.zeros((1, speeds.shape[1])), np.cumsum(held, axis=0)])
        edges = np.append(self.grid, self.grid[-1] + self.dt) - delay
        ahead = np.maximum(time[0] - edges, 0.0)[:, None] * speeds[0]
        after = np.maximum(edges - time[-1], 0.0)[:, None] * speeds[-1]
        passed = np.stack([np.interp(edges, time, column) for column in total.T], axis=1)
        mean = np.diff(passed - ahead + after, axis=0) / self.dt
        commands: np.ndarray = np.maximum(mean, 0.0)
        return commands

    def measured_speeds(self, airframe: Airframe, delay: float) -> np.ndarray:
        """Return the measured rotor speeds at the samples.

        Args:
            airframe: The airframe.
            delay: Delay of the measurements, s; negative if they are late.

        Returns:
            Rotor speeds, (n, R), rad/s, interpolated linearly.
        """
        speeds = logged_speeds(self.log, airframe).T
        return np.stack([np.interp(self.grid - delay, self.log.time, one) for one in speeds], 1)


@kernel
def _speed_fractions(volts: np.ndarray, nominal: float, fraction: np.ndarray) -> None:
    """Compute the fractions of the commanded speed that motors reach at voltages (n,)."""
    for k in range(volts.size):
        fraction[k] = battery_speed_ratio(volts[k], nominal)


def logged_speeds(log: Log, airframe: Airframe) -> np.ndarray:
    """Convert the logged commands to rotor speeds, (n, R), rad/s."""
    kind = log.kind
    commands = log.stack([f"{kind}{r + 1}" for r in range(len(airframe.rotors))])
    if kind == "w":
        return commands
    if kind == "rpm":
        return commands * RPM
    assert airframe.pwm is not None  # guaranteed by `checks`
    speeds = RPM * (airframe.pwm.slope * commands + airframe.pwm.intercept)
    if "vbat" in log and airframe.pack is not None:
        fraction = np.empty(len(commands))
        _speed_fractions(log.columns["vbat"], airframe.pack.voltage, fraction)
        speeds = speeds * fraction[:, None]
    turning: np.ndarray = np.where(commands > 0, speeds, 0.0)
    return turning


def prepare_log(
    log: Log, airframe: Airframe, window: float, measured: bool = False
) -> LoggedFlight:
    """Resample and smooth a log on one clock, and find its windows of flight.

    Args:
        log: A log that has passed `checks.check_log`.
        airframe: The airframe that was flown.
        window: Duration of a window, s.
        measured: Whether the rotor speeds of the log were measured, not commanded.

    Returns:
        The flight.

    Raises:
        ValueError: If the log contains no flight of one window, or the delay of the gyroscope is
            `MAX_GYRO_DELAY` or more.
    """
    time = log.time
    dt = max(float(np.median(np.diff(time))), MIN_SAMPLE_INTERVAL)
    grid = time[0] + dt * np.arange(int((time[-1] - time[0]) / dt) + 1)
    position = savgol_smooth(_resample_columns(grid, log, POSITION), POSITION_SPAN, dt, DEGREES[0])
    quaternion = savgol_smooth(
        _resample_columns(grid, log, QUATERNION), ATTITUDE_SPAN, dt, DEGREES[1]
    )
    quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
    turning = compute_body_rates(grid, _resample_columns(grid, log, QUATERNION))
    delay, bias = 0.0, np.zeros(3)
    rates = turning
    if RATES[0] in log:
        delay, bias = _estimate_gyro_delay(grid, log, turning, dt)
        gyro = np.stack([np.interp(grid + delay, time, log.columns[name]) for name in RATES], 1)
        rates = savgol_smooth(gyro - bias, GYRO_SPAN, dt, DEGREES[2])
    if VELOCITY[0] in log:
        velocity = savgol_smooth(_resample_columns(grid, log, VELOCITY), GYRO_SPAN, dt, degree=2)
    else:
        velocity = savgol_derivative(
            _resample_columns(grid, log, POSITION), POSITION_SPAN, dt, DEGREES[0]
        )
    other = _resample_columns(grid, log, OTHER) if OTHER[0] in log else np.zeros((0, 3))
    track = Track(*map(np.ascontiguousarray, (position, quaternion, velocity, rates, other)))
    steps = max(round(window / dt), 4)
    starts = _find_windows(log, airframe, grid, position, steps)
    if not len(starts):
        stands = airframe.standing_height + CLEARANCE
        raise ValueError(
            f"{log.path}: there is no flight of {window:g} s: the thrust must be at least "
            f"{MIN_THRUST:g} weights, and z must be above {stands:.3g} m, where {airframe.name} "
            f"stands; z goes from {position[:, 2].min():.3g} to {position[:, 2].max():.3g} m"
        )
    return LoggedFlight(log, dt, track, delay, bias, starts, steps, measured)


def _resample_columns(grid: np.ndarray, log: Log, names: tuple[str, ...]) -> np.ndarray:
    """Interpolate columns at the times of a grid, (n, len(names))."""
    return np.stack([np.interp(grid, log.time, log.columns[name]) for name in names], axis=1)


def _estimate_gyro_delay(
    grid: np.ndarray, log: Log, turning: np.ndarray, dt: float
) -> tuple[float, np.ndarray]:
    """Estimate the delay of the gyroscope behind the attitude, s, and its bias, (3,), rad/s."""
    inner = slice(savgol_window(MAX_GYRO_DELAY * 2, dt), -savgol_window(MAX_GYRO_DELAY * 2, dt))

    def compare(delay: float) -> tuple[float, np.ndarray]:
        gyro = np.stack([np.interp(grid + delay, log.time, log.columns[name]) for name in RATES], 1)
        # The same smoothing as that of the rates from the attitude
        error = (savgol_smooth(gyro, 0.07, dt) - turning)[inner]
        bias = np.median(error, axis=0)
        return float(np.mean(np.minimum(np.abs(error - bias), 1.0) ** 2)), bias

    delays = np.arange(-MAX_GYRO_DELAY, MAX_GYRO_DELAY + dt / 2, dt)
    costs = np.array([compare(delay)[0] for delay in delays])
    best = int(np.argmin(costs))
    now = len(delays) // 2
    if costs[best] > (1 - MIN_IMPROVEMENT) * costs[now]:
        best = now
    if best in (0, len(delays) - 1):
        raise ValueError(
            f"{log.path}: the gyroscope's clock is {MAX_GYRO_DELAY:g} s or more off that of the "
            f"attitude: shift p, q, r by the known delay first"
        )
    # Vertex of the parabola through the best delay and its neighbours
    before, at, after = costs[best - 1 : best + 2]
    bend = before - 2 * at + after
    delay = float(delays[best] + dt * (0.5 * (before - after) / bend if bend > 0 else 0.0))
    return delay, compare(delay)[1]


def _find_windows(
    log: Log, airframe: Airframe, grid: np.ndarray, position: np.ndarray, steps: int
) -> np.ndarray:
    """Find the first samples of the windows of flight, (K,)."""
    speeds = logged_speeds(log, airframe)
    thrust = airframe.thrust_coefficient * np.interp(grid, log.time, (speeds**2).sum(axis=1))
    flies = thrust > MIN_THRUST * airframe.mass * STANDARD_GRAVITY
    flies &= position[:, 2] > airframe.standing_height + CLEARANCE
    dt = grid[1] - grid[0]
    edge = math.ceil(WARM_UP / dt)
    flies[:edge] = flies[len(flies) - edge :] = False
    starts = []
    k = edge
    while k + steps < len(grid):
        # The drone must fly some time before the window, so that its rotor speeds are known
        if flies[k - edge // 2 : k + steps + 1].all():
            starts.append(k)
            k += steps
        else:
            k += 1
    return np.array(starts, dtype=np.int64)
