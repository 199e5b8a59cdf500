"""The constants of airframes as rows for the compiled loops."""

from collections.abc import Sequence

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
    ]
)


def parameter_rows(airframes: Sequence[Airframe], effects: Sequence[str] = EFFECTS) -> np.ndarray:
    """(N,) rows of `PARAMETERS`, what the compiled loops read. An effect that is not named has its constants at zero.

    Raises ValueError for an effect that is not in `EFFECTS`.
    """
    for effect in effects:
        if effect not in EFFECTS:
            raise unknown("effect", effect, EFFECTS)
    rows = np.zeros(len(airframes), dtype=PARAMETERS)
    for row, airframe in zip(rows, airframes, strict=True):
        for name in (
            "mass",
            "inertia",
            "thrust_coefficient",
            "max_rotor_speed",
            "propeller_radius",
            "collision_radius",
            "thinnest",
        ):
            row[name] = getattr(airframe, name)
        row["num_rotors"] = len(airframe.rotors)
        row["torque_coefficient"] = airframe.thrust_coefficient * airframe.torque_ratio
        for i, (x, y, turn) in enumerate(airframe.rotors):
            row["rotor_x"][i], row["rotor_y"][i], row["rotor_turn"][i] = x, y, turn
        if "lag" in effects:
            row["lag_up"], row["lag_down"] = airframe.lag_up, airframe.lag_down
        if "drag" in effects:
            row["drag_xy"], row["drag_z"] = airframe.drag_xy, airframe.drag_z
        if "ground_effect" in effects:
            row["ground_effect_gain"] = airframe.ground_effect_gain
        if "downwash" in effects:
            row["downwash_gain"] = DOWNWASH_GAIN
            row["downwash_radius"] = airframe.arm + airframe.propeller_radius
    return rows
