"""Files of race tracks: gates and the order of their passages, as TOML, YAML, JSON or CSV."""

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.compiled.functions import atan2, hypot
from bulletuav.errors import (
    as_bool,
    as_int,
    as_sequence,
    finite,
    numbers_of,
    points_of,
    read_file,
    shown,
    suggest_names,
)
from bulletuav.geometry.rotation import axes
from bulletuav.parsing import parse_number, read_json, read_toml, read_yaml
from bulletuav.tasks.parts.gates import Gate, reverse_gate
from bulletuav.tasks.parts.other_tracks import translate_track

MAX_PASSAGES = 200
"""Maximum number of gates, and of passages in a lap"""
DIRECTIONS = ("yaw", "heading", "direction", "quaternion")
"""Fields for the direction of flight, of which a gate has one at most"""
GATE_FIELDS = ("position", *DIRECTIONS, "pitch", "roll", "shape", "size", "bar", "name")
"""Fields of a gate in a file; only `position` is required"""
TRACK_FIELDS = ("gates", "order")
VECTORS = {"position": ("x", "y", "z"), "quaternion": ("qx", "qy", "qz", "qw")}
VECTORS |= {"direction": ("dx", "dy", "dz")}
"""Columns of a CSV file that form a field"""
TEXTS = ("shape", "name")
NUMBERS = ("yaw", "heading", "pitch", "roll", "size", "bar")
COLUMNS = (*(name for names in VECTORS.values() for name in names), *NUMBERS, *TEXTS)
"""Columns of a CSV file"""
LEVEL = 1e-9
"""Horizontal part of the direction of a gate below which it is vertical"""


def read_track(path: Path, default_of: Callable[[int], Mapping[str, Any]]) -> tuple[Gate, ...]:
    """Read the gates of a track in the order of flight.

    Args:
        path: A file of one of the `TRACK_READERS`.
        default_of: Function that returns the default shape and size of gate k.

    Returns:
        A gate per passage of a lap. A gate that is flown more than once is there more than once.

    Raises:
        ValueError: If the file is not a valid track; the message names the file and the gate.
    """
    track = translate_track(path, TRACK_READERS[path.suffix.lower()](path))
    if isinstance(track, list):
        track = {"gates": track}
    if not isinstance(track, dict):
        raise ValueError(f"track {path} is {shown(track)}: a list of gates is needed")
    for name in track:
        if name not in TRACK_FIELDS:
            raise ValueError(f"track {path} has {shown(name)}: {suggest_names(name, TRACK_FIELDS)}")
    tables = track.get("gates")
    if not isinstance(tables, list):
        raise ValueError(f"track {path} has {shown(tables)} as gates: two or more are needed")
    as_sequence(f"gates of track {path}", tables, most=MAX_PASSAGES)
    # Gates at the same place have the same defaults, as they may be one gate
    first: dict[str, int] = {}
    places = [
        str(table.get("position", k)) if isinstance(table, dict) else str(k)
        for k, table in enumerate(tables)
    ]
    defaults = [default_of(first.setdefault(place, k)) for k, place in enumerate(places)]
    gates = [_read_gate(path, k, table, defaults[k]) for k, table in enumerate(tables)]
    passages = _in_order(path, tables, gates, track["order"]) if "order" in track else gates
    if len(passages) < 2:
        raise ValueError(f"track {path} has {shown(tables)} as gates: two or more are needed")
    return tuple(passages)


def _read_gate(path: Path, k: int, table: object, defaults: Mapping[str, Any]) -> Gate:
    """Create a gate from its table in a file. Raises ValueError if the table is invalid."""
    label = f"gate {k} of track {path}"
    if not isinstance(table, dict):
        raise ValueError(f"{label} is {shown(table)}: a table [[gates]] is needed")
    for name in table:
        if name not in GATE_FIELDS:
            raise ValueError(f"{label} has {shown(name)}: {suggest_names(name, GATE_FIELDS)}")
    if "position" not in table:
        raise ValueError(f"{label} has no position: position = [x, y, z] is needed, m")
    try:
        given = {name: value for name, value in table.items() if name not in ("name", *DIRECTIONS)}
        return Gate(**{**defaults, **given, **_read_angles(table)})
    except (ValueError, TypeError) as error:
        raise ValueError(f"{label}: {error}") from None


def _read_angles(table: Mapping[str, Any]) -> dict[str, float]:
    """Return the yaw, pitch and roll that the direction of a gate sets, degrees."""
    given = [name for name in DIRECTIONS if name in table]
    if len(given) > 1:
        raise ValueError(f"{given[0]} and {given[1]} are given: give one of {DIRECTIONS}")
    kind = given[0] if given else "yaw"
    excluded = {"direction": ("pitch",), "quaternion": ("pitch", "roll")}.get(kind, ())
    for name in excluded:
        if name in table:
            raise ValueError(f"{name} has no effect next to {kind}: leave it out")
    if kind == "yaw":
        return {"yaw": table["yaw"]} if given else {}
    if kind == "heading":
        return {"yaw": 90.0 - finite("heading of a gate", table["heading"])}
    if kind == "direction":
        (forward,) = points_of("direction of a gate", table["direction"])
        if not forward.any():
            raise ValueError("direction of a gate is (0, 0, 0): another vector is needed")
        return _direction_angles(forward)
    quaternion = numbers_of("quaternion of a gate is", table["quaternion"])
    length = float(np.sqrt((quaternion**2).sum()))
    if quaternion.shape != (4,) or not abs(length - 1) < 0.01:
        raise ValueError(
            f"quaternion of a gate is {shown(table['quaternion'])}: (x, y, z, w) of length 1 is "
            f"needed"
        )
    x, y, z, w = (quaternion / length).tolist()
    forward, left, up = np.array(axes((x, y, z, w)))
    if hypot(forward[0], forward[1]) < LEVEL:
        # A vertical direction: yaw and roll turn about the same axis
        yaw = float(np.degrees(atan2(-left[0], left[1])))
        return {"yaw": yaw, "pitch": 90.0 if forward[2] > 0 else -90.0}
    roll = float(np.degrees(atan2(left[2], up[2])))
    return {**_direction_angles(forward), "roll": roll}


def _direction_angles(forward: np.ndarray) -> dict[str, float]:
    """Return the yaw and pitch of a direction (3,), degrees."""
    level = hypot(forward[0], forward[1])
    return {
        "yaw": float(np.degrees(atan2(forward[1], forward[0]))),
        "pitch": float(np.degrees(atan2(forward[2], level))),
    }


def _in_order(path: Path, tables: list[Any], gates: list[Gate], order: object) -> list[Gate]:
    """Return the gates in the order of their passages, reversed where they are flown backwards."""
    label = f"order of track {path}"
    names: dict[str, int] = {}
    for k, table in enumerate(tables):
        if "name" not in table:
            continue
        name = table["name"]
        if not isinstance(name, str) or name in names:
            raise ValueError(
                f"gate {k} of track {path} has the name {shown(name)}: one text that "
                f"no other gate has is needed"
            )
        names[name] = k
    passages, used = [], set()
    for entry in as_sequence(label, order, most=MAX_PASSAGES):
        known = entry if isinstance(entry, dict) else {"gate": entry}
        if "gate" not in known or not known.keys() <= {"gate", "reverse"}:
            raise ValueError(f"{label} has {shown(entry)}: gate, and reverse = true, are needed")
        which = known["gate"]
        if isinstance(which, str):
            if which not in names:
                raise ValueError(f"{label} has {shown(which)}: {suggest_names(which, names)}")
            k = names[which]
        else:
            k = as_int(f"gate in the {label}", which, 0, len(gates) - 1)
        is_reversed = as_bool(f"reverse in the {label}", known.get("reverse", False))
        passages.append(reverse_gate(gates[k]) if is_reversed else gates[k])
        used.add(k)
    for k in range(len(gates)):
        if k not in used:
            raise ValueError(f"{label} leaves out gate {k}: add it, or delete the gate")
    return passages


def read_csv(path: Path) -> list[dict[str, Any]]:
    """Read a gate per row of a CSV file with a header of `COLUMNS`, such as x, y, z, yaw.

    Empty cells have defaults. Columns are separated by commas, semicolons or tabs.
    """
    lines = [line for line in read_file(path).splitlines() if line.strip() and line[0] != "#"]
    separator = next((mark for mark in ",;\t" if lines and mark in lines[0]), ",")
    try:
        rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator))
    except csv.Error as error:
        raise ValueError(f"track {path} is not valid CSV: {error}") from None
    names = [name.strip().lower() for name in rows[0]] if rows else []
    for name in names:
        if name not in COLUMNS or names.count(name) > 1:
            raise ValueError(
                f"track {path} has a column {shown(name)}: a header with each of its columns once "
                f"is needed, such as x,y,z,yaw; {suggest_names(name, COLUMNS)}"
            )
    return [_read_row(path, k, names, row) for k, row in enumerate(rows[1:])]


def _read_row(path: Path, k: int, names: list[str], row: list[str]) -> dict[str, Any]:
    """Return the table of gate k from its row."""
    label = f"gate {k} of track {path}"
    if len(row) != len(names):
        raise ValueError(f"{label} has {len(row)} columns: the header has {len(names)}")
    cells = {name: cell.strip() for name, cell in zip(names, row, strict=True) if cell.strip()}
    table: dict[str, Any] = {name: cells[name] for name in TEXTS if name in cells}
    numbers = {}
    for name, cell in cells.items():
        if name not in TEXTS:
            try:
                numbers[name] = parse_number(cell)
            except ValueError:
                raise ValueError(
                    f"{label} has {shown(cell)} as {name}: a finite number is needed"
                ) from None
    table |= {name: numbers[name] for name in NUMBERS if name in numbers}
    for field, parts in VECTORS.items():
        if missing := [name for name in parts if name not in numbers]:
            if len(missing) < len(parts):
                raise ValueError(f"{label} has no {missing[0]}: {field} needs {', '.join(parts)}")
        else:
            table[field] = [numbers[name] for name in parts]
    return table


TRACK_READERS: dict[str, Callable[[Path], Any]] = {
    ".toml": read_toml,
    ".yaml": read_yaml,
    ".yml": read_yaml,
    ".json": read_json,
    ".csv": read_csv,
}
"""Readers of files of tracks by ending"""
