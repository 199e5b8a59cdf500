"""AirSim's calls for cameras: poses, fields of view, and detections."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.airsim_cameras import AirsimCamera, find_camera
from bulletuav.bridges.airsim_images import list_cameras
from bulletuav.bridges.airsim_objects import (
    SceneObject,
    is_visible,
    list_objects,
    match_wildcards,
)
from bulletuav.bridges.airsim_settings import MountPose
from bulletuav.bridges.airsim_states import geo_point
from bulletuav.bridges.airsim_values import (
    attitude_from_airsim,
    check_flag,
    check_number,
    check_text,
    read_pose,
    swap_rotation,
    write_mount,
    write_pose,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import as_int, finite, shown
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.geometry.rotation import Quat4, product

FIELDS_OF_VIEW = (5.0, 170.0)
"""Smallest and largest horizontal field of view, degrees"""
MAX_PATTERNS = 32
"""Maximum number of patterns of a camera"""
MAX_FILTERS = 1024
"""Maximum number of cameras, image types and vehicles with own patterns"""


class DetectionFilter(NamedTuple):
    """Filter of detections of a camera and an image type.

    Attributes:
        patterns: Patterns of the names of objects that are detected.
        radius: Maximum distance from the camera, m.
    """

    patterns: tuple[str, ...] = ()
    radius: float = math.inf


class CameraCalls:
    """Calls for cameras.

    Attributes:
        table: The calls by name.
    """

    def __init__(self, world: AirsimWorld) -> None:
        """Build the table of calls for a world."""
        self._world = world
        self._filters: defaultdict[Any, DetectionFilter] = defaultdict(DetectionFilter)
        self.table: Mapping[str, Callable[..., Any]] = {
            "simSetCameraPose": self._set_pose,
            "simSetCameraFov": self._set_field_of_view,
            "simGetCameraInfo": self._get_info,
            "simAddDetectionFilterMeshName": self._add_pattern,
            "simSetDetectionFilterRadius": self._set_radius,
            "simClearDetectionMeshNames": self._clear_patterns,
            "simGetDetections": self._get_detections,
        }

    def _find(self, name: Any, vehicle_name: Any, external: Any) -> tuple[int | None, AirsimCamera]:
        """Return a camera, and the index of its vehicle; None for a camera in the world."""
        check_text("camera_name", name)
        is_external = check_flag("external", external)
        i = None if is_external else self._world.vehicle(vehicle_name)[0]
        return i, find_camera(list_cameras(self._world, i), name)

    def _locate(self, i: int | None, camera: AirsimCamera) -> tuple[np.ndarray, Quat4]:
        """Return the pose of a camera in the world."""
        if i is None:
            return camera.mount
        swarm = self._world.airspace.swarm
        return camera.compute_pose(swarm.position[i], swarm.quaternion[i])

    def _set_pose(
        self, camera_name: str, pose: Any, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Set the pose of a camera on its vehicle, or in the world; NaN leaves it unchanged."""
        i, camera = self._find(camera_name, vehicle_name, external)
        position, orientation = read_pose(pose)
        x, y, z = position.tolist()
        given = np.array((y, x, -z) if i is None else (x, -y, -z))
        position = np.where(np.isfinite(given), given, camera.mount.position)
        rotation = camera.mount.rotation
        if np.isfinite(orientation).all():
            turned = attitude_from_airsim(orientation) if i is None else orientation
            rotation = tuple(turned.tolist()) if i is None else swap_rotation(turned)
        camera.mount = MountPose(position, rotation)

    def _set_field_of_view(
        self, camera_name: str, degrees: Any, vehicle_name: str = "", external: bool = False
    ) -> None:
        _, camera = self._find(camera_name, vehicle_name, external)
        camera.set_field_of_view(math.radians(finite("fov_degrees", degrees, *FIELDS_OF_VIEW)))

    def _get_info(
        self, camera_name: str, vehicle_name: str = "", external: bool = False
    ) -> dict[str, Any]:
        """Return the pose, field of view and projection matrix of a camera as CameraInfo."""
        i, camera = self._find(camera_name, vehicle_name, external)
        position, rotation = self._locate(i, camera)
        start = np.zeros(3) if i is None else list(self._world.vehicles.values())[i].start
        return {
            "pose": write_pose(position - start, rotation),
            "fov": math.degrees(camera.get_capture(0).field_of_view),
            "proj_mat": {"matrix": camera.compute_projection()},
        }

    # Detections

    def _make_key(self, camera_name: Any, image_type: Any, vehicle_name: Any, external: Any) -> Any:
        """Return the key of a filter, after validation."""
        i, camera = self._find(camera_name, vehicle_name, external)
        key = (i, id(camera), as_int("image_type", image_type, 0, 11))
        if key not in self._filters and len(self._filters) >= MAX_FILTERS:
            raise ValueError(f"{MAX_FILTERS} cameras have filters: clear some first")
        return key

    def _add_pattern(
        self, camera_name: str, image_type: int, mesh_name: str, vehicle_name: str = "",
        external: bool = False,
    ) -> None:  # fmt: skip
        key = self._make_key(camera_name, image_type, vehicle_name, external)
        check_text("mesh_name", mesh_name)
        patterns, radius = self._filters[key]
        if len(mesh_name) > 100 or mesh_name.count("*") > 3 or len(patterns) >= MAX_PATTERNS:
            raise ValueError(
                f"mesh_name is {shown(mesh_name)}: at most {MAX_PATTERNS} patterns of up to 100 "
                f"letters and 3 * are possible"
            )
        self._filters[key] = DetectionFilter((*patterns, mesh_name), radius)

    def _set_radius(
        self, camera_name: str, image_type: int, radius_cm: Any, vehicle_name: str = "",
        external: bool = False,
    ) -> None:  # fmt: skip
        key = self._make_key(camera_name, image_type, vehicle_name, external)
        radius = check_number("radius_cm", radius_cm, 1e9) / 100
        self._filters[key] = self._filters[key]._replace(radius=radius)

    def _clear_patterns(
        self, camera_name: str, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> None:
        key = self._make_key(camera_name, image_type, vehicle_name, external)
        self._filters.pop(key, None)

    def _get_detections(
        self, camera_name: str, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> list[dict[str, Any]]:
        """Return the objects that match the filter and whose centres the camera sees."""
        key = self._make_key(camera_name, image_type, vehicle_name, external)
        patterns, radius = self._filters.get(key, DetectionFilter())
        i, camera = self._find(camera_name, vehicle_name, external)
        pose = self._locate(i, camera)
        own = None if i is None else list(self._world.vehicles)[i]
        found = []
        for name, one in list_objects(self._world).items():
            is_near = math.dist(one.position, pose[0]) <= radius
            if name != own and is_near and one.half.any() and match_wildcards(name, patterns):
                box = _project(camera, pose, key[2], one)
                if box is not None and self._is_seen(i, pose[0], one):
                    found.append(self._describe(name, one, box, pose))
        return found

    def _is_seen(self, i: int | None, eye: np.ndarray, one: SceneObject) -> bool:
        """Return True if nothing is between a camera and the surface of an object."""
        line = one.position - eye
        length = float(np.linalg.norm(line))
        end = eye + line * max(1 - float(np.linalg.norm(one.half)) / max(length, 1e-9), 0.0)
        return is_visible(self._world, eye, end, i)

    def _describe(
        self, name: str, one: SceneObject, box: np.ndarray, pose: tuple[np.ndarray, Quat4]
    ) -> dict[str, Any]:
        """Return a detection as DetectionInfo."""
        eye, rotation = pose
        x, y, z, w = rotation
        inverse = (-x, -y, -z, w)
        relative = rotate_vectors(np.array(inverse), one.corners - eye)
        centre = rotate_vectors(np.array(inverse), (one.position - eye)[None])[0]
        low, high = relative.min(axis=0), relative.max(axis=0)
        attitude = product(inverse, tuple(np.asarray(one.quaternion).tolist()))
        corners = [
            write_mount(np.array(corner), (0.0, 0.0, 0.0, 1.0))["position"]
            for corner in ((low[0], high[1], high[2]), (high[0], low[1], low[2]))
        ]
        return {
            "name": name,
            "geo_point": geo_point(self._world, one.position),
            "box2D": {
                key: {"x_val": float(column), "y_val": float(row)}
                for key, (column, row) in zip(("min", "max"), box, strict=True)
            },
            "box3D": dict(zip(("min", "max"), corners, strict=True)),
            "relative_pose": write_mount(centre, attitude),
        }


def _project(
    camera: AirsimCamera, pose: tuple[np.ndarray, Quat4], kind: int, one: SceneObject
) -> np.ndarray | None:
    """Project the box of an object into the image of a camera.

    Returns:
        First and last column and row (2, 2), pixels; None if the object is outside of the image.
    """
    eye, (x, y, z, w) = pose
    (width, height), view = camera.get_capture(kind)
    forward, left, up = rotate_vectors(np.array((-x, -y, -z, w)), one.corners - eye).T
    if (forward <= 0.05).any():
        return None
    focal = width / (2 * math.tan(view / 2))
    columns, rows = width / 2 - focal * left / forward, height / 2 - focal * up / forward
    box = np.array([(columns.min(), rows.min()), (columns.max(), rows.max())])
    if (box[1] <= 0).any() or box[0, 0] >= width or box[0, 1] >= height:
        return None
    clipped: np.ndarray = np.clip(box, 0, (width, height))
    return clipped
