"""Course of a race: options, gates as bodies that may oscillate, and starting blocks."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.frame import Scene, Spawn, TaskContext
from bulletuav.tasks.parts.gate_frames import find_frames
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
"""Height at which drones start if they do not take off, m"""


@dataclass(frozen=True)
class RaceConfig(TaskConfig):
    """Options of `race`, in addition to those of every task.

    Attributes:
        track: "random" for a track drawn for each episode, the name of a track of the package, or
            the path of a TOML, YAML, JSON or CSV file.
        laps: Number of laps through all gates.
        num_gates: Number of gates of a random track.
        track_radius: Maximum distance of a gate of a random track from the centre, m.
        gate_height: Minimum and maximum height of the centres of its gates, m.
        gate_tilt: Maximum pitch and roll of its gates, degrees.
        gate_shape: Shape of gates unless a file sets it: "square", "round", or "mixed".
        gate_size: Width of their openings, m.
        gate_motion: Amplitude of the lateral oscillation of gates, m.
        gate_period: Period of the oscillation, s.
        gates_seen: Number of next gates that a drone observes.
        contact_ends: Effect of a contact: "drone" ends the drone's episode, "nothing" does not.
        penalty: Time added to `race_time` for each missed gate and each contact, s.
        margin: Distance from gates to the bounds of the arena, m.
        take_off: Whether drones start at rest on the ground, with rotors stopped. Otherwise they
            start hovering at a height of 1 m.
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
    """Gates of a race, given or drawn for each episode.

    Attributes:
        gates: Number of gates of a lap; a gate that is flown twice counts twice.
        turns: Number of gates of all laps.
        bodies: Bars of all frames.
        sides: (G,) numbers of sides of the openings.
        widest, narrowest: Width of the widest and of the narrowest opening, m.
        fastest: Maximum speed of oscillating gates, m/s; 1 if gates do not move.
        arena: Lower and upper corner of the arena, (3,) each, m.
    """

    def __init__(self, config: RaceConfig, context: TaskContext) -> None:
        """Read the track, or draw one to determine the properties common to all random tracks.

        Raises:
            ValueError: If the track does not exist or cannot be flown.
        """
        low, high = config.gate_height
        if not 0 < low <= high:
            raise ValueError(
                f"gate_height is {config.gate_height}: from low to high, above 0, is needed"
            )
        if config.gate_motion and not config.gate_period:
            raise ValueError("gate_period is 0 s: above 0 is needed if gates oscillate")
        self._config, self._context = config, context
        # `track` may be anything, such as an array
        self._is_random = isinstance(config.track, str) and config.track == RANDOM
        shape = (config.gate_tilt, config.gate_shape, config.gate_size)
        self._like = RandomTrack(config.num_gates, config.track_radius, config.gate_height, *shape)
        self._given = None if self._is_random else self._read()
        # All random tracks have the same bars, in different poses
        some = self._given or self._drawn(np.random.default_rng(0))
        self.gates, self.turns = len(some), config.laps * len(some)
        # Each gate's frame, and the gates that have the frames
        self._frame = find_frames(some)
        self._framed = np.unique(self._frame)
        frames = [some[k] for k in self._framed]
        self.bodies = tuple(bar for gate in frames for bar in make_gate_frame(gate))
        self.sides = np.array([gate.sides for gate in some])
        sizes = [gate.size for gate in some]
        self.widest, self.narrowest = max(sizes), min(sizes)
        self._rate = 2 * np.pi / config.gate_period if config.gate_motion else 0.0
        self._speed = self._rate * config.gate_motion
        self.fastest = self._speed or 1.0
        self._gate_index = self._framed[bar_poses(frames)[0]]
        self.arena = self._lay_out(some)

    def _read(self) -> tuple[Gate, ...]:
        """Read the given track, and check that it can be flown."""
        config, context = self._config, self._context
        gates = load_track(config.track, self._like)
        places = place_start_blocks(gates, context.num_drones)
        found = find_track_error(gates, places, context.collision_radius, config.gate_motion)
        if found is not None:
            raise ValueError(f"track {config.track!r} cannot be flown: {found}")
        return gates

    def _drawn(self, rng: np.random.Generator) -> tuple[Gate, ...]:
        racers = (self._context.num_drones, self._context.collision_radius)
        return draw_track(rng, self._like, *racers, self._config.gate_motion)

    def _lay_out(self, gates: tuple[Gate, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the arena, after checking that the track is short enough for an episode."""
        config, context = self._config, self._context
        middle, start = np.array([gate.position for gate in gates]), self._blocks(gates)
        places = np.concatenate([middle, start])
        low, high = places.min(axis=0), places.max(axis=0)
        if self._given is None:  # contains all random tracks
            behind = float(np.linalg.norm(start[:, :2] - middle[0, :2], axis=1).max())
            half_side = config.track_radius + behind
            low, high = (
                np.full(3, -half_side),
                np.array((half_side, half_side, config.gate_height[1])),
            )
        low, high = low - config.margin, high + config.margin
        low[2] = 0.0
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
        """Return the starting positions, (N, 3) m."""
        start: np.ndarray = place_start_blocks(gates, self._context.num_drones) + np.array(
            (0.0, 0.0, HOVER_HEIGHT)
        )
        return start

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a track, unless given, and the phases of its gates; place drones on blocks."""
        gates = self._given or self._drawn(rng)
        middle, axis = np.array([gate.position for gate in gates]), gate_axes(gates)
        # Gates with the same frame oscillate together, also if their y axes are opposite
        phase = np.zeros(len(gates))
        phase[self._framed] = rng.uniform(-np.pi, np.pi, len(self._framed))
        is_opposite = (axis[:, 1] * axis[self._frame, 1]).sum(axis=1) < 0
        phase = phase[self._frame] + np.pi * is_opposite
        (aside,), (velocity,) = self.swing(np.zeros(1), axis[None], phase[None])
        _, offset, turn = bar_poses([gates[k] for k in self._framed])
        gate_index = self._gate_index
        now = middle + aside
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
        """Return the offsets and velocities of oscillating gates, along their y axes.

        Args:
            time: (K,) time since the start, s.
            axis: (K, G, 3, 3) axes of the gates.
            phase: (K, G) rad.

        Returns:
            (K, G, 3) m, and (K, G, 3) m/s.
        """
        angle = (self._rate * time[:, None] + phase)[..., None]
        left = axis[:, :, 1]
        return self._config.gate_motion * sin(angle) * left, self._speed * cos(angle) * left

    def move(self, scene: Scene, time: np.ndarray, flying: np.ndarray) -> None:
        """Move the gates of worlds `flying` (W,) through a decision that starts at `time`."""
        memory = scene.memory
        axis, phase = memory["gate_axis"][flying], memory["gate_phase"][flying]
        old, _ = self.swing(time[flying], axis, phase)
        new, velocity = self.swing(time[flying] + self._context.period, axis, phase)
        moved = new - old
        memory["gate"][flying] += moved
        memory["gate_velocity"][flying] = velocity
        scene.obstacle[flying] += moved[:, self._gate_index]
        scene.obstacle_velocity[flying] = velocity[:, self._gate_index]
