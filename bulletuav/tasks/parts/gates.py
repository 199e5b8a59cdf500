"""Gates of a race: frames of bars that can be hit, and what it is to fly through one.

A gate has axes of its own: x is the direction in which it is to be flown, y points left, z up.
The opening is a regular polygon across x, so that what counts is what the bars leave free.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.compiled.functions import cos, sin, tan
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import choose, finite, points_of
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, from_euler

SIDES = {"square": 4, "round": 12}
"""How many sides the openings of gates have"""
BAR = 0.2
"""Thickness of the bars of a frame, m"""
ORANGE = (0.95, 0.45, 0.1, 1.0)
"""Colour of frames, RGBA"""
MISS_RANGE = 3.0
"""Who crosses a gate's plane beside the opening missed it, up to so many sizes from its middle"""


@dataclass(frozen=True)
class Gate:
    """A gate that stands somewhere.

    Attributes:
        position: Middle of the opening, m.
        yaw: Direction in which it is to be flown, from east to north, degrees.
        pitch: How steeply upwards that is, degrees.
        roll: Turn of the frame about that direction, degrees.
        shape: "square" or "round".
        size: Width of the opening between opposite sides, m.

    Raises:
        ValueError: The shape is unknown, or a number is none that a gate can have.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    shape: str = "square"
    size: float = 2.0

    def __post_init__(self) -> None:
        choose("shape of a gate", self.shape, SIDES)
        (place,) = points_of("position of a gate", self.position)
        object.__setattr__(self, "position", tuple(place.tolist()))
        finite("yaw of a gate", self.yaw)
        finite("pitch of a gate", self.pitch, -90, 90)
        finite("roll of a gate", self.roll)
        if finite("size of a gate", self.size, 0, 100) == 0:
            raise ValueError("size of a gate is 0 m: above 0 is needed")

    @property
    def sides(self) -> int:
        """Number of sides of the opening."""
        return SIDES[self.shape]

    @property
    def reach(self) -> float:
        """Distance of the frame's outer corners from the middle, m."""
        return (self.size / 2 + BAR) / float(cos(math.pi / self.sides))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Turn from its axes to the world's (x, y, z, w)."""
        roll, pitch, yaw = np.radians(
            np.array([self.roll, -self.pitch, self.yaw], dtype=float)
        ).tolist()
        x, y, z, w = from_euler(roll, pitch, yaw)
        return x, y, z, w


def make_gate_frame(gate: Gate) -> list[Obstacle]:
    """Make the bars of a frame, one at each side of the opening; they overlap at the corners."""
    length = 2 * (gate.size / 2 + BAR) * float(tan(math.pi / gate.sides))
    return [Obstacle("box", (BAR, BAR, length), ORANGE)] * gate.sides


def bar_poses(gates: Sequence[Gate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tell where the bars of gates are.

    Returns:
        (B,) which gate each belongs to; (B, 3) how far it is from that gate's middle, in world
        axes, m; (B, 4) its turn, body to world. A bar's y points away from the middle.
    """
    sides = np.array([gate.sides for gate in gates])
    gate_index = np.repeat(np.arange(len(gates)), sides)
    side = np.arange(len(gate_index)) - np.repeat(np.cumsum(sides) - sides, sides)
    angle = (2 * np.pi * side / sides[gate_index])[:, None]
    out = (np.array([gate.size for gate in gates])[gate_index, None] + BAR) / 2
    axis = gate_axes(gates)[gate_index]
    offset = out * (cos(angle) * axis[:, 1] + sin(angle) * axis[:, 2])
    # The gate's turn, after one about its own x axis.
    x, y, z, w = np.array([gate.quaternion for gate in gates])[gate_index].T[..., None]
    c, s = cos(angle / 2), sin(angle / 2)
    turn = np.concatenate([w * s + x * c, y * c + z * s, z * c - y * s, w * c - x * s], axis=1)
    return gate_index, offset, turn


def gate_axes(gates: Sequence[Gate]) -> np.ndarray:
    """List the axes x, y, z of gates in the world, (G, 3, 3)."""
    return np.array([axes(gate.quaternion) for gate in gates])


@kernel
def cross_gates(
    before: np.ndarray,
    after: np.ndarray,
    flown: np.ndarray,
    time: np.ndarray,
    period: float,
    gate_before: np.ndarray,
    gate: np.ndarray,
    axis: np.ndarray,
    size: np.ndarray,
    sides: np.ndarray,
    passed: np.ndarray,
    split: np.ndarray,
    passing: np.ndarray,
    missing: np.ndarray,
) -> None:
    """Credit drones with the gates that they fly through in a decision, straight on meanwhile.

    What counts is how they move against the gate, which may move itself.

    Args:
        before: (W, N, 3) positions before it, m.
        after: (W, N, 3) those after it, m.
        flown: (W, N) bool, drones that flew it.
        time: (W,) at its end, s.
        period: How long it took, s.
        gate_before: (W, G, 3) where the middles of the gates were before it, m.
        gate: (W, G, 3) where they are after it, m.
        axis: (W, G, 3, 3) axes of the gates: x, the direction of flight, then y and z.
        size: (W, G) widths of the openings, m.
        sides: (G,) how many sides they have.
        passed: (W, N) how many gates drones have passed in turn; brought up to date.
        split: (W, N, L) when they passed each of all laps, s; written.
        passing: (W, N) 1 where a gate was passed now, else 0; written.
        missing: (W, N) 1 where the gate's plane was crossed beside the opening; written.
    """
    for w in range(before.shape[0]):
        for i in range(before.shape[1]):
            passing[w, i] = 0.0
            missing[w, i] = 0.0
            # Who has passed all gates, or flew no more, is not asked
            turn = int(passed[w, i])
            if not flown[w, i] or turn >= split.shape[2]:
                continue
            g = turn % gate.shape[1]
            # Where the drone is in the gate's axes, before and after.
            x0, y0, z0, x1, y1, z1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                old = before[w, i, k] - gate_before[w, g, k]
                new = after[w, i, k] - gate[w, g, k]
                x0 += axis[w, g, 0, k] * old
                y0 += axis[w, g, 1, k] * old
                z0 += axis[w, g, 2, k] * old
                x1 += axis[w, g, 0, k] * new
                y1 += axis[w, g, 1, k] * new
                z1 += axis[w, g, 2, k] * new
            # The plane of the opening counts when it is crossed forwards.
            if not (x0 < 0.0 and x1 >= 0.0):
                continue
            # Where and when the plane was crossed
            share = x0 / (x0 - x1)
            y = y0 + share * (y1 - y0)
            z = z0 + share * (z1 - z0)
            # Beyond which side of the polygon is the crossing farthest out?
            out = 0.0
            for side in range(sides[g]):
                angle = 2.0 * math.pi * side / sides[g]
                out = max(out, y * cos(angle) + z * sin(angle))
            # Through the opening, or so near beside it that it counts as missed
            if out <= 0.5 * size[w, g]:
                passing[w, i] = 1.0
                split[w, i, turn] = time[w] - (1.0 - share) * period
                passed[w, i] += 1.0
            elif y * y + z * z <= (MISS_RANGE * size[w, g]) ** 2:
                missing[w, i] = 1.0


@kernel
def compute_remaining_distances(
    position: np.ndarray,
    passed: np.ndarray,
    gate: np.ndarray,
    leg: np.ndarray,
    turns: int,
    way: np.ndarray,
) -> None:
    """Compute how far drones have yet to fly, straight from gate to gate.

    Args:
        position: (W, N, 3) m.
        passed: (W, N) gates that they have passed.
        gate: (W, G, 3) where the middles of the gates are, m.
        leg: (W, G) from each gate to the next, m.
        turns: Gates of all laps.
        way: (W, N) m; written.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            way[w, i] = 0.0
            turn = int(passed[w, i])
            # Who has passed all gates has no way left
            if turn >= turns:
                continue
            g = turn % gate.shape[1]
            # To the next gate, and from gate to gate through all laps
            square = 0.0
            for k in range(3):
                square += (gate[w, g, k] - position[w, i, k]) ** 2
            way[w, i] = math.sqrt(square)
            for later in range(turn, turns - 1):
                way[w, i] += leg[w, later % gate.shape[1]]


@kernel
def rank_drones(
    way: np.ndarray,
    split: np.ndarray,
    flown: np.ndarray,
    rank: np.ndarray,
    rank_before: np.ndarray,
    overtaken: np.ndarray,
) -> None:
    """Put drones in order: by the way that is left, and those that finished by their times.

    Args:
        way: (W, N) how far each has yet to fly, m; 0 where it finished.
        split: (W, N) when it finished, s.
        flown: (W, N) bool, drones that flew the decision.
        rank: (W, N) from 1; brought up to date.
        rank_before: (W, N) those before the decision, 0 at the start; written.
        overtaken: (W, N) how many of those that were before it are behind it now; written.
    """
    drones = way.shape[1]
    for w in range(way.shape[0]):
        for i in range(drones):
            rank_before[w, i] = rank[w, i]
            rank[w, i] = 1.0
            for j in range(drones):
                # One more place for each that is ahead; ties go by time, then by number
                is_first = way[w, j] < way[w, i]
                if way[w, j] == way[w, i]:
                    is_first = split[w, j] < split[w, i] or (split[w, j] == split[w, i] and j < i)
                if is_first:
                    rank[w, i] += 1.0
        for i in range(drones):
            # Whoever was ahead before and is behind now, and still flies
            overtaken[w, i] = 0.0
            for j in range(drones):
                # Who stands still by a crash is passed, not overtaken.
                fly = flown[w, i] and flown[w, j]
                was_behind = 0.0 < rank_before[w, j] < rank_before[w, i]
                if fly and was_behind and rank[w, j] > rank[w, i]:
                    overtaken[w, i] += 1.0
