"""Offboard setpoints: decoding of position, velocity, acceleration and attitude targets."""

import math

from bulletuav.bridges.mavlink_coordinates import Site, check_global_frame
from bulletuav.bridges.mavlink_protocol import Message, RefusedError
from bulletuav.bridges.mavlink_wings import forward_thrust
from bulletuav.bridges.setpoints import AirspaceCommand, Setpoint, State, euler
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.earth import attitude_to_enu
from bulletuav.vehicle.airframe import Airframe

LOCAL_NED, BODY_NED = 1, 8
"""MAV_FRAME of local setpoints: NED from the start, and velocities relative to the heading"""
IGNORE_XY, IGNORE_Z = 0b11, 0b100
IGNORE_VXY, IGNORE_VZ = 0b11 << 3, 0b100 << 3
IGNORE_ACCELERATION = 0b111 << 6
FORCE_SET, IGNORE_YAW, IGNORE_YAW_RATE = 1 << 9, 1 << 10, 1 << 11
"""Bits of the type mask of position targets (POSITION_TARGET_TYPEMASK)"""
IGNORE_RATES, IGNORE_THRUST, IGNORE_ATTITUDE = 0b111, 1 << 6, 1 << 7
"""Bits of the type mask of attitude targets (ATTITUDE_TARGET_TYPEMASK)"""
MAX_SPEED, MAX_ACCELERATION, MAX_RATE = 100.0, 100.0, 20.0
"""Limits of velocity (m/s), acceleration (m/s^2) and angular rate (rad/s)"""
MAX_TILT = math.radians(60)
"""Limit of roll and pitch, rad"""


def parse_local_target(message: Message, site: Site, state: State) -> Setpoint | AirspaceCommand:
    """Convert a SET_POSITION_TARGET_LOCAL_NED into a setpoint.

    In the frame BODY_NED velocities are forward, right and down, and positions are ignored.
    Velocities, accelerations and rates are clipped to `MAX_SPEED`, `MAX_ACCELERATION` and
    `MAX_RATE`.

    Args:
        message: The message.
        site: Start position of the vehicle.
        state: State of the vehicle.

    Returns:
        The setpoint, or a flight command for an acceleration.

    Raises:
        RefusedError: If the frame or the type mask is not supported, a number is not finite, or the
            position is farther away than `mavlink_coordinates.MAX_DISTANCE`.
    """
    frame = message.coordinate_frame
    if frame not in (LOCAL_NED, BODY_NED):
        raise RefusedError(f"setpoint in frame {frame}: 1 or 8 is needed")
    mask = message.type_mask | (IGNORE_XY | IGNORE_Z if frame == BODY_NED else 0)
    used = [0.0 if mask & 1 << k else getattr(message, name) for k, name in enumerate("xyz")]
    return _make_setpoint(message, mask, site.from_ned(*used), state, frame == BODY_NED)


def parse_global_target(message: Message, site: Site, state: State) -> Setpoint | AirspaceCommand:
    """Convert a SET_POSITION_TARGET_GLOBAL_INT into a setpoint; see `parse_local_target`.

    Velocities and accelerations are north, east and down in all frames of this message.

    Raises:
        RefusedError: If the frame or the type mask is not supported, a number is not finite, or the
            position is farther away than `mavlink_coordinates.MAX_DISTANCE`.
    """
    check_global_frame(message.coordinate_frame)
    mask, position = message.type_mask, (0.0, 0.0, 0.0)
    if mask & (IGNORE_XY | IGNORE_Z) != IGNORE_XY | IGNORE_Z:
        geodetic = (message.lat_int / 1e7, message.lon_int / 1e7, message.alt)
        position = site.from_global(message.coordinate_frame, *geodetic)
    return _make_setpoint(message, mask, position, state, False)


def _make_setpoint(
    message: Message,
    mask: int,
    position: tuple[float, float, float],
    state: State,
    is_body_frame: bool,
) -> Setpoint | AirspaceCommand:
    """Combine the fields that the type mask selects: position, velocity, acceleration and yaw.

    Args:
        message: The message.
        mask: Type mask; set bits mark ignored fields.
        position: Position in the airspace, m.
        state: State of the vehicle.
        is_body_frame: Whether velocities are relative to the heading: forward, right, down.
    """
    if mask & FORCE_SET and mask & IGNORE_ACCELERATION != IGNORE_ACCELERATION:
        raise RefusedError("setpoint: forces are not supported")
    velocity = _read_enu_vector(message, "v", mask >> 3, MAX_SPEED)
    turning, yaw = _read_yaw(message, mask)
    has_position, has_velocity = not mask & IGNORE_XY, not mask & IGNORE_VXY
    has_height, climbs = not mask & IGNORE_Z, not mask & IGNORE_VZ
    if has_position and has_height:
        ahead: tuple[float, ...] = ()
        if has_velocity and climbs:
            ahead = (*velocity, *_read_enu_vector(message, "af", mask >> 6, MAX_ACCELERATION))
        return Setpoint("position", position[:2], "position", position[2], turning, yaw, ahead)
    if has_velocity and (has_height or climbs):
        # From forward, right to forward, left
        xy = (velocity[1], -velocity[0]) if is_body_frame else velocity[:2]
        upward, z = ("position", position[2]) if has_height else ("velocity", velocity[2])
        xy_mode = "body" if is_body_frame else "velocity"
        return Setpoint(xy_mode, (xy[0], xy[1]), upward, z, turning, yaw)
    if not mask & IGNORE_ACCELERATION and not is_body_frame:
        acceleration = _read_enu_vector(message, "af", mask >> 6, MAX_ACCELERATION)
        held_yaw = yaw if turning == "angle" else euler(state[1])[2]
        return AirspaceCommand(SetpointLevel.ACCELERATION, (*acceleration, held_yaw))
    raise RefusedError(f"setpoint with mask {message.type_mask:#x} unsupported")


def _read_enu_vector(
    message: Message, prefix: str, ignored: int, limit: float
) -> tuple[float, ...]:
    """Read a NED vector and return it as east, north, up.

    Args:
        message: The message.
        prefix: Prefix of the names of the components.
        ignored: Bits 0 to 2 mark the components x, y and z as ignored: they are 0.
        limit: Limit of the absolute value of each component.
    """
    north, east, down = (
        0.0 if ignored & 1 << k else _clamp_finite(getattr(message, prefix + axis), limit)
        for k, axis in enumerate("xyz")
    )
    return east, north, -down


def _clamp_finite(value: float, limit: float) -> float:
    """Clip a number to [-limit, limit]; raise RefusedError if it is not finite."""
    if not math.isfinite(value):
        raise RefusedError("setpoint: finite numbers are needed")
    return min(max(value, -limit), limit)


def _read_yaw(message: Message, mask: int) -> tuple[str, float]:
    """Read the yaw or the yaw rate.

    Returns:
        ("angle", yaw from east to north, rad), or ("rate", yaw rate to the left, rad/s). Without
        both the rate is 0, so that the present yaw is held.
    """
    if not mask & IGNORE_YAW:
        return "angle", math.remainder(math.pi / 2 - _clamp_finite(message.yaw, 1e3), math.tau)
    if not mask & IGNORE_YAW_RATE:
        return "rate", -_clamp_finite(message.yaw_rate, MAX_RATE)
    return "rate", 0.0


def parse_attitude_target(message: Message, airframe: Airframe) -> Setpoint:
    """Convert a SET_ATTITUDE_TARGET, whose thrust is a fraction of the maximum thrust.

    That is the thrust of the forward rotors for an aircraft that cannot hover.

    Angular rates count only if the attitude is ignored. Roll and pitch are limited to `MAX_TILT`,
    rates to `MAX_RATE`.

    Args:
        message: The message.
        airframe: Airframe of the vehicle.

    Returns:
        The setpoint.

    Raises:
        RefusedError: If the thrust, or the attitude and all rates, are ignored, the quaternion is
            zero, or a number is not finite.
    """
    # Set bits of the mask mark ignored fields
    mask = message.type_mask
    if mask & IGNORE_THRUST:
        raise RefusedError("attitude setpoint: a thrust is needed")
    full = airframe.max_thrust if airframe.can_hover else forward_thrust(airframe)
    thrust = min(max(_clamp_finite(message.thrust, 1.0), 0.0), 1.0) * full
    rates = [
        0.0 if mask & 1 << k else _clamp_finite(getattr(message, f"body_{axis}_rate"), MAX_RATE)
        for k, axis in enumerate(("roll", "pitch", "yaw"))
    ]
    # Rates without an attitude; from forward, right, down (FRD) to forward, left, up (FLU)
    if mask & IGNORE_ATTITUDE:
        if mask & IGNORE_RATES == IGNORE_RATES:
            raise RefusedError("attitude setpoint: an attitude or rates are needed")
        return Setpoint("rates", (rates[0], -rates[1]), "thrust", thrust, "rate", -rates[2])
    # Normalise, as clients' quaternions have a norm near 1; convert from FRD to NED
    norm = math.sqrt(sum(_clamp_finite(value, 1e3) ** 2 for value in message.q))
    if norm < 1e-3:
        raise RefusedError("attitude setpoint: the quaternion has norm 0")
    w, x, y, z = (value / norm for value in message.q)
    roll, pitch, yaw = euler(attitude_to_enu((x, y, z, w)).tolist())
    # Limit the tilt
    tilt = [min(max(angle, -MAX_TILT), MAX_TILT) for angle in (roll, pitch)]
    return Setpoint("attitude", (tilt[0], tilt[1]), "thrust", thrust, "angle", yaw)
