"""Real time: a pacer that keeps a loop in step with the clock."""

import time
from collections.abc import Callable

from bulletuav.errors import finite

MAX_DELAY = 1.0
"""Delay after which a pacer restarts its deadlines, s, unless the period is longer"""


class Pacer:
    """Keeps a loop in real time, by deadlines that do not drift.

    Deadlines are one period apart, from the time the pacer was created or `restart` was called. A
    missed deadline does not shift later ones: a loop that was late once catches up. After a pause,
    such as a reset, it does not: if `wait` is called later than 1 s and later than one period after
    its deadline, the deadlines restart from there. For example::

        pacer = Pacer(period=0.1)
        while flying:
            env.step(actions)
            pacer.wait()

    Attributes:
        period: Simulated time between calls, s.
        speed: Simulated seconds per second of the clock; 2 is twice as fast as real time.
        late: Number of missed deadlines.
        latest: Largest delay so far, s.
    """

    def __init__(
        self,
        period: float,
        speed: float = 1.0,
        *,
        _clock: Callable[[], float] = time.perf_counter,
        _sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the first period.

        Args:
            period: Simulated time between calls, s, such as the period of decisions.
            speed: Simulated seconds per second of the clock.

        Raises:
            ValueError: If a number is not positive and finite.
        """
        self.period = _positive("period", period, "s")
        self.speed = _positive("speed", speed, "times real time")
        self.late = 0
        self.latest = 0.0
        self._turn = _positive("period / speed", self.period / self.speed, "s")
        self._clock = _clock
        self._sleep = _sleep
        self.restart()

    def restart(self) -> None:
        """Start a period now, such as after a reset; the counts of delays stay."""
        self._deadline = self._clock() + self._turn

    def wait(self) -> float:
        """Sleep until the deadline, and start the next period.

        Returns:
            Delay of the call after the deadline, s; 0 if it was on time.
        """
        delay = self._clock() - self._deadline
        if delay <= 0:
            self._deadline += self._turn
            self._sleep(-delay)
            return 0.0
        self.late += 1
        self.latest = max(self.latest, delay)
        if delay > max(MAX_DELAY, self._turn):
            self.restart()
        else:
            self._deadline += self._turn
        return delay


def _positive(name: str, value: float, unit: str) -> float:
    number = finite(name, value)
    if number <= 0:
        raise ValueError(f"{name} is {number:g} {unit}: a number above 0 is needed")
    return number
