"""MAVLink commands: handlers of COMMAND_LONG and COMMAND_INT."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from bulletuav.bridges.mavlink_coordinates import GLOBAL_FRAMES, RELATIVE_FRAMES
from bulletuav.bridges.mavlink_gimbal import DEVICE_ID, REMOVE
from bulletuav.bridges.mavlink_motions import FACE_TANGENT, OrbitPlan
from bulletuav.bridges.mavlink_protocol import (
    Command,
    CommandResult,
    Message,
    Mode,
    OutgoingMessage,
    RefusedError,
    text,
)
from bulletuav.bridges.mavlink_telemetry import TelemetryRates, make_message
from bulletuav.bridges.mavlink_vehicle import MavlinkVehicle
from bulletuav.bridges.mavlink_wings import ON_ROTORS, ON_WINGS
from bulletuav.bridges.motions import PATH_ACCELERATION

FORCE_DISARM_MAGIC = 21196
"""Second parameter of a command that disarms in the air"""
INFO = 6
"""Severity of an information"""
UNSET_INT32 = 2**31 - 1
AUTOPILOT_VERSION, HOME_POSITION = 148, 242
GIMBAL_MANAGER_INFORMATION, GIMBAL_DEVICE_INFORMATION = 280, 283
DEFAULT_ORBIT_SPEED, MAX_ORBIT_RADIUS = 1.0, 1000.0
"""Speed of an orbit without one (m/s), and maximum radius (m), as in PX4"""
CALIBRATIONS = {(1, 1): "gyro", (2, 1): "mag", (5, 1): "accel", (5, 2): "level"}
"""Sensors by the number and the value of a parameter of `Command.CALIBRATE`"""
POSITION_COMMANDS = (
    Command.LAND,
    Command.TAKEOFF,
    Command.ORBIT,
    Command.REPOSITION,
    Command.ROI_LOCATION,
)
"""Commands whose parameters 5 to 7 are a position"""
CUSTOM_MODE_ENABLED = 1
"""Bit of a base mode that announces PX4's custom modes (MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)"""


class CommandRequest(NamedTuple):
    """Parameters of a command.

    Attributes:
        frame: MAVLink frame of the position.
        params: (7,) parameters; the fifth and sixth of `POSITION_COMMANDS` are latitude and
            longitude, deg.
        sender: System and component of the sender.
    """

    frame: int
    params: tuple[float, ...]
    sender: tuple[int, int]

    @classmethod
    def from_message(cls, message: Message) -> "CommandRequest":
        """Convert a COMMAND_LONG or a COMMAND_INT."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        first = tuple(getattr(message, f"param{k}") for k in range(1, 5))
        if message.get_type() == "COMMAND_LONG":
            last = (message.param5, message.param6, message.param7)
            return cls(GLOBAL_FRAMES[0], (*first, *last), sender)
        # Other numbers than coordinates have no scale
        scale = 1e-7 if message.command in POSITION_COMMANDS else 1.0
        coordinates = (
            math.nan if value == UNSET_INT32 else value * scale for value in (message.x, message.y)
        )
        return cls(message.frame, (*first, *coordinates, message.z), sender)

    def get_int(self, k: int) -> int:
        """Return parameter k, from 1 to 7, as an integer.

        Raises:
            RefusedError: If the parameter is not an integer.
        """
        number = self.params[k - 1]
        if not math.isfinite(number) or number != int(number):
            raise RefusedError(f"parameter {k}: an integer is needed")
        return int(number)


CommandHandler = Callable[
    [MavlinkVehicle, TelemetryRates, CommandRequest], Sequence[OutgoingMessage]
]


def _arm(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Arm (1) or disarm (0)."""
    is_arming = request.get_int(1)
    if is_arming not in (0, 1):
        raise RefusedError("arming: 0 or 1 is needed")
    if is_arming:
        vehicle.pilot.arm()
    else:
        vehicle.pilot.disarm(request.params[1] == FORCE_DISARM_MAGIC)
    return ()


def _take_off(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Take off to an altitude, or to the default height without one."""
    height = request.params[6]
    if not math.isfinite(height):
        vehicle.pilot.take_off(None)
        return ()
    above = height if request.frame not in GLOBAL_FRAMES else height - vehicle.site.altitude
    vehicle.pilot.take_off(vehicle.site.start[2] + above)
    return ()


def _reposition(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Fly to a position; unset coordinates keep the vehicle's present ones."""
    speed, _, radius, yaw, *_ = request.params
    position = _read_position(vehicle, request)
    if vehicle.pilot.is_forward:
        vehicle.pilot.circle(position, radius, speed)
        return ()
    if speed > 0:
        vehicle.pilot.route.speed = speed
    yaw_enu = math.pi / 2 - yaw if math.isfinite(yaw) else None
    vehicle.pilot.go_to(position, yaw_enu)
    return ()


def _read_position(vehicle: MavlinkVehicle, request: CommandRequest) -> tuple[float, float, float]:
    """Return the position of parameters 5 to 7; unset coordinates are the vehicle's, m."""
    latitude, longitude, altitude = request.params[4:]
    x, y, z = vehicle.pilot.state[0]
    if math.isfinite(latitude + longitude):
        height = altitude if math.isfinite(altitude) else vehicle.site.altitude
        px, py, pz = vehicle.site.from_global(request.frame, latitude, longitude, height)
        return px, py, pz if math.isfinite(altitude) else z
    above = altitude - (vehicle.site.altitude if request.frame in GLOBAL_FRAMES else 0.0)
    return x, y, vehicle.site.start[2] + above if math.isfinite(altitude) else z


def _orbit(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Fly a circle: radius (negative: counter-clockwise), speed, yaw behaviour, centre."""
    radius, speed, behavior, sweep, *_ = request.params
    if vehicle.pilot.is_forward:
        vehicle.pilot.circle(_read_position(vehicle, request), radius, speed)
        return ()
    speed = abs(speed) if math.isfinite(speed) else DEFAULT_ORBIT_SPEED
    behavior = behavior if math.isfinite(behavior) else 0.0
    if not 1 <= abs(radius) <= MAX_ORBIT_RADIUS:
        raise RefusedError(f"orbit: radius from 1 to {MAX_ORBIT_RADIUS:g} m is needed")
    if not 0 < speed**2 <= PATH_ACCELERATION * abs(radius):
        raise RefusedError("orbit: speed is 0, or too fast for the radius")
    if behavior not in range(FACE_TANGENT + 1):
        raise RefusedError(f"orbit: yaw behaviour from 0 to {FACE_TANGENT} is needed")
    if math.isfinite(sweep) and sweep:
        raise RefusedError("orbit: angle 0 (without end) is needed")
    center = _read_position(vehicle, request)
    vehicle.pilot.orbit(OrbitPlan(center, abs(radius), speed, radius > 0, int(behavior)))
    return ()


def _inject_failure(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Inject or clear a failure."""
    unit, kind = request.get_int(1), request.get_int(2)
    instance = 0 if math.isnan(request.params[2]) else request.get_int(3)
    vehicle.pilot.inject_failure(unit, kind, instance)
    return ()


def _look_at(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Point the gimbal at a position."""
    if not math.isfinite(sum(request.params[4:])):
        raise RefusedError("region of interest: a position is needed")
    vehicle.gimbal.look_at(_read_position(vehicle, request))
    return ()


def _look_forward(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Point the gimbal forward."""
    vehicle.gimbal.look_at(None)
    return ()


def _point_gimbal(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Point the gimbal: pitch and yaw (deg), their rates (deg/s), and flags."""
    _require_gimbal(request)
    angles = [math.radians(value) for value in request.params[:4]]
    vehicle.gimbal.point(angles[0], angles[1], angles[2], angles[3], request.get_int(5))
    return ()


def _configure_gimbal(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Set which systems control the gimbal."""
    _require_gimbal(request)
    numbers = [request.get_int(k) for k in range(1, 5)]
    if not all(REMOVE <= number <= 255 for number in numbers):
        raise RefusedError(f"gimbal: systems from {REMOVE} to 255 are needed")
    vehicle.gimbal.configure(numbers, request.sender)
    return ()


def _require_gimbal(request: CommandRequest) -> None:
    """Raise RefusedError if a command is for another gimbal."""
    if request.params[6] not in (0, DEVICE_ID):
        raise RefusedError(f"no such gimbal: use {DEVICE_ID}, or 0 for all")


def _calibrate(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Report a finished calibration, with PX4's texts: simulated sensors have no offsets."""
    names = [name for (k, value), name in CALIBRATIONS.items() if request.params[k - 1] == value]
    if len(names) != 1:
        reason = "calibrate one of gyro, mag, accel or level"
        raise RefusedError(reason, CommandResult.UNSUPPORTED)
    (name,) = names
    if vehicle.pilot.is_armed:
        raise RefusedError("calibration: disarm first", CommandResult.TEMPORARILY_REJECTED)
    steps = (f"calibration started: 2 {name}", "progress <100>", f"calibration done: {name}")
    return [text(f"[cal] {step}", INFO) for step in steps]


def _change_speed(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Set the speed of missions, m/s, from the next leg on; on wings the airspeed, from now on."""
    if not 0 < request.params[1] < math.inf:
        raise RefusedError("speed: more than 0 m/s is needed")
    vehicle.pilot.route.speed = request.params[1]
    return ()


def _change_altitude(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Hold at another altitude: parameter 1, in the frame of parameter 2."""
    altitude, frame = request.params[0], request.get_int(2)
    if not math.isfinite(altitude) or frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
        raise RefusedError("altitude in frame 0, 3, 5 or 6 is needed")
    above = altitude - (vehicle.site.altitude if frame in GLOBAL_FRAMES else 0.0)
    vehicle.pilot.change_height(vehicle.site.start[2] + above)
    return ()


def _transition(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Make a VTOL fly on its rotors (3) or its wings (4)."""
    state = request.get_int(1)
    if state not in (ON_ROTORS, ON_WINGS):
        raise RefusedError(f"transition: {ON_ROTORS} or {ON_WINGS} is needed")
    vehicle.pilot.transition(state == ON_WINGS)
    return ()


def set_mode(vehicle: MavlinkVehicle, main: int, sub: int) -> None:
    """Change the flight mode, by PX4's main mode and sub-mode.

    Raises:
        RefusedError: If the mode does not exist, or cannot be entered.
    """
    number = main << 16 | sub << 24 if 0 <= main < 256 and 0 <= sub < 256 else -1
    if number not in tuple(Mode):
        raise RefusedError(f"mode {main}/{sub} is not supported")
    vehicle.pilot.enter_mode(Mode(number))


def _do_set_mode(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Change the flight mode."""
    if not request.get_int(1) & CUSTOM_MODE_ENABLED:
        raise RefusedError("mode: PX4's custom modes (base mode 1) are needed")
    set_mode(vehicle, request.get_int(2), request.get_int(3))
    return ()


def _make_mode_handler(mode: Mode) -> CommandHandler:
    """Return the handler of a command that enters a flight mode."""

    def handler(
        vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
    ) -> Sequence[OutgoingMessage]:
        vehicle.pilot.enter_mode(mode)
        return ()

    return handler


def _pause(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Hold (0), or continue the mission (1)."""
    vehicle.pilot.enter_mode(Mode.MISSION if request.get_int(1) else Mode.HOLD)
    return ()


def _mission_start(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Start the mission, at an item if given."""
    first = request.params[0]
    if vehicle.pilot.route.items and first > 0:
        vehicle.pilot.set_current_item(request.get_int(1))
    vehicle.pilot.enter_mode(Mode.MISSION)
    return ()


def _set_current(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Continue the mission at another item."""
    vehicle.pilot.set_current_item(request.get_int(1))
    return ()


def _terminate(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Switch the motors off, even in the air."""
    if request.params[0] > 0.5:
        vehicle.pilot.disarm(force=True)
    return ()


def _set_interval(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Set the interval of a message, us."""
    streams.set_interval(request.get_int(1), request.params[1])
    return ()


def _get_interval(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Return the interval of a message."""
    number = request.get_int(1)
    return (OutgoingMessage("message_interval", (number, streams.get_interval(number))),)


def _request_message(
    vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
) -> Sequence[OutgoingMessage]:
    """Return a message once; information about the gimbal manager after that about its device.

    MAVSDK 3 requests both, but logs that the latter is missing unless it arrives first.
    """
    number = request.get_int(1)
    first = [GIMBAL_DEVICE_INFORMATION] if number == GIMBAL_MANAGER_INFORMATION else []
    return [make_message(vehicle, one) for one in (*first, number)]


def _make_message_handler(number: int) -> CommandHandler:
    """Return the handler of a command that requests a message."""

    def handler(
        vehicle: MavlinkVehicle, streams: TelemetryRates, request: CommandRequest
    ) -> Sequence[OutgoingMessage]:
        return (make_message(vehicle, number),)

    return handler


COMMANDS: Mapping[int, CommandHandler] = {
    Command.RETURN: _make_mode_handler(Mode.RETURN),
    Command.LAND: _make_mode_handler(Mode.LAND),
    Command.TAKEOFF: _take_off,
    Command.ORBIT: _orbit,
    Command.SET_MODE: _do_set_mode,
    Command.CHANGE_SPEED: _change_speed,
    Command.CHANGE_ALTITUDE: _change_altitude,
    Command.VTOL_TRANSITION: _transition,
    Command.TERMINATE: _terminate,
    Command.REPOSITION: _reposition,
    Command.ROI_LOCATION: _look_at,
    Command.ROI_NONE: _look_forward,
    Command.PAUSE: _pause,
    Command.SET_MISSION_CURRENT: _set_current,
    Command.CALIBRATE: _calibrate,
    Command.MISSION_START: _mission_start,
    Command.ARM: _arm,
    Command.INJECT_FAILURE: _inject_failure,
    Command.GET_HOME: _make_message_handler(HOME_POSITION),
    Command.GET_INTERVAL: _get_interval,
    Command.SET_INTERVAL: _set_interval,
    Command.REQUEST_MESSAGE: _request_message,
    Command.GIMBAL_PITCHYAW: _point_gimbal,
    Command.GIMBAL_CONFIGURE: _configure_gimbal,
    Command.REQUEST_CAPABILITIES: _make_message_handler(AUTOPILOT_VERSION),
}
"""Handlers by command; other commands are acknowledged as unsupported"""
