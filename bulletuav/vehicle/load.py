"""Loads: bodies without rotors, which drones carry on cables."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bulletuav.errors import as_sequence, finite, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.shapes import Shape
from bulletuav.vehicle.airframe import Airframe

VARIED = ("mass", "inertia", "body_drag", "shape", "friction", "restitution")
"""Attributes in which loads differ"""
MAX_LOAD_MASS = 1e9
"""Maximum mass of a load, kg"""
MAX_LOAD_SPEED = 1000.0
"""Maximum speed of loads, which limits no commands, m/s"""
BOX_DRAG, SPHERE_DRAG = (1.05, 1.05), (0.47, 0.47)
CYLINDER_DRAG = (1.1, 0.82)
"""Drag coefficients of shapes in horizontal and vertical motion (Hoerner 1965)"""

WITHOUT_ROTORS: Mapping[str, Any] = MappingProxyType(
    {
        "name": "load",
        "urdf": Path(),
        "rotors": (),
        "thrust_coefficient": 1.0,
        "torque_ratio": 1.0,
        "max_rotor_speed": 1.0,
        "lag_up": 0.0,
        "lag_down": 0.0,
        "drag_xy": 0.0,
        "drag_z": 0.0,
        "drag_height": 0.0,
        "propeller_radius": 1.0,
        "rotor_inertia": 0.0,
        "damping": (0.0, 0.0, 0.0),
        "ground_effect_gain": 0.0,
        "ground_effect_reach": 1.0,
        "wake_share": 0.0,
        "wake_spread": 0.0,
        "wake_radius": 1.0,
        "efficiency": 1.0,
        "electronics": 0.0,
        "max_speed": MAX_LOAD_SPEED,
    }
)
"""Constants that have no effect without rotors"""


@dataclass(frozen=True)
class Load(Airframe):
    """A body without rotors; see `make_load`.

    It feels gravity, the drag of its shape in the wind, contacts and cables, but no downwash, whose
    law was fitted to drones.
    """

    @property
    def is_load(self) -> bool:
        """Whether it has no rotors: True."""
        return True

    def numbers(self) -> dict[str, Any]:
        """Return the values in which loads differ, for `of_numbers`."""
        return {name: getattr(self, name) for name in VARIED}

    @classmethod
    def of_numbers(cls, given: Mapping[str, Any]) -> "Load":
        """Make a load from the result of `numbers`, also with lists in place of tuples."""
        kind, half, corners = given["shape"]
        values = {name: given[name] for name in VARIED}
        values["inertia"], values["body_drag"] = tuple(given["inertia"]), tuple(given["body_drag"])
        shape = Shape(kind, tuple(half), tuple(map(tuple, corners)))
        return cls(**{**WITHOUT_ROTORS, **values, "shape": shape})


def make_load(
    shape: Obstacle,
    mass: float,
    *,
    inertia: Sequence[float] | None = None,
    drag_area: Sequence[float] | None = None,
) -> Load:
    """Make a load, to be used in place of an airframe of an `Airspace`.

    Args:
        shape: Box, sphere or cylinder about the centre of mass, with friction and restitution.
        mass: Mass, kg.
        inertia: (3,) moments of inertia about the axes of the shape, kg m^2. None for those of a
            homogeneous body.
        drag_area: (2,) drag coefficients times areas in horizontal and vertical motion, m^2. None
            for those of the shape.

    Raises:
        ValueError: If the shape is a hull or none, or a number is invalid.
    """
    if not isinstance(shape, Obstacle):
        raise ValueError(
            f"shape of a load is {shown(shape)}: an Obstacle is needed, such as "
            f"Obstacle('sphere', (0.1,))"
        )
    if finite("mass of a load", mass, 0.0, MAX_LOAD_MASS) == 0.0:
        raise ValueError("mass of a load is 0: a number of kg above 0 is needed")
    if shape.kind == "hull":
        raise ValueError("the shape of a load is a hull: use a box, sphere or cylinder")
    moments = _compute_inertia(shape, mass) if inertia is None else inertia
    areas = _estimate_drag(shape) if drag_area is None else drag_area
    x, y, z = (finite("inertia of a load", one) for one in as_sequence("inertia", moments, 3))
    across, along = (finite("drag_area", one, 0.0) for one in as_sequence("drag_area", areas, 2))
    if min(x, y, z) <= 0.0:
        raise ValueError(f"inertia of a load is {(x, y, z)}: numbers above 0 are needed")
    if 2 * max(x, y, z) > (x + y + z) * (1 + 1e-9):
        raise ValueError(
            f"inertia of a load is {(x, y, z)}: no body has a moment above the sum of the others"
        )
    values = (float(mass), (x, y, z), (across, along), shape.shape, shape.friction)
    return Load.of_numbers(dict(zip(VARIED, (*values, shape.restitution), strict=True)))


def _compute_inertia(shape: Obstacle, mass: float) -> tuple[float, float, float]:
    """Return the moments of inertia of a homogeneous box, sphere or cylinder, kg m^2."""
    if shape.kind == "box":
        a, b, c = (edge * edge for edge in shape.size)
        return mass * (b + c) / 12, mass * (a + c) / 12, mass * (a + b) / 12
    square = shape.size[0] ** 2
    if shape.kind == "sphere":
        return (0.4 * mass * square,) * 3
    across = mass * (3 * square + shape.size[1] ** 2) / 12
    return across, across, mass * square / 2


def _estimate_drag(shape: Obstacle) -> tuple[float, float]:
    """Return the drag areas of a shape in horizontal and vertical motion, m^2."""
    if shape.kind == "box":
        a, b, c = shape.size
        return BOX_DRAG[0] * c * (a + b) / 2, BOX_DRAG[1] * a * b
    disc = math.pi * shape.size[0] ** 2
    if shape.kind == "sphere":
        return SPHERE_DRAG[0] * disc, SPHERE_DRAG[1] * disc
    return CYLINDER_DRAG[0] * 2 * shape.size[0] * shape.size[1], CYLINDER_DRAG[1] * disc
