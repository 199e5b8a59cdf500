"""Policies that avoid the task `transport`: they fly as `carrier` does, but for a part of it."""

import numpy as np

from bulletuav.policies.carrier import (
    CARRY_HEIGHT,
    CLIMB,
    FORMATION_GAIN,
    HEIGHT_GAIN,
    LOAD_GAIN,
    SINK,
    Carrier,
    LoadView,
    horizontal_distance,
)
from bulletuav.registry import register

ASIDE = np.array((0.4, 0.0, 0.0))
"""Offset from the place at which loads are set down beside it, m"""
ABOVE = 0.2
"""Horizontal distance from the place within which loads fall, m"""
RAM_DISTANCE = 2.0
"""Distance of the load from its place at which drones fly into it, m"""


def _hold_height(view: LoadView) -> np.ndarray:
    """Return the vertical speeds (W, N) of loads that stay at the height of transport, m/s."""
    error = CARRY_HEIGHT + view.offset[..., 2]
    speed: np.ndarray = np.clip(HEIGHT_GAIN * error, -SINK, CLIMB)
    return speed


@register("policy")
class TransportLift(Carrier):
    """Lift the load, and hover where it was."""

    name = "transport_lift"

    def load_velocity(self, view: LoadView) -> np.ndarray:
        """Return vertical velocities only; see `Carrier.load_velocity`."""
        speed = np.zeros_like(view.offset)
        speed[..., 2] = _hold_height(view)
        return speed


@register("policy")
class TransportAbove(Carrier):
    """Carry the load to its place, and hover above it."""

    name = "transport_above"

    def load_velocity(self, view: LoadView) -> np.ndarray:
        """Return velocities without the way down; see `Carrier.load_velocity`."""
        speed = super().load_velocity(view)
        speed[..., 2] = _hold_height(view)
        return speed


@register("policy")
class TransportDrag(Carrier):
    """Drag the load along the ground."""

    name = "transport_drag"

    def load_velocity(self, view: LoadView) -> np.ndarray:
        """Return horizontal velocities; see `Carrier.load_velocity`."""
        speed = LOAD_GAIN * view.offset
        speed[..., 2] = -SINK
        return speed


@register("policy")
class TransportDrop(Carrier):
    """Carry the load to its place, and descend there at full speed."""

    name = "transport_drop"

    def load_velocity(self, view: LoadView) -> np.ndarray:
        """Return velocities with a fast way down; see `Carrier.load_velocity`."""
        speed = super().load_velocity(view)
        falls = horizontal_distance(view.offset) < ABOVE
        speed[..., 2] = np.where(falls, -self.aviary.options.max_speed, _hold_height(view))
        return speed


@register("policy")
class TransportBeside(Carrier):
    """Set the load down beside its place."""

    name = "transport_beside"

    def plan(self, view: LoadView) -> np.ndarray:
        """Plan the flight to another place; see `Carrier.plan`."""
        return super().plan(view._replace(offset=view.offset + ASIDE))


@register("policy")
class TransportRam(Carrier):
    """Carry the load towards its place, and fly into it there."""

    name = "transport_ram"

    def plan(self, view: LoadView) -> np.ndarray:
        """Plan the flight, and its end near the place; see `Carrier.plan`."""
        velocity = super().plan(view)
        rams = horizontal_distance(view.offset) < RAM_DISTANCE
        into = 2 * FORMATION_GAIN * view.position
        return np.where(rams[..., None], into, velocity)
