"""Any sensor with a rate, a delay, noise and losses of its own."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import finite, shown
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

Numbers = Mapping[str, np.ndarray]


class Imperfect(Sensor):
    """Wrap a sensor: it measures at its own rate, late, with white noise, and sometimes not at all.

    `Imperfect(Uwb(), rate=5, delay=0.2, noise=0.1, loss=0.05)` is a sensor as any other. Its noise
    and loss can be drawn anew for each episode, by `randomization={"uwb_noise": (0.0, 0.2)}`. A
    sensor that has such a parameter of its own keeps it, and gets the rest.
    """

    name = "imperfect"
    uncertain: ClassVar = {"noise": Uncertain(0.0, 1e6), "loss": Uncertain(0.0, 1.0)}

    noise: np.ndarray
    loss: np.ndarray

    def __init__(
        self,
        sensor: Sensor,
        *,
        rate: float | None = None,
        delay: float = 0.0,
        noise: float = 0.0,
        loss: float = 0.0,
    ) -> None:
        """Wrap a sensor.

        Args:
            sensor: What measures.
            rate: Measurements a second; None for one a decision. Between them the last one stays.
            delay: How late readings come, s; rounded to decisions.
            noise: Standard deviation of white noise on every number, in its own unit.
            loss: Probability that a measurement fails; then the last one stays.

        Raises:
            ValueError: A number is not possible, or is given for what the sensor has itself.
        """
        if not isinstance(sensor, Sensor):
            raise ValueError(f"sensor is {shown(sensor)}: an object derived from Sensor is needed")
        self.sensor = sensor
        self.name = sensor.name  # type: ignore[misc]  # that of what is wrapped
        self.gives = sensor.gives  # type: ignore[misc]
        self.prefix = f"{sensor.name}_"  # type: ignore[misc]
        self.needs_bodies = sensor.needs_bodies  # type: ignore[misc]
        own = {
            "noise": Uncertain(0.0, 1e6, finite("noise", noise, 0.0, 1e6)),
            "loss": Uncertain(0.0, 1.0, finite("loss", loss, 0.0, 1.0)),
        }
        for name, parameter in own.items():
            if name in sensor.uncertain and parameter.usual:
                raise ValueError(f"sensor {sensor.name!r} has its own {name}: set it there")
        self._own = frozenset(own) - frozenset(sensor.uncertain)
        self.uncertain = {**own, **sensor.uncertain}  # type: ignore[misc]
        self._rate = None if rate is None else finite("rate", rate, least=1e-3)
        self._delay = finite("delay", delay, least=0.0)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell what the wrapped sensor gives."""
        return self.sensor.labels(setup)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Attach the wrapped sensor, and find out how many decisions rate and delay are."""
        super().attach(setup, engine)
        self.sensor = self.sensor.attached(setup, engine)
        self._every = 1 if self._rate is None else max(1, round(1 / (self._rate * setup.period)))
        self._late = round(self._delay / setup.period)
        self._past: list[dict[str, np.ndarray]] = []

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Begin an episode of the wrapped sensor."""
        self._hand_on()
        self.sensor.reset(world, swarm, known, rng)

    def _hand_on(self) -> None:
        """Give the wrapped sensor its uncertain parameters, which are drawn for this one."""
        for key in self.sensor.uncertain:
            setattr(self.sensor, key, getattr(self, key))

    def measure(self, moment: Moment) -> Numbers:
        """Measure where it is time to, and give what was measured `delay` ago."""
        self._hand_on()
        due = moment.mask & (moment.steps % self._every == 0)[:, None]
        true = self.sensor.measure(moment._replace(mask=due)) if due.any() else {}
        normal, luck = moment._replace(mask=due).draw(sum(_width(one) for one in true.values()))
        # At a reset the first reading comes, and everything before it is as it is.
        fresh = due & (moment.steps == 0)[:, None]
        loss = self.loss if "loss" in self._own else np.zeros(due.shape)
        noise = self.noise if "noise" in self._own else np.zeros(due.shape)
        comes = fresh | (due & (luck >= loss))
        new: dict[str, np.ndarray] = {}
        used = 0
        for name, reading in true.items():
            error = normal[..., used : used + _width(reading)].reshape(reading.shape)
            used += _width(reading)
            last = self._past[0][name] if self._past else np.zeros(reading.shape)
            noisy = reading + _like(noise, reading) * error
            new[name] = np.where(_like(comes, reading), noisy, last)
        self._remember(new or dict(self._past[0]), fresh, np.any(moment.mask, axis=1))
        return {name: array.copy() for name, array in self._past[-1].items()}

    def _remember(self, new: dict[str, np.ndarray], fresh: np.ndarray, flying: np.ndarray) -> None:
        """Keep the newest readings, before those that are still on their way.

        Args:
            new: Readings by name.
            fresh: (W, N) drones whose episode begins: nothing of theirs is on its way.
            flying: (W,) worlds in which time passed, or that were reset; others stay as they are.
        """
        before = self._past or [new] * (self._late + 1)
        self._past = []
        for k in range(self._late + 1):
            older = before[k - 1] if k else new
            past = {}
            for name, reading in new.items():
                moved = np.where(_like(flying[:, None], reading), older[name], before[k][name])
                past[name] = np.where(_like(fresh, reading), reading, moved)
            self._past.append(past)

    def info(self) -> Numbers:
        """Tell what the wrapped sensor tells."""
        return self.sensor.info()


def _width(reading: np.ndarray) -> int:
    """Count the numbers of one drone."""
    return int(np.prod(reading.shape[2:]))


def _like(array: np.ndarray, reading: np.ndarray) -> np.ndarray:
    """Give an array (W, N) as many axes as a reading has."""
    return array.reshape(array.shape + (1,) * (reading.ndim - 2))
