"""Replays: one page of HTML that shows a recorded episode in three dimensions, without a network.

The page's own files are in `web/`. They are put into it as they are, beside a block of the
recording's numbers; see `payload`.
"""

import base64
import colorsys
import html
import json
import re
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
from bulletuav.report.figures import drone_colours
from bulletuav.report.payload import Payload
from bulletuav.report.replay_charts import add_charts, prepend_missing_row
from bulletuav.report.verification import read_sealed

REPLAY = "replay.html"
"""Name of the page beside a recording"""
WEB = Path(__file__).parent / "web"
SCENE_ERRORS = (KeyError, TypeError, IndexError, AttributeError, ValueError)
"""Errors of scenes that are damaged"""
RELATIVE_IMPORT = re.compile(r'(from\s*)"\./')
"""How the scripts name others: in the page they have no folder"""


def read_run(path: Path) -> tuple[Recording, str]:
    """Read what `bulletuav fly` wrote, and compare it with its seals.

    Args:
        path: The folder, or a file in it.

    Returns:
        The recording, and a title that tells task, policy and seed.

    Raises:
        FileNotFoundError: There is no such folder.
        ValueError: It holds no recording, or one that is damaged or of an earlier version.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no {path}: give the folder of a flight")
    # A file in the folder stands for it
    folder = path if path.is_dir() else path.parent
    if not (folder / ARRAYS_FILE).exists():
        raise ValueError(
            f"{folder} holds no recording ({ARRAYS_FILE}): give a folder that `bulletuav fly` wrote"
        )
    # Before anything is read: are the files those that were written?
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
    """Write the page of what `bulletuav fly` wrote.

    Args:
        run: The folder of the flight, or a file in it.
        path: The page; `replay.html` beside the recording when left out.

    Returns:
        The path of the page.

    Raises:
        FileNotFoundError: There is no such folder.
        ValueError: It holds no recording, or one that is damaged or of an earlier version.
        OSError: The page cannot be written.
    """
    recording, title = read_run(run)
    target = path or (run if run.is_dir() else run.parent) / REPLAY
    write_replay(recording, title, target, str(run))
    return target


def write_replay(recording: Recording, title: str, path: Path, source: str = "") -> None:
    """Write a page that replays an episode: one file that needs no other and no network.

    Args:
        recording: The episode, with its scene.
        title: Title of the page.
        path: The file.
        source: Where the recording is from, for the message.

    Raises:
        ValueError: The recording's scene is none.
        OSError: The file cannot be written.
    """
    try:
        text = make_payload(recording, title)
    except SCENE_ERRORS as error:
        raise scene_error(error, source) from None
    replace_file(path, render_page(title, text))


def scene_error(error: Exception, source: str = "") -> ValueError:
    """Make the error for a scene that cannot be read, for the caller to raise."""
    told = f"{source}: " if source else ""
    return ValueError(f"the scene of the recording is damaged ({told}{reason_of(error)}): {REMEDY}")


def render_page(title: str, payload: str = "") -> str:
    """Make the page.

    Args:
        title: Its title.
        payload: The text of a `Payload`; a page without one asks its server for a live feed.
    """
    # All scripts go into the page, which then needs no other file
    scripts = {}
    for script in sorted(WEB.glob("*.js")):
        code = RELATIVE_IMPORT.sub(r'\1"', script.read_text(encoding="utf-8"))
        data = base64.b64encode(code.encode()).decode()
        scripts[script.name] = f"data:text/javascript;base64,{data}"
    # A page with numbers in it connects to nothing
    parts = {
        "title": html.escape(title),
        "style": (WEB / "style.css").read_text(encoding="utf-8"),
        "scripts": json.dumps({"imports": scripts}),
        "license": (WEB / "three.LICENSE").read_text(encoding="utf-8"),
        "payload": payload,
        "connect": "" if payload else "connect-src 'self';",
    }
    template = (WEB / "page.html").read_text(encoding="utf-8")
    return re.sub(r"<!--put (\w+)-->", lambda found: parts[found[1]], template)


def make_payload(recording: Recording, title: str) -> str:
    """Write all that a page shows."""
    about = parse_json(str(recording.scene["about"]), "its description")
    # Numbers go into series, each of which the page finds by its name
    payload = Payload()
    charts = _add_rows(payload, recording, about)
    _add_city(payload, recording)
    # Browsers draw triangles; hulls are corners until here
    for part in (*about["obstacles"], *(p for one in about["airframes"] for p in one["parts"])):
        if part["kind"] == HULL:
            part["triangles"] = _hull_triangles(part["corners"])
    # The rest is small, and goes as it is
    told = {
        "title": title,
        "rows": len(recording.time),
        "drones": recording.position.shape[1],
        "goals": recording.goal.shape[1],
        "users": recording.target.shape[1],
        "colours": _colours(recording.position.shape[1]),
        **{name: about[name] for name in ("task", "d_safe", "airframes", "airframe_of")},
        **{name: about[name] for name in ("obstacles", "lidar")},
        "charts": charts,
    }
    return payload.text(told)


def make_rows_payload(recording: Recording) -> str:
    """Write the rows of a recording alone, for a page that knows the rest."""
    payload = Payload()
    _add_rows(payload, recording, parse_json(str(recording.scene["about"]), "its description"))
    return payload.text({"rows": len(recording.time)})


def _add_rows(payload: Payload, recording: Recording, about: dict[str, Any]) -> list[Any]:
    """Add what changes over time, and return the plots of it."""
    payload.add("time", recording.time, "f4")
    # A drone flies from the start on without a gap.
    payload.add("end", recording.alive[:-1].sum(axis=0), "u4")
    payload.add_series("position", recording.position)
    payload.add_series("quaternion", unwrap_quaternions(recording.quaternion))
    payload.add_series("rotors", recording.scene["rotor_speed"].mean(axis=-1))
    payload.add_series("goal", recording.goal)
    payload.add_series("obstacle", recording.obstacle)
    turns = unwrap_quaternions(recording.scene["obstacle_quaternion"])
    payload.add_series("obstacle_quaternion", turns)
    payload.add("conflict", prepend_missing_row(recording.separation) < about["d_safe"], "u1")
    payload.add("contact_row", recording.contact_step + 1, "u4")
    payload.add("contact_point", recording.contact_point, "f4")
    _add_users(payload, recording)
    for name, values in recording.reading.items():
        if values.dtype.kind != "b":
            payload.add_series(f"{READING}{name}", values)
    return add_charts(payload, recording, about)


def _colours(count: int) -> list[str]:
    """Return the colours of drones as `tracks.png` has them, but seen on light and dark ground."""
    colours = []
    for red, green, blue, _ in drone_colours(count):
        hue, light, strength = colorsys.rgb_to_hls(red, green, blue)
        colours.append(to_hex(colorsys.hls_to_rgb(hue, min(max(light, 0.42), 0.58), strength)))
    return colours


def _add_users(payload: Payload, recording: Recording) -> None:
    """Add targets, whether they are seen, and links to them."""
    payload.add_series("target", recording.target)
    payload.add("seen", recording.seen, "u1")
    row, drone, target = recording.scene["link"].T
    payload.add("link_drone", drone, "u2")
    payload.add("link_target", target, "u2")
    # Links are in the order of rows: those of row k begin at the k-th number.
    payload.add("link_start", np.searchsorted(row, np.arange(len(recording.time) + 1)), "u4")


def _add_city(payload: Payload, recording: Recording) -> None:
    """Add the mesh of all pieces that stand."""
    sizes = recording.scene["hull_size"]
    hulls = np.split(recording.scene["hull"], np.cumsum(sizes)[:-1]) if len(sizes) else []
    boxes = recording.building[: len(recording.building) - len(sizes)]
    corners, triangles = Solids(boxes, tuple(hulls)).mesh
    payload.add("city_corners", corners, "f4")
    payload.add("city_triangles", triangles, "u4")


def _hull_triangles(corners: list[Any]) -> list[list[int]]:
    """Find the triangles of a convex hull, as indices of its corners."""
    _, triangles = Solids(np.zeros((0, 2, 3)), (np.array(corners),)).mesh
    found: list[list[int]] = triangles.tolist()
    return found


def unwrap_quaternions(quaternion: np.ndarray) -> np.ndarray:
    """Choose the signs of quaternions (R, ..., 4) such that each is near the one before."""
    dot = (quaternion[1:] * quaternion[:-1]).sum(axis=-1, keepdims=True)
    flips = np.cumprod(np.where(dot < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternion[:1], quaternion[1:] * flips])
