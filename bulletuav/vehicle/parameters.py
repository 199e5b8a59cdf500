"""Constants of airframes as structured rows for compiled functions."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bulletuav.compiled.plain import record_type
from bulletuav.errors import unknown
from bulletuav.vehicle.airframe import DENSITY, MAX_ROTORS, Airframe

EFFECTS = (
    "lag",
    "drag",
    "body_drag",
    "damping",
    "rotor_inertia",
    "ground_effect",
    "downwash",
    "voltage",
)
"""Physical effects that can be switched off."""
DEFAULT_EFFECTS = EFFECTS[:-1]
"""Default effects: all except "voltage", as firmware compensates for the battery's voltage."""

PARAMETERS = record_type(
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
        ("drag_height", "f8"),
        ("body_drag_xy", "f8"),
        ("body_drag_z", "f8"),
        ("damping", "f8", 3),
        ("rotor_inertia", "f8"),
        ("propeller_radius", "f8"),
        ("arm", "f8"),
        ("ground_effect_gain", "f8"),
        ("ground_effect_reach", "f8"),
        ("ground_effect_fade", "f8"),
        ("wake_share", "f8"),
        ("wake_spread", "f8"),
        ("wake_radius", "f8"),
        ("efficiency", "f8"),
        ("electronics", "f8"),
        ("collision_radius", "f8"),
        ("thinnest", "f8"),
        ("friction", "f8"),
        ("restitution", "f8"),
    ]
)
"""Type of the rows; `ParameterRow` documents the fields."""


class ParameterRow(Protocol):
    """One row of `PARAMETERS` as compiled functions see it, SI units, body axes FLU.

    Attributes:
        mass: Mass, kg.
        inertia: (3,) principal moments of inertia about x, y, z, kg m^2.
        num_rotors: Number of rotors R; arrays of rotors are padded with zeros.
        rotor_x: (MAX_ROTORS,) position of each rotor along x, m.
        rotor_y: (MAX_ROTORS,) position of each rotor along y, m.
        rotor_turn: (MAX_ROTORS,) +1 if the reaction torque is about +z, else -1.
        thrust_coefficient: k_f, thrust divided by the square of the rotor speed, N s^2.
        torque_coefficient: k_m, reaction torque divided by the square of the rotor speed, N m s^2.
        max_rotor_speed: Maximum rotor speed, rad/s.
        lag_up: Time constant of a rotor that speeds up, s; 0 for no lag.
        lag_down: Time constant of a rotor that slows down, s; 0 for no lag.
        drag_xy: Drag of a rotor across its axis, N / (m/s rad/s).
        drag_z: Drag of a rotor along its axis, per m/s and rad/s, N.
        drag_height: Height above the centre of mass at which the rotors' drag acts, m.
        body_drag_xy: Drag of the body in the rotor plane divided by the square of the speed,
            N s^2/m^2.
        body_drag_z: The same across the rotor plane.
        damping: (3,) damping torque per rad/s of the body rates and per rad/s of the sum of the
            rotor speeds, N m s^2.
        rotor_inertia: Moment of inertia of a rotor, kg m^2; 0 to neglect it.
        propeller_radius: Radius of the propellers, m.
        arm: Distance of the outermost rotor from the centre of mass, m.
        ground_effect_gain: Thrust that a surface right below adds, as a fraction of a rotor's
            thrust; 0 for none.
        ground_effect_reach: Height above which there is no ground effect, m.
        ground_effect_fade: Reciprocal of `ground_effect_reach`, 1/m.
        wake_share: Force of the wake on a drone right below, as a fraction of the thrust; 0 for
            none.
        wake_spread: Growth of the wake's width per distance below.
        wake_radius: Width of the wake at the rotors, m.
        efficiency: Power at the rotors' shafts divided by electrical power.
        electronics: Electrical power of everything except the motors, W.
        collision_radius: Radius of the collision shape's bounding sphere, m.
        thinnest: Minimum extent of the collision shape, m.
        friction: Coefficient of friction of the surface.
        restitution: Coefficient of restitution.
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
    drag_height: float
    body_drag_xy: float
    body_drag_z: float
    damping: np.ndarray
    rotor_inertia: float
    propeller_radius: float
    arm: float
    ground_effect_gain: float
    ground_effect_reach: float
    ground_effect_fade: float
    wake_share: float
    wake_spread: float
    wake_radius: float
    efficiency: float
    electronics: float
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
    "arm",
    "ground_effect_reach",
    "wake_spread",
    "wake_radius",
    "efficiency",
    "electronics",
    "collision_radius",
    "thinnest",
    "friction",
    "restitution",
)
"""Fields that have the same name in an airframe, and that no effect switches."""


def parameter_rows(
    airframes: Sequence[Airframe], effects: Sequence[str] = DEFAULT_EFFECTS
) -> np.ndarray:
    """Make the rows of constants that compiled functions read.

    Args:
        airframes: Airframe of each of N drones.
        effects: Names of `EFFECTS` that are on; the constants of all other effects are 0.

    Returns:
        (N,) rows of `PARAMETERS`.

    Raises:
        ValueError: If an effect is unknown, or an airframe has a constant that is not physical.
    """
    for effect in effects:
        if effect not in EFFECTS:
            raise unknown("effect", effect, EFFECTS)
    # Most drones share an airframe
    for airframe in {id(one): one for one in airframes}.values():
        airframe.require_physical()
    rows = np.zeros(len(airframes), dtype=PARAMETERS)
    for row, airframe in zip(rows, airframes, strict=True):
        for name in _COPIED:
            row[name] = getattr(airframe, name)
        row["num_rotors"] = len(airframe.rotors)
        row["ground_effect_fade"] = 1.0 / airframe.ground_effect_reach
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
            row["drag_height"] = airframe.drag_height
        if "body_drag" in effects:
            row["body_drag_xy"] = 0.5 * DENSITY * airframe.body_drag[0]
            row["body_drag_z"] = 0.5 * DENSITY * airframe.body_drag[1]
        if "damping" in effects:
            total_speed = len(airframe.rotors) * airframe.hover_speed()
            if total_speed > 0.0:
                row["damping"] = np.array(airframe.damping) * airframe.inertia / total_speed
        if "rotor_inertia" in effects:
            row["rotor_inertia"] = airframe.rotor_inertia
        if "ground_effect" in effects:
            row["ground_effect_gain"] = airframe.ground_effect_gain
        if "downwash" in effects:
            row["wake_share"] = airframe.wake_share
    return rows
