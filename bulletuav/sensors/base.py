"""Base class of sensors, and the data that sensors exchange with the environment."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import shown
from bulletuav.geometry.view import FAR
from bulletuav.sensors.mounts import FORWARD, Mounts
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm


class Label(NamedTuple):
    """Name, unit and bounds of an observed number; values are clipped to the bounds.

    Attributes:
        name: Quantity, such as "velocity x".
        unit: Unit, "1" for none.
        low: Lower bound.
        high: Upper bound.
    """

    name: str
    unit: str
    low: float
    high: float


def vector_labels(
    name: str, unit: str, low: Iterable[float], high: Iterable[float]
) -> tuple[Label, ...]:
    """Return the labels of the x, y and z components of a vector."""
    bounds = zip("xyz", low, high, strict=True)
    return tuple(
        Label(f"{name} {axis}", unit, minimum, maximum) for axis, minimum, maximum in bounds
    )


class Image(NamedTuple):
    """Bounds and type of an observed image.

    Attributes:
        low: Lower bound of a pixel.
        high: Upper bound of a pixel.
        dtype: NumPy type of a pixel.
        pixel: Shape of a pixel, () for one number.
        stack: Shape of a stack of images, such as (cameras,); () for a single image.
    """

    low: float
    high: float
    dtype: Any
    pixel: tuple[int, ...]
    stack: tuple[int, ...] = ()


class Uncertain(NamedTuple):
    """Parameter of a sensor that option `randomization` can set or draw.

    Attributes:
        least: Minimum valid value.
        most: Maximum valid value.
        usual: Default value.
        per: Whether a value is drawn for each drone or for each world.
    """

    least: float
    most: float
    usual: float = 0.0
    per: Literal["drone", "world"] = "drone"


@dataclass(frozen=True)
class SensorSetup:
    """Properties of the environment that sensors know before the engine exists.

    Attributes:
        shape: Number of worlds and of drones, (W, N).
        period: Time between decisions, s.
        gravity: Gravitational acceleration at the start of an episode, m/s^2.
        radius: (N,) collision radius of each drone, m.
        max_range: Range of range finder and clearance, m.
        beams: Directions of the range finder's beams.
        beam_frame: "yaw" for beams that turn with the drone, "world" for fixed beams.
        camera: "compiled" for the cameras' rasteriser, or "bullet" for PyBullet's.
        camera_size: Width and height of images, pixels.
        camera_every: Number of decisions between images.
        camera_range: Nearest and farthest depth, m.
        camera_depth: "metres", "linear" or "inverse"; see `EnvOptions`.
        camera_mounts: Mount of each drone's camera, or mounts of its cameras.
        num_neighbours: Number of other drones that are observed.
        num_targets: Number of targets of the task, U.
        target_radius: Radius of the bodies around the targets, m; 0 for points.
        arena: Lower and upper corner (3,) of the arena, m.
        wanted: Readings that are observed or required by the task.
        longest_delay: Maximum delay of messages between drones, s.
        longest_picture_delay: Maximum delay of pictures, s.
    """

    shape: tuple[int, int] = (1, 1)
    period: float = 0.1
    gravity: float = STANDARD_GRAVITY
    radius: tuple[float, ...] = ()
    max_range: float = 60.0
    beams: tuple[tuple[float, float], ...] = ()
    beam_frame: str = "yaw"
    camera: str = "compiled"
    camera_size: tuple[int, int] = (64, 48)
    camera_every: int = 1
    camera_range: tuple[float, float] = (0.0, FAR)
    camera_depth: str = "metres"
    camera_mounts: Mounts = FORWARD
    num_neighbours: int = 3
    num_targets: int = 0
    target_radius: float = 0.0
    arena: tuple[np.ndarray, np.ndarray] = (np.full(3, -1e3), np.full(3, 1e3))
    wanted: frozenset[str] = frozenset()
    longest_delay: float = 0.0
    longest_picture_delay: float = 0.0


class Moment(NamedTuple):
    """State of the environment at a measurement: after a decision, or after a reset.

    Attributes:
        before: State of the swarm before the decision; equal to `after` at a reset.
        after: Current state of the swarm.
        targets: (W, U, 3) targets of the task, m.
        mask: (W, N) drones that measure: drones that executed the decision, or were reset.
        steps: (W,) decisions since the reset of each world, 0 at the reset itself.
        rngs: Random generator of each world; draw numbers of a world from its own generator only.
        readings: Readings of earlier sensors at this moment, by name.
        action: (W, N, A) actions of the decision; without numbers in an airspace.
        gravity: (W, N) gravitational acceleration that acts on the drones, m/s^2; None for that of
            the setup.
        wind: (W, N, 3) velocity of the air at the drones, world axes, m/s; None if no sensor needs
            it.
    """

    before: Swarm
    after: Swarm
    targets: np.ndarray
    mask: np.ndarray
    steps: np.ndarray
    rngs: Sequence[np.random.Generator]
    readings: dict[str, np.ndarray]
    action: np.ndarray
    gravity: np.ndarray | None = None
    wind: np.ndarray | None = None

    @property
    def position(self) -> np.ndarray:
        """(W, N, 3) positions as the drones know them, m."""
        return self.readings.get("position", self.after.position)

    @property
    def velocity(self) -> np.ndarray:
        """(W, N, 3) velocities as the drones know them, m/s."""
        return self.readings.get("velocity", self.after.velocity)

    @property
    def flying(self) -> np.ndarray:
        """(W,) worlds that executed a decision; excludes worlds that were just reset."""
        flown: np.ndarray = np.any(self.mask, axis=1) & (self.steps > 0)
        return flown

    def draw(self, width: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Draw random numbers for all drones of the worlds that measure.

        Each world draws from its own generator.

        Args:
            width: Number of normal numbers per drone.

        Returns:
            Standard normal numbers (W, N, width) and uniform numbers (W, N) in [0, 1); zeros in
            worlds that do not measure.
        """
        normal, uniform = np.zeros((*self.mask.shape, width)), np.zeros(self.mask.shape)
        for k in np.flatnonzero(np.any(self.mask, axis=1)).tolist():
            self.rngs[k].standard_normal(out=normal[k])
            self.rngs[k].random(out=uniform[k])
        return normal, uniform


class Sensor(ABC):
    """Base class of sensors. Each drone carries every sensor of the environment.

    Subclasses set `name` and `numbers`, and implement `measure`:

        class Uwb(Sensor):
            name = "uwb"
            numbers = (Label("distance to anchor", "m", 0.0, 500.0),)
            uncertain = {"noise": Uncertain(0.0, 10.0)}

            def measure(self, moment):
                normal, _ = moment.draw()
                distance = np.linalg.norm(moment.after.position, axis=-1)
                return {"uwb": distance + self.noise * normal[..., 0]}

    Pass the sensor to an environment as `sensors=(Uwb(),)` and observe its reading with
    `observation=("velocity", "uwb")`. Its uncertain parameter is set or drawn by
    `randomization={"uwb_noise": (0.1, 0.5)}`. The object is a template: each environment uses its
    own copy.

    Attributes:
        name: Name of the sensor in options.
        numbers: Labels of the single reading, which has the name of the sensor; see `labels` for
            several readings.
        gives: Names of the readings.
        uncertain: Uncertain parameters; each is an attribute, (W, N), or (W,) if drawn per world.
        prefix: Prefix of the parameter names in option `randomization`.
        needs_bodies: Whether the engine's bodies must be at the drones' poses before a measurement.
        needs_wind: Whether the sensor reads the wind of the moment.
        always_if_uncertain: Whether the sensor runs unobserved if a parameter is uncertain.
    """

    name: ClassVar[str]
    numbers: ClassVar[tuple[Label, ...]] = ()
    gives: ClassVar[tuple[str, ...]] = ()
    uncertain: ClassVar[Mapping[str, Uncertain]] = MappingProxyType({})
    prefix: ClassVar[str]
    needs_bodies: bool = False
    needs_wind: bool = False
    always_if_uncertain: ClassVar[bool] = False

    setup: SensorSetup
    engine: Engine

    def __init_subclass__(cls) -> None:
        """Set the class attributes that are derived from the name."""
        if "name" in vars(cls):
            cls.gives = vars(cls).get("gives", (cls.name,))
            cls.prefix = vars(cls).get("prefix", f"{cls.name}_")

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels of each reading by name; by default the single reading of `numbers`."""
        return {self.name: self.numbers}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Bind the sensor to an environment, and allocate its uncertain parameters."""
        self.setup = setup
        self.engine = engine
        for key, parameter in self.uncertain.items():
            shape = setup.shape if parameter.per == "drone" else setup.shape[:1]
            setattr(self, key, np.full(shape, parameter.usual))

    def attached(self, setup: SensorSetup, engine: Engine | None = None) -> Self:
        """Return a copy that is bound to an environment."""
        sensor = copy.deepcopy(self)
        sensor.attach(setup, engine)  # type: ignore[arg-type]  # None only for sensors without an engine
        return sensor

    def reset(  # noqa: B027
        self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator
    ) -> None:
        """Reset the state of the sensor in one world; by default there is none.

        Args:
            world: Index of the world.
            swarm: True state of all worlds.
            known: State of all worlds as the drones know it.
            rng: Random generator of the world.
        """

    @abstractmethod
    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure the current state.

        Args:
            moment: State, drones that measure, and random generators.

        Returns:
            Readings by name: (W, N) or (W, N, number of labels). Rows of drones that do not measure
            are ignored.
        """

    def info(self) -> Mapping[str, np.ndarray]:
        """Return the entries of the sensor in infos, (W, N) by name; by default none."""
        return {}

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return the arrays that determine the next readings, (W, ...) by name, for snapshots.

        By default these are all attributes that are arrays (W, N, ...).
        """
        shape = self.setup.shape
        arrays = {name: one for name, one in vars(self).items() if isinstance(one, np.ndarray)}
        return {name: array for name, array in arrays.items() if array.shape[:2] == shape}

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the minimum and maximum of counts and indices in `kept`, by name.

        A snapshot with values out of these bounds raises an error. By default there are none.
        """
        return {}


def check_readings(
    sensor: Sensor,
    labels: Mapping[str, tuple[Label, ...] | Image],
    wanted: frozenset[str],
    given: Any,
    moment: Moment,
) -> None:
    """Check that the readings of a sensor match its labels.

    Args:
        sensor: The sensor.
        labels: Labels of the sensor, by name of the reading.
        wanted: Readings that are observed or required by the task.
        given: Readings that the sensor returned.
        moment: Moment of the measurement.

    Raises:
        ValueError: If the readings do not match; the message names the sensor, the reading and the
            required format.
    """
    source = f"measure of sensor {sensor.name!r} returned"
    if not isinstance(given, Mapping):
        raise ValueError(f"{source} {shown(given)}: a dict of arrays by name of reading is needed")
    for name in sensor.gives:
        label = labels.get(name)
        # Unused readings may be missing
        if name not in given:
            if label is not None and name in wanted:
                raise ValueError(
                    f"{source} no reading {name!r}: return it, or remove it from labels"
                )
            continue
        reading = given[name]
        if not isinstance(reading, np.ndarray):
            raise ValueError(f"{source} {shown(reading)} as {name!r}: a NumPy array is needed")
        # Images and readings without labels may have any shape
        if label is None or isinstance(label, Image):
            continue
        worlds, drones = moment.mask.shape
        # The last dimension may be missing if there is a single number
        shapes = [(worlds, drones, len(label))] + [(worlds, drones)] * (len(label) == 1)
        if reading.shape not in shapes:
            raise ValueError(
                f"{source} an array {reading.shape} as {name!r}: {shapes[-1]} is needed, "
                f"one number for each of its {len(label)} labels"
            )
        # Rows of drones outside the mask are ignored
        if not np.isfinite(reading[moment.mask]).all():
            raise ValueError(f"{source} {shown(reading)} as {name!r}: finite numbers are needed")
