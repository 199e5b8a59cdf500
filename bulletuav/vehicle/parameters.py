"""The constants of airframes as rows for the compiled loops."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bulletuav.errors import unknown
from bulletuav.vehicle.airframe import DOWNWASH_GAIN, EFFECTS, MAX_ROTORS, Airframe

PARAMETERS = np.dtype(
    [
        ("mass", "f8"),
        ("inertia", "f8", 3),
        ("num_rotors", "i8"),
        ("rotor_x", "f8", MAX_ROTORS),
        ("rotor_y", "f8", MAX_ROTORS),
        ("rotor_turn", "f8", MAX_ROTORS),
        ("thrust_coefficient", "f8"),
        ("torque_coefficient", "f8"),
        ("max_rotor_speed", "f8"),
        ("lag_up", "f8"),
        ("lag_down", "f8"),
        ("drag_xy", "f8"),
        ("drag_z", "f8"),
        ("propeller_radius", "f8"),
        ("ground_effect_gain", "f8"),
        ("downwash_gain", "f8"),
        ("downwash_radius", "f8"),
        ("collision_radius", "f8"),
        ("thinnest", "f8"),
        ("friction", "f8"),
        ("restitution", "f8"),
    ]
)
"""Type of the rows; `ParameterRow` tells what the fields are."""


class ParameterRow(Protocol):
    """One row of `PARAMETERS` as compiled functions see it, SI units, body axes FLU.

    Attributes:
        mass: Mass, kg.
        inertia: (3,) principal moments of inertia about x, y, z, kg m^2.
        num_rotors: Number of rotors R; the arrays of rotors hold zeros beyond it.
        rotor_x: (MAX_ROTORS,) place of each rotor along x, m.
        rotor_y: (MAX_ROTORS,) place of each rotor along y, m.
        rotor_turn: (MAX_ROTORS,) +1 where the reaction torque is about +z, else -1.
        thrust_coefficient: k_f, thrust over the square of the rotor speed, N s^2.
        torque_coefficient: k_m, reaction torque over the square of the rotor speed, N m s^2.
        max_rotor_speed: Greatest rotor speed, rad/s.
        lag_up: Time constant of a rotor that speeds up, s; 0 for none.
        lag_down: Time constant of a rotor that slows down, s; 0 for none.
        drag_xy: Drag of a rotor across its axis, for each m/s and rad/s, N.
        drag_z: Drag of a rotor along its axis, for each m/s and rad/s, N.
        propeller_radius: Radius of the propellers, m.
        ground_effect_gain: Factor of the ground effect; 0 for none.
        downwash_gain: Gain of the downwash, N; 0 for none.
        downwash_radius: Radius of the disc that the rotors sweep together, m.
        collision_radius: Radius of the sphere that holds the collision shape, m.
        thinnest: Least extent of the collision shape, m.
        friction: Coefficient of friction of its surface.
        restitution: Share of the speed that an impact gives back.
    """

    mass: float
    inertia: np.ndarray
    num_rotors: int
    rotor_x: np.ndarray
    rotor_y: np.ndarray
    rotor_turn: np.ndarray
    thrust_coefficient: float
    torque_coefficient: float
    max_rotor_speed: float
    lag_up: float
    lag_down: float
    drag_xy: float
    drag_z: float
    propeller_radius: float
    ground_effect_gain: float
    downwash_gain: float
    downwash_radius: float
    collision_radius: float
    thinnest: float
    friction: float
    restitution: float


_COPIED = (
    "mass",
    "inertia",
    "thrust_coefficient",
    "max_rotor_speed",
    "propeller_radius",
    "collision_radius",
    "thinnest",
    "friction",
    "restitution",
)
"""Fields that an airframe has under the same name, and that no effect switches."""


def parameter_rows(airframes: Sequence[Airframe], effects: Sequence[str] = EFFECTS) -> np.ndarray:
    """Make the rows that the compiled loops read.

    Args:
        airframes: Airframe of each of N drones.
        effects: Names of `EFFECTS`; one that is not named has its constants at zero.

    Returns:
        (N,) rows of `PARAMETERS`.

    Raises:
        ValueError: There is no such effect.
    """
    for effect in effects:
        if effect not in EFFECTS:
            raise unknown("effect", effect, EFFECTS)
    rows = np.zeros(len(airframes), dtype=PARAMETERS)
    for row, airframe in zip(rows, airframes, strict=True):
        for name in _COPIED:
            row[name] = getattr(airframe, name)
        row["num_rotors"] = len(airframe.rotors)
        row["torque_coefficient"] = airframe.thrust_coefficient * airframe.torque_ratio
        for i, (x, y, turn) in enumerate(airframe.rotors):
            row["rotor_x"][i] = x
            row["rotor_y"][i] = y
            row["rotor_turn"][i] = turn
        if "lag" in effects:
            row["lag_up"] = airframe.lag_up
            row["lag_down"] = airframe.lag_down
        if "drag" in effects:
            row["drag_xy"] = airframe.drag_xy
            row["drag_z"] = airframe.drag_z
        if "ground_effect" in effects:
            row["ground_effect_gain"] = airframe.ground_effect_gain
        if "downwash" in effects:
            row["downwash_gain"] = DOWNWASH_GAIN
            row["downwash_radius"] = airframe.arm + airframe.propeller_radius
    return rows
