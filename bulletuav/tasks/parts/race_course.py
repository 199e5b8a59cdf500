"""The course of a race: its options, its gates as bodies that may swing, and where drones start."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.frame import Scene, Spawn, TaskContext
from bulletuav.tasks.parts.gates import Gate, bar_poses, gate_axes, make_gate_frame
from bulletuav.tasks.parts.tracks import (
    RANDOM,
    RandomTrack,
    draw_track,
    find_track_error,
    load_track,
    place_start_blocks,
)

HOVER_HEIGHT = 1.0
"""Height at which drones start that do not take off, m"""


@dataclass(frozen=True)
class RaceConfig(TaskConfig):
    """Options of `race`, beside those of every task.

    Attributes:
        track: "random" for one that is drawn for each episode, the name of a track that comes with
            the package, or the path of a TOML file.
        laps: How often all gates are flown through.
        num_gates: Gates of a random track.
        track_radius: Greatest distance of a gate of a random track from the middle, m.
        gate_height: Least and greatest height of the middles of its gates, m.
        gate_tilt: Greatest pitch and roll of its gates, degrees.
        gate_shape: Shape of gates where a file tells none: "square", "round", or "mixed".
        gate_size: Width of their openings, m.
        gate_motion: How far gates swing to either side, m.
        gate_period: Time of a swing to and fro, s.
        gates_seen: How many of the next gates a drone observes.
        contact_ends: What a contact ends: "drone", the drone's episode, or "nothing".
        penalty: What a gate missed, or a contact, adds to `race_time`, s.
        margin: Distance from gates to the bounds of the arena, m.
        take_off: Whether drones start at rest on the ground, with rotors that stand still. Else
            they hover 1 m high at the start.
    """

    track: str = RANDOM
    laps: int = field(default=1, metadata={"most": 100})
    num_gates: int = field(default=6, metadata={"least": 2, "most": 50})
    track_radius: float = field(default=25.0, metadata={"most": 1000.0})
    gate_height: tuple[float, float] = (2.0, 5.0)
    gate_tilt: float = field(default=15.0, metadata={"most": 45.0})
    gate_shape: Literal["square", "round", "mixed"] = "mixed"
    gate_size: float = field(default=2.0, metadata={"most": 100.0})
    gate_motion: float = field(default=0.0, metadata={"most": 100.0})
    gate_period: float = 6.0
    gates_seen: int = field(default=2, metadata={"most": 50})
    contact_ends: Literal["drone", "nothing"] = "drone"
    penalty: float = 2.0
    margin: float = 15.0
    take_off: bool = True


class RaceCourse:
    """What drones race on: gates that are given, or drawn for each episode.

    Attributes:
        gates: How many there are.
        turns: Gates of all laps.
        bodies: Bars of all gates.
        sides: (G,) how many sides the openings have.
        widest, narrowest: Width of the widest and of the narrowest opening, m.
        fastest: Speed of gates in the middle of their swings, m/s; 1 where none does.
        arena: Its lower and upper corner, (3,) each, m.
    """

    def __init__(self, config: RaceConfig, context: TaskContext) -> None:
        """Read the track, or draw one to learn what all have in common.

        Raises:
            ValueError: There is no such track, or it cannot be flown.
        """
        low, high = config.gate_height
        if not 0 < low <= high:
            raise ValueError(
                f"gate_height is {config.gate_height}: from low to high, above 0, is needed"
            )
        if config.gate_motion and not config.gate_period:
            raise ValueError("gate_period is 0 s: above 0 is needed where gates swing")
        self._config, self._context = config, context
        # What a user gives may be no text at all, such as an array.
        self._is_random = isinstance(config.track, str) and config.track == RANDOM
        shape = (config.gate_tilt, config.gate_shape, config.gate_size)
        self._like = RandomTrack(config.num_gates, config.track_radius, config.gate_height, *shape)
        self._given = None if self._is_random else self._read()
        # Bars are the same in all random tracks; only where they are is drawn.
        some = self._given or self._drawn(np.random.default_rng(0))
        self.gates, self.turns = len(some), config.laps * len(some)
        self.bodies = tuple(bar for gate in some for bar in make_gate_frame(gate))
        self.sides = np.array([gate.sides for gate in some])
        sizes = [gate.size for gate in some]
        self.widest, self.narrowest = max(sizes), min(sizes)
        self._rate = 2 * np.pi / config.gate_period if config.gate_motion else 0.0
        self._speed = self._rate * config.gate_motion
        self.fastest = self._speed or 1.0
        self._gate_index = bar_poses(some)[0]
        self.arena = self._lay_out(some)

    def _read(self) -> tuple[Gate, ...]:
        """Read the track that is given, and refuse one that cannot be flown."""
        config, context = self._config, self._context
        gates = load_track(config.track, self._like)
        places = place_start_blocks(gates, context.num_drones)
        found = find_track_error(gates, places, context.collision_radius, config.gate_motion)
        if found is not None:
            raise ValueError(f"track {config.track!r} cannot be flown: {found}")
        return gates

    def _drawn(self, rng: np.random.Generator) -> tuple[Gate, ...]:
        """Draw a track."""
        racers = (self._context.num_drones, self._context.collision_radius)
        return draw_track(rng, self._like, *racers, self._config.gate_motion)

    def _lay_out(self, gates: tuple[Gate, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Lay out the arena, and refuse tracks that are too long for an episode."""
        config, context = self._config, self._context
        middle, start = np.array([gate.position for gate in gates]), self._blocks(gates)
        # The arena holds gates and blocks, with a margin around
        places = np.concatenate([middle, start])
        low, high = places.min(axis=0), places.max(axis=0)
        if self._given is None:  # wherever gates and blocks of others are
            behind = float(np.linalg.norm(start[:, :2] - middle[0, :2], axis=1).max())
            reach = config.track_radius + behind
            low, high = np.full(3, -reach), np.array((reach, reach, config.gate_height[1]))
        low, high = low - config.margin, high + config.margin
        low[2] = 0.0
        # The shortest way through all gates, m, must be possible in the time
        lap = float(np.linalg.norm(middle - np.roll(middle, 1, axis=0), axis=1).sum())
        furthest = context.max_speed * context.duration
        if config.laps * lap > furthest:
            raise ValueError(
                f"track {config.track!r} has {config.laps} laps of {lap:.4g} m, and drones fly "
                f"{furthest:.4g} m in {context.duration:g} s at most: raise horizon or max_speed, "
                f"fly fewer laps, or lower track_radius"
            )
        return low, high

    def _blocks(self, gates: tuple[Gate, ...]) -> np.ndarray:
        """Tell where drones start, (N, 3) m."""
        start: np.ndarray = place_start_blocks(gates, self._context.num_drones) + np.array(
            (0.0, 0.0, HOVER_HEIGHT)
        )
        return start

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a track, unless one is given, and the swings of its gates; put drones on blocks."""
        gates = self._given or self._drawn(rng)
        # Gates swing from a phase of their own
        phase = rng.uniform(-np.pi, np.pi, len(gates))
        middle, axis = np.array([gate.position for gate in gates]), gate_axes(gates)
        (aside,), (velocity,) = self.swing(np.zeros(1), axis[None], phase[None])
        # Frames are bars about the middle, which move with it
        gate_index, offset, turn = bar_poses(gates)
        now = middle + aside
        # What is kept of the gates; `leg` goes from each to the next
        memory = {
            "gate": now,
            "gate_before": now,
            "gate_velocity": velocity,
            "gate_axis": axis,
            "gate_size": np.array([gate.size for gate in gates]),
            "gate_phase": phase,
            "leg": np.sqrt(((np.roll(middle, -1, axis=0) - middle) ** 2).sum(axis=1)),
        }
        return Spawn(
            position=self._blocks(gates),
            goal=now[0],
            goal_velocity=velocity[0],
            obstacle=now[gate_index] + offset,
            obstacle_velocity=velocity[gate_index],
            obstacle_quaternion=turn,
            memory=memory,
        )

    def swing(
        self, time: np.ndarray, axis: np.ndarray, phase: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tell how far gates swing to their left, and how fast.

        Args:
            time: (K,) since the start, s.
            axis: (K, G, 3, 3) their axes.
            phase: (K, G) rad.

        Returns:
            (K, G, 3) m, and (K, G, 3) m/s.
        """
        angle = (self._rate * time[:, None] + phase)[..., None]
        left = axis[:, :, 1]
        return self._config.gate_motion * sin(angle) * left, self._speed * cos(angle) * left

    def move(self, scene: Scene, time: np.ndarray, flying: np.ndarray) -> None:
        """Swing the gates of the worlds of `flying` (W,) on by a decision that begins at `time`."""
        memory = scene.memory
        axis, phase = memory["gate_axis"][flying], memory["gate_phase"][flying]
        old, _ = self.swing(time[flying], axis, phase)
        new, velocity = self.swing(time[flying] + self._context.period, axis, phase)
        moved = new - old
        memory["gate"][flying] += moved
        memory["gate_velocity"][flying] = velocity
        scene.obstacle[flying] += moved[:, self._gate_index]
        scene.obstacle_velocity[flying] = velocity[:, self._gate_index]
