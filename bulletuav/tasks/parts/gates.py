"""Gates of a race: solid frames made of bars, and the test for flying through them.

The axes of a gate are x, the direction of flight, y to the left and z up. The opening is a regular
polygon perpendicular to x: the area that the bars leave free.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bulletuav.compiled.functions import cos, sin, tan
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import find_choice, finite, points_of
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, from_euler

SIDES = {"square": 4, "round": 12}
"""Number of sides of the opening, by shape"""
BAR = 0.2
"""Default thickness of the bars of a frame, m"""
ORANGE = (0.95, 0.45, 0.1, 1.0)
"""Colour of frames, RGBA"""
MISS_RANGE = 3.0
"""Distance from the centre up to which crossing the plane beside the opening is a miss, sizes"""


@dataclass(frozen=True)
class Gate:
    """Pose, shape and size of a gate.

    Attributes:
        position: Centre of the opening, m.
        yaw: Direction of flight, from east to north, degrees.
        pitch: Inclination of the direction of flight, positive upwards, degrees.
        roll: Rotation of the frame about this direction, degrees.
        shape: "square" or "round".
        size: Width of the opening between opposite sides, m.
        bar: Thickness of the bars of the frame, m.

    Raises:
        ValueError: If the shape is unknown, or a number is out of range.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    shape: str = "square"
    size: float = 2.0
    bar: float = BAR

    def __post_init__(self) -> None:
        find_choice("shape of a gate", self.shape, SIDES)
        (place,) = points_of("position of a gate", self.position)
        object.__setattr__(self, "position", tuple(place.tolist()))
        finite("yaw of a gate", self.yaw)
        finite("pitch of a gate", self.pitch, -90, 90)
        finite("roll of a gate", self.roll)
        if finite("size of a gate", self.size, 0, 100) == 0:
            raise ValueError("size of a gate is 0 m: above 0 is needed")
        finite("bar of a gate", self.bar, 0.01, 10)

    @property
    def sides(self) -> int:
        """Number of sides of the opening."""
        return SIDES[self.shape]

    @property
    def reach(self) -> float:
        """Distance of the frame's outer corners from the centre, m."""
        return (self.size / 2 + self.bar) / float(cos(math.pi / self.sides))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Rotation from the gate's axes to the world's (x, y, z, w)."""
        roll, pitch, yaw = np.radians(
            np.array([self.roll, -self.pitch, self.yaw], dtype=float)
        ).tolist()
        x, y, z, w = from_euler(roll, pitch, yaw)
        return x, y, z, w


def reverse_gate(gate: Gate) -> Gate:
    """Return the gate with the same frame that is flown in the opposite direction."""
    return replace(gate, yaw=gate.yaw + 180.0, pitch=-gate.pitch, roll=-gate.roll)


def make_gate_frame(gate: Gate) -> list[Obstacle]:
    """Return the bars of a gate's frame, one per side; they overlap at the corners."""
    length = 2 * (gate.size / 2 + gate.bar) * float(tan(math.pi / gate.sides))
    return [Obstacle("box", (gate.bar, gate.bar, length), ORANGE)] * gate.sides


def bar_poses(gates: Sequence[Gate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the poses of the bars of gates.

    Returns:
        (B,) index of each bar's gate; (B, 3) offset from the gate's centre, in world axes, m; (B,
        4) quaternion, body to world. A bar's y axis points away from the centre.
    """
    sides = np.array([gate.sides for gate in gates])
    gate_index = np.repeat(np.arange(len(gates)), sides)
    side = np.arange(len(gate_index)) - np.repeat(np.cumsum(sides) - sides, sides)
    angle = (2 * np.pi * side / sides[gate_index])[:, None]
    out = np.array([(gate.size + gate.bar) / 2 for gate in gates])[gate_index, None]
    axis = gate_axes(gates)[gate_index]
    offset = out * (cos(angle) * axis[:, 1] + sin(angle) * axis[:, 2])
    # The gate's rotation composed with one about its x axis
    x, y, z, w = np.array([gate.quaternion for gate in gates])[gate_index].T[..., None]
    c, s = cos(angle / 2), sin(angle / 2)
    turn = np.concatenate([w * s + x * c, y * c + z * s, z * c - y * s, w * c - x * s], axis=1)
    return gate_index, offset, turn


def gate_axes(gates: Sequence[Gate]) -> np.ndarray:
    """Return the axes x, y, z of gates in the world, (G, 3, 3)."""
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
    """Detect passed and missed gates in a decision, assuming straight motion in between.

    The motion is relative to the gate, which may move.

    Args:
        before: (W, N, 3) positions before the decision, m.
        after: (W, N, 3) positions after the decision, m.
        flown: (W, N) bool, drones active before the decision.
        time: (W,) time at the end of the decision, s.
        period: Length of the decision, s.
        gate_before: (W, G, 3) centres of the gates before the decision, m.
        gate: (W, G, 3) centres of the gates after the decision, m.
        axis: (W, G, 3, 3) axes of the gates: x, the direction of flight, then y and z.
        size: (W, G) widths of the openings, m.
        sides: (G,) numbers of sides of the openings.
        passed: (W, N) number of gates passed in order; updated.
        split: (W, N, L) times of passing each gate of all laps, s; updated.
        passing: (W, N) output: number of gates passed in this decision.
        missing: (W, N) output: 1 if the next gate's plane was crossed beside the opening, else 0.
    """
    for w in range(before.shape[0]):
        for i in range(before.shape[1]):
            passing[w, i] = 0.0
            missing[w, i] = 0.0
            if not flown[w, i]:
                continue
            # A fast drone may pass several close gates in a decision, each later than the one
            # before it; drones that finished have no next gate
            last = -1.0
            for turn in range(int(passed[w, i]), split.shape[2]):
                g = turn % gate.shape[1]
                # Positions in the gate's axes, before and after
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
                # The plane has to be crossed forwards
                if not (x0 < 0.0 and x1 >= 0.0):
                    break
                # Point and time of crossing
                share = x0 / (x0 - x1)
                if share <= last:
                    break
                last = share
                y = y0 + share * (y1 - y0)
                z = z0 + share * (z1 - z0)
                # Maximum distance from the centre, along the normals of the polygon's sides
                out = 0.0
                for side in range(sides[g]):
                    angle = 2.0 * math.pi * side / sides[g]
                    out = max(out, y * cos(angle) + z * sin(angle))
                # Through the opening, or close enough beside it to be a miss
                if out <= 0.5 * size[w, g]:
                    passing[w, i] += 1.0
                    split[w, i, turn] = time[w] - (1.0 - share) * period
                    passed[w, i] += 1.0
                    continue
                if passing[w, i] == 0.0 and y * y + z * z <= (MISS_RANGE * size[w, g]) ** 2:
                    missing[w, i] = 1.0
                break


@kernel
def compute_remaining_distances(
    position: np.ndarray,
    passed: np.ndarray,
    gate: np.ndarray,
    leg: np.ndarray,
    turns: int,
    remaining_distance: np.ndarray,
) -> None:
    """Compute the remaining distances to the finish, straight from gate to gate.

    Args:
        position: (W, N, 3) m.
        passed: (W, N) number of gates passed.
        gate: (W, G, 3) centres of the gates, m.
        leg: (W, G) distance from each gate to the next, m.
        turns: Number of gates of all laps.
        remaining_distance: (W, N) output, m.
    """
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            remaining_distance[w, i] = 0.0
            turn = int(passed[w, i])
            # Drones that finished have no remaining distance
            if turn >= turns:
                continue
            g = turn % gate.shape[1]
            # Distance to the next gate, then from gate to gate through all laps
            square = 0.0
            for k in range(3):
                square += (gate[w, g, k] - position[w, i, k]) ** 2
            remaining_distance[w, i] = math.sqrt(square)
            for later in range(turn, turns - 1):
                remaining_distance[w, i] += leg[w, later % gate.shape[1]]


@kernel
def rank_drones(
    remaining_distance: np.ndarray,
    split: np.ndarray,
    flown: np.ndarray,
    rank: np.ndarray,
    rank_before: np.ndarray,
    overtaken: np.ndarray,
) -> None:
    """Rank drones by remaining distance, and finished ones by their times.

    Args:
        remaining_distance: (W, N) m; 0 if finished.
        split: (W, N) time of finishing, s.
        flown: (W, N) bool, drones active before the decision.
        rank: (W, N) rank from 1; updated.
        rank_before: (W, N) output: rank before the decision, 0 at the start.
        overtaken: (W, N) output: number of drones that were ahead and are behind now.
    """
    drones = remaining_distance.shape[1]
    for w in range(remaining_distance.shape[0]):
        for i in range(drones):
            rank_before[w, i] = rank[w, i]
            rank[w, i] = 1.0
            for j in range(drones):
                # Ties are broken by time, then by index
                is_first = remaining_distance[w, j] < remaining_distance[w, i]
                if remaining_distance[w, j] == remaining_distance[w, i]:
                    is_first = split[w, j] < split[w, i] or (split[w, j] == split[w, i] and j < i)
                if is_first:
                    rank[w, i] += 1.0
        for i in range(drones):
            overtaken[w, i] = 0.0
            for j in range(drones):
                # Crashed drones are not overtaken
                fly = flown[w, i] and flown[w, j]
                was_behind = 0.0 < rank_before[w, j] < rank_before[w, i]
                if fly and was_behind and rank[w, j] > rank[w, i]:
                    overtaken[w, i] += 1.0
