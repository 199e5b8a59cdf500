"""Wall time of a training run, by what it was spent on."""

import time

from bulletuav.training.store import WALL


class WallTime:
    """A clock that knows what the time is spent on."""

    def __init__(self) -> None:
        """Begin with simulation."""
        self._seconds = dict.fromkeys(WALL, 0.0)
        self._part = WALL[0]
        self._since = time.perf_counter()

    @property
    def part(self) -> str:
        """What time is spent on now, one of `WALL`."""
        return self._part

    @part.setter
    def part(self, part: str) -> None:
        self.seconds()
        self._part = part

    def seconds(self) -> dict[str, float]:
        """Give the seconds so far of each part of `WALL`, which add up to all of them."""
        now = time.perf_counter()
        self._seconds[self._part] += now - self._since
        self._since = now
        return dict(self._seconds)
