"""Observations of all drones: concatenated blocks of features, and images."""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.control.actions import Action
from bulletuav.errors import shown, unknown
from bulletuav.registry import find, names
from bulletuav.sensors.base import Image, Label, Sensor, SensorSetup
from bulletuav.sensors.suite import provider, reading_labels
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import ALL, PRESENT, Binding, Bound
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.observations.images import (
    ARRAY,
    IMAGE,
    frames_name,
    image_space,
    to_images,
)
from bulletuav.tasks.stages import StableArrays, clear

STATE = ("position", "attitude", "velocity", "rates", "goal_position", "alive")
"""Blocks of the global state, for every drone"""
Observation = np.ndarray | dict[str, np.ndarray]
Format = Literal["vector", "dict"]
VECTOR = "vector"


def observation_name(source: Any) -> str:
    """Return the name of a block.

    Args:
        source: A name, of which the part after the colon counts, a function, or another object,
            whose class gives the name.
    """
    if isinstance(source, str):
        return source.rpartition(":")[2]
    return str(getattr(source, "__name__", type(source).__name__))


def known_observations(sensors: Mapping[str, Sensor]) -> list[str]:
    """Return the names that can be observed: registered blocks and readings of sensors."""
    readings = {
        reading for one in sensors.values() for reading in one.gives if _has_labels(one, reading)
    }
    return sorted({*names("observation"), *readings})


def _has_labels(sensor: Sensor, reading: str) -> bool:
    """Check whether a sensor has labels for a reading, so that it can be observed."""
    return reading in sensor.labels(SensorSetup())


class ObservationBuilder:
    """Observation of a task: blocks concatenated into one vector, or a dict.

    Vectors are float32, clipped to their bounds, and scaled from the bounds to [-1, 1] if
    `normalise`. An observation with images is a dict of "vector" (if there are features) and the
    images; with the format "dict" it has an entry for each block. A single picture in the format
    "image", without features, is an array.

    Attributes:
        images: Images, by name.
        num_frames: Number of frames of each image.
        is_plain: Whether observations are vectors, without a dict.
        is_picture: Whether observations are a single image, without a dict.
        low: (D,) lower bounds after scaling.
        high: (D,) upper bounds after scaling.
    """

    def __init__(
        self,
        sources: Sequence[Any],
        task: Any,
        action: Action,
        binding: Binding,
        sensors: Mapping[str, Sensor],
        setup: SensorSetup,
        *,
        normalise: bool = False,
        form: Format = "vector",
        num_frames: int = 1,
        camera_format: str = ARRAY,
    ) -> None:
        """Create the blocks.

        Args:
            sources: Names of blocks and readings, or blocks themselves.
            task: The task.
            action: Action type of the drones.
            binding: Resolves argument names of block functions to arrays of a frame.
            sensors: All sensors, by name.
            setup: Setup of the sensors.
            normalise: Whether features are scaled to [-1, 1]; one with equal bounds is 0.
            form: "vector", or "dict" with an entry for each block.
            num_frames: Number of frames of each image.
            camera_format: Format of images, see `bulletuav.tasks.observations.images`.

        Raises:
            ValueError: If a block does not exist or is invalid.
        """
        self._labels: list[Label] = []
        self._slices: dict[str, slice] = {}
        self.images: dict[str, Image] = {}
        self._writers: list[tuple[slice, Bound | _BlockWriter]] = []
        self._size, self._form = setup.camera_size, form
        self.num_frames, self._camera_format = num_frames, camera_format
        for source in sources:
            made = _make(source, task, action, binding, sensors, setup)
            if isinstance(made, Image):
                self.images[observation_name(source)] = made
                continue
            labels, writer = made
            part = slice(len(self._labels), len(self._labels) + len(labels))
            self._labels += labels
            self._slices[observation_name(source)] = part
            self._writers.append((part, writer))
        # Single precision, as the vector
        self.is_plain = not self.images and form == VECTOR
        is_alone = len(self.images) == 1 and not self.labels and form == VECTOR
        self.is_picture = is_alone and camera_format == IMAGE
        self._low = np.array([label.low for label in self.labels], dtype=np.float32)
        self._high = np.array([label.high for label in self.labels], dtype=np.float32)
        middle, half = (self._low + self._high) / 2, (self._high - self._low) / 2
        # A feature with equal bounds is constant: do not divide by zero
        half[half == 0] = 1.0
        self._bounds = (self._low, self._high, normalise, middle, half)
        # Public bounds are those after scaling
        ones = np.ones_like(self._low)
        self.low, self.high = (-ones, ones) if normalise else (self._low, self._high)

    @property
    def labels(self) -> list[Label]:
        """Name, unit and bounds before scaling of each feature of the vector."""
        return self._labels

    @property
    def slices(self) -> dict[str, slice]:
        """Slice of the vector of each block, by name."""
        return self._slices

    @property
    def kinds(self) -> "tuple[ObservationBuilder, ...]":
        """Observations of the teams: this one if all drones have the same."""
        return (self,)

    def of(self, drone: int) -> "ObservationBuilder":
        """Return the observation of one drone: this one if all drones have the same."""
        return self

    def unpadded(self, observation: Any, drone: int) -> Any:
        """Return the numbers that a drone observes, (..., D), without padding."""
        return observation

    def require_vectors(self) -> None:
        """Raise ValueError for pictures and dicts, which drones cannot have on their own."""
        if self.images:
            raise ValueError(
                f"observation differs by team, and has the picture {next(iter(self.images))!r}: "
                f"leave pictures out, or give one observation for all drones"
            )
        if not self.is_plain:
            raise ValueError(
                f"observation differs by team, and observation_format is {self._form!r}: choose "
                f"'vector', or give one observation for all drones"
            )

    def scratch(self) -> tuple[np.ndarray, ...]:
        """Return the arrays (W, ...) that programs write, except for the vectors."""
        return ()

    def space(self) -> Box | Dict:
        """Return one drone's observation space, a new object in each call."""
        if self.is_plain:
            return Box(self.low, self.high, dtype=np.float32)
        spaces: dict[str, Space[Any]] = {}
        if self._form == VECTOR:
            if self.labels:
                spaces[VECTOR] = Box(self.low, self.high, dtype=np.float32)
        else:
            for name, part in self.slices.items():
                spaces[name] = Box(self.low[part], self.high[part], dtype=np.float32)
        for name, image in self.images.items():
            spaces[name] = image_space(image, self._size, self.num_frames, self._camera_format)
        if self.is_picture:
            (only,) = spaces.values()
            return cast(Box, only)
        return Dict(spaces)

    def observe(self, frame: Frame, present: np.ndarray, copy: bool = True) -> Observation:
        """Compute the observations of all drones.

        Args:
            frame: The decision, or the first frame after a reset.
            present: (W, N) bool, drones active after the decision.
            copy: See `assemble`.

        Returns:
            (W, N, D) float32, or a dict of arrays (W, N, ...).
        """
        frame.derived[PRESENT] = present
        vector = self.make_vector(present.shape)
        for part, writer in self._writers:
            writer.fill(frame, vector[..., part])
        _bound(vector, *self._bounds)
        return self.assemble(frame, vector, copy)

    def reads_any(self, names: Iterable[str]) -> bool:
        """Check whether any block function has an argument with one of these names.

        Args:
            names: Names of arguments, without `all_`; arguments with this prefix count, too.
        """
        bounds = [writer for _, writer in self._writers if isinstance(writer, Bound)]
        asked = {name.removeprefix(ALL) for bound in bounds for name in bound.sources}
        return not asked.isdisjoint(names)

    def make_vector(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return zeros for the features of all drones, (W, N, D) float32."""
        return np.zeros((*shape, len(self.labels)), dtype=np.float32)

    def add_to(self, program: Program, frame: Frame, vector: np.ndarray) -> None:
        """Add steps to a program that write the vectors.

        Args:
            program: Program to extend.
            frame: The decision; its `derived` has PRESENT, the drones active after the decision.
            vector: (W, N, D) float32, output.
        """
        program.call(clear, vector)
        kept = StableArrays(program, frame)
        for part, writer in self._writers:
            out = vector[..., part]
            if isinstance(writer, Bound):
                kept.add(writer, out)
            else:
                writer.add_to(program, frame, out)
        program.call(_bound, vector, *self._bounds)

    def assemble(self, frame: Frame, vector: np.ndarray, copy: bool = True) -> Observation:
        """Return observations from the vectors and the images of a frame.

        Args:
            frame: The decision, or the first frame after a reset.
            vector: (W, N, D) float32, which is not copied.
            copy: If False, images in the format "array" are those of the frame, which the next
                decision or reset overwrites.
        """
        if self.is_plain:
            return vector
        if self.is_picture:
            (name,) = self.images
            return self._image(frame, name, copy)
        seen: dict[str, np.ndarray] = {}
        if self.labels:
            seen = {VECTOR: vector} if self._form == VECTOR else self.split(vector)
        return seen | {name: self._image(frame, name, copy) for name in self.images}

    def _image(self, frame: Frame, name: str, copy: bool) -> np.ndarray:
        """Return the pictures (W, N, ...) of a name."""
        pictures = frame.readings[name if self.num_frames == 1 else frames_name(name)]
        if self._camera_format == IMAGE:
            return to_images(pictures, self.images[name])
        return pictures.copy() if copy else pictures

    def split(self, observation: Any) -> dict[str, Any]:
        """Split observations by block.

        Args:
            observation: (..., D) of one or more drones, or a dict with "vector".

        Returns:
            Arrays (..., features of the block) by name, views of the given array. Images are
            unchanged.

        Raises:
            ValueError: If the size does not match the observation.
        """
        if isinstance(observation, Mapping):
            images = {name: value for name, value in observation.items() if name != VECTOR}
            return (self.split(observation[VECTOR]) if VECTOR in observation else {}) | images
        if self.is_picture:
            return dict.fromkeys(self.images, observation)
        vector = np.asarray(observation)
        if vector.ndim == 0 or vector.shape[-1] != len(self.labels):
            raise ValueError(
                f"observation is an array {vector.shape}: {len(self.labels)} numbers are needed, "
                f"one for each label"
            )
        return {name: vector[..., part] for name, part in self.slices.items()}


@kernel
def _bound(
    vector: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    normalise: bool,
    middle: np.ndarray,
    half: np.ndarray,
) -> None:
    """Clip `vector` (W, N, D) to its bounds (D,), and scale it to [-1, 1] if `normalise`."""
    one = np.float32(1.0)
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            for k in range(vector.shape[2]):
                value = vector[w, i, k]
                # Comparisons preserve NaN, which min and max may not
                value = low[k] if value < low[k] else value
                value = high[k] if value > high[k] else value
                # Rounding may exceed the bounds
                if normalise:
                    value = (value - middle[k]) / half[k]
                    value = -one if value < -one else value
                    value = one if value > one else value
                vector[w, i, k] = value


def _make(
    source: Any,
    task: Any,
    action: Action,
    binding: Binding,
    sensors: Mapping[str, Sensor],
    setup: SensorSetup,
) -> "tuple[tuple[Label, ...], Bound | _BlockWriter] | Image":
    """Return the labels and the writer of a block, or an image."""
    name = observation_name(source)
    # Other names may be readings of sensors
    if isinstance(source, str) and ":" not in source and source not in names("observation"):
        labels = reading_labels(sensors, source, setup)
        if labels is None:
            raise unknown("observation block", source, known_observations(sensors))
        if isinstance(labels, Image):
            return labels
        checked = _checked(labels, f"reading {source!r} of a sensor")
        return checked, _BlockWriter(f"reading {source!r}", _make_reading_block(source))
    block = source if isinstance(source, Block) else find("observation", source, callable)
    title = f"observation block {name!r}"
    if getattr(block, "ingredient", None) == "block":
        make: Any = block.labels
        wants_action = "action" in inspect.signature(make).parameters
        labels = make(action if wants_action else task)
        if not labels:
            raise ValueError(f"labels of {title} are empty: a label for each number is needed")
        return _checked(labels, title), Bound(block, binding, title, np.float32, len(labels))
    if isinstance(block, type):
        raise ValueError(f"observation block {shown(block)} is a class: a function is needed")
    if not isinstance(block, Block) and len(inspect.signature(block).parameters) != 1:
        raise ValueError(
            f"{title} takes other arguments than the task: decorate it with @block(labels)"
        )
    made = block if isinstance(block, Block) else block(task)
    if not isinstance(made, Block):
        raise ValueError(
            f"{title} gave {shown(made)} for the task: a Block is needed; decorate a "
            f"per-drone function with @block(labels)"
        )
    return _checked(made.labels, title), _BlockWriter(title, made)


def _checked(labels: Any, title: str) -> tuple[Label, ...]:
    """Return labels as a tuple, after checking their types and bounds."""
    is_sequence = isinstance(labels, list | tuple) and not isinstance(labels, Label)
    if not is_sequence or not all(isinstance(one, Label) for one in labels):
        raise ValueError(
            f"labels of {title} are {shown(labels)}: a list of Label(name, unit, low, high) is "
            f"needed"
        )
    for one in labels:
        if not one.low <= one.high:
            raise ValueError(
                f"bounds of {shown(one)} of {title} must be numbers, the lower one first"
            )
    return tuple(labels)


def _make_reading_block(name: str) -> Block:
    """Return a block that shows a reading unchanged."""

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        return frame.readings[name].reshape(*present.shape, -1)

    return Block((), compute)


class _BlockWriter:
    """Writer of a block whose function is not decorated with @block."""

    def __init__(self, title: str, block: Block) -> None:
        self._title, self._block = title, block

    def fill(self, frame: Frame, out: np.ndarray) -> None:
        """Write the features of a frame to `out` (W, N, labels)."""
        numbers = self._block.compute(frame, frame.derived[PRESENT])
        if np.shape(numbers) != out.shape:
            raise ValueError(
                f"{self._title} gave an array {np.shape(numbers)}: {out.shape} is needed, a number "
                f"for each of its labels"
            )
        out[...] = numbers

    def add_to(self, program: Program, frame: Frame, out: np.ndarray) -> None:
        """Add a step to a program that writes the features."""
        if self._block.add is not None and self._block.add(program, frame, out):
            return
        program.callback(lambda: self.fill(frame, out))


def needed_readings(sources: Sequence[Any], sensors: Mapping[str, Sensor]) -> set[str]:
    """Return the readings that observations show, or that their block functions request."""
    wanted: set[str] = set()
    for source in sources:
        name = observation_name(source)
        if provider(sensors, name) is not None:
            wanted.add(name)
        block = source
        if isinstance(source, str) and (":" in source or source in names("observation")):
            block = find("observation", source, callable)
        wanted |= requested_readings(block, sensors)
    return wanted


def requested_readings(function: Any, sensors: Mapping[str, Sensor]) -> set[str]:
    """Return the readings that a decorated function requests by argument name.

    Args:
        function: A function decorated with @block, @reward or @end; others request no readings.
        sensors: All sensors, by name.
    """
    if not getattr(function, "ingredient", None):
        return set()
    asked = {one.removeprefix(ALL) for one in inspect.signature(function).parameters}
    return {one for one in asked if provider(sensors, one) is not None}


def copied(observations: Observation) -> Observation:
    """Return a copy of observations."""
    if isinstance(observations, dict):
        return {name: array.copy() for name, array in observations.items()}
    return observations.copy()


def part(observations: Observation, index: Any) -> Any:
    """Return `observations[index]`, or a dict with that of each entry."""
    if isinstance(observations, dict):
        return {name: array[index] for name, array in observations.items()}
    return observations[index]
