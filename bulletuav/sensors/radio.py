"""Broadcast of positions and velocities between drones, with delay, range and losses."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.engine.engine import Engine
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

MEMORY = 1.0
"""s; a drone that has not been received for longer is forgotten"""


@kernel
def _deliver_messages(
    sent: np.ndarray,
    earlier: np.ndarray,
    between: float,
    position: np.ndarray,
    range_: float,
    loss: float,
    chance: np.ndarray,
    flying: np.ndarray,
    delay: float,
    period: float,
    start: bool,
    message: np.ndarray,
    age: np.ndarray,
    received: np.ndarray,
) -> None:
    """Deliver messages (N, 6) between all pairs (i, j) of one world; see `Radio`."""
    drones = flying.shape[0]
    for i in range(drones):
        received[i] = 0
        for j in range(drones):
            age[i, j] += period
            if i == j or not (flying[i] and flying[j]):
                continue
            # Skip senders out of range, and lost messages.
            square = 0.0
            for k in range(3):
                square += (position[j, k] - position[i, k]) ** 2
            if square > range_ * range_ or (chance[i, j] < loss and not start):
                continue
            # State of the sender `delay` ago, interpolated between two decisions.
            for k in range(6):
                message[i, j, k] = sent[j, k] + between * (earlier[j, k] - sent[j, k])
            age[i, j] = delay
            received[i] += 1


@register("sensor")
class Radio(Sensor):
    """Broadcast of each drone's own position and velocity, as the drone knows them, to all others.

    At a decision, drone i receives the state that drone j knew `delay` ago, interpolated between
    two decisions, if j is within `range` and the message is not lost. Otherwise the last received
    message is held for up to a second.

    Attributes:
        delay: (W,) delay, s.
        loss: (W,) probability that a message is lost.
        range: (W,) radio range, m.
        message: (W, N, N, 6) position and velocity that i last received from j.
        received: (W, N) number of messages received in the last decision.
    """

    name = "radio"
    gives = ("heard", "heard_position", "heard_velocity")
    uncertain: ClassVar = {
        "delay": Uncertain(0.0, 10.0, per="world"),
        "loss": Uncertain(0.0, 1.0, per="world"),
        "range": Uncertain(0.0, np.inf, usual=np.inf, per="world"),
    }
    always_if_uncertain = True

    delay: np.ndarray
    loss: np.ndarray
    range: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return no labels: the observation blocks of other drones use these readings."""
        return {}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate messages in transit and received messages."""
        super().attach(setup, engine)
        worlds, drones = setup.shape
        past = 2 + int(setup.longest_delay / setup.period)
        self._sent = np.zeros((past, worlds, drones, 6))  # latest first
        self.message = np.zeros((worlds, drones, drones, 6))
        self._age = np.full((worlds, drones, drones), np.inf)
        self.received = np.zeros(setup.shape, dtype=np.int64)

    @property
    def heard(self) -> np.ndarray:
        """(W, N, N) bool: pairs whose last message is at most a second (plus the delay) old."""
        known: np.ndarray = self._age <= MEMORY + self.delay[:, None, None]
        return known

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Reset one world: all drones in range have received the current states."""
        state = np.concatenate([known.position[world], known.velocity[world]], axis=-1)
        self._sent[:, world] = state
        self._age[world] = np.inf
        everyone = np.ones(self.setup.shape[1], dtype=bool)
        self._deliver(world, swarm.position[world], everyone, rng, start=True)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Send and receive messages in the worlds that executed a decision."""
        for k in np.flatnonzero(moment.flying).tolist():
            self._sent[1:, k] = self._sent[:-1, k]
            self._sent[0, k] = np.concatenate([moment.position[k], moment.velocity[k]], axis=-1)
            place, mask = moment.after.position[k], moment.mask[k]
            self._deliver(k, place, mask, moment.rngs[k], start=False)
        message = self.message.copy()
        heard = {"heard_position": message[..., :3], "heard_velocity": message[..., 3:]}
        return {**heard, "heard": self.heard}

    def info(self) -> Mapping[str, np.ndarray]:
        """Return the number of messages received in the last decision."""
        return {"messages": self.received}

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return received messages and messages in transit; see the base class."""
        arrays = {"message": self.message, "age": self._age, "received": self.received}
        return {**arrays, "sent": self._sent.swapaxes(0, 1)}

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the bounds of the number of messages; see the base class."""
        return {"received": (0, self.setup.shape[1])}

    def _deliver(
        self,
        world: int,
        position: np.ndarray,
        flying: np.ndarray,
        rng: np.random.Generator,
        *,
        start: bool,
    ) -> None:
        # The delayed state lies between two stored states: whole steps and fraction
        steps, between = divmod(self.delay[world] / self.setup.period, 1)
        # One number per pair, flying or not, so that the sequence does not depend on the mask
        chance = rng.random((len(flying), len(flying)))
        _deliver_messages(
            self._sent[int(steps), world],
            self._sent[int(steps) + 1, world],
            between,
            position,
            self.range[world],
            self.loss[world],
            chance,
            flying,
            self.delay[world],
            self.setup.period,
            start,
            self.message[world],
            self._age[world],
            self.received[world],
        )
