"""Sizes of tasks for aircraft that cannot hover, from the radius of their tightest turn."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bulletuav.errors import finite
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.cruise import turn_radius
from bulletuav.vehicle.envelope import find_envelope

TURN_MARGIN = 3.0
"""Distance from starts and goals to the arena's bounds, in radii of the tightest turn: half a turn
needs two"""
DETOUR = 1.5
"""Duration of an episode, in times of the straight flight at cruise speed and a full turn"""


def tightest_turn(airframes: Sequence[Airframe]) -> float:
    """Return the radius of the tightest turn at cruise speed that all aircraft can fly, m."""
    return max(map(turn_radius, airframes))


def kept_number(
    kept: Mapping[str, Any], name: str, usual: float, most: float | None = None
) -> float:
    """Return an option that stays, or its usual value.

    Raises:
        ValueError: If the option is not a finite number, below 0, or above `most`.
    """
    return finite(name, kept[name], 0.0, most) if name in kept else usual


def forward_sizes(
    airframes: Sequence[Airframe],
    values: Mapping[str, Any],
    distance: float,
    speed: float = math.inf,
) -> dict[str, Any]:
    """Return goal radius, margin and horizon of flights to goals.

    An aircraft that turns towards a goal as tightly as it can may circle around it at the radius of
    its turn, so the goal is that large. The horizon is at least the usual one.

    Args:
        airframes: Airframes of the aircraft that cannot hover.
        values: All options by name.
        distance: Distance from starts to goals, m.
        speed: Speed at which it is flown, m/s, if that is below cruise speed.
    """
    radius = tightest_turn(airframes)
    slowest = min(speed, *(find_envelope(one).cruise_speed for one in airframes))
    duration = DETOUR * (distance + 2 * math.pi * radius) / slowest
    return {
        "goal_radius": math.ceil(radius),
        "margin": math.ceil(TURN_MARGIN * radius),
        "horizon": max(int(values["horizon"]), math.ceil(duration * values["decision_hz"])),
    }
