"""Wrapper that adds sample rate, delay, noise and losses to any sensor."""

from collections.abc import Mapping

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import finite, shown
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

MAX_DELAY = 10.0
"""Maximum delay, s"""
MAX_VALUES = {"noise": 1e6, "loss": 1.0}
"""Maximum noise and loss"""


class Imperfect(Sensor):
    """Wrapper that adds sample rate, delay, noise and losses to a sensor.

    `Imperfect(Uwb(), rate=5, delay=0.2, noise=0.1, loss=0.05)` is used like any other sensor. Its
    noise and loss can be drawn for each episode with `randomization={"uwb_noise": (0.0, 0.2)}`. If
    the wrapped sensor has a parameter of the same name, that parameter is kept.

    The wrapped sensor measures at every decision, so that quantities which it integrates over time
    stay correct.
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
            sensor: The sensor.
            rate: Sample rate, 1/s; None for one sample per decision. The sample period is rounded
                to decisions, and the last sample is held in between.
            delay: Delay of the readings, s; rounded to decisions.
            noise: Standard deviation of white noise on every number, in its unit. Integers are
                rounded, Boolean readings get no noise.
            loss: Probability that a sample is lost; the last one is held in this case.

        Raises:
            ValueError: If a number is out of bounds, or the sensor already has such a parameter.
        """
        if not isinstance(sensor, Sensor):
            raise ValueError(f"sensor is {shown(sensor)}: an object derived from Sensor is needed")
        self.sensor = sensor
        self.name = sensor.name  # type: ignore[misc]  # name of the wrapped sensor
        self.gives = sensor.gives  # type: ignore[misc]
        self.prefix = sensor.prefix  # type: ignore[misc]
        self.always_if_uncertain = sensor.always_if_uncertain  # type: ignore[misc]
        self._keys: dict[str, str] = {}
        own: dict[str, Uncertain] = {}
        for what, given in (("noise", noise), ("loss", loss)):
            usual = finite(what, given, 0.0, MAX_VALUES[what])
            # The public name is always "uwb_noise", even if the sensor has another prefix.
            key = f"{sensor.name}_{what}".removeprefix(sensor.prefix)
            if key not in sensor.uncertain:
                own[key] = Uncertain(0.0, MAX_VALUES[what], usual)
                self._keys[what] = key
            elif usual:
                raise ValueError(f"sensor {sensor.name!r} has its own {what}: set it there")
        self.uncertain = {**sensor.uncertain, **own}  # type: ignore[misc]
        self._rate = None if rate is None else finite("rate", rate, least=1e-3)
        self._delay = finite("delay", delay, 0.0, MAX_DELAY)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels of the wrapped sensor."""
        return self.sensor.labels(setup)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Attach the wrapped sensor, and convert rate and delay to decisions."""
        super().attach(setup, engine)
        self.sensor = self.sensor.attached(setup, engine)
        self.needs_bodies = self.sensor.needs_bodies
        self.needs_wind = self.sensor.needs_wind
        self._images = {
            name: one for name, one in self.labels(setup).items() if isinstance(one, Image)
        }
        self._every = 1 if self._rate is None else max(1, round(1 / (self._rate * setup.period)))
        self._late = round(self._delay / setup.period)
        self._past: dict[str, np.ndarray] = {}  # (delay, W, N, ...), latest first

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Reset the wrapped sensor in one world."""
        self._pass_parameters()
        self.sensor.reset(world, swarm, known, rng)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure, store the sample, and return the sample from `delay` ago.

        Each world draws from its own generator if its noise or loss is above 0.
        """
        self._pass_parameters()
        true = self.sensor.measure(moment)
        noise, loss = self._parameter("noise"), self._parameter("loss")
        due = moment.mask & (moment.steps % self._every == 0)[:, None]
        uncertain = np.any((noise > 0) | (loss > 0), axis=1)[:, None]
        drawing = moment._replace(mask=due & uncertain)
        normal, chance = drawing.draw(sum(_width(one) for one in true.values()))
        # At a reset, the first sample is never lost, and fills the whole delay line.
        fresh = moment.mask & (moment.steps == 0)[:, None]
        comes = fresh | (due & (chance >= loss))
        flown = np.any(moment.mask, axis=1)
        late: dict[str, np.ndarray] = {}
        used = 0
        for name, reading in true.items():
            error = normal[..., used : used + _width(reading)].reshape(reading.shape)
            used += _width(reading)
            measured = self._add_noise(name, reading, noise, error)
            if name not in self._past:
                self._past[name] = np.stack([reading] * (self._late + 1))
            # Advance the delay line only in worlds that measure.
            past = self._past[name]
            past[1:, flown] = past[:-1, flown]
            past[0, comes] = measured[comes]
            past[:, fresh] = measured[fresh]
            late[name] = past[-1].copy()
        return late

    def info(self) -> Mapping[str, np.ndarray]:
        """Return the info entries of the wrapped sensor."""
        return self.sensor.info()

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return the state of the wrapped sensor, and the delayed samples."""
        past = {f"past {name}": array.swapaxes(0, 1) for name, array in self._past.items()}
        return {**super().kept(), **self.sensor.kept(), **past}

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the bounds of the wrapped sensor's state."""
        return self.sensor.kept_bounds()

    def _pass_parameters(self) -> None:
        """Pass the drawn parameters to the wrapped sensor."""
        for key in self.sensor.uncertain:
            setattr(self.sensor, key, getattr(self, key))

    def _parameter(self, what: str) -> np.ndarray:
        """Return noise or loss, (W, N)."""
        if what not in self._keys:
            return np.zeros(self.setup.shape)
        values: np.ndarray = getattr(self, self._keys[what])
        return values

    def _add_noise(
        self, name: str, reading: np.ndarray, noise: np.ndarray, error: np.ndarray
    ) -> np.ndarray:
        """Add noise to a reading; preserve its type, and clip images to their bounds."""
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
    """Return the number of values per drone."""
    return int(np.prod(reading.shape[2:]))


def unwrapped(sensor: Sensor) -> Sensor:
    """Return the innermost wrapped sensor."""
    while isinstance(sensor, Imperfect):
        sensor = sensor.sensor
    return sensor
