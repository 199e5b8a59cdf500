"""Users who walk along streets and turn at crossings: the Manhattan model.

F. Bai, N. Sadagopan and A. Helmy, IMPORTANT: a framework to systematically analyze the impact of mobility on performance of
routing protocols for ad hoc networks, INFOCOM 2003; without its lanes and its distance between those who follow each other.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.errors import as_sequence, finite
from bulletuav.kernel import func, kernel
from bulletuav.network.mobility.base import Generators, State, Walking, keys, uniform
from bulletuav.network.mobility.ground import OFF_GRID, Ground, length

MOST_WEIGHT = 1e6  # of a turn


@dataclass(frozen=True)
class Manhattan(Walking):
    """Users walk on the centre lines of streets, each at its own constant speed, and turn only at nodes.

    turns  weights of a way straight on, to the left and to the right: with those of the ways that a node has, one is drawn.
           Straight on is up to 45 degrees off. Users turn back only where a street ends.
    """

    name: ClassVar[str] = "manhattan"
    turns: tuple[float, float, float] = (0.5, 0.25, 0.25)

    def __post_init__(self):
        super().__post_init__()
        self._keep(
            "turns",
            tuple(
                finite("turns", weight, most=MOST_WEIGHT)
                for weight in as_sequence("turns", self.turns, 3)
            ),
        )
        for weight in self.turns:
            if not weight > 0:  # it may be that of a node's only way on
                raise ValueError(
                    f"turns has {weight!r}: three numbers above 0 are needed, of straight on, left and right"
                )

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Also "user_speed" (U,) m/s and "user_street" (U, 3): the node behind, the node ahead, and m from the first."""
        return super().state(count) | {"user_speed": (count,), "user_street": (count, 3)}

    def require(self, ground: Ground) -> None:
        """Raises ValueError where a city has no streets, or a street of no length."""
        ground.graph  # noqa: B018 - made here, or refused

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Uniform along the streets."""
        street, speed = ground.street_places(rng, layout, count), rng.uniform(*self.speed, count)
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
        own = (state["users"], state["user_velocity"], state["user_speed"], state["user_street"])
        advance(*own, keys(rng, flying), ground.graph, layout, flying, dt, self.turns)


@kernel
def advance(users, velocity, speed, street, key, graph, layout, flying, dt, turns):
    """Move users (W, U, 3) along their streets through dt s; keys (W,) of `uniform`."""
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        node, drawn = graph.node[layout[w]], 0
        for i in range(users.shape[1]):
            behind, ahead = int(street[w, i, 0]), int(street[w, i, 1])
            along = street[w, i, 2] + speed[w, i] * dt
            extent = length(node[ahead, 0] - node[behind, 0], node[ahead, 1] - node[behind, 1])
            while along >= extent:
                along -= extent
                chance = uniform(key[w], drawn)
                behind, ahead = ahead, next_node(graph, layout[w], behind, ahead, turns, chance)
                extent = length(node[ahead, 0] - node[behind, 0], node[ahead, 1] - node[behind, 1])
                drawn += 1
            street[w, i, 0], street[w, i, 1], street[w, i, 2] = behind, ahead, along
            for axis in range(2):
                heading = (node[ahead, axis] - node[behind, axis]) / extent
                users[w, i, axis] = node[behind, axis] + along * heading
                velocity[w, i, axis] = speed[w, i] * heading


@func
def next_node(graph, layout, before, node, turns, chance):
    """Where one who came from node `before` to `node` goes: drawn by `chance` in [0, 1) with the weights of the turns."""
    total = 0.0
    for ahead in graph.neighbour[layout, node]:
        if ahead != OFF_GRID and ahead != before:
            total += turns[turn(graph.node[layout], before, node, ahead)]
    left, chosen = chance * total, before
    for ahead in graph.neighbour[layout, node]:
        if ahead != OFF_GRID and ahead != before and left >= 0.0:
            left -= turns[turn(graph.node[layout], before, node, ahead)]
            chosen = ahead
    return chosen


@func
def turn(place, before, node, ahead):
    """Whether a way from `before` by `node` goes on to `ahead` straight (0, up to 45 degrees off), left (1) or right (2)."""
    x, y = place[node, 0] - place[before, 0], place[node, 1] - place[before, 1]
    next_x, next_y = place[ahead, 0] - place[node, 0], place[ahead, 1] - place[node, 1]
    across, on = x * next_y - y * next_x, x * next_x + y * next_y
    if abs(across) <= on:
        return 0
    return 1 if across > 0.0 else 2
