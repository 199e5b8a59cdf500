"""Manhattan mobility model: users walk along streets and turn at crossings.

Lanes and the distance between successive users are not modelled.

References:
    F. Bai, N. Sadagopan and A. Helmy, IMPORTANT: a framework to systematically analyze the impact
    of mobility on performance of routing protocols for ad hoc networks, INFOCOM 2003.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.errors import as_sequence, finite
from bulletuav.network.mobility.base import (
    MAX_VELOCITY,
    Generators,
    State,
    Walking,
    stream_keys,
    stream_uniform,
)
from bulletuav.network.mobility.ground import OFF_GRID, Graph, Ground
from bulletuav.network.mobility.raster import length
from bulletuav.registry import register

MAX_WEIGHT = 1e6
"""Maximum weight of a turn in options"""
STRAIGHT, LEFT, RIGHT = range(3)


@register("mobility")
@dataclass(frozen=True)
class Manhattan(Walking):
    """Manhattan mobility model.

    Users walk on the centre lines of streets, each with its own constant speed, and turn only at
    nodes. At a node, one of the outgoing streets is drawn according to the weights of the turns.
    Users turn back only at dead ends.

    Attributes:
        turns: Weights of outgoing streets: straight on (up to 45 degrees off), left and right.
    """

    name: ClassVar[str] = "manhattan"
    turns: tuple[float, float, float] = (0.5, 0.25, 0.25)

    def __post_init__(self) -> None:
        """Validate the options."""
        super().__post_init__()
        given = as_sequence("turns", self.turns, 3)
        turns = tuple(finite("turns", weight, most=MAX_WEIGHT) for weight in given)
        self._set_option("turns", turns)
        for weight in turns:
            # A turn may be the only option at a node, so weights must not be 0
            if not weight > 0:
                raise ValueError(
                    f"turns has {weight!r}: three positive weights are needed, "
                    "for straight on, left and right"
                )

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Return the state arrays, see `Mobility.state`.

        The additional arrays are "user_speed" (U,), m/s, and "user_street" (U, 3): previous node,
        next node, and distance from the previous node, m.
        """
        return super().state(count) | {"user_speed": (count,), "user_street": (count, 3)}

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the state arrays, see `Mobility.bounds`."""
        last = ground.graph.node.shape[1] - 1
        longest = 4.0 * float(ground.raster.half_side)  # longer than the diagonal of the square
        return super().bounds(ground) | {
            "user_speed": (0.0, MAX_VELOCITY),
            "user_street": (np.zeros(3), np.array((last, last, longest))),
        }

    def require(self, ground: Ground) -> None:
        """Check that all cities have streets.

        Args:
            ground: Ground of all layouts.

        Raises:
            ValueError: If a city has no streets, or a street of zero length.
        """
        ground.graph  # noqa: B018 - the property validates the streets

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw positions uniformly along the streets, see `Mobility.start`."""
        street = ground.street_places(rng, layout, count)
        speed = rng.uniform(*self.speed, count)
        # Position and direction on the street
        behind, ahead = ground.graph.node[layout, street[:, :2].astype(int).T]
        heading = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1)[:, None]
        users = ground.raised(behind + street[:, 2:] * heading)
        return {
            "users": users,
            "user_velocity": speed[:, None] * heading,
            "user_speed": speed,
            "user_street": street,
        }

    def _move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Advance users as `move`."""
        advance_manhattan(
            state["users"],
            state["user_velocity"],
            state["user_speed"],
            state["user_street"],
            stream_keys(rng, flying),
            ground.graph,
            layout,
            flying,
            dt,
            self.turns,
        )


@kernel
def advance_manhattan(
    users: np.ndarray,
    velocity: np.ndarray,
    speed: np.ndarray,
    street: np.ndarray,
    key: np.ndarray,
    graph: Graph,
    layout: np.ndarray,
    flying: np.ndarray,
    dt: float,
    turns: tuple[float, float, float],
) -> None:
    """Advance users along their streets by one time step, in place.

    Args:
        users: Positions (W, U, 3), m; modified.
        velocity: Velocities (W, U, 2), m/s; overwritten.
        speed: Speeds (W, U), m/s.
        street: Previous node, next node, and distance from the previous node, m (W, U, 3);
            modified.
        key: Keys (W,) of the random streams, uint64.
        graph: Street graphs of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) users of each world move.
        dt: Length of the step, s.
        turns: Weights of outgoing streets: straight on, left and right.
    """
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        # All users of a world share one random stream
        node = graph.node[layout[w]]
        drawn = 0
        for i in range(users.shape[1]):
            # Distance along the current street
            behind = int(street[w, i, 0])
            ahead = int(street[w, i, 1])
            along = street[w, i, 2] + speed[w, i] * dt
            extent = street_length(node, behind, ahead)
            # Continue on the next street at every passed node
            while along >= extent:
                along -= extent
                chance = stream_uniform(key[w], drawn)
                following = next_node(graph, layout[w], behind, ahead, turns, chance)
                behind = ahead
                ahead = following
                extent = street_length(node, behind, ahead)
                drawn += 1
            street[w, i, 0] = behind
            street[w, i, 1] = ahead
            street[w, i, 2] = along
            # Position and velocity on the centre line
            for axis in range(2):
                heading = (node[ahead, axis] - node[behind, axis]) / extent
                users[w, i, axis] = node[behind, axis] + along * heading
                velocity[w, i, axis] = speed[w, i] * heading


@func
def street_length(node: np.ndarray, behind: int, ahead: int) -> float:
    """Return the length of the street between two of the nodes (S, 2), m."""
    x = node[ahead, 0] - node[behind, 0]
    y = node[ahead, 1] - node[behind, 1]
    return length(x, y)


@func
def next_node(
    graph: Graph,
    layout: int,
    before: int,
    node: int,
    turns: tuple[float, float, float],
    chance: float,
) -> int:
    """Draw the next node of a user at a node.

    Args:
        graph: Street graphs of all layouts.
        layout: Index of the layout.
        before: Previous node.
        node: Current node.
        turns: Weights of outgoing streets: straight on, left and right.
        chance: Uniform random number in [0, 1).

    Returns:
        A neighbour other than `before`, drawn by the weights; `before` at a dead end.
    """
    # Total weight of the outgoing streets
    total = 0.0
    for ahead in graph.neighbour[layout, node]:
        if ahead != OFF_GRID and ahead != before:
            total += turns[turn(graph.node[layout], before, node, ahead)]
    # Inverse transform sampling
    left = chance * total
    chosen = before
    for ahead in graph.neighbour[layout, node]:
        if ahead != OFF_GRID and ahead != before and left >= 0.0:
            left -= turns[turn(graph.node[layout], before, node, ahead)]
            chosen = ahead
    return chosen


@func
def turn(place: np.ndarray, before: int, node: int, ahead: int) -> int:
    """Classify the turn from one street to the next.

    Args:
        place: Positions (S, 2) of nodes, m.
        before: Previous node.
        node: Current node.
        ahead: Next node.

    Returns:
        `STRAIGHT` (up to 45 degrees off), `LEFT` or `RIGHT`.
    """
    # Directions before and after the node
    x = place[node, 0] - place[before, 0]
    y = place[node, 1] - place[before, 1]
    next_x = place[ahead, 0] - place[node, 0]
    next_y = place[ahead, 1] - place[node, 1]
    # Cross and dot product of the directions
    across = x * next_y - y * next_x
    onward = x * next_x + y * next_y
    if abs(across) <= onward:
        return STRAIGHT
    return LEFT if across > 0.0 else RIGHT
