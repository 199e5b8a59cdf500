"""Observation blocks of the airspace."""

from typing import Any

from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import SIDES
from bulletuav.tasks.ingredients import block


def _room_labels(task: Any) -> tuple[Label, ...]:
    """Label the sides; distances are clipped to the maximum range of the range finder."""
    return tuple(Label(f"room {side}", "m", 0.0, task.context.max_range) for side in SIDES)


@register("observation")
@block(_room_labels)
def room(
    known_position: Vec3,
    bound_east: float,
    bound_north: float,
    bound_up: float,
    bound_west: float,
    bound_south: float,
    bound_down: float,
) -> tuple[float, float, float, float, float, float]:
    """Distances to the sides of the arena: edges, ceiling and ground, up to max_range."""
    x, y, z = known_position
    beyond = bound_east - x, bound_north - y, bound_up - z
    return *beyond, x - bound_west, y - bound_south, z - bound_down
