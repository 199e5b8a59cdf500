"""Wall time of a training run by activity."""

import time

from bulletuav.training.store import WALL_COLUMNS


class WallTime:
    """Clock that measures the wall time of each activity."""

    def __init__(self) -> None:
        """Start the clock with the activity "simulation"."""
        self._seconds = dict.fromkeys(WALL_COLUMNS, 0.0)
        self._part = WALL_COLUMNS[0]
        self._since = time.perf_counter()

    @property
    def part(self) -> str:
        """The current activity, one of `WALL_COLUMNS`."""
        return self._part

    @part.setter
    def part(self, part: str) -> None:
        self.seconds()
        self._part = part

    def seconds(self) -> dict[str, float]:
        """Return the seconds so far by activity; their sum is the total wall time."""
        now = time.perf_counter()
        self._seconds[self._part] += now - self._since
        self._since = now
        return dict(self._seconds)
