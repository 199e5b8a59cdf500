"""Losses and delay of the datagrams between a drone and its clients."""

from collections import deque
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.radio_loss import RadioLoss
from bulletuav.errors import finite

MAX_DELAY = 10.0
"""Maximum delay, s"""
MAX_WAITING = 1000
"""Maximum number of delayed datagrams in one direction; more are lost"""
Address = tuple[str, int]
Datagram = tuple[bytes, Address]


class LinkQuality(NamedTuple):
    """Quality of the links between drones and clients.

    Attributes:
        loss: Probability that a datagram is lost, in each direction; or a model of it.
        delay: Time from sending to receiving, in each direction, simulated s.
        seed: Seed of the losses; None for a random one.
    """

    loss: float | RadioLoss = 0.0
    delay: float = 0.0
    seed: int | None = None

    @property
    def is_ideal(self) -> bool:
        """Whether all datagrams arrive immediately."""
        return not self.loss and not self.delay

    def check(self) -> None:
        """Raise ValueError if a number is invalid."""
        if not isinstance(self.loss, RadioLoss):
            finite("loss", self.loss, 0.0, 1.0)
        finite("delay", self.delay, 0.0, MAX_DELAY)


IDEAL = LinkQuality()
"""Links without losses and delay"""


class LossyLink:
    """One direction of a drone's link.

    Datagrams are lost independently, in the order in which they are sent; delays are rounded up to
    whole steps.
    """

    def __init__(self, quality: LinkQuality, period: float, stream: tuple[int, int]) -> None:
        """Initialise without datagrams.

        Args:
            quality: Quality of the link.
            period: Duration of a step, s.
            stream: Index of the drone, and of the direction; they select the random numbers.
        """
        self._loss, self._drone = quality.loss, stream[0]
        self._steps = int(np.ceil(quality.delay / period - 1e-9))
        seed = np.random.SeedSequence(quality.seed, spawn_key=stream)
        self._rng = np.random.default_rng(seed)
        self._waiting: deque[tuple[int, Datagram]] = deque()

    def put(self, datagram: Datagram, step: int) -> None:
        """Send a datagram at a step."""
        loss = self._loss
        if isinstance(loss, RadioLoss):
            loss = loss.probability(self._drone, len(datagram[0]))
        if self._rng.random() >= loss and len(self._waiting) < MAX_WAITING:
            self._waiting.append((step + self._steps, datagram))

    def has_due(self, step: int) -> bool:
        """Return True if a datagram has arrived at a step."""
        return bool(self._waiting) and self._waiting[0][0] <= step

    def get(self, step: int) -> Datagram | None:
        """Return the next datagram that has arrived at a step, or None."""
        return self._waiting.popleft()[1] if self.has_due(step) else None
