"""Any sensor with a rate, a delay, noise and losses of its own."""

from collections.abc import Mapping

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import finite, shown
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

MOST_DELAY = 10.0
"""s"""
MOST = {"noise": 1e6, "loss": 1.0}
"""Largest noise and loss"""


class Imperfect(Sensor):
    """Wrap a sensor: readings come at a rate of their own, late, noisy, and sometimes not at all.

    `Imperfect(Uwb(), rate=5, delay=0.2, noise=0.1, loss=0.05)` is a sensor as any other. Its noise
    and loss can be drawn anew for each episode, by `randomization={"uwb_noise": (0.0, 0.2)}`. A
    sensor that has such a parameter already keeps its own.

    What is wrapped measures at every decision, as it does alone, so that what it accumulates over
    time is right.
    """

    name = "imperfect"

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
            rate: Readings a second; None for one a decision. The time from one to the next is
                rounded to decisions, and until then the last one stays.
            delay: How late readings come, s; rounded to decisions.
            noise: Standard deviation of white noise on every number, in its own unit. Whole numbers
                stay whole, truths stay true or false without noise.
            loss: Probability that a reading fails; then the last one stays.

        Raises:
            ValueError: A number is not possible, or the sensor has such a parameter already.
        """
        if not isinstance(sensor, Sensor):
            raise ValueError(f"sensor is {shown(sensor)}: an object derived from Sensor is needed")
        self.sensor = sensor
        self.name = sensor.name  # type: ignore[misc]  # that of what is wrapped
        self.gives = sensor.gives  # type: ignore[misc]
        self.prefix = sensor.prefix  # type: ignore[misc]
        self.needs_bodies = sensor.needs_bodies  # type: ignore[misc]
        self.always_if_uncertain = sensor.always_if_uncertain  # type: ignore[misc]
        self._keys: dict[str, str] = {}
        own: dict[str, Uncertain] = {}
        for what, given in (("noise", noise), ("loss", loss)):
            usual = finite(what, given, 0.0, MOST[what])
            # "uwb_noise", whatever the sensor puts before the names of its other parameters.
            key = f"{sensor.name}_{what}".removeprefix(sensor.prefix)
            if key not in sensor.uncertain:
                own[key] = Uncertain(0.0, MOST[what], usual)
                self._keys[what] = key
            elif usual:
                raise ValueError(f"sensor {sensor.name!r} has its own {what}: set it there")
        self.uncertain = {**sensor.uncertain, **own}  # type: ignore[misc]
        self._rate = None if rate is None else finite("rate", rate, least=1e-3)
        self._delay = finite("delay", delay, 0.0, MOST_DELAY)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell what the wrapped sensor gives."""
        return self.sensor.labels(setup)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Attach the wrapped sensor, and find out how many decisions rate and delay are."""
        super().attach(setup, engine)
        self.sensor = self.sensor.attached(setup, engine)
        self._images = {
            name: one for name, one in self.labels(setup).items() if isinstance(one, Image)
        }
        self._every = 1 if self._rate is None else max(1, round(1 / (self._rate * setup.period)))
        self._late = round(self._delay / setup.period)
        self._past: dict[str, np.ndarray] = {}  # (delay, W, N, ...), the latest first

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Begin an episode of the wrapped sensor."""
        self._share()
        self.sensor.reset(world, swarm, known, rng)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure, keep what comes, and give what came `delay` ago.

        Each world draws from its own generator, if its noise or loss is above 0.
        """
        self._share()
        true = self.sensor.measure(moment)
        noise, loss = self._own("noise"), self._own("loss")
        due = moment.mask & (moment.steps % self._every == 0)[:, None]
        uncertain = np.any((noise > 0) | (loss > 0), axis=1)[:, None]
        drawing = moment._replace(mask=due & uncertain)
        normal, luck = drawing.draw(sum(_width(one) for one in true.values()))
        # At a reset the first reading comes, and everything before it is as it is.
        fresh = moment.mask & (moment.steps == 0)[:, None]
        comes = fresh | (due & (luck >= loss))
        flown = np.any(moment.mask, axis=1)
        late: dict[str, np.ndarray] = {}
        used = 0
        for name, reading in true.items():
            error = normal[..., used : used + _width(reading)].reshape(reading.shape)
            used += _width(reading)
            measured = self._blurred(name, reading, noise, error)
            if name not in self._past:
                self._past[name] = np.stack([reading] * (self._late + 1))
            # Time goes on in the worlds that measure alone.
            past = self._past[name]
            past[1:, flown] = past[:-1, flown]
            past[0, comes] = measured[comes]
            past[:, fresh] = measured[fresh]
            late[name] = past[-1].copy()
        return late

    def info(self) -> Mapping[str, np.ndarray]:
        """Tell what the wrapped sensor tells."""
        return self.sensor.info()

    def kept(self) -> Mapping[str, np.ndarray]:
        """Tell what the wrapped sensor keeps, and readings that are on their way."""
        past = {f"past {name}": array.swapaxes(0, 1) for name, array in self._past.items()}
        return {**super().kept(), **self.sensor.kept(), **past}

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the bounds of what the wrapped sensor keeps."""
        return self.sensor.kept_bounds()

    def _share(self) -> None:
        """Let the wrapped sensor work with what was drawn for it."""
        for key in self.sensor.uncertain:
            setattr(self.sensor, key, getattr(self, key))

    def _own(self, what: str) -> np.ndarray:
        """Look up noise or loss, (W, N)."""
        if what not in self._keys:
            return np.zeros(self.setup.shape)
        values: np.ndarray = getattr(self, self._keys[what])
        return values

    def _blurred(
        self, name: str, reading: np.ndarray, noise: np.ndarray, error: np.ndarray
    ) -> np.ndarray:
        """Add noise to a reading, which keeps its type; pictures stay within their bounds."""
        if reading.dtype == bool or not noise.any():
            return reading
        blurred = reading + noise.reshape(noise.shape + (1,) * (reading.ndim - 2)) * error
        if name in self._images:
            blurred = np.clip(blurred, self._images[name].low, self._images[name].high)
        if reading.dtype.kind in "iu":
            blurred = np.rint(blurred)
        kept: np.ndarray = blurred.astype(reading.dtype)
        return kept


def _width(reading: np.ndarray) -> int:
    """Count the numbers of one drone."""
    return int(np.prod(reading.shape[2:]))


def unwrapped(sensor: Sensor) -> Sensor:
    """Take off what is wrapped around a sensor."""
    while isinstance(sensor, Imperfect):
        sensor = sensor.sensor
    return sensor
