"""All sensors of an environment: those that its observations and its task ask for."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import shown
from bulletuav.registry import find, names, require_declared
from bulletuav.sensors.base import (
    Image,
    Label,
    Moment,
    Sensor,
    SensorSetup,
    Uncertain,
    check_readings,
)
from bulletuav.sensors.gps import Gps
from bulletuav.sensors.imperfect import unwrapped
from bulletuav.vehicle.swarm import Swarm

ORDER = (
    "gps",
    "radio",
    "imu",
    "lidar",
    "camera",
    "clearance",
    "sight",
    "sight_ahead",
    "barometer",
    "magnetometer",
    "optical_flow",
    "drone_sight",
)
"""In which the package's own sensors measure, and draw random numbers; others follow"""


def find_sensor(source: Any) -> Sensor:
    """Find a sensor: an object, a class, a registered name, or `module:Name`.

    Raises:
        ValueError: There is none of that name, it is no sensor, or its class has an unknown public
            attribute.
    """
    found = find("sensor", source, _is_sensor)
    kind = found if isinstance(found, type) else type(found)
    require_declared("sensor", kind, Sensor)
    sensor: Sensor = found() if isinstance(found, type) else found
    return sensor


def _is_sensor(found: Any) -> bool:
    return isinstance(found, Sensor) or (isinstance(found, type) and issubclass(found, Sensor))


def known_sensors(given: Iterable[Any] = ()) -> dict[str, Sensor]:
    """List all sensors by name: the package's own and registered ones, and those that were given.

    A given sensor replaces the registered one of its name.

    Raises:
        ValueError: Two given sensors bear the same name, or one is none; the option is named.
    """
    own: dict[str, Sensor] = {}
    for source in given:
        try:
            sensor = find_sensor(source)
        except ValueError as error:
            raise ValueError(f"sensors: {error}") from None
        if not isinstance(getattr(sensor, "name", None), str):
            raise ValueError(f"sensor {type(sensor).__name__} has no name: give its class one")
        if sensor.name in own:
            raise ValueError(f"sensors has {sensor.name!r} twice: give each a name of its own")
        own[sensor.name] = sensor
    order = [*ORDER, *(name for name in names("sensor") if name not in ORDER)]
    return {**{name: find_sensor(name) for name in order}, **own}


def uncertain_parameters(sensors: Mapping[str, Sensor]) -> dict[str, Uncertain]:
    """List what `randomization` can set of sensors, by the names that it uses."""
    return {
        f"{sensor.prefix}{key}": parameter
        for sensor in sensors.values()
        for key, parameter in sensor.uncertain.items()
    }


def provider(sensors: Mapping[str, Sensor], reading: str) -> Sensor | None:
    """Find the sensor whose reading can be observed, the last of several; else None."""
    setup = SensorSetup()
    found = [
        one for one in sensors.values() if reading in one.gives and reading in one.labels(setup)
    ]
    return found[-1] if found else None


class SensorSuite:
    """The sensors of an environment, in the order in which they measure.

    Attributes:
        sensors: Those that work, by name.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        setup: SensorSetup,
        engine: Engine,
        drawn: Mapping[str, np.ndarray],
    ) -> None:
        """Attach the sensors that are needed.

        Args:
            sensors: All that there are, by name.
            setup: What they know of their environment.
            engine: The engine in which drones fly.
            drawn: What `randomization` draws, by name: (W, N), or (W, 1) for worlds. Sensors read
                these arrays where they stand.
        """
        self.sensors: dict[str, Sensor] = {}
        self._labels: dict[str, Mapping[str, tuple[Label, ...] | Image]] = {}
        self._unchecked: set[str] = set()
        self._wanted = setup.wanted
        # Only sensors that somebody reads cost time
        for name, sensor in sensors.items():
            # Names that users write carry the sensor's prefix
            uncertain = {f"{sensor.prefix}{key}": key for key in sensor.uncertain}
            # Tasks with targets need to know who sees them
            needed = bool(setup.wanted.intersection(sensor.gives))
            needed |= name == "sight" and setup.num_targets > 0
            # Some change what drones know even where nobody reads them
            if not needed and not (
                sensor.always_if_uncertain and not drawn.keys().isdisjoint(uncertain)
            ):
                continue
            # A copy that knows its environment; the one given stays as it is
            attached = sensor.attached(setup, engine)
            # Arrays that resets write into, not copies of them
            for public, key in uncertain.items():
                if public in drawn:
                    per_world = sensor.uncertain[key].per == "world"
                    setattr(attached, key, drawn[public][:, 0] if per_world else drawn[public])
            self.sensors[name] = attached
            self._labels[name] = attached.labels(setup)
            # The first measurement of each is checked against its labels
            self._unchecked.add(name)
        self._last = next(reversed(self.sensors.values()), None)

    @property
    def keep_others(self) -> bool:
        """Whether what drones of one world measure leaves the readings of all others alone."""
        return all(type(sensor) is Gps for sensor in self.sensors.values())

    def reset(self, world: int, swarm: Swarm, rng: np.random.Generator) -> None:
        """Begin a new episode of one world."""
        known = swarm
        for sensor in self.sensors.values():
            sensor.reset(world, swarm, known, rng)
            if sensor is self._last:  # nobody is left to know it
                return
            gps = unwrapped(sensor)
            if isinstance(gps, Gps):
                known = swarm._replace(position=gps.position, velocity=gps.velocity)

    def measure(
        self, moment: Moment, show: Callable[[Swarm, np.ndarray], None]
    ) -> dict[str, np.ndarray]:
        """Measure with all sensors.

        Args:
            moment: State, drones that measure, and random generators; its readings are filled.
            show: Put the engine's bodies of some drones where the swarm is.

        Returns:
            All readings by name.

        Raises:
            ValueError: A sensor gave something else than its labels promise (looked at once).
        """
        shown_bodies = False
        for name, sensor in self.sensors.items():
            if sensor.needs_bodies and not shown_bodies:
                show(moment.after, moment.mask)
                shown_bodies = True
            readings = sensor.measure(moment)
            if name in self._unchecked:
                check_readings(sensor, self._labels[name], self._wanted, readings, moment)
                self._unchecked.discard(name)
            moment.readings.update(readings)
        return moment.readings

    def kept(self) -> dict[str, np.ndarray]:
        """Tell the arrays that the next readings follow from, (W, ...) by name."""
        return {
            f"{name} {key}": array
            for name, sensor in self.sensors.items()
            for key, array in sensor.kept().items()
        }

    def kept_bounds(self) -> dict[str, tuple[float, float]]:
        """Return the bounds of counts and indices in `kept`, by name."""
        return {
            f"{name} {key}": bounds
            for name, sensor in self.sensors.items()
            for key, bounds in sensor.kept_bounds().items()
        }

    def numbers(self) -> dict[str, tuple[Label, ...]]:
        """Tell the labels of all readings but pictures, by the readings' names."""
        return {
            name: label
            for labels in self._labels.values()
            for name, label in labels.items()
            if not isinstance(label, Image)
        }

    def info(self) -> dict[str, np.ndarray]:
        """Tell what infos say of sensors, (W, N) by name."""
        return {key: value for one in self.sensors.values() for key, value in one.info().items()}


def reading_labels(
    sensors: Mapping[str, Sensor], reading: str, setup: SensorSetup
) -> tuple[Label, ...] | Image | None:
    """Tell what a reading is; None where no sensor has labels for it.

    Raises:
        ValueError: A sensor tells no labels for what it gives.
    """
    sensor = provider(sensors, reading)
    if sensor is None:
        return None
    label = sensor.labels(setup).get(reading)
    if isinstance(label, tuple) and not isinstance(label, Image) and not label:
        raise ValueError(
            f"reading {reading!r} of sensor {shown(sensor.name)} has no numbers here: the task has "
            f"no targets, or the sensor tells no labels (give it `numbers`, one Label for each)"
        )
    return label
