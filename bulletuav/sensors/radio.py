"""Drones tell each other where they are: messages with a delay, a range and losses."""

import numpy as np

from bulletuav.kernel import kernel

MEMORY = 1.0  # s; a drone that was not heard for longer is forgotten


@kernel
def _hear(
    sent,
    earlier,
    between,
    position,
    range_,
    loss,
    luck,
    flying,
    delay,
    period,
    start,
    message,
    age,
    received,
):
    """Deliver messages (N, 6) to all pairs (i, j) of one world; see `Radio`."""
    drones = flying.shape[0]
    for i in range(drones):
        received[i] = 0
        for j in range(drones):
            age[i, j] += period
            if i == j or not (flying[i] and flying[j]):
                continue
            square = 0.0
            for k in range(3):
                square += (position[j, k] - position[i, k]) ** 2
            if square > range_ * range_ or (luck[i, j] < loss and not start):
                continue
            for k in range(6):
                message[i, j, k] = sent[j, k] + between * (earlier[j, k] - sent[j, k])
            age[i, j] = delay
            received[i] += 1


class Radio:
    """Every drone always tells the others its position and velocity, as far as it knows them.

    At a decision drone i hears what drone j knew `delay` ago (between two decisions: interpolated), if j is within `range`
    and the message is not lost; otherwise what it heard last stays, for up to a second.

    delay, loss, range  (W,) s, probability, m
    message   (W, N, N, 6) what i last heard of j
    heard     (W, N, N) whom i has heard of
    received  (W, N) messages that came in the last decision
    """

    def __init__(self, shape: tuple[int, int], period: float, longest: float):
        """`period` between decisions, `longest` delay, s."""
        worlds, drones = shape
        self.delay, self.loss = np.zeros((2, worlds))
        self.range = np.full(worlds, np.inf)
        self._period = period
        self._sent = np.zeros((2 + int(longest / period), worlds, drones, 6))  # the latest first
        self.message = np.zeros((worlds, drones, drones, 6))
        self._age = np.full((worlds, drones, drones), np.inf)
        self.received = np.zeros(shape, dtype=np.int64)

    @property
    def heard(self) -> np.ndarray:
        """(W, N, N) whose last message is at most a second (and the delay) old."""
        return self._age <= MEMORY + self.delay[:, None, None]

    def start(
        self, k: int, known: np.ndarray, position: np.ndarray, rng: np.random.Generator
    ) -> None:
        """World k begins: all within range have heard of each other, as they are."""
        self._sent[:, k] = known
        self._age[k] = np.inf
        self._deliver(k, position, np.ones(len(position), dtype=bool), rng, True)

    def hear(
        self,
        k: int,
        known: np.ndarray,
        position: np.ndarray,
        flying: np.ndarray,
        rng: np.random.Generator,
    ) -> None:
        """One decision of world k later: drones know (N, 6) of themselves and are at `position` (N, 3)."""
        self._sent[1:, k] = self._sent[:-1, k]
        self._sent[0, k] = known
        self._deliver(k, position, flying, rng, False)

    def _deliver(
        self,
        k: int,
        position: np.ndarray,
        flying: np.ndarray,
        rng: np.random.Generator,
        start: bool,
    ) -> None:
        steps, between = divmod(self.delay[k] / self._period, 1)
        luck = rng.random((len(flying), len(flying)))
        _hear(
            self._sent[int(steps), k],
            self._sent[int(steps) + 1, k],
            between,
            position,
            self.range[k],
            self.loss[k],
            luck,
            flying,
            self.delay[k],
            self._period,
            start,
            self.message[k],
            self._age[k],
            self.received[k],
        )
