"""Real time: a pacer that keeps a loop to the clock."""

import time
from collections.abc import Callable

from bulletuav.errors import finite

LONGEST_DELAY = 1.0
"""Lateness after which a pacer starts anew, s, unless a turn is longer."""


class Pacer:
    """Keeps a loop in real time, by deadlines that do not drift.

    Deadlines lie one turn apart, from the time the pacer was made or `restart` was called. One
    that is missed does not shift later ones: a loop that was late for once catches up. After a
    pause, such as a reset, it does not: when `wait` comes later than 1 s and a turn after its
    deadline, deadlines start anew from there.

        pacer = Pacer(period=0.1)
        while flying:
            env.step(actions)
            pacer.wait()

    Attributes:
        period: Simulated time of a turn, s.
        speed: Simulated seconds in one of the clock; 2 is twice as fast as real time.
        late: How many turns were late.
        latest: Greatest lateness so far, s.
    """

    def __init__(
        self,
        period: float,
        speed: float = 1.0,
        *,
        _clock: Callable[[], float] = time.perf_counter,
        _sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the first turn.

        Args:
            period: Simulated time of a turn, s, such as the period of decisions.
            speed: Simulated seconds in one of the clock.

        Raises:
            ValueError: One is not positive and finite.
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
        """Start a turn now, such as after a reset; counts of late turns stay."""
        self._deadline = self._clock() + self._turn

    def wait(self) -> float:
        """Sleep until the turn's deadline, and start the next turn.

        Returns:
            How long after the deadline it was called, s; 0 when it was on time.
        """
        delay = self._clock() - self._deadline
        if delay <= 0:
            self._deadline += self._turn
            self._sleep(-delay)
            return 0.0
        self.late += 1
        self.latest = max(self.latest, delay)
        if delay > max(LONGEST_DELAY, self._turn):
            self.restart()
        else:
            self._deadline += self._turn
        return delay


def _positive(name: str, value: float, unit: str) -> float:
    """Check that a number is positive and finite, and return it as a float."""
    number = finite(name, value)
    if number <= 0:
        raise ValueError(f"{name} is {number:g} {unit}: a number above 0 is needed")
    return number
