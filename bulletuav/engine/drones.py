"""Functions that create the bodies of drones, from the URDFs of their airframes."""

import contextlib
import functools
import tempfile
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from bulletuav.engine.bodies import Body, cylinder_triangles, make_load_body, rims
from bulletuav.engine.calls import HAS_BULLET, bullet
from bulletuav.engine.client import disconnect, open_client
from bulletuav.engine.silence import silenced
from bulletuav.geometry.shapes import CYLINDER, Shape
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.urdf import UrdfFile

DISC = "disc.stl"
"""File name of the mesh of a rotor's disc, in the folder of the URDFs that refer to it"""
ROUND = 24
"""Number of sides of a rotor's disc in images"""


@contextlib.contextmanager
def drawn_files(airframes: Iterable[Airframe]) -> Iterator[dict[Path, Path]]:
    """Write copies of airframes' URDFs in which meshes replace the visual cylinders.

    Bullet builds a hull of each cylinder for every drone, which takes longer than the rest of a
    drone. It also rounds the hull, so that rotors look like cones.

    Args:
        airframes: The airframes.

    Yields:
        The file to load for each URDF. URDFs that refer to mesh files are loaded unchanged.
    """
    files = {airframe.urdf: airframe.urdf for airframe in airframes if not airframe.is_load}
    with contextlib.ExitStack() as stack:
        try:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            files |= _write_drawn(files, folder)
        except OSError as error:
            warnings.warn(
                f"the folder for temporary files ({tempfile.gettempdir()}) cannot be written: "
                f"{error}: rotors look like cones, and drones take longer to make; "
                f"set TMPDIR to a writable folder with free space",
                stacklevel=2,
            )
        yield files


def make_drone(client: int, airframe: Airframe, file: Path | None, place: np.ndarray) -> Body:
    """Create the body of a drone.

    Args:
        client: Id of the client in Bullet.
        airframe: Shape, mass and inertia of the drone.
        file: File to load, from `drawn_files`; None for a load.
        place: (3,) position in Bullet's frame, m.

    Returns:
        The body.

    Raises:
        ValueError: If Bullet cannot load the airframe's URDF.
    """
    if airframe.is_load:
        body = make_load_body(client, airframe.shape, airframe.mass, place.tolist())
    else:
        assert file is not None, "from drawn_files"
        body = _load(client, airframe.urdf, file, place.tolist())
    # By default Bullet damps velocities by 4 % a second and clamps them at 100. Mass and inertia
    # are set explicitly, as Bullet may round or scale those of the file.
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
    """Load a file in place of a URDF; raise ValueError if Bullet cannot load it."""
    flags = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_USE_IMPLICIT_CYLINDER
    flags |= bullet.URDF_USE_MATERIAL_COLORS_FROM_MTL
    # Drones of one airframe share visual shapes, which halves the time that Bullet needs.
    flags |= bullet.URDF_ENABLE_CACHED_GRAPHICS_SHAPES
    try:
        with silenced():
            body: Body = bullet.loadURDF(str(file), place, flags=flags, physicsClientId=client)
    except bullet.error as error:
        raise ValueError(f"{urdf}: the engine cannot load it: {error}") from None
    return body


def require_loadable(airframes: Iterable[Airframe]) -> None:
    """Raise ValueError if Bullet cannot load the URDF of an airframe.

    The drones themselves may be created much later, or never, as without PyBullet.
    """
    files = {airframe.urdf for airframe in airframes if not airframe.is_load}
    for urdf in files if HAS_BULLET else ():
        _try_once(urdf, urdf.read_bytes())


@functools.cache
def _try_once(urdf: Path, _: bytes) -> None:
    """Load a URDF in a separate client, once for each content of the file."""
    client = open_client(live=False)
    try:
        _load(client, urdf, urdf, (0.0, 0.0, 0.0))
    finally:
        disconnect([client])


def _write_drawn(urdfs: Iterable[Path], folder: Path) -> dict[Path, Path]:
    """Write the files to load in place of URDFs that refer to no meshes."""
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
    """Return the contents to load in place of a URDF; None if the URDF refers to meshes."""
    robot = UrdfFile(urdf).root
    if robot.find(".//mesh") is not None:
        return None
    _replace_cylinders(robot)
    written: bytes = ElementTree.tostring(robot)
    return written


def _replace_cylinders(robot: ElementTree.Element) -> None:
    """Replace visual cylinders by a scaled mesh of a cylinder of radius and length 1."""
    for geometry in robot.iterfind("link/visual/geometry"):
        for cylinder in geometry.findall("cylinder"):
            radius, length = cylinder.get("radius"), cylinder.get("length")
            if radius and length:  # else Bullet reports the missing attribute
                geometry.remove(cylinder)
                scale = f"{radius} {radius} {length}"
                ElementTree.SubElement(geometry, "mesh", filename=DISC, scale=scale)


@functools.cache
def _disc() -> bytes:
    """Return a disc of radius and thickness 1 as a binary STL file, which Bullet reads fastest."""
    corners = rims(Shape(CYLINDER, (1.0, 1.0, 0.5)), ROUND)
    corner = corners[cylinder_triangles(ROUND)]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = np.zeros(
        len(corner), [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("unused", "<u2")]
    )
    rows["normal"], rows["corner"] = normal, corner
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()
