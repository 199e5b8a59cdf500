"""Race tracks: read from files, drawn at random, and checked for whether they can be flown."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bulletuav.compiled.functions import atan2, cos, hypot, sin
from bulletuav.errors import find_choice, require_file, shown, unknown
from bulletuav.tasks.parts.gate_frames import do_intersect, find_frames, make_bars
from bulletuav.tasks.parts.gates import Gate, gate_axes
from bulletuav.tasks.parts.track_files import TRACK_READERS, read_track
from bulletuav.vehicle.airframes import URDF_FOLDER

RANDOM = "random"
"""Name of tracks that are drawn for each episode"""
CLEAR_LENGTH = 3.0
"""Length that must be clear before and behind a gate, m"""
MIN_CLEARANCE = 0.5
"""Distance of this clear path from frames and from the ground, m"""
START_HEIGHT = 1.5
"""Height above a starting block that frames of other gates leave free, m"""
BLOCKS_PER_ROW = 4
"""Number of starting blocks in a row"""
BLOCK_SPACING, ROW_SPACING = 2.0, 2.5
"""Distance between neighbouring blocks, and between rows of blocks, m"""
RUN_UP_DISTANCE = 6.0
"""Distance from the first row of blocks to the first gate, m"""
MAX_TRIES = 200
"""Maximum number of draws of a random track until it can be flown"""
RADIUS_SPREAD = 0.3
"""Variation of the distance of a random track's gates from the centre, as a fraction"""
MAX_YAW_OFFSET = 15.0
"""Maximum deviation of a random gate's yaw from the direction of the track, degrees"""

TRACK_FOLDER = URDF_FOLDER.parent / "tracks"
"""Folder of the tracks of the package"""

ENDINGS = ", ".join(TRACK_READERS)


@dataclass(frozen=True)
class RandomTrack:
    """Distribution of random tracks.

    Attributes:
        gates: Number of gates.
        radius: Maximum distance of a gate from the centre, m.
        height: Minimum and maximum height of the centres of gates, m.
        tilt: Maximum pitch and roll of gates, degrees.
        shape: "square", "round", or "mixed" for alternating shapes.
        size: Width of the openings, m.
    """

    gates: int
    radius: float
    height: tuple[float, float]
    tilt: float
    shape: str
    size: float

    def draw(self, rng: np.random.Generator) -> tuple[Gate, ...]:
        """Draw gates around the centre, clockwise or counterclockwise; they may overlap."""
        count = self.gates
        turn = 2 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
        angle = (1.0 if rng.uniform() < 0.5 else -1.0) * turn + rng.uniform(-np.pi, np.pi)
        radius = self.radius * rng.uniform(1 - RADIUS_SPREAD, 1, count)
        height = rng.uniform(*self.height, count)
        place = np.stack([radius * cos(angle), radius * sin(angle), height], axis=1)
        # Gates face roughly from the previous gate to the next one
        direction = np.roll(place, -1, axis=0) - np.roll(place, 1, axis=0)
        yaw = np.degrees(atan2(direction[:, 1], direction[:, 0])) + rng.uniform(
            -MAX_YAW_OFFSET, MAX_YAW_OFFSET, count
        )
        slope = np.degrees(atan2(direction[:, 2], hypot(direction[:, 0], direction[:, 1])))
        pitch = slope + self.tilt * rng.uniform(-1, 1, count)
        roll = self.tilt * rng.uniform(-1, 1, count)
        pitch = np.clip(pitch, -60, 60)
        # The first gate is upright, as drones approach it from the ground
        pitch[0] = roll[0] = 0.0
        shapes = [self.shape_of(k) for k in range(count)]
        numbers = zip(place.tolist(), yaw.tolist(), pitch.tolist(), roll.tolist(), strict=True)
        return tuple(
            Gate((x, y, z), heading, rise, lean, shape, self.size)
            for ((x, y, z), heading, rise, lean), shape in zip(numbers, shapes, strict=True)
        )

    def shape_of(self, k: int) -> str:
        """Return the shape of gate k."""
        return ("square", "round")[k % 2] if self.shape == "mixed" else self.shape


def list_tracks() -> list[str]:
    """Return the names of the tracks of the package."""
    return sorted(path.stem for path in TRACK_FOLDER.glob("*.toml"))


def load_track(source: object, usual: RandomTrack) -> tuple[Gate, ...]:
    """Read a track.

    Args:
        source: Name of a track, or the path of a TOML, YAML, JSON or CSV file; see `read_track`.
        usual: Default shape and size of gates.

    Returns:
        The gates in the order of flight, one per passage.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the name is unknown, or the file is not a valid track.
    """
    names = list_tracks()
    if not isinstance(source, str | Path):
        raise ValueError(
            f"track is {shown(source)}: {RANDOM!r}, a name such as {names[0]!r}, or the path of a "
            f"{ENDINGS} file is needed"
        )
    is_file = isinstance(source, Path) or Path(source).suffix.lower() in TRACK_READERS
    if isinstance(source, str) and not is_file:
        if Path(source).suffix:
            raise ValueError(f"track {shown(source)} is no {ENDINGS} file, and no name of a track")
        if source not in names:
            raise unknown("track", source, (RANDOM, *names))
        source = TRACK_FOLDER / f"{source}.toml"
    path = require_file(
        "track", source, f"choose from {', '.join(names)}, or give a {ENDINGS} file"
    )
    find_choice(f"kind of file for track {str(path)!r},", path.suffix.lower(), TRACK_READERS)
    return read_track(path, lambda k: {"shape": usual.shape_of(k), "size": usual.size})


def place_start_blocks(gates: tuple[Gate, ...], drones: int) -> np.ndarray:
    """Return the positions of starting blocks on the ground before the first gate, in rows of four.

    Returns:
        (N, 3) m; the first blocks are nearest to the gate.

    Raises:
        ValueError: If the direction of the first gate is too steep.
    """
    (east, north, _) = gate_axes(gates[:1])[0, 0]
    level = float(hypot(east, north))
    if level < 0.5:
        raise ValueError(
            f"gate 0 has a pitch of {gates[0].pitch:g} degrees: 60 at most are possible, as drones "
            f"start on the ground before it"
        )
    # Axes on the ground, towards the gate and to its left
    forward = np.array((east, north)) / level
    left = np.array((-forward[1], forward[0]))
    # Each row is centred, also an incomplete last row
    index = np.arange(drones)
    row, column = index // BLOCKS_PER_ROW, index % BLOCKS_PER_ROW
    in_row = np.minimum(drones - row * BLOCKS_PER_ROW, BLOCKS_PER_ROW)
    aside = BLOCK_SPACING * (column - (in_row - 1) / 2)
    behind = RUN_UP_DISTANCE + ROW_SPACING * row
    places = np.array(gates[0].position[:2]) - np.outer(behind, forward) + np.outer(aside, left)
    return np.column_stack([places, np.zeros(drones)])


def find_track_error(
    gates: tuple[Gate, ...], start: np.ndarray, radius: float, motion: float
) -> str | None:
    """Return the reason why a track of a file cannot be flown, or None.

    Frames may be close to each other, or above each other, as long as they do not intersect. Gates
    of equal poses, or of opposite directions, are passages of one frame.

    Args:
        gates: Gates in the order of flight.
        start: (N, 3) start positions, m.
        radius: Collision radius of the drones, m.
        motion: Amplitude of the gates' oscillation, m.
    """
    frames = np.unique(find_frames(gates)).tolist()
    bars = {k: make_bars(gates[k], motion) for k in frames}
    columns = np.repeat(
        np.diag((MIN_CLEARANCE, MIN_CLEARANCE, START_HEIGHT / 2))[None], len(start), 0
    )
    above = start + np.array((0.0, 0.0, START_HEIGHT / 2))
    for k in frames:
        gate = gates[k]
        label = _label(gates, k)
        if (found := _narrow_or_low(gate, label, radius, 0.0, radius)) is not None:
            return found
        if do_intersect(*bars[k], above, columns):
            return (
                f"{label} is less than {MIN_CLEARANCE:g} m from a starting block, or from the "
                f"{START_HEIGHT:g} m above it: move it"
            )
        for other in frames[: frames.index(k)]:
            apart = gate.reach + gates[other].reach + 2 * motion
            offset = np.subtract(gate.position, gates[other].position)
            if (offset**2).sum() < apart**2 and do_intersect(*bars[k], *bars[other]):
                return (
                    f"{_label(gates, other)} and {label} overlap, with bars {gate.bar:g} m thick: "
                    f"move one, make its size or bar smaller, or use equal poses if they are one "
                    f"gate"
                )
    return None


def find_spacing_error(
    gates: tuple[Gate, ...], start: np.ndarray, radius: float, motion: float
) -> str | None:
    """Return the reason why a drawn track has too little space between gates, or None.

    Args:
        gates: Gates in the order of flight.
        start: (N, 3) start positions, m.
        radius: Collision radius of the drones, m.
        motion: Amplitude of the gates' oscillation, m.
    """
    middle = np.array([gate.position for gate in gates])
    reach = np.array([gate.reach for gate in gates]) + motion
    forward = gate_axes(gates)[:, 0]
    # Distances between gates, and from the clear paths through them
    offset = middle - middle[:, None]
    along = np.clip((offset * forward[:, None]).sum(axis=-1), -CLEAR_LENGTH, CLEAR_LENGTH)
    off = offset - along[..., None] * forward[:, None]
    gap, off = (np.sqrt((one**2).sum(axis=-1)) for one in (offset, off))
    apart, clear = reach[:, None] + reach, reach + MIN_CLEARANCE
    np.fill_diagonal(gap, np.inf)
    np.fill_diagonal(off, np.inf)
    block = np.sqrt(((start[:, None] - middle) ** 2).sum(axis=-1)).min(axis=0)
    for k, gate in enumerate(gates):
        label = _label(gates, k)
        if (found := _narrow_or_low(gate, label, radius, gate.bar, MIN_CLEARANCE)) is not None:
            return found
        if (gap[k] < apart[k]).any():
            other = int((gap[k] < apart[k]).argmax())
            return (
                f"{label} and gate {other} overlap: their middles are {gap[k, other]:.3g} m apart, "
                f"{apart[k, other]:.3g} m are needed"
            )
        if (off[k] < clear).any():
            return (
                f"{label} is blocked by gate {int((off[k] < clear).argmax())}: "
                f"{CLEAR_LENGTH:g} m before and behind it have to be clear; turn or move it"
            )
        if block[k] < clear[k]:
            return f"{label} is {block[k]:.3g} m from a starting block: {clear[k]:.3g} m are needed"
    return None


def _label(gates: tuple[Gate, ...], k: int) -> str:
    return f"gate {k} at {shown(gates[k].position)} m"


def _narrow_or_low(
    gate: Gate, label: str, radius: float, bar: float, clearance: float
) -> str | None:
    """Return the reason why a gate is too narrow or too low, or None.

    Args:
        gate: The gate.
        label: Its name.
        radius: Collision radius of the drones, m.
        bar: Thickness of bars that have to be above the ground, m.
        clearance: Distance of the path through the gate from the ground, m.
    """
    if gate.size <= 2 * radius:
        return f"{label} is {gate.size:g} m wide, and a drone is {2 * radius:.3g} m: widen it"
    height, climb = gate.position[2], gate_axes([gate])[0, 0, 2]
    if height < _depth(gate, bar):
        return f"{label} reaches into the ground: raise it"
    if height - CLEAR_LENGTH * abs(climb) < clearance:
        return (
            f"{label} faces the ground: the path through it is below {clearance:g} m at "
            f"{CLEAR_LENGTH:g} m from it; raise it, or lower its pitch"
        )
    return None


def _depth(gate: Gate, bar: float) -> float:
    """Return how far an opening with bars of a thickness extends below its centre, m."""
    _, left, up = gate_axes([gate])[0]
    steps = 2 * math.pi * (np.arange(gate.sides) + 0.5) / gate.sides
    reach = (gate.size / 2 + bar) / float(cos(math.pi / gate.sides))
    return float(-reach * (cos(steps) * left[2] + sin(steps) * up[2]).min())


def draw_track(
    rng: np.random.Generator, like: RandomTrack, drones: int, radius: float, motion: float
) -> tuple[Gate, ...]:
    """Draw a random track that can be flown.

    Args:
        rng: Random generator.
        like: Distribution of the track.
        drones: Number of drones.
        radius: Collision radius of the drones, m.
        motion: Amplitude of the gates' oscillation, m.

    Raises:
        ValueError: If no valid track was found; the message states the last error.
    """
    found = None
    for _ in range(MAX_TRIES):
        gates = like.draw(rng)
        found = find_spacing_error(gates, place_start_blocks(gates, drones), radius, motion)
        if found is None:
            return gates
    raise ValueError(
        f"no random track of {like.gates} gates within {like.radius:g} m can be flown ({found}): "
        f"raise track_radius, or lower num_gates, gate_size, gate_tilt or gate_motion"
    )
