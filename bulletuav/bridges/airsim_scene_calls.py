"""AirSim's calls for the scene: objects, lines of sight, segmentation."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from bulletuav.bridges.airsim_objects import (
    compute_extents,
    is_visible,
    list_objects,
    match_names,
    move_object,
    read_geo_point,
)
from bulletuav.bridges.airsim_states import geo_point
from bulletuav.bridges.airsim_values import (
    check_flag,
    check_text,
    read_pose,
    write_pose,
    write_quaternion,
    write_vector,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import as_int

NO_POSE = {
    "position": write_vector((math.nan,) * 3),
    "orientation": write_quaternion((math.nan,) * 4),
}
"""Pose of an object that does not exist, as in AirSim"""


class SceneCalls:
    """Calls for objects of the scene.

    Attributes:
        table: The calls by name.
    """

    def __init__(self, world: AirsimWorld) -> None:
        """Build the table of calls for a world."""
        self._world = world
        self.table: Mapping[str, Callable[..., Any]] = {
            "simListSceneObjects": self._list_objects,
            "simGetObjectPose": self._get_object_pose,
            "simSetObjectPose": self._set_object_pose,
            "simTestLineOfSightToPoint": self._test_sight_to_point,
            "simTestLineOfSightBetweenPoints": self._test_sight,
            "simGetWorldExtents": self._get_extents,
            "simSetSegmentationObjectID": self._set_segmentation_id,
            "simGetSegmentationObjectID": self._get_segmentation_id,
        }

    def _list_objects(self, name_regex: str = ".*") -> list[str]:
        return match_names(list_objects(self._world), check_text("name_regex", name_regex))

    def _get_object_pose(self, object_name: str, is_ned: bool = True) -> dict[str, Any]:
        """Return the pose of an object; NaN if there is none. Cosys-AirSim's clients send `ned`."""
        check_flag("ned", is_ned)
        found = list_objects(self._world).get(check_text("object_name", object_name))
        return NO_POSE if found is None else write_pose(found.position, found.quaternion)

    def _set_object_pose(self, object_name: str, pose: Any, teleport: bool = True) -> bool:
        check_flag("teleport", teleport)
        return move_object(self._world, check_text("object_name", object_name), *read_pose(pose))

    def _test_sight_to_point(self, point: Any, vehicle_name: str = "") -> bool:
        i, _ = self._world.vehicle(vehicle_name)
        start = self._world.airspace.swarm.position[i]
        return is_visible(self._world, start, read_geo_point(self._world, point), i)

    def _test_sight(self, point: Any, other: Any) -> bool:
        start, end = (read_geo_point(self._world, one) for one in (point, other))
        return is_visible(self._world, start, end)

    def _get_extents(self) -> list[dict[str, float]]:
        return [geo_point(self._world, corner) for corner in compute_extents(self._world)]

    def _set_segmentation_id(
        self, mesh_name: str, object_id: int, is_name_regex: bool = False
    ) -> bool:
        """Set the id of objects, whose names are compared without case, as in AirSim.

        Returns:
            Whether there is such an object.
        """
        number = as_int("object_id", object_id, 0, 255)
        check_text("mesh_name", mesh_name)
        objects = list_objects(self._world)
        is_regex = check_flag("is_name_regex", is_name_regex)
        if is_regex:
            names = match_names(objects, mesh_name, re.IGNORECASE)
        else:
            names = [name for name in objects if name.lower() == mesh_name.lower()]
        self._world.segmentation_ids |= dict.fromkeys(names, number)
        return bool(names)

    def _get_segmentation_id(self, mesh_name: str) -> int:
        """Return the id of an object; -1 if there is no such object, or no id was set."""
        check_text("mesh_name", mesh_name)
        names = [one for one in list_objects(self._world) if one.lower() == mesh_name.lower()]
        ids = self._world.segmentation_ids
        return next((ids[name] for name in names if name in ids), -1)
