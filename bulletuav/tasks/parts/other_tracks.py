"""Race courses of other programs, translated into the tables of `track_files`.

Gates are given by roll, pitch and yaw. The direction of flight in the axes of a gate differs:

- lsy_drone_racing (TOML, `env.track.gates`, rad): along x (`gate_passed` in its `utils.py`).
- safe-control-gym (YAML, rows x, y, z, r, p, y, type of `gates`, rad): the opening is across y. It
  counts passages in both directions; its example flies along y.
- TOGT-Planner (YAML, `orders`, degrees): along -z, as the corridors of `prisma_corridor.cpp` start
  at +z; x is up.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.compiled.functions import cos, hypot
from bulletuav.errors import as_sequence, find_choice, finite, points_of, shown, suggest_names
from bulletuav.geometry.rotation import Quat4, from_euler, product

HALF = math.sqrt(0.5)
ALONG_X: Quat4 = (0.0, 0.0, 0.0, 1.0)
ALONG_Y: Quat4 = (0.0, 0.0, HALF, HALF)
ALONG_MINUS_Z: Quat4 = (0.0, HALF, 0.0, HALF)
"""Rotations from the axes of this package's gates to those of other programs"""
LSY_FRAME = {"shape": "square", "size": 0.4, "bar": 0.16}
"""Gates of lsy_drone_racing: 0.72 m wide, with an opening of 0.4 m (gate.xml)"""
PORTAL_FRAME = {"shape": "square", "size": 0.4, "bar": 0.05}
"""Gates of safe-control-gym: bars of 0.05 m at 0.225 m from the centre (portal.urdf)"""
PORTAL_HEIGHTS = (1.0, 0.525)
"""Heights of the centres of its tall and low gates, m"""
MAX_GATES = 200


def translate_track(path: Path, track: Any) -> Any:
    """Translate a track of another program; return all others unchanged.

    Raises a one-line warning that lists what is not used.

    Args:
        path: The file, for messages.
        track: Its content.

    Returns:
        The track, with gates and perhaps an order.

    Raises:
        ValueError: If the track is of another program, and not valid.
    """
    if not isinstance(track, dict):
        return track
    unused: list[str] = []
    gates = track.get("gates")
    environment, config = track.get("env"), track.get("quadrotor_config")
    if isinstance(track.get("orders"), list):
        translated = _translate_togt(path, track, unused)
    elif isinstance(environment, dict) and isinstance(environment.get("track"), dict):
        course = environment["track"]
        tables = as_sequence(f"gates of track {path}", course.get("gates"), most=MAX_GATES)
        translated = {"gates": [_translate_lsy(path, k, one) for k, one in enumerate(tables)]}
        unused += _describe({name: one for name, one in course.items() if name != "gates"})
        unused += [f"env.{name}" for name in environment if name != "track"]
        unused += [name for name in track if name != "env"]
    elif isinstance(config, dict) and "gates" in config:
        rows = as_sequence(f"gates of track {path}", config["gates"], most=MAX_GATES)
        translated = {"gates": [_translate_portal(path, k, row) for k, row in enumerate(rows)]}
        unused += _describe({name: one for name, one in config.items() if name != "gates"})
        unused += [name for name in track if name != "quadrotor_config"]
    elif isinstance(gates, list) and gates and isinstance(gates[0], list):
        as_sequence(f"gates of track {path}", gates, most=MAX_GATES)
        translated = {"gates": [_translate_portal(path, k, row) for k, row in enumerate(gates)]}
        unused += _describe({name: one for name, one in track.items() if name != "gates"})
    else:
        return track
    if unused:
        warnings.warn(f"track {path}: not used: {', '.join(unused)}", stacklevel=2)
    return translated


def _describe(rest: Mapping[str, Any]) -> list[str]:
    """Describe what is not used, with numbers of entries of lists."""
    return [
        f"{len(one)} {name}" if isinstance(one, list) else str(name) for name, one in rest.items()
    ]


def _quaternion(label: str, angles: object, scale: float, turn: Quat4) -> list[float]:
    """Return the quaternion of a gate with roll, pitch and yaw, each in units of `scale` rad."""
    ((roll, pitch, yaw),) = scale * points_of(f"roll, pitch and yaw of {label}", angles)
    return list(product(from_euler(roll, pitch, yaw), turn))


def _translate_lsy(path: Path, k: int, table: object) -> dict[str, Any]:
    label = f"gate {k} of track {path}"
    if not isinstance(table, dict) or table.keys() != {"pos", "rpy"}:
        raise ValueError(f"{label} is {shown(table)}: pos and rpy are needed")
    return {
        "position": table["pos"],
        "quaternion": _quaternion(label, table["rpy"], 1.0, ALONG_X),
        **LSY_FRAME,
    }


def _translate_portal(path: Path, k: int, row: object) -> dict[str, Any]:
    label = f"gate {k} of track {path}"
    if not isinstance(row, list) or len(row) != 7 or row[6] not in (0, 1):
        raise ValueError(
            f"{label} is {shown(row)}: x, y, z, roll, pitch, yaw and a type, 0 (tall) or 1 (low), "
            f"are needed"
        )
    x, y, z = points_of(f"position of {label}", row[:3])[0].tolist()
    return {
        "position": [x, y, z + PORTAL_HEIGHTS[row[6]]],
        "quaternion": _quaternion(label, row[3:6], 1.0, ALONG_Y),
        **PORTAL_FRAME,
    }


SHAPES: dict[str, tuple[dict[str, str], Callable[..., float]]] = {
    "RectanglePrisma": ({"width": "marginW", "height": "marginH"}, min),
    "TrianglePrisma": (
        {"width": "margin", "height": "margin"},
        lambda width, height: min(height, width * height / hypot(width, 2 * height)),
    ),
    "PentagonPrisma": ({"radius": "margin"}, lambda radius: 2 * radius * cos(math.pi / 5)),
    "HexagonPrisma": ({"side": "margin"}, lambda side: math.sqrt(3) * side),
    "SingleBall": ({"radius": ""}, lambda radius: 2 * radius),
}
"""Shapes of TOGT-Planner: fields, margins that reduce them, and diameter of the largest circle"""


def _translate_togt(path: Path, track: Mapping[str, Any], unused: list[str]) -> dict[str, Any]:
    orders = as_sequence(f"orders of track {path}", track["orders"], most=MAX_GATES)
    names = list(dict.fromkeys(map(str, orders)))
    for name in names:
        if not isinstance(track.get(name), dict):
            raise ValueError(f"orders of track {path} has {name!r}: {suggest_names(name, track)}")
    unused += [name for name in track if name not in ("orders", *names)]
    gates: list[dict[str, Any]] = []
    for k, name in enumerate(names):
        label, table = f"gate {name!r} of track {path}", track[name]
        kind = table.get("type")
        fields, width_of = find_choice(f"type of {label}", kind, SHAPES)
        sizes = [
            finite(f"{field} of {label}", table.get(field), 0, 100)
            - finite(f"{margin} of {label}", table.get(margin, 0.0), 0, 100)
            for field, margin in fields.items()
        ]
        is_ball, is_square = kind == "SingleBall", kind == "RectanglePrisma"
        used = {"type", "name", "position", "stationary", *fields, *fields.values()}
        used |= set() if is_ball else {"rpy"}
        # Fields of 0 have no effect
        rest = [field for field in table if field not in used and table[field]]
        if table.get("stationary", True) is not True:
            rest.append("stationary: false")
        if len({*sizes}) > 1 or not (is_ball or is_square):
            rest.append(f"{kind} beyond the widest {'square' if is_square else 'circle'}")
        unused += [f"{name}.{field}" for field in rest]
        gate = {
            "name": name,
            "position": table.get("position"),
            "shape": "square" if is_square else "round",
            "size": float(width_of(*sizes)),
        }
        if is_ball:
            direction = _direction(label, track, names, k)
            # Balls at one place are flown as one gate
            for other in gates:
                if "direction" in other and other["position"] == gate["position"]:
                    ahead = np.dot(other["direction"], direction)
                    direction = [float(np.sign(ahead) or 1) * one for one in other["direction"]]
                    break
            gate["direction"] = direction
        else:
            gate["quaternion"] = _quaternion(label, table.get("rpy"), math.pi / 180, ALONG_MINUS_Z)
        gates.append(gate)
    return {"gates": gates, "order": list(map(str, orders))}


def _direction(label: str, track: Mapping[str, Any], names: Sequence[str], k: int) -> list[float]:
    """Return the direction from the gate before a ball to the gate after it."""
    places = [track[names[j % len(names)]].get("position") for j in (k - 1, k + 1)]
    before, after = (points_of(f"position next to {label}", place)[0] for place in places)
    step = after - before
    if not step.any():  # of two gates
        step = points_of(f"position of {label}", track[names[k]].get("position"))[0] - before
    direction: list[float] = np.asarray(step).tolist()
    return direction
