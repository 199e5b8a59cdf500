"""Policy `race_pilot`, which flies races along lines that it has planned."""

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bulletuav.compiled.functions import tan
from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.actions import limit_norm
from bulletuav.control.gains import MAX_TILT
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.policies.racing_line import (
    SAMPLES,
    Limits,
    Way,
    fastest_choice,
    line_of,
    usual_choice,
)
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.gates import SIDES
from bulletuav.tasks.race import Race
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm

MOST = STANDARD_GRAVITY * float(tan(MAX_TILT))
"""Acceleration of a drone that flies level at the greatest tilt of its controller, m/s^2"""
DRAG = 0.42
"""Deceleration of the racer by drag per speed, 1/s: that of its rotors at this tilt"""
SHARE, FREE = 0.9, 0.9
"""Share of that acceleration that lines need where gates leave so many metres free to each side; in
narrower ones less, so that more is left to correct errors"""
SPEED = 0.98
"""Share of max_speed that lines need"""
CLEAR = 0.4
"""Room that lines leave between a drone's shape and the frames, m"""
ROUND = 0.7
"""Size of a square in a round opening, as a share of the opening"""
PRECISION = 1e-4
"""Gain at which the search for a line ends; see `fastest_choice`"""
LOOK = 12
"""Gates ahead that are planned at a time"""
EXTEND = 3
"""Gates before the end of a line at which it is planned on"""
LEAD_IN = 0.1
"""How long before its line begins a drone spins up its rotors and tilts, s"""
HEADWAY = 0.7
"""Time between the starts of one drone and the next, s"""
LOST = 2.0
"""Distance from its line at which a drone plans anew, m"""
LATE = 0.1
"""Time after which a gate that was not passed is missed, s"""
PULL = 2.0
"""Speed towards the line per distance from it, 1/s"""
SLIP = 0.2
"""Share of the time by which a drone is behind its line that the line waits in each decision"""
SLOW = 2.0
"""Speed below which no drone counts as behind, m/s"""
REST = 1.0
"""Speed into the ground of drones that wait for their start, m/s"""
LOOP = (0.3, 0.2)
"""Lag of the velocity loop, s, and how far ahead accelerations are looked up for it, s: tilting
takes time"""
LOOPS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "single_integrator": (0.0, 0.05),
        "double_integrator": (0.25, 0.05),
        "point_mass": (0.25, 0.05),
    }
)
"""The same for dynamics without attitudes"""


@register("policy")
class RacePilot(Policy):
    """Flight along lines that are nearly the fastest ones, one drone shortly after the other.

    A line is planned through the next gates, where they will be by then. It waits for who is
    behind. Who is far off it, or has missed a gate, plans a plain line from where it is. Other
    drones are not looked at.
    """

    name = "race_pilot"
    actions = ("velocity",)
    reads_swarm = True
    remembers = (
        "_begin",
        "_start",
        "_speed",
        "_first",
        "_choice",
        "_position",
        "_velocity",
        "_time",
        "_count",
    )

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`.

        Raises:
            ValueError: Its task is not `race`.
        """
        super().__init__(aviary)
        if not isinstance(aviary.task, Race):
            raise ValueError(
                f"policy {self.name!r} flies task 'race', not {aviary.task.name!r}: choose "
                f"another policy"
            )
        self._task, self._radius = aviary.task, aviary.task.context.collision_radius
        free = min(SHARE, SHARE * (aviary.task.course.narrowest / 2 - self._radius) / FREE)
        self._limits = Limits(SPEED * aviary.options.max_speed, free * MOST, DRAG)
        self._loop = LOOPS.get(aviary.options.dynamics, LOOP)
        shape = aviary.alive.shape
        # How lines were planned: when and where they begin, with which gate, and what they choose.
        self._begin = np.zeros(shape)
        self._start, self._speed = np.zeros((2, *shape, 3))
        self._first = np.zeros(shape, dtype=np.int64)
        self._choice = [[usual_choice(1)] * shape[1] for _ in range(shape[0])]
        # Their points, how many there are, and 0 before there is a line.
        points = LOOK * SAMPLES + 1
        self._position, self._velocity = np.zeros((2, *shape, points, 3))
        self._time = np.zeros((*shape, points))
        self._count = np.zeros(shape, dtype=np.int64)
        # What they say now: velocities to ask for, those of the line, and the way back to it.
        self._wanted, self._flow, self._off = np.zeros((3, *shape, 3))

    def reset(self, mask: np.ndarray) -> None:
        """Forget the lines of the worlds of `mask` (W,)."""
        self._count[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the velocities that keep drones on their lines; see `Policy.act`."""
        aviary = self.aviary
        now = aviary.steps / aviary.options.decision_hz
        # Drones without a line plan one, all of a world together
        for w in np.flatnonzero(np.any(aviary.alive & (self._count == 0), axis=1)).tolist():
            self._plan_start(w, swarm, now[w])
        if self._task.config.gate_motion:  # gates will be elsewhere when lines have waited
            for w, i in np.argwhere(aviary.alive).tolist():
                self._draw(w, i, now[w])
        # Who is far off its line, or at its end, plans anew
        self._look_up(swarm, now)
        lost = np.argwhere(aviary.alive & self._is_lost(now)).tolist()
        for w, i in lost:
            self._plan_on(w, i, swarm, now[w])
        if lost:
            self._look_up(swarm, now)
        # Wait for others on the way, and on the blocks until the own start
        self._wait(now)
        velocity = limit_norm(self._wanted + PULL * self._off, aviary.options.max_speed)
        velocity[now[:, None] < self._begin - LEAD_IN] = (0.0, 0.0, -REST)
        return self.encoded(velocity)

    def fastest(self, w: int, swarm: Swarm) -> float:
        """Compute how long the fastest line of drone 0 of world w takes, s: a reference for it.

        It begins at once from rest, touches frames, and needs all of the speed and acceleration.
        Gates that swing count where they are at the start. Call it before the flight.

        Args:
            w: Index of the world.
            swarm: The state of all drones, right after a reset.
        """
        limits = Limits(self.aviary.options.max_speed, MOST, DRAG)
        self._begin_at(w, 0, swarm, 0.0)
        way = self._way(w, 0, 0.0, clear=0.0)
        return float(line_of(way, fastest_choice(way, limits), limits).time[-1])

    def _look_up(self, swarm: Swarm, now: np.ndarray) -> None:
        """Find out what lines say at times (W,), s."""
        lines = (self._position, self._velocity, self._time, self._count)
        told = (self._wanted, self._flow, self._off)
        look_up(*lines, now[:, None] - self._begin, swarm.position, *self._loop, *told)

    def _wait(self, now: np.ndarray) -> None:
        """Let lines wait for drones that are behind them."""
        square = np.maximum((self._flow**2).sum(axis=-1), SLOW**2)
        behind = (self._off * self._flow).sum(axis=-1) / square
        self._begin += np.where(now[:, None] >= self._begin, SLIP * behind, 0.0)

    def _is_lost(self, now: np.ndarray) -> np.ndarray:
        """Tell who is off its line, missed a gate, or comes to the end of its line, (W, N) bool."""
        passed = self._memory("passed").astype(np.int64)
        along = now[:, None] - self._begin
        times = self._time[..., SAMPLES::SAMPLES]
        due = self._first + (times < along[..., None] - LATE).sum(axis=-1)
        planned = self._first + (self._count - 1) // SAMPLES
        ends = (planned - passed < EXTEND) & (planned < self._task.turns)
        is_off = (self._off**2).sum(axis=-1) > LOST**2
        lost: np.ndarray = (is_off | ends | (passed < due)) & (along >= 0)
        return lost

    def _memory(self, name: str) -> np.ndarray:
        return self.aviary.scene.memory[name]

    def _plan_start(self, w: int, swarm: Swarm, now: float) -> None:
        """Plan the lines of all drones of a world, which pass gates at the same points."""
        choice = None
        for i in range(self.aviary.num_drones):
            self._begin_at(w, i, swarm, now + LEAD_IN + HEADWAY * i)
            if choice is None:
                choice = fastest_choice(self._way(w, i, now), self._limits, PRECISION)
            self._choose(w, i, choice, now)

    def _plan_on(self, w: int, i: int, swarm: Swarm, now: float) -> None:
        """Plan a plain line of one drone from where it is."""
        self._begin_at(w, i, swarm, now)
        left = min(LOOK, self._task.turns - int(self._first[w, i]))
        self._choose(w, i, usual_choice(left + 1), now)

    def _begin_at(self, w: int, i: int, swarm: Swarm, begin: float) -> None:
        """Let a line begin at a time, s, where the drone is now."""
        self._begin[w, i] = begin
        self._start[w, i], self._speed[w, i] = swarm.position[w, i], swarm.velocity[w, i]
        self._first[w, i] = int(self._memory("passed")[w, i])
        self._time[w, i], self._count[w, i] = 0.0, 0

    def _choose(self, w: int, i: int, choice: np.ndarray, now: float) -> None:
        """Keep a choice, and draw its line; each time it knows better when it comes to gates."""
        self._choice[w][i] = choice
        for _ in range(3):
            self._draw(w, i, now)

    def _draw(self, w: int, i: int, now: float) -> None:
        """Draw a line through gates where they are at the times of the line that is there."""
        line = line_of(self._way(w, i, now), self._choice[w][i], self._limits)
        count = len(line.time)
        self._position[w, i, :count], self._velocity[w, i, :count] = line.position, line.velocity
        self._time[w, i, :count], self._time[w, i, count:] = line.time, np.inf
        self._count[w, i] = count

    def _way(self, w: int, i: int, now: float, clear: float = CLEAR) -> Way:
        """Tell what a line has to pass."""
        first, course = int(self._first[w, i]), self._task.course
        turn = np.arange(first, min(first + LOOK, self._task.turns)) % course.gates
        axis, phase = self._memory("gate_axis")[w], self._memory("gate_phase")[w]
        # Gates that swing are now where they are, and will be elsewhere.
        times = self._begin[w, i] + self._time[w, i, SAMPLES::SAMPLES][: len(turn)]
        swung, _ = course.swing(np.array([now]), axis[None], phase[None])
        later, _ = course.swing(times, axis[turn][:, None], phase[turn][:, None])
        middle = (self._memory("gate")[w] - swung[0])[turn] + later[:, 0]
        start, speed = self._start[w, i], math.sqrt(float((self._speed[w, i] ** 2).sum()))
        ahead = self._speed[w, i] / speed if speed > 1.0 else _climbing(middle[0] - start)
        free = self._memory("gate_size")[w, turn] / 2 - self._radius - clear
        free = np.where(course.sides[turn] > SIDES["square"], ROUND * free, free)
        return Way(
            point=np.concatenate([start[None], middle]),
            axis=np.concatenate([np.stack([ahead] * 3)[None], axis[turn]]),
            room=np.insert(np.maximum(free, 0.0), 0, 0.0),
            first_speed=speed,
        )


def _climbing(way: np.ndarray) -> np.ndarray:
    """Return the direction of a way (3,), but steeper, for drones that stand on the ground."""
    steep = way + np.array((0.0, 0.0, 0.5 * math.sqrt(float((way**2).sum()))))
    direction: np.ndarray = steep / math.sqrt(float((steep**2).sum()))
    return direction


@func
def piece_at(time: np.ndarray, w: int, i: int, last: int, now: float) -> tuple[int, float]:
    """Find the piece of a line that is flown at a time, and the share of it that is over then."""
    s = min(max(int(np.searchsorted(time[w, i, : last + 1], now, side="right")), 1), last)
    lapse = time[w, i, s] - time[w, i, s - 1]
    return s - 1, min(max((now - time[w, i, s - 1]) / lapse, 0.0), 1.0)


@kernel
def look_up(
    line: np.ndarray,
    velocity: np.ndarray,
    time: np.ndarray,
    count: np.ndarray,
    along: np.ndarray,
    position: np.ndarray,
    lag: float,
    ahead: float,
    wanted: np.ndarray,
    flow: np.ndarray,
    off: np.ndarray,
) -> None:
    """Look up where drones should be on their lines, and which velocity to ask for.

    A velocity loop that follows with a lag has to be told v + lag a. The acceleration is the mean
    one until twice `ahead`.

    Args:
        line: (W, N, K, 3) points of lines, m.
        velocity: (W, N, K, 3) velocities there, m/s.
        time: (W, N, K) when to be there, s.
        count: (W, N) how many points lines have.
        along: (W, N) time since lines began, s.
        position: (W, N, 3) where drones are, m.
        lag: s.
        ahead: How long before it is needed an acceleration has to be asked for, s.
        wanted: (W, N, 3) velocity to ask for, m/s; written.
        flow: (W, N, 3) that of the line, m/s; written.
        off: (W, N, 3) from drones to where they should be, m; written.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            last = count[w, i] - 1
            # No line yet, or a single point
            if last < 1:
                continue
            # Where on the line by the time, and a little later for the acceleration
            now = max(along[w, i], 0.0)
            s, share = piece_at(time, w, i, last, now)
            t, part = piece_at(time, w, i, last, now + 2.0 * ahead)
            for k in range(3):
                # Way to the place on the line, between two of its points
                here = line[w, i, s, k]
                off[w, i, k] = here + share * (line[w, i, s + 1, k] - here) - position[w, i, k]
                # Its velocity now and later; the difference is the acceleration to tell ahead
                speed, later = velocity[w, i, s, k], velocity[w, i, t, k]
                speed += share * (velocity[w, i, s + 1, k] - speed)
                later += part * (velocity[w, i, t + 1, k] - later)
                flow[w, i, k] = speed
                wanted[w, i, k] = speed + lag * (later - speed) / (2.0 * ahead)
