"""Export of recorded flights for the viewer Rerun (.rrd); needs the extra `rerun`.

Rerun stores positions in single precision; times and curves are exact.
"""

from collections.abc import Mapping, Sized
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.flights import (
    FlightArrays,
    check_flight,
    count_flown_rows,
    decision_results,
)
from bulletuav.errors import missing_extra
from bulletuav.files import whole_file
from bulletuav.geometry.shapes import CYLINDER, HULL, SPHERE
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import parse_json

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError:
    raise missing_extra("writing for Rerun", "rerun") from None

TIME = "time"
"""Name of the timeline, in s since the start"""
PATH_WIDTH = 1.5
"""Width of the paths of drones, in screen points"""
GOAL_SIZE = 6.0
"""Radius of goals, in screen points"""
CITY_COLOUR = (150, 152, 158)


def write_rrd(flight: FlightArrays, colours: np.ndarray, path: Path) -> None:
    """Write a recorded flight as one .rrd file.

    Args:
        flight: Arrays of a recording of version 5, as `Recording.everything()` returns them.
        colours: (N, 4) RGBA colour of each drone, from 0 to 1.
        path: The file; an existing file is replaced.

    Raises:
        ValueError: If an array is damaged.
        OSError: If the file cannot be written.
        RuntimeError: If the environment variable RERUN disables Rerun.
    """
    check_flight(flight)
    about = parse_json(str(flight["scene/about"]), "its description")
    with whole_file(path) as part:
        part.touch()  # raises Python's error if the folder does not exist
        with rr.RecordingStream("bulletuav", send_properties=False) as stream:
            if not rr.is_enabled(stream):
                raise RuntimeError("Rerun is off by the variable RERUN: unset it, and export again")
            stream.save(part, _views())
            # Right-handed with z up: ENU
            stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
            shades = (255 * colours).astype(np.uint8)
            _add_drones(stream, flight, about, shades)
            _add_curves(stream, flight, shades)
            _add_obstacles(stream, flight, about["obstacles"])
            _add_city(stream, flight)


def _views() -> rrb.Blueprint:
    """Return the layout: the 3-D scene on the left, the curves on the right."""
    curves = [
        rrb.TimeSeriesView(origin=name, name=name) for name in ("altitude", "reward", "separation")
    ]
    scene = rrb.Spatial3DView(origin="world", name="flight")
    both = rrb.Horizontal(scene, rrb.Vertical(*curves), column_shares=[2, 1])
    return rrb.Blueprint(both, rrb.TimePanel(timeline=TIME), collapse_panels=True)


def _add_drones(
    stream: rr.RecordingStream, flight: FlightArrays, about: Mapping[str, Any], colours: np.ndarray
) -> None:
    """Log drones, their paths and their goals, each up to the last decision of the drone."""
    time, position, quaternion = (flight[name] for name in ("time", "position", "quaternion"))
    # The path of a drone ends with its last decision
    rows = count_flown_rows(flight)
    for i, end in enumerate(rows):
        body = f"world/drones/{i}"
        _add_motion(stream, body, time[:end], position[:end, i], quaternion[:end, i])
        # Child entities inherit the transform of the body
        for k, shape in enumerate(about["airframes"][about["airframe_of"][i]]["parts"]):
            _add_shape(stream, f"{body}/{k}", shape)
    # Paths are static
    paths = rr.LineStrips3D(
        [position[:end, i] for i, end in enumerate(rows)],
        colors=colours,
        radii=rr.Radius.ui_points(PATH_WIDTH),
        labels=_names(rows),
    )
    stream.log("world/paths", paths, static=True, strict=True)
    # Goals may move: one set of points for each time
    goal = flight["goal"]
    if goal.shape[1]:
        style = rr.Points3D.from_fields(colors=colours, radii=rr.Radius.ui_points(GOAL_SIZE))
        stream.log("world/goals", style, static=True, strict=True)
        columns = rr.Points3D.columns(positions=goal.reshape(-1, 3))
        _send(stream, "world/goals", time, columns.partition([goal.shape[1]] * len(time)))


def _add_curves(stream: rr.RecordingStream, flight: FlightArrays, colours: np.ndarray) -> None:
    """Log altitudes and results of decisions, one curve for each drone while it flies."""
    rows = count_flown_rows(flight)
    altitude = flight["position"][:, :, 2]
    for name, values in {"altitude": altitude, **decision_results(flight)}.items():
        # A result is plotted at the end of its decision; NaN after the drone has left
        time = flight["time"][-len(values) :]
        ends = np.array(rows) - (len(flight["time"]) - len(time))
        flown = np.where(np.arange(len(time))[:, None] < ends, values, np.nan)
        entity = rr.new_entity_path(name.split("/"))
        style = rr.SeriesLines(colors=colours, names=_names(rows))
        stream.log(entity, style, static=True, strict=True)
        columns = rr.Scalars.columns(scalars=flown.reshape(-1))
        _send(stream, entity, time, columns.partition([len(rows)] * len(time)))


def _names(drones: Sized) -> list[str]:
    return [f"drone_{i}" for i in range(len(drones))]


def _add_obstacles(stream: rr.RecordingStream, flight: FlightArrays, shapes: list[Any]) -> None:
    """Log obstacles, which may move."""
    for k, shape in enumerate(shapes):
        entity = f"world/obstacles/{k}"
        position, quaternion = flight["obstacle"][:, k], flight["scene/obstacle_quaternion"][:, k]
        _add_motion(stream, entity, flight["time"], position, quaternion)
        _add_shape(stream, f"{entity}/shape", shape)


def _add_city(stream: rr.RecordingStream, flight: FlightArrays) -> None:
    """Log one mesh of all buildings, if there are any."""
    sizes = flight["scene/hull_size"]
    hulls = np.split(flight["scene/hull"], np.cumsum(sizes)[:-1]) if len(sizes) else []
    boxes = flight["building"][: len(flight["building"]) - len(sizes)]
    if len(flight["building"]):
        mesh = _mesh(Solids(boxes, tuple(hulls)), CITY_COLOUR)
        stream.log("world/city", mesh, static=True, strict=True)


def _add_motion(
    stream: rr.RecordingStream,
    entity: str,
    time: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> None:
    """Log the pose of an entity in the world; quaternions are (x, y, z, w), as in Rerun."""
    columns = rr.Transform3D.columns(translation=position, quaternion=quaternion)
    _send(stream, entity, time, columns)


def _send(stream: rr.RecordingStream, entity: str, time: np.ndarray, columns: Any) -> None:
    """Log columns, one row for each time in s."""
    index = rr.TimeColumn(TIME, duration=np.round(time * 1e9).astype("timedelta64[ns]"))
    stream.send_columns(entity, [index], columns, strict=True)


def _add_shape(stream: rr.RecordingStream, entity: str, shape: Mapping[str, Any]) -> None:
    """Log a part of an airframe, with its pose in the body, or an obstacle."""
    place = []
    if "position" in shape:
        place = [rr.Transform3D(translation=shape["position"], quaternion=shape["quaternion"])]
    stream.log(entity, _archetype(shape), *place, static=True, strict=True)


def _archetype(shape: Mapping[str, Any]) -> Any:
    """Convert a shape to a Rerun archetype."""
    kind, half = shape["kind"], shape["half"]
    colour = tuple(round(255 * share) for share in shape["colour"])
    solid = {"colors": colour, "fill_mode": rr.components.FillMode.Solid}
    if kind == HULL:
        return _mesh(Solids(np.zeros((0, 2, 3)), (np.array(shape["corners"]),)), colour)
    if kind == SPHERE:
        return rr.Ellipsoids3D(half_sizes=half, **solid)
    if kind == CYLINDER:
        return rr.Cylinders3D(lengths=2 * half[2], radii=half[0], **solid)
    return rr.Boxes3D(half_sizes=half, **solid)


def _mesh(solids: Solids, colour: tuple[int, ...]) -> rr.Mesh3D:
    """Convert convex solids to a Rerun mesh."""
    corners, triangles = solids.mesh
    return rr.Mesh3D(vertex_positions=corners, triangle_indices=triangles, albedo_factor=colour)
