"""Sensor suite of an environment: the sensors that observations and task require."""

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
    "detector",
    "airspeed",
)
"""Order in which the package's sensors measure and draw random numbers; others follow"""


def find_sensor(source: Any) -> Sensor:
    """Find a sensor by object, class, registered name, or `module:Name`.

    Raises:
        ValueError: If there is no such sensor, the object is not a sensor, or its class has an
            unknown public attribute.
    """
    found = find("sensor", source, _is_sensor)
    kind = found if isinstance(found, type) else type(found)
    require_declared("sensor", kind, Sensor)
    sensor: Sensor = found() if isinstance(found, type) else found
    return sensor


def _is_sensor(found: Any) -> bool:
    return isinstance(found, Sensor) or (isinstance(found, type) and issubclass(found, Sensor))


def known_sensors(given: Iterable[Any] = ()) -> dict[str, Sensor]:
    """Return all sensors by name: built-in, registered, and given ones.

    A given sensor replaces the registered sensor with the same name.

    Raises:
        ValueError: If two given sensors have the same name, or an object is not a sensor; the
            message names the option.
    """
    own: dict[str, Sensor] = {}
    for source in given:
        try:
            sensor = find_sensor(source)
        except ValueError as error:
            raise ValueError(f"sensors: {error}") from None
        if not isinstance(getattr(sensor, "name", None), str):
            raise ValueError(f"sensor {type(sensor).__name__} has no name: set name in its class")
        if sensor.name in own:
            raise ValueError(f"sensors has {sensor.name!r} twice: unique names are needed")
        own[sensor.name] = sensor
    order = [*ORDER, *(name for name in names("sensor") if name not in ORDER)]
    return {**{name: find_sensor(name) for name in order}, **own}


def uncertain_parameters(sensors: Mapping[str, Sensor]) -> dict[str, Uncertain]:
    """Return the sensor parameters that `randomization` can set, by option name."""
    return {
        f"{sensor.prefix}{key}": parameter
        for sensor in sensors.values()
        for key, parameter in sensor.uncertain.items()
    }


def provider(sensors: Mapping[str, Sensor], reading: str) -> Sensor | None:
    """Return the last sensor that provides an observable reading, or None."""
    setup = SensorSetup()
    found = [
        one for one in sensors.values() if reading in one.gives and reading in one.labels(setup)
    ]
    return found[-1] if found else None


class SensorSuite:
    """Sensors of an environment, in the order of measurement.

    Attributes:
        sensors: Active sensors by name.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        setup: SensorSetup,
        engine: Engine,
        drawn: Mapping[str, np.ndarray],
    ) -> None:
        """Attach the required sensors.

        Args:
            sensors: All available sensors by name.
            setup: Properties of the environment.
            engine: The physics engine.
            drawn: Parameters that `randomization` draws, by name: (W, N), or (W, 1) if per world.
                Sensors hold views of these arrays.
        """
        self.sensors: dict[str, Sensor] = {}
        self._labels: dict[str, Mapping[str, tuple[Label, ...] | Image]] = {}
        self._unchecked: set[str] = set()
        self._wanted = setup.wanted
        # Attach only sensors with a consumer
        for name, sensor in sensors.items():
            # Option names include the sensor's prefix
            uncertain = {f"{sensor.prefix}{key}": key for key in sensor.uncertain}
            # Tasks with targets need the lines of sight
            needed = bool(setup.wanted.intersection(sensor.gives))
            needed |= name == "sight" and setup.num_targets > 0
            # Some sensors change the known state even if they are not observed
            if not needed and not (
                sensor.always_if_uncertain and not drawn.keys().isdisjoint(uncertain)
            ):
                continue
            # Bind a copy to the environment; the given object does not change
            attached = sensor.attached(setup, engine)
            # Share the arrays, as resets write new values into them
            for public, key in uncertain.items():
                if public in drawn:
                    per_world = sensor.uncertain[key].per == "world"
                    setattr(attached, key, drawn[public][:, 0] if per_world else drawn[public])
            self.sensors[name] = attached
            self._labels[name] = attached.labels(setup)
            # The first measurement of each sensor is checked against its labels
            self._unchecked.add(name)
        self._last = next(reversed(self.sensors.values()), None)

    @property
    def needs_wind(self) -> bool:
        """Whether any sensor reads the wind."""
        return any(sensor.needs_wind for sensor in self.sensors.values())

    @property
    def keep_others(self) -> bool:
        """Whether a measurement in one world leaves all other readings unchanged."""
        return all(type(sensor) is Gps for sensor in self.sensors.values())

    def reset(self, world: int, swarm: Swarm, rng: np.random.Generator) -> None:
        """Reset all sensors in one world."""
        known = swarm
        for sensor in self.sensors.values():
            sensor.reset(world, swarm, known, rng)
            if sensor is self._last:  # no later sensor reads the known state
                return
            gps = unwrapped(sensor)
            if isinstance(gps, Gps):
                known = swarm._replace(position=gps.position, velocity=gps.velocity)

    def measure(
        self, moment: Moment, show: Callable[[Swarm, np.ndarray], None]
    ) -> dict[str, np.ndarray]:
        """Measure with all sensors.

        Args:
            moment: State, drones that measure, and random generators; its readings are updated.
            show: Function that moves the engine's bodies of the drones in a mask to their poses.

        Returns:
            All readings by name.

        Raises:
            ValueError: If the first readings of a sensor do not match its labels.
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
        """Return the arrays that determine the next readings, (W, ...) by name."""
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
        """Return the labels of all readings except images, by reading."""
        return {
            name: label
            for labels in self._labels.values()
            for name, label in labels.items()
            if not isinstance(label, Image)
        }

    def info(self) -> dict[str, np.ndarray]:
        """Return the entries of all sensors in infos, (W, N) by name."""
        return {key: value for one in self.sensors.values() for key, value in one.info().items()}


def reading_labels(
    sensors: Mapping[str, Sensor], reading: str, setup: SensorSetup
) -> tuple[Label, ...] | Image | None:
    """Return the labels of a reading, or None if no sensor provides it.

    Raises:
        ValueError: If the sensor has no labels for its reading.
    """
    sensor = provider(sensors, reading)
    if sensor is None:
        return None
    label = sensor.labels(setup).get(reading)
    if isinstance(label, tuple) and not isinstance(label, Image) and not label:
        raise ValueError(
            f"reading {reading!r} of sensor {shown(sensor.name)} has no numbers here: the task has "
            f"no targets, or the sensor has no labels (set `numbers`, one Label per number)"
        )
    return label
