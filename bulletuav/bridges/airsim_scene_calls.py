"""AirSim's calls for the scene: objects, lines of sight, segmentation, plots."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from bulletuav.bridges.airsim_images import make_label_colour
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
    check_number,
    check_text,
    read_pose,
    read_text_list,
    read_vector,
    write_pose,
    write_quaternion,
    write_vector,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import as_int, as_sequence

MAX_POINTS = 2000
"""Maximum number of points, texts or poses of a plot"""
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
            "simPlotPoints": self._plot_points,
            "simPlotLineStrip": self._plot_points,
            "simPlotLineList": self._plot_points,
            "simPlotArrows": self._plot_arrows,
            "simPlotStrings": self._plot_strings,
            "simPlotTransforms": self._plot_transforms,
            "simPlotTransformsWithNames": self._plot_named_transforms,
            "simFlushPersistentMarkers": lambda: None,
            "simSetTraceLine": self._set_trace_line,
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
        """Set the id of the classes of objects: pictures show classes, not single objects."""
        number = as_int("object_id", object_id, 0, 255)
        check_text("mesh_name", mesh_name)
        objects = list_objects(self._world)
        is_regex = check_flag("is_name_regex", is_name_regex)
        names = match_names(objects, mesh_name) if is_regex else [mesh_name]
        labels = {objects[name].label for name in names if name in objects}
        for label in labels:
            self._world.segmentation_ids[label] = number
            self._world.label_colours = self._world.label_colours.copy()
            self._world.label_colours[label] = make_label_colour(number)
        return bool(labels)

    def _get_segmentation_id(self, mesh_name: str) -> int:
        found = list_objects(self._world).get(check_text("mesh_name", mesh_name))
        return -1 if found is None else self._world.segmentation_ids[found.label]

    # Plots are checked and dropped, because there is no screen

    def _plot_points(
        self, points: Any, colour: Any, size: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        for point in as_sequence("points", points, most=MAX_POINTS):
            read_vector("point", point)
        _check_style(colour, size, duration, is_persistent)

    def _plot_arrows(
        self, starts: Any, ends: Any, colour: Any, thickness: Any, arrow_size: Any, duration: Any,
        is_persistent: Any = False,
    ) -> None:  # fmt: skip
        check_number("arrow_size", arrow_size)
        self._plot_points(starts, colour, thickness, duration, is_persistent)
        self._plot_points(ends, colour, thickness, duration, is_persistent)

    def _plot_strings(
        self, strings: Any, positions: Any, scale: Any, colour: Any, duration: Any
    ) -> None:
        read_text_list("strings", strings, MAX_POINTS)
        self._plot_points(positions, colour, scale, duration)

    def _plot_transforms(
        self, poses: Any, scale: Any, thickness: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        for pose in as_sequence("poses", poses, most=MAX_POINTS):
            read_pose(pose)
        check_number("scale", scale)
        _check_style((0.0,) * 4, thickness, duration, is_persistent)

    def _plot_named_transforms(
        self, poses: Any, names: Any, scale: Any, thickness: Any, text_scale: Any, colour: Any,
        duration: Any,
    ) -> None:  # fmt: skip
        read_text_list("names", names, MAX_POINTS)
        self._plot_transforms(poses, scale, thickness, duration)
        _check_style(colour, text_scale, duration, False)

    def _set_trace_line(self, colour: Any, thickness: Any = 1.0, vehicle_name: str = "") -> None:
        self._world.vehicle(vehicle_name)
        _check_style(colour, thickness, -1.0, False)


def _check_style(colour: Any, size: Any, duration: Any, is_persistent: Any) -> None:
    """Raise ValueError unless the style of a plot is valid."""
    for part in as_sequence("color_rgba", colour, 4):
        check_number("color_rgba", part)
    check_number("size", size)
    check_number("duration", duration)
    check_flag("is_persistent", is_persistent)
