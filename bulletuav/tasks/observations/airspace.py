"""Observation blocks about the airspace that drones fly in."""

from typing import Any

from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label
from bulletuav.tasks.ingredients import block

SIDES = ("east", "north", "up", "west", "south", "down")
"""Sides of the airspace, in the order of `room`"""


def _room_labels(task: Any) -> tuple[Label, ...]:
    """Label the sides; what is farther than the range finder reaches counts as its reach."""
    return tuple(Label(f"room {side}", "m", 0.0, task.context.max_range) for side in SIDES)


@register("observation")
@block(_room_labels)
def room(
    known_position: Vec3, reach_east: float, reach_north: float, ceiling: float
) -> tuple[float, float, float, float, float, float]:
    """Distances to the sides of a city's airspace: edges, ceiling and ground, up to max_range."""
    x, y, z = known_position
    return reach_east - x, reach_north - y, ceiling - z, reach_east + x, reach_north + y, z
