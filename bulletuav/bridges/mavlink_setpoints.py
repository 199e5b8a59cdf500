"""Offboard setpoints: positions, velocities, accelerations and attitudes as clients send them."""

import math

from bulletuav.bridges.mavlink_places import Site
from bulletuav.bridges.mavlink_wire import Message, RefusedError
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, State, euler
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.earth import attitude_to_enu
from bulletuav.vehicle.airframe import Airframe

LOCAL, BODY = 1, 8
"""Frames of local setpoints: north-east-down of the start; velocities turned by the yaw"""
PLACE_XY, PLACE_Z = 0b11, 0b100
VELOCITY_XY, VELOCITY_Z = 0b11 << 3, 0b100 << 3
ACCELERATION = 0b111 << 6
IS_FORCE, NO_YAW, NO_YAW_RATE = 1 << 9, 1 << 10, 1 << 11
"""Bits of a mask of what is to be ignored"""
NO_RATES, NO_THRUST, NO_ATTITUDE = 0b111, 1 << 6, 1 << 7
"""The same for attitudes"""
FASTEST, MOST_ACCELERATION, QUICKEST = 100.0, 100.0, 20.0
"""Greatest velocity (m/s), acceleration (m/s^2) and rate (rad/s) that are taken"""
STEEPEST = math.radians(60)
"""Greatest roll and pitch, rad"""


def of_local(
    message: Message,
    site: Site,
    state: State,
) -> Setpoint | AirspaceCommand:
    """Read a SET_POSITION_TARGET_LOCAL_NED.

    Args:
        message: The message.
        site: Where the vehicle's coordinates begin.
        state: Its state.

    Returns:
        What the drone is to do.

    Raises:
        RefusedError: The frame or the mask is not supported, or a number cannot be.
    """
    frame = message.coordinate_frame
    if frame not in (LOCAL, BODY):
        raise RefusedError(f"setpoint in frame {frame}: 1 or 8 is needed")
    mask = message.type_mask | (PLACE_XY | PLACE_Z if frame == BODY else 0)
    used = [0.0 if mask & 1 << k else getattr(message, name) for k, name in enumerate("xyz")]
    return _moving(message, mask, site.of_ned(*used), state, "body" if frame == BODY else "")


def of_global(
    message: Message,
    site: Site,
    state: State,
) -> Setpoint | AirspaceCommand:
    """Read a SET_POSITION_TARGET_GLOBAL_INT; see `of_local`.

    Raises:
        RefusedError: The frame or the mask is not supported, or a number cannot be.
    """
    mask, place = message.type_mask, (0.0, 0.0, 0.0)
    if mask & (PLACE_XY | PLACE_Z) != PLACE_XY | PLACE_Z:
        spot = (message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
        place = site.of_global(message.coordinate_frame, *spot)
    return _moving(message, mask, place, state, "")


def _moving(
    message: Message,
    mask: int,
    place: tuple[float, float, float],
    state: State,
    body: str,
) -> Setpoint | AirspaceCommand:
    """Join what a message tells of place, velocity, acceleration and yaw."""
    if mask & IS_FORCE and mask & ACCELERATION != ACCELERATION:
        raise RefusedError("setpoint: forces are not supported")
    velocity = _vector(message, "v", mask >> 3, FASTEST)
    turning, yaw = _turning(message, mask)
    has_place, has_velocity = not mask & PLACE_XY, not mask & VELOCITY_XY
    has_height, climbs = not mask & PLACE_Z, not mask & VELOCITY_Z
    if has_place and has_height:
        ahead: tuple[float, ...] = ()
        if has_velocity and climbs:
            ahead = (*velocity, *_vector(message, "af", mask >> 6, MOST_ACCELERATION))
        return Setpoint("position", place[:2], "position", place[2], turning, yaw, ahead)
    if has_velocity and (has_height or climbs):
        # Forward, right of the body into forward, left.
        xy = (velocity[1], -velocity[0]) if body else velocity[:2]
        upward, z = ("position", place[2]) if has_height else ("velocity", velocity[2])
        return Setpoint(body or "velocity", (xy[0], xy[1]), upward, z, turning, yaw)
    if not mask & ACCELERATION and not body:
        push = _vector(message, "af", mask >> 6, MOST_ACCELERATION)
        held = yaw if turning == "angle" else euler(state[1])[2]
        return AirspaceCommand(SetpointLevel.ACCELERATION, (*push, held))
    raise RefusedError(f"setpoint with mask {message.type_mask:#x} unsupported")


def _vector(
    message: Message,
    prefix: str,
    ignored: int,
    most: float,
) -> tuple[float, ...]:
    """Read a vector north, east, down as one east, north, up; what is ignored is 0."""
    north, east, down = (
        0.0 if ignored & 1 << k else _number(getattr(message, prefix + axis), most)
        for k, axis in enumerate("xyz")
    )
    return east, north, -down


def _number(value: float, most: float) -> float:
    """Check that a number is finite, and cut it."""
    if not math.isfinite(value):
        raise RefusedError("setpoint: finite numbers are needed")
    return min(max(value, -most), most)


def _turning(message: Message, mask: int) -> tuple[str, float]:
    """Read the yaw, or its rate; without both the yaw is held."""
    if not mask & NO_YAW:
        return "angle", math.remainder(math.pi / 2 - _number(message.yaw, 1e3), math.tau)
    if not mask & NO_YAW_RATE:
        return "rate", -_number(message.yaw_rate, QUICKEST)
    return "rate", 0.0


def of_attitude(message: Message, airframe: Airframe) -> Setpoint:
    """Read a SET_ATTITUDE_TARGET; thrust is a share of the greatest.

    Args:
        message: The message.
        airframe: Of the vehicle.

    Returns:
        What the drone is to do.

    Raises:
        RefusedError: The mask is not supported, or a number cannot be.
    """
    # Bits of the mask name what to leave out
    mask = message.type_mask
    if mask & NO_THRUST:
        raise RefusedError("attitude setpoint: a thrust is needed")
    thrust = min(max(_number(message.thrust, 1.0), 0.0), 1.0) * airframe.max_thrust
    rates = [
        0.0 if mask & 1 << k else _number(getattr(message, f"body_{axis}_rate"), QUICKEST)
        for k, axis in enumerate(("roll", "pitch", "yaw"))
    ]
    # Rates alone; from forward, right, down to forward, left, up
    if mask & NO_ATTITUDE:
        if mask & NO_RATES == NO_RATES:
            raise RefusedError("attitude setpoint: an attitude or rates are needed")
        return Setpoint("rates", (rates[0], -rates[1]), "thrust", thrust, "rate", -rates[2])
    # Clients' quaternions have lengths near 1; the attitude is from north, east, down
    size = math.sqrt(sum(_number(one, 1e3) ** 2 for one in message.q))
    if size < 1e-3:
        raise RefusedError("attitude setpoint: the quaternion has no length")
    w, x, y, z = (one / size for one in message.q)
    roll, pitch, yaw = euler(attitude_to_enu((x, y, z, w)).tolist())
    # Tilt stays within what a client may ask for
    lean = [min(max(one, -STEEPEST), STEEPEST) for one in (roll, pitch)]
    return Setpoint("attitude", (lean[0], lean[1]), "thrust", thrust, "angle", yaw)
