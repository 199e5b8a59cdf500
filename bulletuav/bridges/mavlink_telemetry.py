"""Telemetry of a MAVLink vehicle: message contents and stream rates."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_protocol import CommandResult, Mode, OutgoingMessage, RefusedError
from bulletuav.bridges.mavlink_sensors import compute_field, measure
from bulletuav.bridges.mavlink_vehicle import MavlinkVehicle
from bulletuav.bridges.setpoints import euler

STEP_HZ = 100
"""Steps per second, and maximum rate of a stream"""
FIXED_WING, QUADROTOR, VTOL_FIXED_ROTOR, PX4 = 1, 2, 22, 12
"""MAV_TYPE of the vehicle, and MAV_AUTOPILOT"""
STANDBY, ACTIVE = 3, 4
HEALTH = 0b1 | 0b10 | 0b100 | 0b1000 | 0b100000 | 1 << 21 | 1 << 25 | 1 << 28
"""Bits of SYS_STATUS: gyroscope, accelerometer, magnetometer, barometer, GPS, attitude, battery and
pre-arm check are present, enabled and healthy"""
GPS_HEALTH, BATTERY_HEALTH, PRE_ARM_HEALTH = 0b100000, 1 << 25, 1 << 28
NO_FIX, FIX_3D = 0, 3
"""Fix types of a GPS receiver (GPS_FIX_TYPE)"""
CHARGE_OK, CHARGE_FAILED = 1, 5
"""Charge states of a battery (MAV_BATTERY_CHARGE_STATE)"""
EMPTY_VOLTAGE = 12.0
"""Voltage of an empty battery, V"""
ALL_FIELDS = 0b1111111111111
"""Bits of HIGHRES_IMU: all values are new"""
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""Landed states (MAV_LANDED_STATE)"""
NO_MISSION, NOT_STARTED, RUNNING, PAUSED, COMPLETE = 1, 2, 3, 4, 5
"""Mission states (MISSION_STATE)"""
CAPABILITIES = sum(1 << bit for bit in (2, 3, 4, 6, 7, 8, 11, 13, 14, 15))
"""Capabilities (MAV_PROTOCOL_CAPABILITY): MISSION_INT, COMMAND_INT, bytewise parameters, targets of
attitude and of local and global positions, termination, MAVLink 2, geofence, rally points"""
VERSION = 1 << 24 | 14 << 16 | 3 << 8 | 255
"""Firmware version PX4 1.14.3, as clients require a minimum version"""
UINT16_UNKNOWN = 2**16 - 1
FULL_VOLTAGE = 16.2
"""Battery voltage, V"""


def _heartbeat(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    pilot = vehicle.pilot
    # Base mode: custom, stabilised, armed; guided and automatic except in mode OFFBOARD
    base = 1 | 16 | (0 if pilot.mode == Mode.OFFBOARD else 8 | 4) | (128 if pilot.is_armed else 0)
    return (
        vehicle_type(vehicle),
        PX4,
        base,
        int(pilot.mode),
        ACTIVE if pilot.is_armed else STANDBY,
        3,
    )


def vehicle_type(vehicle: MavlinkVehicle) -> int:
    """Return the MAV_TYPE of a vehicle."""
    if vehicle.wings is None:
        return QUADROTOR
    return VTOL_FIXED_ROTOR if vehicle.wings.can_hover else FIXED_WING


def _sys_status(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    failures, health = vehicle.pilot.failures, HEALTH
    if not failures.has_gps:
        health &= ~(GPS_HEALTH | PRE_ARM_HEALTH)
    if failures.is_battery_empty:
        health &= ~BATTERY_HEALTH
    voltage, percent = _battery_level(vehicle)
    return (HEALTH, HEALTH, health, 100, round(voltage * 1000), -1, percent, *[0] * 6)


def _battery_level(vehicle: MavlinkVehicle) -> tuple[float, int]:
    """Return voltage, V, and charge, percent."""
    return (EMPTY_VOLTAGE, 0) if vehicle.pilot.failures.is_battery_empty else (FULL_VOLTAGE, 100)


def _system_time(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    """Return SYSTEM_TIME, with the time since the start in place of the UNIX time."""
    return vehicle.time_boot_ms * 1000, vehicle.time_boot_ms


def _gps(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    """Return GPS_RAW_INT, with exact values; without a position if the receiver has failed."""
    if not vehicle.pilot.failures.has_gps:
        unknown = [UINT16_UNKNOWN] * 4
        return (vehicle.time_boot_ms * 1000, NO_FIX, 0, 0, 0, *unknown, 0, 0, 0, 0, 0, 0)
    latitude, longitude, altitude = _scaled_position(vehicle)
    north, east, _ = _velocity(vehicle)
    speed = math.hypot(north, east)
    course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
    flat = (30, 50, min(round(speed * 100), UINT16_UNKNOWN - 1), course, 16)
    exact = (altitude, 100, 100, 10, 0, 0)
    return (vehicle.time_boot_ms * 1000, FIX_3D, latitude, longitude, altitude, *flat, *exact)


def _attitude(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    roll, pitch, yaw = euler(vehicle.pilot.state[1])
    yaw_ned = math.remainder(math.pi / 2 - yaw, math.tau)
    return (vehicle.time_boot_ms, roll, -pitch, yaw_ned, *_rates(vehicle))


def _attitude_quaternion(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return (vehicle.time_boot_ms, *_quaternion(vehicle), *_rates(vehicle))


def _local_position(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return vehicle.time_boot_ms, *vehicle.site.to_ned(vehicle.pilot.state[0]), *_velocity(vehicle)


def _global_position(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    latitude, longitude, altitude = _scaled_position(vehicle)
    above = altitude - round(vehicle.site.altitude * 1000)
    speeds = [_clamp_int16(speed * 100) for speed in _velocity(vehicle)]
    return (
        vehicle.time_boot_ms,
        latitude,
        longitude,
        altitude,
        above,
        *speeds,
        _heading(vehicle) * 100,
    )


def _home(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    still = ([1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, vehicle.time_boot_ms * 1000)
    return (*_scale_geodetic(vehicle.site.home), 0.0, 0.0, 0.0, *still)


def _origin(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return (*_scale_geodetic(vehicle.site.home), vehicle.time_boot_ms * 1000)


def _extended(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    pilot = vehicle.pilot
    flying = {Mode.TAKEOFF: TAKING_OFF, Mode.LAND: LANDING}.get(pilot.mode, IN_AIR)
    return pilot.vtol_state, ON_GROUND if pilot.has_landed else flying


def _hud(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    north, east, down = _velocity(vehicle)
    speed, altitude = math.hypot(north, east), _scaled_position(vehicle)[2] / 1000
    wings = vehicle.wings
    air = speed if wings is None else wings.airspeed(vehicle.pilot.state)
    throttle = 0 if wings is None else round(100 * vehicle.throttle)
    return air, speed, _heading(vehicle), throttle, altitude, -down


def _altitude(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    altitude, above = (
        _scaled_position(vehicle)[2] / 1000,
        -vehicle.site.to_ned(vehicle.pilot.state[0])[2],
    )
    return vehicle.time_boot_ms * 1000, altitude, altitude, above, above, math.nan, math.nan


def _battery(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    """Return BATTERY_STATUS of a full or an empty battery."""
    voltage, percent = _battery_level(vehicle)
    cells = [round(voltage * 1000 / 4)] * 4 + [UINT16_UNKNOWN] * 6
    state = CHARGE_OK if percent else CHARGE_FAILED
    return 0, 1, 1, 2**15 - 1, cells, -1, -1, -1, percent, 0, state


def _highres_imu(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    """Return HIGHRES_IMU, without noise."""
    _, quaternion, _, rates = vehicle.pilot.state
    field, altitude = compute_field(vehicle.site.home), vehicle.locate()[2]
    motion = np.array([quaternion]), np.array([rates]), np.array([vehicle.acceleration])
    (values,) = measure(*motion, field, np.array([altitude])).tolist()
    return (vehicle.time_boot_ms * 1000, *values, ALL_FIELDS)


def _mission(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    pilot, route = vehicle.pilot, vehicle.pilot.route
    total = len(route.items)
    if total == 0:
        state = NO_MISSION
    elif pilot.mode == Mode.MISSION and pilot.is_armed:
        state = RUNNING
    elif route.is_over:
        state = COMPLETE
    else:
        state = PAUSED if route.current else NOT_STARTED
    return min(route.current, max(total - 1, 0)), total, state


def _odometry(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    """Return ODOMETRY: position in the local frame, velocities in the body frame."""
    x, y, z, w = vehicle.pilot.state[1]
    u, v, s = vehicle.pilot.state[2]
    # Rotate the velocity into body axes by the conjugate quaternion
    tx, ty, tz = 2 * (z * v - y * s), 2 * (x * s - z * u), 2 * (y * u - x * v)
    forward = u + w * tx - (y * tz - z * ty)
    left = v + w * ty - (z * tx - x * tz)
    up = s + w * tz - (x * ty - y * tx)
    unknown = [math.nan, *[0.0] * 20]
    position = vehicle.site.to_ned(vehicle.pilot.state[0])
    kinematics = (*position, list(_quaternion(vehicle)), forward, -left, -up, *_rates(vehicle))
    return (vehicle.time_boot_ms * 1000, 1, 12, *kinematics, unknown, unknown)


def _gimbal_manager(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return vehicle.gimbal.manager_information(vehicle.time_boot_ms)


def _gimbal_status(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return vehicle.gimbal.manager_status(vehicle.time_boot_ms)


def _gimbal_device(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return vehicle.gimbal.device_information(vehicle.time_boot_ms)


def _gimbal_attitude(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    return vehicle.gimbal.attitude_status(vehicle.time_boot_ms, vehicle.pilot.state)


def _autopilot_version(vehicle: MavlinkVehicle) -> tuple[Any, ...]:
    none = [0] * 8
    return CAPABILITIES, VERSION, 0, 0, 0, none, none, none, 0, 0, vehicle.system_id


class TelemetryStream(NamedTuple):
    """Message that a vehicle can send.

    Attributes:
        name: Message name in lower case.
        hz: Default rate, Hz; 0 for on request only.
        fields: Function that returns the values of the fields.
    """

    name: str
    hz: float
    fields: Callable[[MavlinkVehicle], tuple[Any, ...]]


STREAMS: Mapping[int, TelemetryStream] = {
    0: TelemetryStream("heartbeat", 1, _heartbeat),
    1: TelemetryStream("sys_status", 1, _sys_status),
    2: TelemetryStream("system_time", 1, _system_time),
    24: TelemetryStream("gps_raw_int", 1, _gps),
    30: TelemetryStream("attitude", 10, _attitude),
    31: TelemetryStream("attitude_quaternion", 10, _attitude_quaternion),
    32: TelemetryStream("local_position_ned", 10, _local_position),
    33: TelemetryStream("global_position_int", 5, _global_position),
    42: TelemetryStream("mission_current", 1, _mission),
    49: TelemetryStream("gps_global_origin", 0, _origin),
    74: TelemetryStream("vfr_hud", 2, _hud),
    105: TelemetryStream("highres_imu", 0, _highres_imu),
    141: TelemetryStream("altitude", 1, _altitude),
    147: TelemetryStream("battery_status", 0.5, _battery),
    148: TelemetryStream("autopilot_version", 0, _autopilot_version),
    242: TelemetryStream("home_position", 0.5, _home),
    245: TelemetryStream("extended_sys_state", 2, _extended),
    280: TelemetryStream("gimbal_manager_information", 0, _gimbal_manager),
    281: TelemetryStream("gimbal_manager_status", 0.5, _gimbal_status),
    283: TelemetryStream("gimbal_device_information", 0, _gimbal_device),
    285: TelemetryStream("gimbal_device_attitude_status", 1, _gimbal_attitude),
    331: TelemetryStream("odometry", 0, _odometry),
}
"""Telemetry streams by message ID"""


def find_stream(number: int) -> TelemetryStream:
    """Return the stream of a message ID.

    Raises:
        RefusedError: If the vehicle cannot send the message.
    """
    if number not in STREAMS:
        raise RefusedError(f"message {number} is not supported", CommandResult.UNSUPPORTED)
    return STREAMS[number]


class TelemetryRates:
    """Intervals at which a vehicle sends its telemetry streams."""

    def __init__(self, offset: int) -> None:
        """Initialise with the default rates.

        Args:
            offset: Offset in steps that differs between vehicles, so that not all send in one step.
        """
        self._offset = offset
        self._periods = {
            number: _interval_to_steps(1e6 / stream.hz)
            for number, stream in STREAMS.items()
            if stream.hz
        }

    def set_interval(self, number: int, interval_us: float) -> None:
        """Set the interval of a stream.

        Args:
            number: Message ID.
            interval_us: Interval, us; 0 for the default rate, -1 to stop the stream. It is rounded
                to steps of 10 ms.

        Raises:
            RefusedError: If there is no such message, or the interval is invalid.
        """
        default_hz = find_stream(number).hz
        if not (interval_us == -1 or 0 <= interval_us < math.inf):
            raise RefusedError("interval must be -1, 0 or positive (us)")
        wanted_us = interval_us or (1e6 / default_hz if default_hz else -1)
        if wanted_us < 0:
            self._periods.pop(number, None)
        else:
            self._periods[number] = _interval_to_steps(wanted_us)

    def get_interval(self, number: int) -> int:
        """Return the interval of a stream, us, or -1 for a stopped stream.

        Raises:
            RefusedError: If there is no such message.
        """
        find_stream(number)
        period = self._periods.get(number)
        return -1 if period is None else period * (10**6 // STEP_HZ)

    def due(self, tick: int) -> Sequence[int]:
        """Return the IDs of the messages to send at a step."""
        when = tick + self._offset
        return [number for number, period in self._periods.items() if when % period == 0]


def _interval_to_steps(interval_us: float) -> int:
    """Convert an interval, us, into a number of steps, at least one."""
    return min(max(round(interval_us * STEP_HZ / 1e6), 1), 2**31 // (10**6 // STEP_HZ))


def make_message(vehicle: MavlinkVehicle, number: int) -> OutgoingMessage:
    """Return a message with the present values.

    Raises:
        RefusedError: If the vehicle cannot send the message.
    """
    stream = find_stream(number)
    return OutgoingMessage(stream.name, stream.fields(vehicle))


def _quaternion(vehicle: MavlinkVehicle) -> tuple[float, ...]:
    """Return the attitude w, x, y, z, from FRD body axes to NED."""
    return tuple(vehicle.locate()[3:])


def _rates(vehicle: MavlinkVehicle) -> tuple[float, float, float]:
    """Return the angular rates in FRD body axes, rad/s."""
    p, q, r = vehicle.pilot.state[3]
    return p, -q, -r


def _velocity(vehicle: MavlinkVehicle) -> tuple[float, float, float]:
    """Return the velocity in NED, m/s."""
    x, y, z = vehicle.pilot.state[2]
    return y, x, -z


def _heading(vehicle: MavlinkVehicle) -> int:
    """Return the heading, degrees clockwise from north, rounded."""
    return round(90 - math.degrees(euler(vehicle.pilot.state[1])[2])) % 360


def _scaled_position(vehicle: MavlinkVehicle) -> tuple[int, int, int]:
    """Return latitude and longitude, 1e-7 deg, and altitude, mm."""
    return _scale_geodetic(vehicle.locate()[:3])


def _scale_geodetic(geodetic: Sequence[float]) -> tuple[int, int, int]:
    """Convert degrees and metres into integers of 1e-7 deg and mm."""
    latitude, longitude, altitude = geodetic
    return round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3)


def _clamp_int16(number: float) -> int:
    """Round a number and clip it to 16 bits."""
    return round(min(max(number, -32768), 32767))
