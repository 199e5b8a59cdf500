"""Sensors: one class each that measures and says what its numbers and uncertainties are."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import shown
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm


class Label(NamedTuple):
    """One number that can be observed; values beyond the bounds are clipped to them.

    Attributes:
        name: What it is, such as "velocity x".
        unit: Its unit, "1" for none.
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
    """Make the labels of x, y and z of a vector."""
    bounds = zip("xyz", low, high, strict=True)
    return tuple(Label(f"{name} {axis}", unit, least, most) for axis, least, most in bounds)


class Image(NamedTuple):
    """A picture that can be observed.

    Attributes:
        low: Lower bound of a pixel.
        high: Upper bound of a pixel.
        dtype: NumPy type of a pixel.
        pixel: Shape of a pixel, () for one number.
    """

    low: float
    high: float
    dtype: Any
    pixel: tuple[int, ...]


class Uncertain(NamedTuple):
    """A parameter of a sensor that the option `randomization` can set or draw.

    Attributes:
        least: Smallest value that makes sense.
        most: Largest value that makes sense.
        usual: Value unless the option says otherwise.
        per: Whether one is drawn for each drone or for each world.
    """

    least: float
    most: float
    usual: float = 0.0
    per: Literal["drone", "world"] = "drone"


@dataclass(frozen=True)
class SensorSetup:
    """What sensors know of their environment before it has an engine.

    Attributes:
        shape: Number of worlds and of drones, (W, N).
        period: Time between decisions, s.
        gravity: m/s^2.
        radius: (N,) collision radius of each drone, m.
        max_range: How far range finder and clearance reach, m.
        beams: Directions of the range finder's beams.
        beam_frame: "yaw" for beams that turn with the drone, "world" for fixed ones.
        camera_size: Width and height of pictures, pixels.
        camera_every: Decisions from one picture to the next.
        num_targets: Number of the task's targets, U.
        arena: Lower and upper corner (3,) of the arena, m.
        wanted: Readings that are observed or that the task needs.
        longest_delay: Of messages between drones, s.
    """

    shape: tuple[int, int] = (1, 1)
    period: float = 0.1
    gravity: float = STANDARD_GRAVITY
    radius: tuple[float, ...] = ()
    max_range: float = 60.0
    beams: tuple[tuple[float, float], ...] = ()
    beam_frame: str = "yaw"
    camera_size: tuple[int, int] = (64, 48)
    camera_every: int = 1
    num_targets: int = 0
    arena: tuple[np.ndarray, np.ndarray] = (np.full(3, -1e3), np.full(3, 1e3))
    wanted: frozenset[str] = frozenset()
    longest_delay: float = 0.0


class Moment(NamedTuple):
    """When sensors measure: after a decision, or after a reset.

    Attributes:
        before: State of the swarm before the decision; at a reset the same as `after`.
        after: State of the swarm now.
        targets: (W, U, 3) the task's targets, m.
        mask: (W, N) drones that measure: those that flew the decision, or were reset.
        steps: (W,) decisions since each world's reset, 0 at the reset itself.
        rngs: Random generator of each world; draw from that of a world alone for that world.
        readings: What sensors measured earlier at this moment, by name.
    """

    before: Swarm
    after: Swarm
    targets: np.ndarray
    mask: np.ndarray
    steps: np.ndarray
    rngs: Sequence[np.random.Generator]
    readings: dict[str, np.ndarray]

    @property
    def position(self) -> np.ndarray:
        """(W, N, 3) where drones think that they are, m."""
        return self.readings.get("position", self.after.position)

    @property
    def velocity(self) -> np.ndarray:
        """(W, N, 3) how drones think that they move, m/s."""
        return self.readings.get("velocity", self.after.velocity)

    @property
    def flying(self) -> np.ndarray:
        """(W,) worlds that flew a decision; none of those that were just reset."""
        flown: np.ndarray = np.any(self.mask, axis=1) & (self.steps > 0)
        return flown

    def draw(self, width: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Draw for every drone of the worlds that measure, each world from its own generator.

        Args:
            width: Numbers for each drone.

        Returns:
            Standard normal numbers (W, N, width) and uniform ones (W, N) in [0, 1); else zeros.
        """
        normal, uniform = np.zeros((*self.mask.shape, width)), np.zeros(self.mask.shape)
        for k in np.flatnonzero(np.any(self.mask, axis=1)).tolist():
            self.rngs[k].standard_normal(out=normal[k])
            self.rngs[k].random(out=uniform[k])
        return normal, uniform


class Sensor(ABC):
    """A sensor that every drone carries. Derive from it, name the numbers, and measure.

        class Uwb(Sensor):
            name = "uwb"
            numbers = (Label("distance to anchor", "m", 0.0, 500.0),)
            uncertain = {"noise": Uncertain(0.0, 10.0)}

            def measure(self, moment):
                normal, _ = moment.draw()
                distance = np.linalg.norm(moment.after.position, axis=-1)
                return {"uwb": distance + self.noise * normal[..., 0]}

    Give it to an environment as `sensors=(Uwb(),)` and observe it as `observation=("velocity",
    "uwb")`. Its uncertain parameter is then set or drawn by `randomization={"uwb_noise": (0.1,
    0.5)}`. An object given as an option is a description: each environment works with a copy of its
    own.

    Attributes:
        name: What users call it.
        numbers: Labels of its one reading, which bears the sensor's name; see `labels` for several.
        gives: Names of its readings.
        uncertain: Its uncertain parameters; each is an attribute, (W, N) or, for worlds, (W,).
        prefix: What the option `randomization` puts before their names.
        needs_bodies: Whether the engine's bodies must stand where drones are before it measures.
        always_if_uncertain: Whether it works unobserved where a parameter is uncertain.
    """

    name: ClassVar[str]
    numbers: ClassVar[tuple[Label, ...]] = ()
    gives: ClassVar[tuple[str, ...]] = ()
    uncertain: ClassVar[Mapping[str, Uncertain]] = MappingProxyType({})
    prefix: ClassVar[str]
    needs_bodies: ClassVar[bool] = False
    always_if_uncertain: ClassVar[bool] = False

    setup: SensorSetup
    engine: Engine

    def __init_subclass__(cls) -> None:
        """Fill in what follows from the name."""
        if "name" in vars(cls):
            cls.gives = vars(cls).get("gives", (cls.name,))
            cls.prefix = vars(cls).get("prefix", f"{cls.name}_")

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell what each reading is, by name; by default the one reading of `numbers`."""
        return {self.name: self.numbers}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Get ready for an environment: keep the setup and make arrays for uncertain parameters."""
        self.setup = setup
        self.engine = engine
        for key, parameter in self.uncertain.items():
            shape = setup.shape if parameter.per == "drone" else setup.shape[:1]
            setattr(self, key, np.full(shape, parameter.usual))

    def attached(self, setup: SensorSetup, engine: Engine | None = None) -> Self:
        """Make a copy that works in an environment."""
        sensor = copy.deepcopy(self)
        sensor.attach(setup, engine)  # type: ignore[arg-type]  # None only for sensors that ask no engine
        return sensor

    def reset(  # noqa: B027
        self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator
    ) -> None:
        """Begin a new episode of one world; by default nothing to do.

        Args:
            world: Its index.
            swarm: True state of all worlds.
            known: The same as far as drones know it.
            rng: Random generator of this world.
        """

    @abstractmethod
    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure.

        Args:
            moment: State, drones that measure, and random generators.

        Returns:
            Each reading by name: (W, N) or (W, N, number of its labels). Rows of drones that do not
            measure are not looked at.
        """

    def info(self) -> Mapping[str, np.ndarray]:
        """Tell what infos say of it, (W, N) by name; by default nothing."""
        return {}

    def kept(self) -> Mapping[str, np.ndarray]:
        """Tell the arrays that its next readings follow from, (W, ...) by name, for snapshots.

        By default all of its attributes that are arrays (W, N, ...).
        """
        shape = self.setup.shape
        arrays = {name: one for name, one in vars(self).items() if isinstance(one, np.ndarray)}
        return {name: array for name, array in arrays.items() if array.shape[:2] == shape}

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the lowest and highest value of counts and indices in `kept`, by name.

        A snapshot with a value beyond them is refused. By default there are none.
        """
        return {}


def check_readings(
    sensor: Sensor,
    labels: Mapping[str, tuple[Label, ...] | Image],
    wanted: frozenset[str],
    given: Any,
    moment: Moment,
) -> None:
    """Refuse what a sensor gave unless it is what its labels promise.

    Args:
        sensor: What measured.
        labels: Its labels, by name of reading.
        wanted: Readings that are observed or that the task needs.
        given: What it gave.
        moment: When it measured.

    Raises:
        ValueError: It is not; the sensor, the reading and what is needed are named.
    """
    who = f"measure of sensor {sensor.name!r} gave"
    if not isinstance(given, Mapping):
        raise ValueError(f"{who} {shown(given)}: a dict of arrays by name of reading is needed")
    for name in sensor.gives:
        label = labels.get(name)
        # A reading that nobody uses may be missing
        if name not in given:
            if label is not None and name in wanted:
                raise ValueError(f"{who} no reading {name!r}: return it, or leave it out of labels")
            continue
        reading = given[name]
        if not isinstance(reading, np.ndarray):
            raise ValueError(f"{who} {shown(reading)} as {name!r}: a NumPy array is needed")
        # Pictures, and readings without labels, have any shape
        if label is None or isinstance(label, Image):
            continue
        worlds, drones = moment.mask.shape
        # A single number a drone may go without the last dimension
        shapes = [(worlds, drones, len(label))] + [(worlds, drones)] * (len(label) == 1)
        if reading.shape not in shapes:
            raise ValueError(
                f"{who} an array {reading.shape} as {name!r}: {shapes[-1]} is needed, "
                f"one number for each of its {len(label)} labels"
            )
        # Drones that are not measured may have anything
        if not np.isfinite(reading[moment.mask]).all():
            raise ValueError(f"{who} {shown(reading)} as {name!r}: finite numbers are needed")
