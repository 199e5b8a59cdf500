"""Options of formations, and the schedule of their shapes and of the drones' places."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import FlightConfig
from bulletuav.tasks.parts.airspace import AirspaceOptions, clearance
from bulletuav.tasks.parts.formation_shapes import as_shape_list, find_places
from bulletuav.tasks.parts.formations import Leader, assign_places, in_world, max_place_speed

NEVER = np.inf
"""Period of events that never happen, s"""
ROUNDING = 1e-9
"""Tolerance when counting periods"""


@dataclass(frozen=True)
class FormationConfig(AirspaceOptions, FlightConfig):
    """Options of `formation`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        shapes: One shape, or several in sequence: "v", "line", "ring", "letters", or places (M, 3)
            relative to the leader, m forward, left and up; at least one place for each drone.
        spacing: Distance between neighbours in named shapes, and at the start, m.
        text: Text of "letters": letters, digits and spaces.
        change_every: Time from one shape to the next, s.
        assignment: Assignment of drones to places. "fixed": drone i to place i. "free": minimum sum
            of squared distances, at the start and whenever the shape changes.
        exchange: Period at which drones exchange their places at random, s; 0 for never.
        leader_speed: Speed of the leader, m/s.
        turn_rate: Turn rate of the leader, degrees/s, to a side drawn at the start.
        start_speed: Minimum and maximum speed at the start, m/s; the default is limited to
            max_speed.
        at_goal: Behaviour at a place: the drone has to "hold" it.
        min_in_place: Fraction of the episode that a drone has to be in place. Shapes last equally
            long, so that drones which keep to one shape do not reach it.
    """

    shapes: Any = "v"
    spacing: float = 12.0
    text: str = "A"
    change_every: float = 25.0
    assignment: Literal["fixed", "free"] = "fixed"
    exchange: float = 0.0
    leader_speed: float = field(default=5.0, metadata={"most": 100.0})
    turn_rate: float = field(default=0.0, metadata={"most": 180.0})
    start_speed: tuple[float, float] = (5.0, 5.0)
    at_goal: Literal["hold"] = "hold"
    min_in_place: float = 0.7

    def __post_init__(self) -> None:
        """Convert shapes to tuples, so that configs can be compared and saved."""
        super().__post_init__()
        object.__setattr__(self, "shapes", _frozen(self.shapes))


def _frozen(value: Any) -> Any:
    """Convert arrays and lists to tuples, recursively."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


class FormationPlan:
    """Schedule of the shapes, and assignment of drones to places.

    Attributes:
        shapes: (S, M, 3) places of all shapes, forward, left and up of the leader, m. Shapes with
            fewer than M places are padded with places that are never assigned.
    """

    def __init__(self, config: FormationConfig, context: TaskContext) -> None:
        """Find the places, and check that drones can follow them.

        Args:
            config: Options.
            context: The swarm.

        Raises:
            ValueError: If a shape is invalid, has too few places or places that are too close; if
                places move too fast; or if shapes or places change too often.
        """
        drones, apart = context.num_drones, clearance(config, context)
        of_name = (drones, config.spacing, config.text, apart)
        shapes = [find_places(one, *of_name) for one in as_shape_list(config.shapes)]
        self._counts = [len(one) for one in shapes]
        max_places = max(self._counts)
        self.shapes = np.stack(
            [np.pad(one, ((0, max_places - len(one)), (0, 0))) for one in shapes]
        )
        # Changes must be at least one decision apart
        self._is_free = config.assignment == "free"
        self._change = config.change_every if len(shapes) > 1 else NEVER
        self._exchange = config.exchange or NEVER
        for name, time in (("change_every", self._change), ("exchange", self._exchange)):
            if time < context.period:
                raise ValueError(
                    f"{name} is {time:g} s: at least {context.period:g} s, the time of a "
                    f"decision, is needed"
                )
        # Drones must be faster than all places
        every, turn = self.shapes.reshape(-1, 3), float(np.radians(config.turn_rate))
        fastest = max_place_speed(every, config.leader_speed, turn)
        if fastest >= context.max_speed:
            raise ValueError(
                f"places move at up to {fastest:.3g} m/s, and less than max_speed "
                f"{context.max_speed:g} m/s is needed: lower leader_speed, turn_rate or spacing"
            )

    def shape_at(self, time: np.ndarray) -> np.ndarray:
        """Return the index of the shape at times (K,), s: (K,)."""
        shape: np.ndarray = _count(time, self._change) % len(self.shapes)
        return shape

    def due(self, now: float, period: float) -> tuple[bool, bool]:
        """Return whether the shape changes, and whether drones exchange their places.

        Args:
            now: Time, s.
            period: Time since the previous call, s.
        """
        then = np.array([now - period, now])
        before, after = np.stack([_count(then, self._change), _count(then, self._exchange)], axis=1)
        changes, exchanges = (before != after).tolist()
        return changes, exchanges

    def first(self, position: np.ndarray, leader: Leader) -> np.ndarray:
        """Return the places (N,), as indices, of drones that start at (N, 3), m."""
        return self._nearest(position, leader, 0) if self._is_free else np.arange(len(position))

    def _nearest(self, position: np.ndarray, leader: Leader, shape: int) -> np.ndarray:
        """Return the places of a shape with the minimum sum of squared distances to drones."""
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
        """Return new places after a change of the shape or an exchange.

        Args:
            place: (K,) indices of the drones' places.
            position: (K, 3) positions of the drones, m.
            leader: The single leader.
            now: Time, s.
            due: Which changes are due, see `due`.
            rng: Generator of exchanges.

        Returns:
            (K,) indices.
        """
        changes, exchanges = due
        if changes and self._is_free:
            place = self._nearest(position, leader, int(self.shape_at(np.array([now]))[0]))
        if not exchanges:
            return place
        # A random cycle, so that no drone keeps its place
        circle = rng.permutation(len(place))
        exchanged = place.copy()
        exchanged[circle] = place[np.roll(circle, 1)]
        return exchanged


def _count(time: np.ndarray, every: float) -> np.ndarray:
    """Return the number of periods of `every` seconds that have elapsed."""
    count: np.ndarray = np.floor(time / every + ROUNDING).astype(int)
    return count
