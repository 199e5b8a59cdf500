"""Replays: a self-contained HTML page that shows a recorded episode in 3-D, without a network.

The files of the page are in `web/`. They are embedded in the page, next to the payload of the
recording; see `payload`.
"""

import base64
import colorsys
import dataclasses
import html
import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from bulletuav.analysis.recorded import READING, Recording
from bulletuav.analysis.recording import ARRAYS_FILE, REMEDY, load
from bulletuav.analysis.results_folder import RUN
from bulletuav.errors import reason_of
from bulletuav.files import replace_file
from bulletuav.geometry.shapes import HULL
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import parse_json
from bulletuav.report.figures import NO_PADS, drone_colours
from bulletuav.report.payload import Payload
from bulletuav.report.replay_charts import add_charts, prepend_missing_row
from bulletuav.report.replay_sampling import Sample, take_sample, take_whole
from bulletuav.report.verification import read_sealed

REPLAY = "replay.html"
"""Name of the page in the folder of a recording"""
WEB = Path(__file__).parent / "web"
SCENE_ERRORS = (KeyError, TypeError, IndexError, AttributeError, ValueError)
"""Errors that a damaged scene can raise"""
RELATIVE_IMPORT = re.compile(r'(from\s*)"\./')
"""Relative imports in the scripts, which become bare names in the page"""


def read_run(path: Path) -> tuple[Recording, str]:
    """Read a recording that `bulletuav fly` wrote, after a check of its seal and hashes.

    Args:
        path: The folder, or a file in it.

    Returns:
        The recording, and a title with task, policy and seed.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the folder holds no recording, or one that is damaged or of an earlier
            version.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no {path}: pass the folder of a flight")
    # A file selects its folder
    folder = path if path.is_dir() else path.parent
    if not (folder / ARRAYS_FILE).exists():
        raise ValueError(
            f"{folder} holds no recording ({ARRAYS_FILE}): pass a folder of `bulletuav fly`"
        )
    # Check the hashes of the files before they are read
    about, checks = read_sealed(folder / RUN)
    changed = [check.what for check in checks if not check.same]
    if changed:
        raise ValueError(
            f"{folder / changed[0]} is damaged or was changed: it does not match {RUN}; {REMEDY}"
        )
    # Earlier versions have no scene
    recording = load(folder)
    if not recording.scene:
        raise ValueError(
            f"{folder / ARRAYS_FILE} is a recording of version {recording.version}, which has no "
            f"scene to replay: {REMEDY}"
        )
    task, policy, seed = (about.get(name, "?") for name in ("task", "policy", "seed"))
    drones = recording.position.shape[1]
    return (
        recording,
        f"{task}: {drones} {'drones' if drones > 1 else 'drone'}, {policy}, seed {seed}",
    )


def replay_run(run: Path, path: Path | None = None) -> Path:
    """Write the replay of a recording that `bulletuav fly` wrote.

    Args:
        run: The folder of the flight, or a file in it.
        path: The page; by default `replay.html` in the folder of the recording.

    Returns:
        The path of the page.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the folder holds no recording, or one that is damaged or of an earlier
            version.
        OSError: If the page cannot be written.
    """
    recording, title = read_run(run)
    target = path or (run if run.is_dir() else run.parent) / REPLAY
    write_replay(recording, title, target, str(run))
    return target


def write_replay(recording: Recording, title: str, path: Path, source: str = "") -> None:
    """Write the replay of an episode: a single HTML file that needs no other file and no network.

    Args:
        recording: The episode, with its scene.
        title: Title of the page.
        path: The file.
        source: Path of the recording, for messages.

    Raises:
        ValueError: If the scene of the recording is missing or damaged.
        OSError: If the file cannot be written.
    """
    try:
        text = make_payload(recording, title, take_sample)
    except SCENE_ERRORS as error:
        raise scene_error(error, source) from None
    replace_file(path, render_page(title, text))


def scene_error(error: Exception, source: str = "") -> ValueError:
    """Return a ValueError for a damaged scene."""
    prefix = f"{source}: " if source else ""
    return ValueError(
        f"the scene of the recording is damaged ({prefix}{reason_of(error)}): {REMEDY}"
    )


def render_page(title: str, payload: str = "") -> str:
    """Return the HTML of the page.

    Args:
        title: Title of the page.
        payload: Text of a `Payload`; without it the page connects to its server's live feed.
    """
    scripts = {
        script.name: RELATIVE_IMPORT.sub(r'\1"', script.read_text(encoding="utf-8"))
        for script in sorted(WEB.glob("*.js"))
    }
    compressed = zlib.compress(json.dumps(scripts).encode(), 9)
    # The content policy of a page with a payload forbids all connections
    parts = {
        "title": html.escape(title),
        "style": (WEB / "style.css").read_text(encoding="utf-8"),
        "scripts": base64.b64encode(compressed).decode(),
        "license": (WEB / "three.LICENSE").read_text(encoding="utf-8"),
        "payload": payload,
        "connect": "" if payload else "connect-src 'self';",
    }
    template = (WEB / "page.html").read_text(encoding="utf-8")
    return re.sub(r"<!--put (\w+)-->", lambda found: parts[found[1]], template)


def make_payload(
    recording: Recording,
    title: str,
    take: Callable[[Recording, dict[str, Any]], Sample] = take_whole,
) -> str:
    """Return the payload of a recording.

    Args:
        recording: The recording.
        title: Title of the page.
        take: Chooses the part of the recording that is in the page.
    """
    about = parse_json(str(recording.scene["about"]), "its description")
    recording, about, drones, order, every = take(recording, about)
    # The page finds arrays and series by name
    payload = Payload()
    charts = _add_rows(payload, recording, about)
    _add_city(payload, recording)
    _add_markers(payload, recording)
    # Browsers draw triangles, but the scene holds only the vertices of hulls
    for part in (*about["obstacles"], *(p for one in about["airframes"] for p in one["parts"])):
        if part["kind"] == HULL:
            part["triangles"] = _hull_triangles(part["corners"])
    # Metadata
    colours = _colours(len(order))
    metadata = {
        "title": title,
        "rows": len(recording.time),
        "drones": recording.position.shape[1],
        "goals": recording.goal.shape[1],
        "users": recording.target.shape[1],
        "detailed": drones,
        "every": every,
        "colours": [colours[drone] for drone in order.tolist()],
        **{name: about[name] for name in ("task", "d_safe", "airframes", "airframe_of")},
        **{name: about[name] for name in ("obstacles", "lidar")},
        # Earlier recordings have no pads
        "pads": dict(about.get("pads", NO_PADS)),
        "charts": charts,
        "marker_texts": json.loads(str(recording.scene.get("marker_text", "[]"))),
    }
    return payload.text(metadata)


def make_rows_payload(recording: Recording) -> str:
    """Return the payload of a recording's rows only, for a page that has the rest."""
    payload = Payload()
    _add_rows(payload, recording, parse_json(str(recording.scene["about"]), "its description"))
    return payload.text({"rows": len(recording.time)})


def _add_rows(payload: Payload, recording: Recording, about: dict[str, Any]) -> list[Any]:
    """Add all time-dependent data, and return the charts."""
    payload.add("time", recording.time, "f4")
    # A drone is alive without interruption from the start.
    payload.add("end", recording.alive[:-1].sum(axis=0), "u4")
    payload.add_series("position", recording.position)
    payload.add_series("quaternion", unwrap_quaternions(recording.quaternion))
    _add_rotors(payload, recording, about)
    payload.add_series("goal", recording.goal)
    payload.add_series("obstacle", recording.obstacle)
    turns = unwrap_quaternions(recording.scene["obstacle_quaternion"])
    payload.add_series("obstacle_quaternion", turns)
    if "cable" in recording.scene:
        payload.add_series("cable", recording.scene["cable"])
    payload.add("conflict", prepend_missing_row(recording.separation) < about["d_safe"], "u1")
    detailed = recording.quaternion.shape[1]
    recording = dataclasses.replace(recording, separation=recording.separation[:, :detailed])
    payload.add("contact_row", recording.contact_step + 1, "u4")
    payload.add("contact_point", recording.contact_point, "f4")
    _add_users(payload, recording)
    for name, values in recording.reading.items():
        if values.dtype.kind != "b":
            payload.add_series(f"{READING}{name}", values)
    return add_charts(payload, recording, about)


def _add_rotors(payload: Payload, recording: Recording, about: dict[str, Any]) -> None:
    """Add the mean speeds of rotors along z and along x, and what only aircraft with wings have."""
    speed = recording.scene["rotor_speed"]
    if "deflection" not in recording.scene:
        payload.add_series("rotors", speed.mean(axis=-1))
        return
    lifting, forward = np.zeros((2, *speed.shape[:2]))
    for k, kind in enumerate(about["airframe_of"][: speed.shape[1]]):
        airframe = about["airframes"][kind]
        ahead = list(airframe.get("forward", ()))
        others = [r for r in range(len(airframe["rotors"])) if r not in ahead]
        for mean, numbers in ((lifting, others), (forward, ahead)):
            if numbers:
                mean[:, k] = speed[:, k, numbers].mean(axis=-1)
    payload.add_series("rotors", lifting)
    payload.add_series("forward rotors", forward)
    payload.add_series("deflection", recording.scene["deflection"])
    payload.add_series("airspeed", recording.scene["airspeed"])


def _colours(count: int) -> list[str]:
    """Return the drones' colours of `tracks.png`, adjusted to light and dark backgrounds."""
    colours = []
    for red, green, blue, _ in drone_colours(count):
        hue, light, strength = colorsys.rgb_to_hls(red, green, blue)
        colours.append(to_hex(colorsys.hls_to_rgb(hue, min(max(light, 0.42), 0.58), strength)))
    return colours


def _add_users(payload: Payload, recording: Recording) -> None:
    """Add targets, whether they are in sight, and links to them."""
    payload.add_series("target", recording.target)
    payload.add("seen", recording.seen, "u1")
    row, drone, target = recording.scene["link"].T
    payload.add("link_drone", drone, "u2")
    payload.add("link_target", target, "u2")
    # Links are sorted by row: entry k is the index of the first link of row k.
    payload.add("link_start", np.searchsorted(row, np.arange(len(recording.time) + 1)), "u4")


def _add_city(payload: Payload, recording: Recording) -> None:
    """Add the mesh of all buildings."""
    sizes = recording.scene["hull_size"]
    hulls = np.split(recording.scene["hull"], np.cumsum(sizes)[:-1]) if len(sizes) else []
    boxes = recording.building[: len(recording.building) - len(sizes)]
    solids = Solids(boxes, tuple(hulls))
    corners, triangles = solids.mesh
    payload.add("city_corners", corners, "f4")
    payload.add("city_triangles", triangles, "u4")
    colours = recording.scene.get("building_colour", np.zeros((0, 3)))
    counts = [len(vertices) for vertices, _ in solids.faces] if len(colours) else []
    payload.add("city_colours", np.repeat(colours, counts, axis=0) / 255, "f4")


def _add_markers(payload: Payload, recording: Recording) -> None:
    """Add the points and lines of client programs, if there are any."""
    for kind in ("point", "line"):
        name = f"marker_{kind}"
        if name in recording.scene:
            payload.add(name, recording.scene[name], "f4")
            payload.add(f"{name}_style", recording.scene[f"{name}_style"], "u1")
            payload.add(f"{name}_time", recording.scene[f"{name}_time"], "f4")


def _hull_triangles(corners: list[Any]) -> list[list[int]]:
    """Return the triangles of a convex hull, as indices of its vertices."""
    _, triangles = Solids(np.zeros((0, 2, 3)), (np.array(corners),)).mesh
    found: list[list[int]] = triangles.tolist()
    return found


def unwrap_quaternions(quaternion: np.ndarray) -> np.ndarray:
    """Choose the signs of quaternions (R, ..., 4) so that consecutive ones are close."""
    dot = (quaternion[1:] * quaternion[:-1]).sum(axis=-1, keepdims=True)
    flips = np.cumprod(np.where(dot < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternion[:1], quaternion[1:] * flips])
