"""Validation of arguments of an airspace: options, drone indices, setpoints and states."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import default_dynamics, find_dynamics
from bulletuav.dynamics.divergence import FASTEST, FASTEST_SPIN
from bulletuav.dynamics.setpoints import CONVERTED
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.envs.agents import in_c
from bulletuav.envs.cables import require_cables
from bulletuav.envs.options import EnvOptions, check_names
from bulletuav.envs.randomization import Randomization, known_uncertainties
from bulletuav.envs.resolve_options import load_airframes, make_tuples
from bulletuav.envs.viewer import VIEWERS
from bulletuav.errors import (
    UnknownOptionError,
    find_choice,
    finite,
    numbers_of,
    shown,
    suggest_names,
)
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Sensor
from bulletuav.sensors.suite import find_sensor, known_sensors
from bulletuav.vehicle.airframe import Airframe

Drones = int | Sequence[int] | np.ndarray | None
"""Index of one drone, several indices, a mask (N,), or None for all"""
Angle = float | Sequence[float] | np.ndarray
"""One angle for all drones, or one for each, rad"""
MAX_YAW = 1e4
"""Largest yaw, rad, and largest yaw rate, rad/s"""
MAX_NUMBER = 1e9
"""Largest absolute value in a state or setpoint"""
TOLERANCE = 1e-6
"""Relative tolerance of quaternion norms and of rotor speeds"""
MOTION_BOUNDS = {"velocity": FASTEST, "rates": FASTEST_SPIN}
"""Bounds of speed, m/s, and of angular rate, rad/s"""
DYNAMICS_WITH_GRAVITY = ("point_mass", "double_integrator")
"""Dynamics whose accelerations are bounded by a fraction of gravity"""
UPRIGHT, STILL = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
"""Quaternion of a level body that heads east, and zero velocity"""
LEVELS = {one.name.lower(): one for one in SetpointLevel}
"""Setpoint levels by name"""
YAW = 3
"""Column of the yaw in a setpoint"""
ALL_DRONES = slice(None)
FLOAT = np.dtype(np.float64)
NUMBER_TYPES = frozenset((float, int))
"""Number types that need no further checks"""
TASK_OPTIONS = (
    "num_drones",
    "min_drones",
    "decision_every",
    "action",
    "action_masks",
    "communication",
    "horizon",
    "observation",
    "observation_format",
    "reward",
    "num_neighbours",
    "normalise",
    "difficulty",
    "preset",
    "battery_capacity",
    "energy",
    "bodies",
    "events",
)
"""Options that apply to tasks only"""


def airspace_options(
    position: Any, airframe: Any, sensors: Any, given: Mapping[str, Any]
) -> tuple[EnvOptions, dict[str, Sensor]]:
    """Check the options of an airspace.

    Args:
        position: (N, 3) start positions; their number is the number of drones.
        airframe: One airframe, or one for each drone.
        sensors: Names of sensors, or sensor objects.
        given: Other options by name.

    Returns:
        The options, and the sensors that the drones carry, by name.

    Raises:
        UnknownOptionError: If there is no such option.
        ValueError: If a value is invalid.
    """
    known = {field.name for field in dataclasses.fields(EnvOptions)}.difference(TASK_OPTIONS)
    for name in given:
        if name not in known:
            raise UnknownOptionError(
                f"unknown option of Airspace: {name!r}: {suggest_names(name, known)}"
            )
    places = numbers_of("position is", position)
    if places.ndim != 2 or places.shape[1] != 3 or not len(places):
        raise ValueError(
            f"position is {shown(position)}: a row x, y, z for each drone is needed, such as "
            f"[(0.0, 0.0, 1.0)]"
        )
    # Default values follow from the airframes
    values = dict(given)
    if "dynamics" not in values:
        values["dynamics"] = default_dynamics(values.get("contacts"))
    make_tuples(values)
    values["airframe"] = load_airframes(airframe, len(places))
    dynamics = find_dynamics(values["dynamics"])
    if any(one.is_load for one in values["airframe"]):
        require_cables(dynamics, values.get("contacts"), "there is a load")
    values.setdefault("max_speed", min(one.max_speed for one in values["airframe"]))
    listed = sensors if isinstance(sensors, list | tuple) else (sensors,)
    all_sensors = known_sensors(one for one in listed if not isinstance(one, str))
    values["randomization"] = Randomization(
        values.get("randomization"), known_uncertainties(all_sensors)
    )
    # Setpoints come from `command`; action "rotor" is valid with all other options
    values |= {"num_drones": len(places), "action": "rotor", "horizon": 1, "sensors": listed}
    options = EnvOptions(**values)
    options.check_worlds(1)
    if options.render_mode in VIEWERS:
        raise ValueError(
            f"render_mode is {options.render_mode!r}: live views show tasks; use 'human' or "
            f"'rgb_array'"
        )
    if options.gravity == 0 and options.dynamics_name in DYNAMICS_WITH_GRAVITY:
        raise ValueError(
            f"gravity is 0: dynamics {options.dynamics_name!r} bounds accelerations by it, use "
            f"another dynamics"
        )
    # Sensors that are named must be registered, or among those given
    names = [one if isinstance(one, str) else find_sensor(one).name for one in listed]
    check_names("sensors", "sensor", names, tuple(all_sensors))
    carried = {name: sensor for name, sensor in all_sensors.items() if name in names}
    return options, carried


def require_bodies(obstacles: Any, layout: Any) -> None:
    """Raise ValueError unless `obstacles` lists obstacles and `layout` is `Solids` or None."""
    if not isinstance(obstacles, list | tuple) or not all(
        isinstance(one, Obstacle) for one in obstacles
    ):
        raise ValueError(f"obstacles is {shown(obstacles)}: a list of `Obstacle` is needed")
    if layout is not None and not isinstance(layout, Solids):
        raise ValueError(f"layout is {shown(layout)}: `Solids`, such as those of a city, is needed")


def rows_of(drones: Drones, count: int) -> tuple[Any, tuple[int, ...]]:
    """Convert a selection of drones to an array index.

    Args:
        drones: See `Drones`.
        count: Number of drones.

    Returns:
        Index into arrays (N, ...): an int for one drone, else an array or a slice; and the selected
        shape: () for one drone, else (M,).

    Raises:
        ValueError: If there is no such drone.
    """
    # The usual forms first, without allocating arrays
    if type(drones) is int and 0 <= drones < count:
        return drones, ()
    if drones is None:
        return ALL_DRONES, (count,)
    try:
        rows = np.asarray(drones)
    except ValueError:  # rows of several lengths
        rows = np.zeros(1)
    # NumPy converts an empty list to floats
    if rows.shape == (0,):
        return np.zeros(0, dtype=int), (0,)
    if rows.dtype == bool and rows.shape == (count,):
        return np.flatnonzero(rows), (int(rows.sum()),)
    # A drone that is listed twice would have two values
    whole = rows.dtype.kind in "iu" and rows.ndim <= 1
    if not whole or ((rows < 0) | (rows >= count)).any() or rows.size != np.unique(rows).size:
        raise ValueError(
            f"drones is {shown(drones)}: an index from 0 to {count - 1}, several different ones, "
            f"a mask of {count}, or None for all is needed"
        )
    return (rows, rows.shape) if rows.ndim else (int(rows), ())


def without_loads(drones: Drones, airframes: Sequence[Airframe]) -> Drones:
    """Return a selection of drones that can be commanded; for None all but the loads.

    Raises:
        ValueError: If there is no such drone, or a load is among them.
    """
    are_loads = np.array([one.is_load for one in airframes])
    if drones is None:
        return np.flatnonzero(~are_loads)
    rows, _ = rows_of(drones, len(airframes))
    if are_loads[rows].any():
        raise ValueError(
            f"drones is {shown(drones)}, and {np.flatnonzero(are_loads).tolist()} are loads, which "
            f"have no rotors: command drones only"
        )
    return drones


def numbers(name: str, value: Any) -> np.ndarray:
    """Convert a value to an array of finite numbers of any shape.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.

    Returns:
        A float64 array.

    Raises:
        ValueError: If the values are not numbers, not finite, or too large.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:
        array = value
    elif type(value) is tuple and NUMBER_TYPES.issuperset(map(type, value)):
        array = np.array(value, dtype=np.float64)
    else:
        array = numbers_of(f"{name} is", value)
    flat = array.ravel()
    # The sum of squares is not finite if any number is not
    if not flat.dot(flat) <= MAX_NUMBER**2:
        raise ValueError(
            f"{name} is {shown(value)}: finite numbers up to {MAX_NUMBER:g} are needed"
        )
    return array


def numbers_of_shape(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Convert a value to finite numbers of a shape, given in full or once for all drones.

    Args:
        name: Name of the argument, for the message.
        value: Value of the argument.
        shape: Required shape.

    Returns:
        A float64 array that broadcasts to the shape.

    Raises:
        ValueError: If the value has another shape, or its numbers are not finite.
    """
    array = numbers(name, value)
    if array.shape != shape and array.shape != shape[-1:]:
        raise ValueError(f"{name} has shape {array.shape}: {shape} is needed")
    return array


def angles(name: str, value: Any, count: tuple[int, ...]) -> np.ndarray | float:
    """Convert a value to an angle or its rate, or to one for each of the drones (M,).

    Raises:
        ValueError: If the value has another shape, or exceeds `MAX_YAW`.
    """
    if np.ndim(value) == 0:
        one = value[()] if isinstance(value, np.ndarray) else value
        return finite(name, one, -MAX_YAW, MAX_YAW)
    several = numbers(name, value)
    if several.shape != count or np.abs(several).max(initial=0.0) > MAX_YAW:
        raise ValueError(
            f"{name} is {shown(value)}: a number up to {MAX_YAW:g}, or one for each of the "
            f"drones, is needed"
        )
    return several


def state_numbers(
    most: np.ndarray, position: Any, quaternion: Any, velocity: Any, rates: Any, rotor_speed: Any
) -> tuple[np.ndarray, ...]:
    """Check a new state of drones.

    Args:
        most: (M, R) maximum speed of each rotor, rad/s; (R,) for one drone.
        position: (M, 3) m, or (3,) for one drone.
        quaternion: (M, 4), or (4,) for all.
        velocity: (M, 3), or (3,) for all, m/s.
        rates: (M, 3), or (3,) for all, rad/s.
        rotor_speed: (M, R), (R,) for all, or one for all rotors, rad/s.

    Returns:
        The five values as arrays.

    Raises:
        ValueError: If a number is invalid.
    """
    # Several drones at one position would overlap
    count = most.shape[:-1]
    place = numbers_of_shape("position", position, (*count, 3))
    if place.ndim < len(count) + 1 and count != (1,):
        raise ValueError(f"position has shape {place.shape}: {(*count, 3)} is needed")
    # Another norm is a mistake, such as w in the first column
    turn = numbers_of_shape("quaternion", quaternion, (*count, 4))
    require_unit("quaternion", turn)
    # Tiles of other worlds, and parked bodies, are beyond
    half = TILE_PITCH / 2
    if (np.abs(place[..., :2]) >= half).any() or (np.abs(place[..., 2]) >= PARKING_HEIGHT).any():
        raise ValueError(
            f"position is {shown(position)}: less than {half:g} m aside and {PARKING_HEIGHT:g} m "
            f"up is needed"
        )
    # One number applies to all rotors of the airframe
    if np.ndim(rotor_speed) == 0:
        rotor_speed = np.where(most > 0, finite("rotor_speed", rotor_speed), 0.0)
    speed = numbers_of_shape("rotor_speed", rotor_speed, most.shape)
    if (speed < 0).any() or (speed > most * (1 + TOLERANCE)).any():
        raise ValueError(
            f"rotor_speed is {shown(rotor_speed)}: from 0 to the {most.max():g} rad/s of the "
            f"airframe is needed"
        )
    moving = numbers_of_shape("velocity", velocity, (*count, 3))
    turning = numbers_of_shape("rates", rates, (*count, 3))
    require_motion("velocity", moving)
    require_motion("rates", turning)
    return place, turn, moving, turning, speed


def require_unit(name: str, quaternion: np.ndarray) -> None:
    """Raise ValueError for quaternions (..., 4) whose norm is not 1, or not a number."""
    norms = np.sqrt((quaternion * quaternion).sum(axis=-1))
    if not (np.abs(norms - 1) <= TOLERANCE).all():
        raise ValueError(
            f"{name} is {shown(quaternion)}: a length of 1 is needed, divide by its norm"
        )


def require_motion(name: str, values: np.ndarray) -> None:
    """Raise ValueError for velocities, m/s, or body rates, rad/s, (..., 3) that are too fast."""
    # Half of the speed at which a flight counts as diverged
    most, unit = MOTION_BOUNDS[name] / 2, "m/s" if name == "velocity" else "rad/s"
    if not (np.abs(values) < most).all():
        raise ValueError(
            f"{name} is {shown(values)}: finite numbers of less than {most:g} {unit} are needed"
        )


def level_of(level: Any, consumes: SetpointLevel, options: EnvOptions) -> SetpointLevel:
    """Convert a setpoint level or its name, and check that it can be commanded.

    Args:
        level: Value of the argument.
        consumes: Setpoint level that the dynamics consumes.
        options: Options of the airspace.

    Returns:
        The level.

    Raises:
        ValueError: If there is no such level, or it cannot drive the dynamics.
    """
    if isinstance(level, SetpointLevel):
        chosen = level
    elif isinstance(level, np.integer) and level in LEVELS.values():  # from `Airspace.levels`
        chosen = SetpointLevel(int(level))
    else:
        chosen = find_choice(
            "setpoint level", level.lower() if isinstance(level, str) else level, LEVELS
        )
    # No conversion goes up: a point dynamics has no attitude to command
    if chosen > consumes:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints: "
            f"command that level or one above it, not {chosen.name}; or use 'rigid_body', 'bullet'"
        )
    # Custom dynamics may consume levels that no controller outputs
    if chosen != consumes and consumes not in CONVERTED:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints, "
            f"which no controller outputs: command {consumes.name}"
        )
    # Rotor controllers balance thrust against the weight
    if chosen < consumes == SetpointLevel.ROTOR:
        if options.gravity == 0:
            raise ValueError(
                f"setpoints of {chosen.name} need gravity, which thrust is balanced against: "
                f"without gravity, command ROTOR"
            )
        options.check_controller(chosen)
    return chosen


def setpoint_widths(
    consumes: SetpointLevel, options: EnvOptions, rotors: int
) -> dict[SetpointLevel, int]:
    """Return the number of setpoint columns of each level that needs no further checks.

    Args:
        consumes: Setpoint level that the dynamics consumes.
        options: Options of the airspace.
        rotors: Number of rotors and control surfaces of a ROTOR setpoint.
    """
    widths = {}
    for level in SetpointLevel:
        with contextlib.suppress(ValueError):
            widths[level_of(level, consumes, options)] = YAW + 1
    if SetpointLevel.ROTOR in widths:
        widths[SetpointLevel.ROTOR] = rotors
    if options.controller == "pid":  # its integrals are cleared by the full path
        widths.pop(SetpointLevel.ROTOR, None)
    return widths


def hold_plainly(
    levels: np.ndarray,
    setpoint: np.ndarray,
    commanded: np.ndarray,
    drones: Any,
    level: SetpointLevel,
    width: int,
    numbers: Any,
) -> bool:
    """Write setpoints of one or all drones if they are contiguous floats.

    The C implementation does this. The Python version writes nothing, so that the caller continues
    with full checks.

    Args:
        levels: (1, N) levels that the drones hold, written.
        setpoint: (1, N, S) setpoints that the drones hold, written.
        commanded: (1, N) bool, whether a drone was commanded any setpoint, written.
        drones: Value of the argument `drones`.
        level: One of `setpoint_widths`.
        width: Number of columns of the level; the yaw may be missing for drones that hold one.
        numbers: Value of the argument `setpoint`.

    Returns:
        True if the setpoints were written.
    """
    return False


hold = in_c(hold_plainly)


def setpoint_numbers(
    level: SetpointLevel, setpoint: Any, count: tuple[int, ...], rotors: int, has_yaw: bool
) -> np.ndarray:
    """Check the numbers of a setpoint.

    Args:
        level: Setpoint level.
        setpoint: Value of the argument.
        count: (M,) for M drones, () for one.
        rotors: Number of rotors and control surfaces of a ROTOR setpoint.
        has_yaw: Whether a yaw or a yaw rate is given separately.

    Returns:
        Numbers that broadcast to (M, columns of the level); without the yaw if it is left out.

    Raises:
        ValueError: If the numbers are invalid.
    """
    array, width = numbers("setpoint", setpoint), rotors
    # Three numbers and a yaw, which may be left out or given separately
    if level < SetpointLevel.ROTOR:
        width = YAW + 1
        if level < SetpointLevel.ATTITUDE:
            width -= has_yaw or array.shape[-1:] == (YAW,)
        elif has_yaw:
            raise ValueError(
                f"yaw and yaw_rate are for POSITION, VELOCITY and ACCELERATION, not {level.name}"
            )
    if array.shape != (width,) and array.shape != (*count, width):
        twice = "; the yaw is given separately" if has_yaw else ""
        raise ValueError(
            f"setpoint of {level.name} has shape {array.shape}: {(*count, width)} is needed{twice}"
        )
    return array
