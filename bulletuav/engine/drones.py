"""Makers of the bodies of drones, from the URDF of their airframes."""

import contextlib
import functools
import tempfile
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from bulletuav.engine.bodies import Body, rims
from bulletuav.engine.calls import bullet
from bulletuav.engine.client import disconnect, open_client
from bulletuav.engine.silence import silenced
from bulletuav.geometry.shapes import CYLINDER, Shape
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.urdf import UrdfFile

DISC = "disc.stl"
"""The file of a rotor's disc, beside those that name it"""
ROUND = 24
"""Sides of a rotor's disc in pictures"""


@contextlib.contextmanager
def drawn_files(airframes: Iterable[Airframe]) -> Iterator[dict[Path, Path]]:
    """Write the URDF of airframes with triangles in place of the cylinders that pictures show.

    Of each cylinder Bullet makes a hull for every drone, which takes longer than all else about a
    drone. It rounds the hull, too: rotors look like cones.

    Args:
        airframes: The airframes.

    Yields:
        The file to load for each URDF. Files that name meshes beside them stay as they are.
    """
    files = {airframe.urdf: airframe.urdf for airframe in airframes}
    with contextlib.ExitStack() as stack:
        try:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            files |= _write_drawn(files, folder)
        except OSError as error:
            warnings.warn(
                f"the folder for temporary files ({tempfile.gettempdir()}) cannot be written: "
                f"{error}: rotors look like cones, and drones take longer to make; "
                f"set TMPDIR to a folder with room",
                stacklevel=2,
            )
        yield files


def make_drone(client: int, airframe: Airframe, file: Path, place: np.ndarray) -> Body:
    """Make one drone.

    Args:
        client: Number that Bullet gave the client.
        airframe: Its shape, mass and inertia.
        file: The file to load, of `drawn_files`.
        place: (3,) position in Bullet's frame, m.

    Returns:
        The body.

    Raises:
        ValueError: Bullet cannot load the airframe's URDF.
    """
    body = _load(client, airframe.urdf, file, place.tolist())
    # Bullet damps velocities by 4 % a second and clamps them at 100 unless told otherwise. Mass and
    # inertia are ours, as its own reading of the file may round or scale them.
    bullet.changeDynamics(
        body,
        -1,
        mass=airframe.mass,
        localInertiaDiagonal=airframe.inertia,
        linearDamping=0,
        angularDamping=0,
        maxJointVelocity=1e4,
        physicsClientId=client,
    )
    return body


def _load(client: int, urdf: Path, file: Path, place: Sequence[float]) -> Body:
    """Load a file that stands for a URDF; raises ValueError where Bullet cannot."""
    flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_IMPLICIT_CYLINDER
    flags |= bullet.URDF_USE_MATERIAL_COLORS_FROM_MTL
    # Drones of one airframe share what is drawn, which takes Bullet half the time to make.
    flags |= bullet.URDF_ENABLE_CACHED_GRAPHICS_SHAPES
    try:
        with silenced():
            body: Body = bullet.loadURDF(str(file), place, flags=flags, physicsClientId=client)
    except bullet.error as error:
        raise ValueError(f"{urdf}: the engine cannot load it: {error}") from None
    return body


def require_loadable(airframes: Iterable[Airframe]) -> None:
    """Raise ValueError if Bullet cannot load the URDF of an airframe.

    Drones may be made much later, or never.
    """
    for urdf in {airframe.urdf for airframe in airframes}:
        _try_once(urdf, urdf.read_bytes())


@functools.cache
def _try_once(urdf: Path, _: bytes) -> None:
    """Load a URDF in a client of its own, once for what is in the file."""
    client = open_client(live=False)
    try:
        _load(client, urdf, urdf, (0.0, 0.0, 0.0))
    finally:
        disconnect([client])


def _write_drawn(urdfs: Iterable[Path], folder: Path) -> dict[Path, Path]:
    """Write what is loaded in place of those URDF that name no meshes."""
    Path(folder, DISC).write_bytes(_disc())
    files = {}
    for k, urdf in enumerate(urdfs):
        drawn = _drawn(urdf, urdf.read_bytes())
        if drawn is not None:
            files[urdf] = Path(folder, f"{k}.urdf")
            files[urdf].write_bytes(drawn)
    return files


@functools.cache
def _drawn(urdf: Path, _: bytes) -> bytes | None:
    """Return what is loaded in place of a URDF, once for what is in it; None if it names meshes."""
    robot = UrdfFile(urdf).root
    if robot.find(".//mesh") is not None:
        return None
    _replace_cylinders(robot)
    written: bytes = ElementTree.tostring(robot)
    return written


def _replace_cylinders(robot: ElementTree.Element) -> None:
    """Replace the cylinders that pictures show by a mesh of radius and length 1 that is scaled."""
    for geometry in robot.iterfind("link/visual/geometry"):
        for cylinder in geometry.findall("cylinder"):
            radius, length = cylinder.get("radius"), cylinder.get("length")
            if radius and length:  # Bullet tells what is missing
                geometry.remove(cylinder)
                scale = f"{radius} {radius} {length}"
                ElementTree.SubElement(geometry, "mesh", filename=DISC, scale=scale)


@functools.cache
def _disc() -> bytes:
    """Return a disc of radius and thickness 1 as a binary STL file, which Bullet reads fastest."""
    corners = rims(Shape(CYLINDER, (1.0, 1.0, 0.5)), ROUND)
    # Corners of the lower rim, those after them, and the same on the upper rim
    low = np.arange(ROUND)
    after = (low + 1) % ROUND
    high, beyond = low + ROUND, after + ROUND
    sides = [(low, after, beyond), (low, beyond, high)]
    caps = [(0 * low, after, low), (0 * low + ROUND, high, beyond)]
    triangles = np.concatenate([np.stack(three, axis=1) for three in (*sides, *caps)])
    corner = corners[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(normal, axis=1)
    # Fans begin and end with triangles of no area
    has_area = size > 0
    rows = np.zeros(
        has_area.sum(), [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("unused", "<u2")]
    )
    rows["normal"] = normal[has_area] / size[has_area, None]
    rows["corner"] = corner[has_area]
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()
