"""Policy `race_pilot`: flies races along precomputed racing lines."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import tan
from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.actions import limit_norm
from bulletuav.control.gains import MAX_TILT
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy, require_supported_task
from bulletuav.policies.racing_line import (
    SAMPLES,
    GatePath,
    RacingLimits,
    default_parameters,
    make_line,
    optimize_line,
)
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.gates import SIDES
from bulletuav.tasks.race import Race
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm

MAX_ACCELERATION = STANDARD_GRAVITY * float(tan(MAX_TILT))
"""Horizontal acceleration of a level drone at the maximum tilt of its controller, m/s^2"""
DRAG = 0.42
"""Rotor drag of the racer at this tilt: deceleration per speed, 1/s"""
ACCELERATION_FRACTION, REFERENCE_CLEARANCE = 0.9, 0.9
"""Fraction of that acceleration for lines through gates with the reference clearance to each
side, m; narrower gates use less, as a reserve for corrections"""
SPEED_FRACTION = 0.98
"""Fraction of max_speed for lines"""
FRAME_MARGIN = 0.4
"""Margin between a drone's shape and the frames, m"""
ROUND_OPENING_FRACTION = 0.7
"""Size of the square inside a round opening, as a fraction of the opening"""
PRECISION = 1e-4
"""Tolerance of the line optimisation; see `optimize_line`"""
PLANNED_GATES = 12
"""Number of gates in one plan"""
REPLAN_GATES = 3
"""Number of gates before the end of a line at which planning continues"""
LEAD_IN = 0.1
"""Time before the start of its line at which a drone spins up its rotors and tilts, s"""
HEADWAY = 0.7
"""Time between the starts of consecutive drones, s"""
MAX_DEVIATION = 2.0
"""Distance from its line at which a drone plans a new line, m"""
MISSED_AFTER = 0.1
"""Delay after which a gate counts as missed, s"""
TRACKING_GAIN = 2.0
"""Gain from distance to correction speed, 1/s"""
DELAY_FRACTION = 0.2
"""Fraction of the delay of a drone by which its line is delayed in each decision"""
MIN_DELAY_SPEED = 2.0
"""Minimum speed for the computation of delays, m/s"""
WAITING_SPEED = 1.0
"""Downward speed of drones that wait for their start, m/s"""
VELOCITY_LOOP = (0.3, 0.2)
"""Lag of the velocity loop, s, and look-ahead of its acceleration, s: tilting takes time"""
VELOCITY_LOOPS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "single_integrator": (0.0, 0.05),
        "double_integrator": (0.25, 0.05),
        "point_mass": (0.25, 0.05),
    }
)
"""Lag and look-ahead of dynamics without attitude"""


@register("policy")
class RacePilot(Policy):
    """Flight along near time-optimal racing lines, with staggered starts.

    A line is planned through the next gates at their predicted positions. The line is delayed if
    its drone falls behind, and with it the lines of drones that started later. A drone that is far
    from its line, or has missed a gate, gets a new line with default parameters from its current
    position. Other drones are not considered otherwise.

    Attributes:
        headway: Time between the starts of consecutive drones, s.
    """

    name = "race_pilot"
    headway: ClassVar[float] = HEADWAY
    actions = ("velocity",)
    reads_swarm = True
    remembers = (
        "_start_time",
        "_start",
        "_speed",
        "_first",
        "_parameters",
        "_position",
        "_velocity",
        "_time",
        "_count",
    )

    def __init__(self, aviary: Aviary) -> None:
        """Compute the limits and allocate the lines; see `Policy`.

        Raises:
            ValueError: If the task is not `race`.
        """
        super().__init__(aviary)
        self._task = require_supported_task(self, Race)
        self._radius = self._task.context.collision_radius
        free = min(
            ACCELERATION_FRACTION,
            ACCELERATION_FRACTION
            * (self._task.course.narrowest / 2 - self._radius)
            / REFERENCE_CLEARANCE,
        )
        self._limits = RacingLimits(
            SPEED_FRACTION * aviary.options.max_speed, free * MAX_ACCELERATION, DRAG
        )
        self._loop = VELOCITY_LOOPS.get(aviary.options.dynamics, VELOCITY_LOOP)
        shape = aviary.alive.shape
        # Plans: start times, start states, first gates, and line parameters.
        self._start_time = np.zeros(shape)
        self._start, self._speed = np.zeros((2, *shape, 3))
        self._first = np.zeros(shape, dtype=np.int64)
        self._parameters = [[default_parameters(1)] * shape[1] for _ in range(shape[0])]
        # Points of the lines and their number, 0 before planning.
        points = PLANNED_GATES * SAMPLES + 1
        self._position, self._velocity = np.zeros((2, *shape, points, 3))
        self._time = np.zeros((*shape, points))
        self._count = np.zeros(shape, dtype=np.int64)
        # Current commands: velocities to command, velocities of the line, and offsets to the line.
        self._wanted, self._line_velocity, self._line_offset = np.zeros((3, *shape, 3))

    def reset(self, mask: np.ndarray) -> None:
        """Drop the lines of the worlds in `mask` (W,)."""
        self._count[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the velocities that track the lines; see `Policy.act`."""
        aviary = self.aviary
        now = aviary.steps / aviary.options.decision_hz
        # Plan missing lines, for all drones of a world together
        for w in np.flatnonzero(np.any(aviary.alive & (self._count == 0), axis=1)).tolist():
            self._plan_start(w, swarm, now[w])
        if self._task.config.gate_motion:  # delayed lines meet the gates at other positions
            for w, i in np.argwhere(aviary.alive).tolist():
                self._update_line(w, i, now[w])
        # Plan a new line for drones that are far from their lines, or near the end
        self._evaluate_lines(swarm, now)
        lost = np.argwhere(aviary.alive & self._is_lost(now)).tolist()
        for w, i in lost:
            self._replan(w, i, swarm, now[w])
        if lost:
            self._evaluate_lines(swarm, now)
        # Delay lines of drones that fall behind; stay on the start block until the own start
        self._delay_lines(now)
        velocity = limit_norm(
            self._wanted + TRACKING_GAIN * self._line_offset, aviary.options.max_speed
        )
        velocity[now[:, None] < self._start_time - LEAD_IN] = (0.0, 0.0, -WAITING_SPEED)
        return self.encoded(velocity)

    def fastest(self, w: int, swarm: Swarm) -> float:
        """Compute the duration of the fastest line of drone 0 in world w, s, as a reference.

        The line starts immediately from rest, touches the frames, and uses the full speed and
        acceleration. Swinging gates are fixed at their initial positions. Call this method before
        the flight.

        Args:
            w: Index of the world.
            swarm: The state of all drones, right after a reset.
        """
        limits = RacingLimits(self.aviary.options.max_speed, MAX_ACCELERATION, DRAG)
        self._start_line(w, 0, swarm, 0.0)
        path = self._gate_path(w, 0, 0.0, clear=0.0)
        return float(make_line(path, optimize_line(path, limits), limits).time[-1])

    def _evaluate_lines(self, swarm: Swarm, now: np.ndarray) -> None:
        """Evaluate the lines at times (W,), s."""
        lines = (self._position, self._velocity, self._time, self._count)
        outputs = (self._wanted, self._line_velocity, self._line_offset)
        evaluate_lines(
            *lines, now[:, None] - self._start_time, swarm.position, *self._loop, *outputs
        )

    def _delay_lines(self, now: np.ndarray) -> None:
        """Delay the lines of drones that fall behind, and those of the drones behind them."""
        square = np.maximum((self._line_velocity**2).sum(axis=-1), MIN_DELAY_SPEED**2)
        behind = (self._line_offset * self._line_velocity).sum(axis=-1) / square
        self._start_time += np.where(now[:, None] >= self._start_time, DELAY_FRACTION * behind, 0.0)
        # A line of the same gates keeps behind that of the drone that started before
        follows = (self._first[:, 1:] == self._first[:, :-1]) & self.aviary.alive[:, :-1]
        for i in np.flatnonzero(follows.any(axis=0)).tolist():
            earliest = self._start_time[:, i] + self.headway
            delayed = np.maximum(self._start_time[:, i + 1], earliest)
            self._start_time[:, i + 1] = np.where(
                follows[:, i], delayed, self._start_time[:, i + 1]
            )

    def _is_lost(self, now: np.ndarray) -> np.ndarray:
        """Return which drones left their line, missed a gate or near its end, (W, N) bool."""
        passed = self._memory("passed").astype(np.int64)
        elapsed = now[:, None] - self._start_time
        times = self._time[..., SAMPLES::SAMPLES]
        due = self._first + (times < elapsed[..., None] - MISSED_AFTER).sum(axis=-1)
        planned = self._first + (self._count - 1) // SAMPLES
        ends = (planned - passed < REPLAN_GATES) & (planned < self._task.turns)
        is_off = (self._line_offset**2).sum(axis=-1) > MAX_DEVIATION**2
        lost: np.ndarray = (is_off | ends | (passed < due)) & (elapsed >= 0)
        return lost

    def _memory(self, name: str) -> np.ndarray:
        return self.aviary.scene.memory[name]

    def _plan_start(self, w: int, swarm: Swarm, now: float) -> None:
        """Plan the lines of all drones of a world, with the same line parameters."""
        parameters = None
        for i in range(self.aviary.num_drones):
            self._start_line(w, i, swarm, now + LEAD_IN + self.headway * i)
            if parameters is None:
                parameters = optimize_line(self._gate_path(w, i, now), self._limits, PRECISION)
            self._set_parameters(w, i, parameters, now)

    def _replan(self, w: int, i: int, swarm: Swarm, now: float) -> None:
        """Plan a line with default parameters from the current state of a drone."""
        self._start_line(w, i, swarm, now)
        left = min(PLANNED_GATES, self._task.turns - int(self._first[w, i]))
        self._set_parameters(w, i, default_parameters(left + 1), now)

    def _start_line(self, w: int, i: int, swarm: Swarm, start_time: float) -> None:
        """Start a line at a time, s, from the current state of the drone."""
        self._start_time[w, i] = start_time
        self._start[w, i], self._speed[w, i] = swarm.position[w, i], swarm.velocity[w, i]
        self._first[w, i] = int(self._memory("passed")[w, i])
        self._time[w, i], self._count[w, i] = 0.0, 0

    def _set_parameters(self, w: int, i: int, parameters: np.ndarray, now: float) -> None:
        """Set the line parameters, and compute the line; iterate on the times at the gates."""
        self._parameters[w][i] = parameters
        for _ in range(3):
            self._update_line(w, i, now)

    def _update_line(self, w: int, i: int, now: float) -> None:
        """Compute a line through the gates at their positions at the times of the current line."""
        line = make_line(self._gate_path(w, i, now), self._parameters[w][i], self._limits)
        count = len(line.time)
        self._position[w, i, :count], self._velocity[w, i, :count] = line.position, line.velocity
        self._time[w, i, :count], self._time[w, i, count:] = line.time, np.inf
        self._count[w, i] = count

    def _gate_path(self, w: int, i: int, now: float, clear: float = FRAME_MARGIN) -> GatePath:
        """Return the gates that a line passes, at their predicted positions."""
        first, course = int(self._first[w, i]), self._task.course
        turn = np.arange(first, min(first + PLANNED_GATES, self._task.turns)) % course.gates
        axis, phase = self._memory("gate_axis")[w], self._memory("gate_phase")[w]
        # Replace the current displacement of swinging gates by the predicted one.
        times = self._start_time[w, i] + self._time[w, i, SAMPLES::SAMPLES][: len(turn)]
        swung, _ = course.swing(np.array([now]), axis[None], phase[None])
        later, _ = course.swing(times, axis[turn][:, None], phase[turn][:, None])
        middle = (self._memory("gate")[w] - swung[0])[turn] + later[:, 0]
        start, speed = self._start[w, i], math.sqrt(float((self._speed[w, i] ** 2).sum()))
        ahead = self._speed[w, i] / speed if speed > 1.0 else _tilted_up(middle[0] - start)
        free = self._memory("gate_size")[w, turn] / 2 - self._radius - clear
        free = np.where(course.sides[turn] > SIDES["square"], ROUND_OPENING_FRACTION * free, free)
        return GatePath(
            point=np.concatenate([start[None], middle]),
            axis=np.concatenate([np.stack([ahead] * 3)[None], axis[turn]]),
            clearance=np.insert(np.maximum(free, 0.0), 0, 0.0),
            first_speed=speed,
        )


def _tilted_up(offset: np.ndarray) -> np.ndarray:
    """Return the direction of a vector (3,), tilted upwards, for drones on the ground."""
    steep = offset + np.array((0.0, 0.0, 0.5 * math.sqrt(float((offset**2).sum()))))
    direction: np.ndarray = steep / math.sqrt(float((steep**2).sum()))
    return direction


@func
def segment_at(time: np.ndarray, w: int, i: int, last: int, now: float) -> tuple[int, float]:
    """Return the segment of a line at a time, and the elapsed fraction of the segment."""
    s = min(max(int(np.searchsorted(time[w, i, : last + 1], now, side="right")), 1), last)
    lapse = time[w, i, s] - time[w, i, s - 1]
    return s - 1, min(max((now - time[w, i, s - 1]) / lapse, 0.0), 1.0)


@kernel
def evaluate_lines(
    line: np.ndarray,
    velocity: np.ndarray,
    time: np.ndarray,
    count: np.ndarray,
    elapsed: np.ndarray,
    position: np.ndarray,
    lag: float,
    ahead: float,
    wanted: np.ndarray,
    line_velocity: np.ndarray,
    line_offset: np.ndarray,
) -> None:
    """Evaluate the lines: the offset of each drone from its line, and the velocity to command.

    A velocity loop with a lag follows v if v + lag a is commanded. The acceleration a is the mean
    over the interval up to twice `ahead`.

    Args:
        line: (W, N, K, 3) points of the lines, m.
        velocity: (W, N, K, 3) velocities at the points, m/s.
        time: (W, N, K) times at the points, s.
        count: (W, N) number of points.
        elapsed: (W, N) time since the start of the line, s.
        position: (W, N, 3) positions of the drones, m.
        lag: Lag of the velocity loop, s.
        ahead: Look-ahead of the acceleration, s.
        wanted: (W, N, 3) velocities to command, m/s; written.
        line_velocity: (W, N, 3) velocities of the lines, m/s; written.
        line_offset: (W, N, 3) offsets from the drones to the lines, m; written.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            last = count[w, i] - 1
            # No line yet, or a single point
            if last < 1:
                continue
            # Segments at the current time, and later for the acceleration
            now = max(elapsed[w, i], 0.0)
            s, fraction = segment_at(time, w, i, last, now)
            t, later_fraction = segment_at(time, w, i, last, now + 2.0 * ahead)
            for k in range(3):
                # Offset to the interpolated point
                here = line[w, i, s, k]
                line_offset[w, i, k] = (
                    here + fraction * (line[w, i, s + 1, k] - here) - position[w, i, k]
                )
                # Velocity now and later; their difference is the feed-forward acceleration
                speed, later = velocity[w, i, s, k], velocity[w, i, t, k]
                speed += fraction * (velocity[w, i, s + 1, k] - speed)
                later += later_fraction * (velocity[w, i, t + 1, k] - later)
                line_velocity[w, i, k] = speed
                wanted[w, i, k] = speed + lag * (later - speed) / (2.0 * ahead)
