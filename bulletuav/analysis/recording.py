"""Flying, writing and reading of recordings of episodes."""

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.analysis.recorded import (
    ARRAYS,
    INFO,
    READING,
    SCENE,
    VERSION,
    Outcome,
    Recording,
    outcomes,
)
from bulletuav.analysis.recorder import Recorder
from bulletuav.analysis.results_folder import RUN
from bulletuav.analysis.scene import PARTS
from bulletuav.analysis.seals import add_seal, format_call, hash_files
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.descriptions import describe_options
from bulletuav.errors import reason_of, require_file, shown
from bulletuav.files import replace_file, whole_file
from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.policies.base import Policy
from bulletuav.policies.mismatch import naming_task
from bulletuav.version import __version__

__all__ = ["Outcome", "Recording", "fly_episode", "load", "outcomes", "save"]

ARRAYS_FILE = "trajectory.npz"
TABLE_FILE = "trajectory.csv"
CALLS_FILE = "calls.json"
"""File with the calls that flew an airspace; see `analysis.airspace_recorder`"""
READABLE = (2, 3, 4, 5)
"""Versions that can be read. Version 2 has only the task's own infos, and goals even for tasks
without goals. Versions 2 and 3 lack the axes of bars, and only version 5 has readings and the
scene.
"""
SHAPES = {
    "time": "R",
    **dict.fromkeys(("position", "velocity", "rates"), "R N 3"),
    "quaternion": "R N 4",
    "alive": "R N",
    "action": "T N A",
    **dict.fromkeys(("reward", "separation", "conflicts", "collision", "success"), "T N"),
    **dict.fromkeys(("contact_step", "contact_drone", "contact_other", "contact_impulse"), "C"),
    **dict.fromkeys(("contact_point", "contact_normal", "contact_velocity"), "C 3"),
    "goal": "R G 3",
    "obstacle": "R K 3",
    "obstacle_radius": "K",
    "obstacle_axis": "K 3",
    "building": "P 2 3",
    "target": "R U 3",
    "seen": "R U",
    "scene/rotor_speed": "R N M",
    "scene/deflection": "R N F",
    "scene/airspeed": "R N",
    "scene/obstacle_quaternion": "R K 4",
    "scene/link": "L 3",
    "scene/cable": "R E 2 3",
    "scene/building_colour": "P 3",
    "scene/hull": "H 3",
    "scene/hull_size": "S",
}
"""Shapes of arrays: R rows, T decisions, N drones, and other sizes that must agree by letter"""
UNRECORDED_OPTIONS = ("num_worlds", "render_mode", "render_size", "render_address")
"""Options that do not affect the flight and are not part of a recorded call"""
REMEDY = "fly the episode again with this bulletuav"
HEADER = (
    *("time", "drone", "alive"),
    *("x", "y", "z"),
    *("qx", "qy", "qz", "qw"),
    *("vx", "vy", "vz"),
    *("p", "q", "r"),
)
"""Columns of `trajectory.csv`: position, m; quaternion; velocity, m/s; body rates, rad/s"""


def fly_episode(
    aviary: Aviary, policy: Policy, seed: int, progress: Callable[[], None] = lambda: None
) -> Recording:
    """Fly and record one episode in world 0.

    Args:
        aviary: The worlds, all of which are reset.
        policy: The policy.
        seed: Seed of world 0.
        progress: Callback after every decision.

    Returns:
        The recording, until the last drone has finished.
    """
    observations = aviary.reset(seeds=seed)
    with naming_task(policy, aviary):
        policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    recorder = Recorder(aviary)
    while aviary.alive[0].any():
        with naming_task(policy, aviary):
            actions = policy.act(observations, aviary.swarm)
        step = aviary.step(actions)
        observations = step.observations
        recorder.record(actions, step.rewards, step.info)
        progress()
    return recorder.recording()


def save(recording: Recording, aviary: Aviary, policy: str, seed: int, folder: Path) -> list[Path]:
    """Write a recording to files.

    Args:
        recording: The episode.
        aviary: The worlds in which it was flown.
        policy: Name of the policy.
        seed: Seed of the episode.
        folder: An existing folder.

    Returns:
        The paths of `trajectory.npz` (the whole recording), `trajectory.csv` (a row for each drone
        and time) and `run.json` (options, outcomes, and hashes for `bulletuav verify`).

    Raises:
        OSError: If a file cannot be written.
    """
    about = {
        "task": aviary.task.name,
        "policy": policy,
        "seed": seed,
        "options": {
            **describe_options(aviary.options, aviary.task.config),
            **_events(recording, aviary),
        },
        # `bulletuav verify` repeats this call and compares the hashes
        "call": _call(recording, aviary, policy, seed),
    }
    return write_run(recording, folder, about)


def write_run(
    recording: Recording, folder: Path, about: Mapping[str, Any], calls: str | None = None
) -> list[Path]:
    """Write a recording to files.

    Args:
        recording: The flight.
        folder: An existing folder.
        about: Entries of `run.json` on what was flown; the outcomes and hashes are added.
        calls: Contents of `calls.json`, which repeat the flight of an airspace.

    Returns:
        The paths; see `save`.

    Raises:
        OSError: If a file cannot be written.
    """
    # The arrays are written first: the description holds hashes of these files
    arrays, table, run = folder / ARRAYS_FILE, folder / TABLE_FILE, folder / RUN
    written = [arrays, table, run]
    _write_arrays(recording, arrays)
    _write_table(recording, table)
    # Calls of an earlier flight are none of this one
    (folder / CALLS_FILE).unlink(missing_ok=True)
    if calls is not None:
        replace_file(folder / CALLS_FILE, calls)
        written.append(folder / CALLS_FILE)
    content = {
        "bulletuav": __version__,
        **about,
        # JSON has no infinity: the separation of a single drone becomes null
        "outcomes": [
            {name: value if value != np.inf else None for name, value in row._asdict().items()}
            for row in outcomes(recording)
        ],
        "hash": recording.hash(),
        "files": hash_files(folder, (ARRAYS_FILE, TABLE_FILE, CALLS_FILE)),
    }
    # The seal reveals manual edits
    replace_file(run, json.dumps(add_seal(content), indent=2) + "\n")
    return written


def _call(recording: Recording, aviary: Aviary, policy: str, seed: int) -> str | None:
    """Format the call that repeats the flight; see `format_call`."""
    (task, *_), options = aviary.made_from
    given = {name: value for name, value in options.items() if name not in UNRECORDED_OPTIONS}
    if aviary.worlds.schedule.log[0] is None:
        return None
    given |= _events(recording, aviary)
    flown = {"task": task, "policy": policy, "seed": seed, "num_worlds": aviary.num_worlds}
    return format_call({**flown, "options": given})


def _events(recording: Recording, aviary: Aviary) -> dict[str, Any]:
    """Return the option `events` that repeats the changes in world 0, if there were any."""
    # A change after the last decision has no effect, and may be at the end of the episode
    end = float(recording.time[-1]) - 0.5 / aviary.options.decision_hz
    log = aviary.worlds.schedule.log[0] or ()
    events = (*aviary.options.events, *(event for event in log if event.time_bounds[0] < end))
    return {"events": [event.described() for event in events]} if events else {}


def _write_arrays(recording: Recording, path: Path) -> None:
    arrays: dict[str, Any] = recording.everything()
    with whole_file(path) as part:
        np.savez_compressed(part, version=np.array(recording.version), **arrays)


def _write_table(recording: Recording, path: Path) -> None:
    """Write the states as CSV, a row for each drone and time."""
    states = np.concatenate(
        [
            recording.position,
            recording.quaternion,
            recording.velocity,
            recording.rates,
        ],
        axis=-1,
    )
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for t, time in enumerate(recording.time):
            for drone, state in enumerate(states[t]):
                alive = int(recording.alive[t, drone])
                writer.writerow([f"{time:.6g}", drone, alive, *(f"{x:.9g}" for x in state)])


def load(path: str | Path) -> Recording:
    """Read a recording.

    Args:
        path: Path of a `trajectory.npz`, or of its folder.

    Returns:
        The recording as it was written. Version 2 has fewer infos and no reward terms; versions
        before 5 have no readings and no scene.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file is not a recording, or its version is missing or not supported.
    """
    folder = isinstance(path, str | Path) and Path(path).is_dir()
    given = Path(path) / ARRAYS_FILE if folder else path
    found = require_file("recording", given, "pass the trajectory.npz of a flight, or its folder")
    try:
        # NumPy would leave a damaged file open if it were given a path.
        with found.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
            if other := [name for name in arrays if not isinstance(arrays[name], np.ndarray)]:
                raise TypeError(f"{shown(other[0])} is not an array")
    # NumPy and zipfile raise a dozen types of errors for damaged files
    except Exception as error:
        raise ValueError(f"{found} is not a recording ({reason_of(error)}): {REMEDY}") from None
    # Check the version before anything that may differ between versions.
    version = _known_version(arrays.pop("version", None), found)
    if version < 4 and "obstacle_radius" in arrays:
        arrays["obstacle_axis"] = np.zeros((*arrays["obstacle_radius"].shape, 3))
    needed = [*ARRAYS, *(f"{SCENE}{part}" for part in PARTS if version == VERSION)]
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise ValueError(f"{found} is a damaged recording, without {missing[0]!r}: {REMEDY}")
    _check_shapes(arrays, found)
    infos, readings, scene = (
        {key.removeprefix(prefix): one for key, one in arrays.items() if key.startswith(prefix)}
        for prefix in (INFO, READING, SCENE)
    )
    if version == 2:
        _upgrade_version_2(arrays, infos)
    own = {name: arrays[name] for name in ARRAYS}
    return Recording(**own, info=infos, reading=readings, scene=scene, version=version)


def _check_shapes(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Raise ValueError for an array that is not numeric or has a wrong shape."""
    rows, drones = (*arrays["position"].shape, 0, 0)[:2]
    sizes = {"R": rows, "T": rows - 1, "N": drones}
    for name, array in arrays.items():
        shape = SHAPES.get(name, "")
        letters = shape.split()
        # Infos and readings may have any shape per drone
        if name.startswith((INFO, READING)):
            letters, shape = ["T" if name.startswith(INFO) else "R", "N"], "of each drone"
        elif not shape:
            continue
        given = array.shape[: len(letters)] if shape == "of each drone" else array.shape
        known = {
            letter: sizes.get(letter, size) for letter, size in zip(letters, given, strict=False)
        }
        needed = tuple(int(one) if one.isdigit() else known.get(one, 1) for one in letters)
        if given != needed or array.dtype.kind not in "biuf":
            what = "the scene" if name.startswith(SCENE) else repr(name)
            raise ValueError(
                f"{path}: {what} of the recording is damaged: numbers {needed} are needed "
                f"({name}); {REMEDY}"
            )
        sizes |= {letter: size for letter, size in known.items() if not letter.isdigit()}
    if rows < 2 or drones < 1 or sizes.get("G", 0) not in (0, drones):
        raise ValueError(
            f"{path}: the recording is damaged: it has no decision, or no drone; {REMEDY}"
        )
    hull, size = (arrays.get(f"{SCENE}{name}") for name in ("hull", "hull_size"))
    if hull is not None and size is not None:
        pieces = arrays["building"].shape[0]
        if (size < 0).any() or size.sum() != len(hull) or len(size) > pieces:
            raise ValueError(
                f"{path}: the scene of the recording is damaged: the corners of {len(hull)} hulls "
                f"are needed; {REMEDY}"
            )
    for name in ("building", f"{SCENE}hull"):
        if not np.isfinite(arrays.get(name, 0.0)).all():
            raise ValueError(f"{path}: {name!r} of the recording is not finite; {REMEDY}")


def _upgrade_version_2(arrays: dict[str, np.ndarray], infos: dict[str, np.ndarray]) -> None:
    """Upgrade goals and goal distances of a recording of version 2 to version 3."""
    if arrays["target"].shape[1]:
        arrays["goal"] = arrays["goal"][:, :0]  # where drones started
    else:
        infos["goal_distance"] = paired_distances(arrays["goal"], arrays["position"])[1:]


def _known_version(version: np.ndarray | None, path: Path) -> int:
    """Return the version of a recording.

    Raises:
        ValueError: If the version is missing or not supported.
    """
    if version is None:
        raise ValueError(
            f"{path} is a recording without a version, and version {VERSION} is needed: {REMEDY}"
        )
    if version.shape != () or version.dtype.kind not in "iu" or version not in READABLE:
        raise ValueError(
            f"{path} is a recording of version {version}, and version {VERSION} is needed: "
            f"{REMEDY}, or read it with the bulletuav that wrote it"
        )
    return int(version)
