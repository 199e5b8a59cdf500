"""What users give to an airspace, checked: options, drones, setpoints, states."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.divergence import FASTEST, FASTEST_SPIN
from bulletuav.dynamics.setpoints import CONVERTED
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.envs.agents import in_c
from bulletuav.envs.options import EnvOptions, check_names
from bulletuav.envs.randomization import Randomization, known_uncertainties
from bulletuav.envs.resolve import airframes_of, make_tuples
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

Drones = int | Sequence[int] | np.ndarray | None
"""One drone by its index, several, a mask (N,), or None for all"""
Angle = float | Sequence[float] | np.ndarray
"""One for all drones, or one for each, rad"""
MOST_TURN = 1e4
"""Largest yaw (rad), and fastest turn of it (rad/s)"""
MOST = 1e9
"""Greatest size of a number in a state or setpoint"""
UNIT = 1e-6
"""Error of the norm of a unit quaternion"""
FASTEST_OF = (FASTEST, FASTEST_SPIN)
"""Bounds of speed (m/s) and spin (rad/s)"""
NEED_GRAVITY = ("point_mass", "double_integrator")
"""Dynamics whose accelerations are bounded by a share of gravity"""
UPRIGHT, STILL = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
"""Quaternion of a level body that heads east, and no motion"""
LEVELS = {one.name.lower(): one for one in SetpointLevel}
"""Setpoint levels by name"""
YAW = 3
"""Column of a setpoint"""
EVERY = slice(None)
FLOAT = np.dtype(np.float64)
PLAIN = frozenset((float, int))
"""Types of numbers that need no closer look"""
OF_TASKS = (
    "num_drones",
    "action",
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
)
"""Options that only tasks have a use for"""


def airspace_options(
    position: Any, airframe: Any, sensors: Any, given: Mapping[str, Any]
) -> tuple[EnvOptions, dict[str, Sensor]]:
    """Check the options of an airspace.

    Args:
        position: (N, 3) where drones start; tells how many there are.
        airframe: One, or one for each drone.
        sensors: Names of sensors, or objects.
        given: Other options by name.

    Returns:
        The options, and the sensors that drones carry, by name.

    Raises:
        UnknownOptionError: There is no such option.
        ValueError: A value cannot be.
    """
    # Options that only tasks have are unknown here
    known = {field.name for field in dataclasses.fields(EnvOptions)}.difference(OF_TASKS)
    for name in given:
        if name not in known:
            raise UnknownOptionError(
                f"unknown option of Airspace: {name!r}: {suggest_names(name, known)}"
            )
    # Positions tell how many drones there are
    places = numbers_of("position is", position)
    if places.ndim != 2 or places.shape[1] != 3 or not len(places):
        raise ValueError(
            f"position is {shown(position)}: a row x, y, z for each drone is needed, such as "
            f"[(0.0, 0.0, 1.0)]"
        )
    # Usual values follow from the airframes
    values = dict(given)
    make_tuples(values)
    values["airframe"] = airframes_of(airframe, len(places))
    values.setdefault("max_speed", min(one.max_speed for one in values["airframe"]))
    listed = sensors if isinstance(sensors, list | tuple) else (sensors,)
    all_sensors = known_sensors(one for one in listed if not isinstance(one, str))
    values["randomization"] = Randomization(
        values.get("randomization"), known_uncertainties(all_sensors)
    )
    # Setpoints come from `command`; rotor speeds are what every option allows.
    values |= {"num_drones": len(places), "action": "rotor", "horizon": 1, "sensors": listed}
    options = EnvOptions(**values)
    # What is possible in tasks alone
    if options.render_mode in VIEWERS:
        raise ValueError(
            f"render_mode is {options.render_mode!r}: live views show tasks; use 'human' or "
            f"'rgb_array'"
        )
    if options.gravity == 0 and options.dynamics_name in NEED_GRAVITY:
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
    """Raise ValueError unless these are obstacles, and a layout or None."""
    if not isinstance(obstacles, list | tuple) or not all(
        isinstance(one, Obstacle) for one in obstacles
    ):
        raise ValueError(f"obstacles is {shown(obstacles)}: a list of `Obstacle` is needed")
    if layout is not None and not isinstance(layout, Solids):
        raise ValueError(f"layout is {shown(layout)}: `Solids`, such as those of a city, is needed")


def rows_of(drones: Drones, count: int) -> tuple[Any, tuple[int, ...]]:
    """Find which drones are meant.

    Args:
        drones: See `Drones`.
        count: How many there are.

    Returns:
        What picks them from arrays (N, ...), an index for one drone, else an array or slice; and
        the shape that it picks, () for one drone, else (M,).

    Raises:
        ValueError: There is no such drone.
    """
    # The usual forms first, without making arrays
    if type(drones) is int and 0 <= drones < count:
        return drones, ()
    if drones is None:
        return EVERY, (count,)
    try:
        rows = np.asarray(drones)
    except ValueError:  # rows of several lengths
        rows = np.zeros(1)
    # An empty list is no drone, though NumPy takes it for numbers that are not whole
    if rows.shape == (0,):
        return np.zeros(0, dtype=int), (0,)
    if rows.dtype == bool and rows.shape == (count,):
        return np.flatnonzero(rows), (int(rows.sum()),)
    # Twice the same drone would have two values
    whole = rows.dtype.kind in "iu" and rows.ndim <= 1
    if not whole or ((rows < 0) | (rows >= count)).any() or rows.size != np.unique(rows).size:
        raise ValueError(
            f"drones is {shown(drones)}: an index from 0 to {count - 1}, several different ones, "
            f"a mask of {count}, or None for all is needed"
        )
    return (rows, rows.shape) if rows.ndim else (int(rows), ())


def numbers(name: str, value: Any) -> np.ndarray:
    """Take finite numbers of any shape.

    Args:
        name: What they are, for the message.
        value: What was given.

    Returns:
        A float64 array.

    Raises:
        ValueError: They are no numbers, not finite, or too large.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:
        array = value
    elif type(value) is tuple and PLAIN.issuperset(map(type, value)):
        array = np.array(value, dtype=np.float64)
    else:
        array = numbers_of(f"{name} is", value)
    flat = array.ravel()
    # A sum of squares finds what is not finite, too
    if not flat.dot(flat) <= MOST**2:
        raise ValueError(f"{name} is {shown(value)}: finite numbers up to {MOST:g} are needed")
    return array


def filled(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Take finite numbers that fill a shape, given whole or once for all drones.

    Args:
        name: What they are, for the message.
        value: What was given.
        shape: What is needed.

    Returns:
        A float64 array that broadcasts to the shape.

    Raises:
        ValueError: They have another shape, or are no finite numbers.
    """
    array = numbers(name, value)
    if array.shape != shape and array.shape != shape[-1:]:
        raise ValueError(f"{name} has shape {array.shape}: {shape} is needed")
    return array


def angles(name: str, value: Any, count: tuple[int, ...]) -> np.ndarray | float:
    """Take an angle or its rate, or one for each of the drones (M,).

    Raises:
        ValueError: They are no finite numbers up to `MOST_TURN`, or not as many.
    """
    if np.ndim(value) == 0:
        one = value[()] if isinstance(value, np.ndarray) else value
        return finite(name, one, -MOST_TURN, MOST_TURN)
    several = numbers(name, value)
    if several.shape != count or np.abs(several).max(initial=0.0) > MOST_TURN:
        raise ValueError(
            f"{name} is {shown(value)}: a number up to {MOST_TURN:g}, or one for each of the "
            f"drones, is needed"
        )
    return several


def state_numbers(
    most: np.ndarray, position: Any, quaternion: Any, velocity: Any, rates: Any, rotor_speed: Any
) -> tuple[np.ndarray, ...]:
    """Take a state that drones are to have.

    Args:
        most: (M, R) the highest speed of each rotor, rad/s; (R,) for one drone.
        position: (M, 3) m, or (3,) for one drone.
        quaternion: (M, 4), or (4,) for all.
        velocity: (M, 3), or (3,) for all, m/s.
        rates: The same, rad/s.
        rotor_speed: (M, R), (R,) for all, or one for all rotors, rad/s.

    Returns:
        The five as arrays.

    Raises:
        ValueError: A number cannot be; nothing has changed.
    """
    # One place for several drones would put them into each other
    count = most.shape[:-1]
    place = filled("position", position, (*count, 3))
    if place.ndim < len(count) + 1 and count != (1,):
        raise ValueError(f"position has shape {place.shape}: {(*count, 3)} is needed")
    # A quaternion of another length is a mistake, such as w first
    turn = filled("quaternion", quaternion, (*count, 4))
    norms = np.sqrt((turn * turn).sum(axis=-1))
    if (np.abs(norms - 1) > UNIT).any():
        raise ValueError(
            f"quaternion is {shown(quaternion)}: a length of 1 is needed, divide by its norm"
        )
    # Beyond it are other worlds' tiles, or what is parked
    half = TILE_PITCH / 2
    if (np.abs(place[..., :2]) >= half).any() or (np.abs(place[..., 2]) >= PARKING_HEIGHT).any():
        raise ValueError(
            f"position is {shown(position)}: less than {half:g} m aside and {PARKING_HEIGHT:g} m "
            f"up is needed"
        )
    # One number is for all rotors that the airframe has
    if np.ndim(rotor_speed) == 0:
        rotor_speed = np.where(most > 0, finite("rotor_speed", rotor_speed), 0.0)
    speed = filled("rotor_speed", rotor_speed, most.shape)
    if (speed < 0).any() or (speed > most * (1 + UNIT)).any():
        raise ValueError(
            f"rotor_speed is {shown(rotor_speed)}: from 0 to the {most.max():g} rad/s of the "
            f"airframe is needed"
        )
    # Half of the speed at which flights count as diverged
    moving = (filled("velocity", velocity, (*count, 3)), filled("rates", rates, (*count, 3)))
    for name, array, most_of in zip(("velocity", "rates"), moving, FASTEST_OF, strict=True):
        if np.abs(array).max(initial=0.0) >= most_of / 2:
            raise ValueError(f"{name} is {shown(array)}: less than {most_of / 2:g} is needed")
    return place, turn, *moving, speed


def level_of(level: Any, consumes: SetpointLevel, options: EnvOptions) -> SetpointLevel:
    """Take a setpoint level, or its name, that drones can be told.

    Args:
        level: What was given.
        consumes: What the dynamics consumes.
        options: Options of the airspace.

    Returns:
        The level.

    Raises:
        ValueError: There is no such level, or it cannot drive the dynamics.
    """
    if isinstance(level, SetpointLevel):
        chosen = level
    elif isinstance(level, np.integer) and level in LEVELS.values():  # as `levels` tells it
        chosen = SetpointLevel(int(level))
    else:
        chosen = find_choice(
            "setpoint level", level.lower() if isinstance(level, str) else level, LEVELS
        )
    # Nothing leads up: a dynamics of points has no attitude to command
    if chosen > consumes:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints: "
            f"command that level or one above it, not {chosen.name}; or use 'rigid_body', 'bullet'"
        )
    # Own dynamics may consume levels that no controller gives
    if chosen != consumes and consumes not in CONVERTED:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints, "
            f"to which no controller leads: command {consumes.name}"
        )
    # Controllers of rotors tilt thrust against the weight
    if chosen < consumes == SetpointLevel.ROTOR:
        if options.gravity == 0:
            raise ValueError(
                f"setpoints of {chosen.name} need gravity, against which thrust is steered: "
                f"without it command ROTOR"
            )
        options.check_controller(chosen)
    return chosen


def usual_widths(
    consumes: SetpointLevel, options: EnvOptions, rotors: int
) -> dict[SetpointLevel, int]:
    """Tell the levels that drones can be told with no more ado, and how many numbers each has.

    Args:
        consumes: What the dynamics consumes.
        options: Options of the airspace.
        rotors: How many rotors setpoints are for.
    """
    widths = {}
    for level in SetpointLevel:
        with contextlib.suppress(ValueError):
            widths[level_of(level, consumes, options)] = YAW + 1
    if SetpointLevel.ROTOR in widths:
        widths[SetpointLevel.ROTOR] = rotors
    if options.controller == "pid":  # what it has summed up is to be forgotten
        widths.pop(SetpointLevel.ROTOR, None)
    return widths


def hold_plainly(
    levels: np.ndarray,
    setpoint: np.ndarray,
    told: np.ndarray,
    drones: Any,
    level: SetpointLevel,
    width: int,
    numbers: Any,
) -> bool:
    """Let drones hold a setpoint, if it is as usual: one or all, floats as they lie in memory.

    Args:
        levels: (1, N) that drones hold, written.
        setpoint: (1, N, S) that they hold, written.
        told: (1, N) bool, whether they were told any, written.
        drones: What was given.
        level: One of `usual_widths`.
        width: How many numbers it has; drones that hold a yaw already need not be told one.
        numbers: What was given.

    Returns:
        Whether it was done. Here nothing is, and all is left to the closer look that follows.
    """
    return False


hold = in_c(hold_plainly)


def setpoint_numbers(
    level: SetpointLevel, setpoint: Any, count: tuple[int, ...], rotors: int, speaks: bool
) -> np.ndarray:
    """Take the numbers of a setpoint.

    Args:
        level: Its level.
        setpoint: What was given.
        count: (M,) for M drones, () for one.
        rotors: How many rotors setpoints are for, R.
        speaks: Whether a yaw or its rate is told beside it.

    Returns:
        Numbers that broadcast to (M, numbers of the level); without the yaw where it is left out.

    Raises:
        ValueError: They cannot be.
    """
    array, width = numbers("setpoint", setpoint), rotors
    # Three numbers and a yaw, which may be left out or told beside it
    if level < SetpointLevel.ROTOR:
        width = YAW + 1
        if level < SetpointLevel.ATTITUDE:
            width -= speaks or array.shape[-1:] == (YAW,)
        elif speaks:
            raise ValueError(
                f"yaw and yaw_rate go with POSITION, VELOCITY and ACCELERATION, not {level.name}"
            )
    # One setpoint for all, or one for each
    if array.shape != (width,) and array.shape != (*count, width):
        twice = "; the yaw is told beside it" if speaks else ""
        raise ValueError(
            f"setpoint of {level.name} has shape {array.shape}: {(*count, width)} is needed{twice}"
        )
    return array
