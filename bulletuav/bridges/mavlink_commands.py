"""MAVLink's commands: what each does with a vehicle."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from bulletuav.bridges.mavlink_places import GLOBAL_FRAMES
from bulletuav.bridges.mavlink_telemetry import Streams, tell
from bulletuav.bridges.mavlink_vehicle import Vehicle
from bulletuav.bridges.mavlink_wire import Command, Message, Mode, RefusedError, Told

BY_FORCE = 21196
"""Second parameter of a disarming in the air"""
LEFT_OUT = 2**31 - 1
AUTOPILOT_VERSION, HOME_POSITION = 148, 242
CUSTOM = 1
"""Bit of a base mode that says that numbers of PX4's modes follow"""


class Request(NamedTuple):
    """A command, as a client sends it.

    Attributes:
        frame: Of its place.
        numbers: (7,) parameters; the fifth and sixth are latitude and longitude, deg.
    """

    frame: int
    numbers: tuple[float, ...]

    @classmethod
    def of(cls, message: Message) -> "Request":
        """Read a COMMAND_LONG or a COMMAND_INT."""
        first = tuple(getattr(message, f"param{k}") for k in range(1, 5))
        if message.get_type() == "COMMAND_LONG":
            return cls(GLOBAL_FRAMES[0], (*first, message.param5, message.param6, message.param7))
        place = (math.nan if one == LEFT_OUT else one * 1e-7 for one in (message.x, message.y))
        return cls(message.frame, (*first, *place, message.z))

    def whole(self, k: int) -> int:
        """Tell a parameter, from 1 to 7, that is to be a whole number.

        Raises:
            RefusedError: It is none.
        """
        number = self.numbers[k - 1]
        if not math.isfinite(number) or number != int(number):
            raise RefusedError(f"parameter {k}: a whole number is needed")
        return int(number)


Does = Callable[[Vehicle, Streams, Request], Sequence[Told]]


def _arm(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Arm (1) or disarm (0)."""
    wanted = request.whole(1)
    if wanted not in (0, 1):
        raise RefusedError("arming: 0 or 1 is needed")
    if wanted:
        vehicle.pilot.arm()
    else:
        vehicle.pilot.disarm(request.numbers[1] == BY_FORCE)
    return ()


def _take_off(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Take off, to an altitude."""
    height = request.numbers[6]
    if not math.isfinite(height):
        vehicle.pilot.take_off(None)
        return ()
    above = height if request.frame not in GLOBAL_FRAMES else height - vehicle.site.altitude
    vehicle.pilot.take_off(vehicle.site.start[2] + above)
    return ()


def _reposition(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Fly to a place; what is left out stays as it is."""
    speed, _, _, yaw, latitude, longitude, altitude = request.numbers
    x, y, z = vehicle.pilot.state[0]
    if math.isfinite(latitude + longitude):
        height = altitude if math.isfinite(altitude) else vehicle.site.altitude
        px, py, pz = vehicle.site.of_global(request.frame, latitude, longitude, height)
        place = (px, py, pz if math.isfinite(altitude) else z)
    else:
        above = altitude - (vehicle.site.altitude if request.frame in GLOBAL_FRAMES else 0.0)
        place = (x, y, vehicle.site.start[2] + above if math.isfinite(altitude) else z)
    if speed > 0:
        vehicle.pilot.route.speed = speed
    turn = math.pi / 2 - yaw if math.isfinite(yaw) else None
    vehicle.pilot.go_to(place, turn)
    return ()


def _change_speed(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Change the speed of missions, m/s, from the next leg on."""
    if not 0 < request.numbers[1] < math.inf:
        raise RefusedError("speed: more than 0 m/s is needed")
    vehicle.pilot.route.speed = request.numbers[1]
    return ()


def set_mode(vehicle: Vehicle, main: int, sub: int) -> None:
    """Change the mode, by PX4's numbers.

    Raises:
        RefusedError: There is no such mode, or it cannot begin.
    """
    number = main << 16 | sub << 24 if 0 <= main < 256 and 0 <= sub < 256 else -1
    if number not in tuple(Mode):
        raise RefusedError(f"mode {main}/{sub} is not supported")
    vehicle.pilot.enter(Mode(number))


def _mode(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Change the mode."""
    if not request.whole(1) & CUSTOM:
        raise RefusedError("mode: PX4's own (base mode 1) are needed")
    set_mode(vehicle, request.whole(2), request.whole(3))
    return ()


def _entering(mode: Mode) -> Does:
    """Make the function of a command that changes the mode."""

    def does(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
        vehicle.pilot.enter(mode)
        return ()

    return does


def _pause(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Hold (0), or go on with the mission (1)."""
    vehicle.pilot.enter(Mode.MISSION if request.whole(1) else Mode.HOLD)
    return ()


def _mission_start(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Begin the mission, at an item."""
    first = request.numbers[0]
    if vehicle.pilot.route.items and first > 0:
        vehicle.pilot.jump(request.whole(1))
    vehicle.pilot.enter(Mode.MISSION)
    return ()


def _set_current(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Go on with another item of the mission."""
    vehicle.pilot.jump(request.whole(1))
    return ()


def _terminate(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Switch motors off, wherever it is."""
    if request.numbers[0] > 0.5:
        vehicle.pilot.disarm(by_force=True)
    return ()


def _set_interval(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Change how often a message is sent, us."""
    streams.set(request.whole(1), request.numbers[1])
    return ()


def _get_interval(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Tell how often a message is sent."""
    number = request.whole(1)
    return (Told("message_interval", (number, streams.interval(number))),)


def _request(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
    """Send a message once."""
    return (tell(vehicle, request.whole(1)),)


def _requesting(number: int) -> Does:
    """Make the function of a command that asks for one message."""

    def does(vehicle: Vehicle, streams: Streams, request: Request) -> Sequence[Told]:
        return (tell(vehicle, number),)

    return does


COMMANDS: Mapping[int, Does] = {
    Command.RETURN: _entering(Mode.RETURN),
    Command.LAND: _entering(Mode.LAND),
    Command.TAKEOFF: _take_off,
    Command.SET_MODE: _mode,
    Command.CHANGE_SPEED: _change_speed,
    Command.TERMINATE: _terminate,
    Command.REPOSITION: _reposition,
    Command.PAUSE: _pause,
    Command.SET_MISSION_CURRENT: _set_current,
    Command.MISSION_START: _mission_start,
    Command.ARM: _arm,
    Command.GET_HOME: _requesting(HOME_POSITION),
    Command.GET_INTERVAL: _get_interval,
    Command.SET_INTERVAL: _set_interval,
    Command.REQUEST_MESSAGE: _request,
    Command.REQUEST_CAPABILITIES: _requesting(AUTOPILOT_VERSION),
}
"""Commands by their numbers; others are answered as unsupported"""
