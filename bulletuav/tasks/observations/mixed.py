"""Observations of drones that differ from team to team in their blocks."""

from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import numpy as np
from gymnasium.spaces import Box

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.sensors.base import Label
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.observer import Observation, ObservationBuilder

PADDING = -1
"""Column of numbers that a drone does not observe"""


class MixedObservations(ObservationBuilder):
    """Observations of drones of several kinds, as vectors.

    Vectors (W, N, D) have as many numbers as the drone with the most. The others of a drone are
    padding, with values of 0. All blocks of all kinds are computed once, for all drones; then each
    drone's own are copied.

    Attributes:
        images: Images, by name: none.
        low: (D,) lowest of the lower bounds of all drones, after scaling.
        high: (D,) highest of the upper bounds of all drones, after scaling.
    """

    def __init__(
        self,
        kinds: Sequence[ObservationBuilder],
        kind_of: Sequence[int],
        whole: ObservationBuilder,
    ) -> None:
        """Create the observations.

        Args:
            kinds: The observation of each kind.
            kind_of: Index of the kind of each drone.
            whole: The observation of the blocks of all kinds.
        """
        self._kinds, self._kind_of, self._whole = tuple(kinds), tuple(kind_of), whole
        self.images, self.num_frames = {}, 1
        self.is_plain, self.is_picture = True, False
        width = max(len(one.labels) for one in kinds)
        bounds = np.zeros((2, len(kinds), width), dtype=np.float32)
        columns = np.full((len(kinds), width), PADDING)
        for k, one in enumerate(kinds):
            size = len(one.labels)
            bounds[:, k, :size] = one.low, one.high
            for name, part in one.slices.items():
                shown = whole.slices[name]
                columns[k, part] = np.arange(shown.start, shown.stop)
        self.low, self.high = bounds[0].min(axis=0), bounds[1].max(axis=0)
        self._columns = columns[list(kind_of)]
        self._features = whole.make_vector((0, len(self._kind_of)))

    @property
    def labels(self) -> list[Label]:
        """Raise ValueError: the drones have different ones."""
        self._ask_for_one("labels")

    @property
    def slices(self) -> dict[str, slice]:
        """Raise ValueError: the drones have different ones."""
        self._ask_for_one("slices")

    @property
    def kinds(self) -> tuple[ObservationBuilder, ...]:
        """Observations of the kinds of drones."""
        return self._kinds

    def of(self, drone: int) -> ObservationBuilder:
        """Return the observation of one drone, without padding."""
        return self._kinds[self._kind_of[drone]]

    def unpadded(self, observation: Any, drone: int) -> Any:
        """Return the numbers that a drone observes, without padding.

        Args:
            observation: (..., D) padded vectors.
            drone: Index of the drone.

        Returns:
            (..., numbers of the drone), a view of the vectors.
        """
        return observation[..., : len(self.of(drone).labels)]

    def split(self, observation: Any) -> dict[str, Any]:
        """Raise ValueError: the drones have different blocks."""
        self._ask_for_one("split(...)")

    def _ask_for_one(self, what: str) -> NoReturn:
        raise ValueError(
            f"teams observe different blocks, and this needs the same for all drones: give one "
            f"observation for all, or read those of drone i by aviary.observer.of(i).{what}"
        )

    def space(self) -> Box:
        """Return the space of padded vectors, which includes those of all drones."""
        return Box(self.low, self.high, dtype=np.float32)

    def observe(self, frame: Frame, present: np.ndarray, copy: bool = True) -> Observation:
        """Compute the padded vectors of all drones; see `ObservationBuilder.observe`."""
        vector, features = self.make_vector(present.shape), self._whole.observe(frame, present)
        assert isinstance(features, np.ndarray)  # no pictures among its blocks
        _select_columns(features, self._columns, vector)
        return vector

    def reads_any(self, names: Iterable[str]) -> bool:
        """Check the block functions of all kinds; see `ObservationBuilder.reads_any`."""
        return self._whole.reads_any(names)

    def make_vector(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return zeros for the padded vectors of all drones, (W, N, D) float32."""
        return np.zeros((*shape, len(self.low)), dtype=np.float32)

    def scratch(self) -> tuple[np.ndarray, ...]:
        """Return the blocks of all kinds, (W, N, features)."""
        return (self._features,)

    def add_to(self, program: Program, frame: Frame, vector: np.ndarray) -> None:
        """Add steps to a program that write the padded vectors; see `ObservationBuilder.add_to`."""
        if len(self._features) != len(vector):
            self._features = self._whole.make_vector(vector.shape[:2])
        self._whole.add_to(program, frame, self._features)
        program.call(_select_columns, self._features, self._columns, vector)


@kernel
def _select_columns(features: np.ndarray, columns: np.ndarray, vector: np.ndarray) -> None:
    """Copy the columns (N, D) of features (W, N, F) to vectors (W, N, D); 0 for padding."""
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            for k in range(vector.shape[2]):
                column = columns[i, k]
                vector[w, i, k] = features[w, i, column] if column >= 0 else np.float32(0.0)
