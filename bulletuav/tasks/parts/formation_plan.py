"""Options of formations, and what follows from them: which shape when, and who goes where."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import FlightConfig
from bulletuav.tasks.parts.airspace import AirspaceOptions, clearance
from bulletuav.tasks.parts.formation_shapes import as_shape_list, find_places
from bulletuav.tasks.parts.formations import Leader, assign_places, in_world, max_place_speed

NEVER = np.inf
"""Time after which something happens that never does, s"""
ROUNDING = 1e-9
"""Of a time over another one"""


@dataclass(frozen=True)
class FormationConfig(AirspaceOptions, FlightConfig):
    """Options of `formation`, beside those of free airspace (`AirspaceOptions`).

    Attributes:
        shapes: One shape, or several that follow each other: "v", "line", "ring", "letters", or
            places (M, 3) about the leader, m forward, left and up; a place for each drone or more.
        spacing: Distance between neighbours in shapes that have names, and at the start, m.
        text: What "letters" write: letters, digits and spaces.
        change_every: Time from one shape to the next, s.
        assignment: Who goes where. "fixed": drone i to place i. "free": so that the sum of squared
            distances is least, at the start and whenever the shape changes.
        exchange: Time after which each drone is told the place of another, again and again, s; 0
            for never.
        leader_speed: Speed of the leader, m/s.
        turn_rate: Turn of the leader, degrees/s, to a side that is drawn at the start.
        start_speed: Least and greatest speed at the start, m/s; by default cut to max_speed.
        at_goal: What happens at a place: the drone has to "hold" it.
    """

    shapes: Any = "v"
    spacing: float = 12.0
    text: str = "A"
    change_every: float = 20.0
    assignment: Literal["fixed", "free"] = "fixed"
    exchange: float = 0.0
    leader_speed: float = field(default=5.0, metadata={"most": 100.0})
    turn_rate: float = field(default=0.0, metadata={"most": 180.0})
    start_speed: tuple[float, float] = (5.0, 5.0)
    at_goal: Literal["hold"] = "hold"

    def __post_init__(self) -> None:
        """Keep shapes as tuples, so that configs can be compared and written."""
        super().__post_init__()
        object.__setattr__(self, "shapes", _frozen(self.shapes))


def _frozen(value: Any) -> Any:
    """Make tuples of arrays and lists, and of those in them."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


class FormationPlan:
    """Which shape is asked for when, and who is told which place.

    Attributes:
        shapes: (S, M, 3) places of all shapes, forward, left and up of the leader, m. Rows of those
            with fewer than M places end with ones that nobody is told.
    """

    def __init__(self, config: FormationConfig, context: TaskContext) -> None:
        """Find the places, and check that drones can fly in them.

        Args:
            config: Options.
            context: The swarm.

        Raises:
            ValueError: A shape is none, or has too few places or ones that are too close; places
                move too fast; shapes or places change too often.
        """
        # Shapes may have different numbers of places; the table holds the largest
        drones, apart = context.num_drones, clearance(config, context)
        of_name = (drones, config.spacing, config.text, apart)
        shapes = [find_places(one, *of_name) for one in as_shape_list(config.shapes)]
        self._counts = [len(one) for one in shapes]
        max_places = max(self._counts)
        self.shapes = np.stack(
            [np.pad(one, ((0, max_places - len(one)), (0, 0))) for one in shapes]
        )
        # Times of changes, none of which may come within one decision
        self._is_free = config.assignment == "free"
        self._change = config.change_every if len(shapes) > 1 else NEVER
        self._exchange = config.exchange or NEVER
        for name, time in (("change_every", self._change), ("exchange", self._exchange)):
            if time < context.period:
                raise ValueError(
                    f"{name} is {time:g} s: at least {context.period:g} s, the time of a "
                    f"decision, is needed"
                )
        # Drones must be able to catch up with a place that moves
        every, turn = self.shapes.reshape(-1, 3), float(np.radians(config.turn_rate))
        fastest = max_place_speed(every, config.leader_speed, turn)
        if fastest >= context.max_speed:
            raise ValueError(
                f"places move at up to {fastest:.3g} m/s, and less than max_speed "
                f"{context.max_speed:g} m/s is needed: lower leader_speed, turn_rate or spacing"
            )

    def shape_at(self, time: np.ndarray) -> np.ndarray:
        """Tell which shape is asked for at times (K,), s: (K,) indices."""
        shape: np.ndarray = _count(time, self._change) % len(self.shapes)
        return shape

    def due(self, now: float, period: float) -> tuple[bool, bool]:
        """Tell whether the shape changes, and whether drones exchange their places.

        Args:
            now: Time, s.
            period: How long before the last look was, s.
        """
        then = np.array([now - period, now])
        before, after = np.stack([_count(then, self._change), _count(then, self._exchange)], axis=1)
        changes, exchanges = (before != after).tolist()
        return changes, exchanges

    def first(self, position: np.ndarray, leader: Leader) -> np.ndarray:
        """Choose the places of drones at (N, 3), m, at the start: (N,) indices."""
        return self._nearest(position, leader, 0) if self._is_free else np.arange(len(position))

    def _nearest(self, position: np.ndarray, leader: Leader, shape: int) -> np.ndarray:
        """Choose the places of a shape that are nearest to all drones together."""
        place = self.shapes[None, shape, : self._counts[shape]]
        return assign_places(position, in_world(place, leader)[0][0])

    def reassign(
        self,
        place: np.ndarray,
        position: np.ndarray,
        leader: Leader,
        now: float,
        due: tuple[bool, bool],
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Choose places anew.

        Args:
            place: (K,) indices of the drones' places.
            position: (K, 3) where they are, m.
            leader: The one leader.
            now: Time, s.
            due: What is due, see `due`.
            rng: Generator of exchanges.

        Returns:
            (K,) indices.
        """
        changes, exchanges = due
        if changes and self._is_free:
            place = self._nearest(position, leader, int(self.shape_at(np.array([now]))[0]))
        if not exchanges:
            return place
        # Round a random circle, so that nobody keeps its place.
        circle = rng.permutation(len(place))
        reassign = place.copy()
        reassign[circle] = place[np.roll(circle, 1)]
        return reassign


def _count(time: np.ndarray, every: float) -> np.ndarray:
    """Count how often something has happened that happens every so many seconds."""
    count: np.ndarray = np.floor(time / every + ROUNDING).astype(int)
    return count
