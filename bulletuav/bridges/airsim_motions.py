"""AirSim's motion calls: what each asks for, as something that a drone does."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_values import MOST, duration, flag, number, vector_in, yaw_in
from bulletuav.bridges.airsim_world import Vehicle, World
from bulletuav.bridges.motions import Heading, Hold, Land, Motion, Path, Stay, Turn
from bulletuav.bridges.setpoints import Order, Setpoint, corner_speeds
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.errors import as_int, as_sequence, shown

TAKE_OFF_HEIGHT = 3.0
"""m, as in AirSim"""
TAKE_OFF_SPEED = 1.5
"""m/s"""
MOST_POINTS = 1000
"""Most points of a path"""
STEEPEST = math.radians(60)
"""Greatest roll and pitch that a call may ask for, rad"""
QUICKEST = 20.0
"""Greatest rate that a call may ask for, rad/s"""
MotionOf = Callable[..., Motion]
"""Function that makes a motion of world, index, vehicle and the numbers of a call"""


def _heading(drivetrain: Any, yaw_mode: Any) -> Heading:
    """Read where to look: 1 is forward only; else a yaw, or its rate, clockwise in degrees."""
    as_int("drivetrain", drivetrain, 0, 1)
    if not isinstance(yaw_mode, Mapping):
        raise ValueError(
            f"yaw_mode is {shown(yaw_mode)}: a map of is_rate and yaw_or_rate is needed"
        )
    degrees = number("yaw_or_rate", yaw_mode.get("yaw_or_rate"))
    if flag("is_rate", yaw_mode.get("is_rate", False)):
        return Heading("rate", -math.radians(degrees), drivetrain == 1)
    return Heading("angle", yaw_in(degrees), drivetrain == 1)


def _place(world: World, vehicle: Vehicle, x: Any, y: Any, z: Any) -> np.ndarray:
    """Convert north, east, down of a vehicle's start into a place of the airspace, (3,) m."""
    moved = (number("y", y), number("x", x), -number("z", z))
    return np.array([one + way for one, way in zip(vehicle.start, moved, strict=True)])


def _path(
    world: World,
    i: int,
    points: list[np.ndarray],
    speed: Any,
    heading: Heading,
    limit: Any,
    lookahead: Any = -1,
    adaptive: Any = 1,
) -> Motion:
    """Make a motion along points; how AirSim looks ahead along its own does not matter here."""
    number("lookahead", lookahead)
    number("adaptive_lookahead", adaptive)
    fast = number("velocity", speed)
    if fast <= 0:
        raise ValueError(f"velocity is {fast:g} m/s: more than 0 is needed")
    times = (world.clock, duration("timeout_sec", limit))
    return Path(world.state(i), points, fast, heading, times)


def take_off(world: World, i: int, vehicle: Vehicle, limit: Any) -> Motion:
    """Rise to 3 m above the present place."""
    goal = np.array(world.state(i)[0])
    goal[2] += TAKE_OFF_HEIGHT
    return _path(world, i, [goal], TAKE_OFF_SPEED, Heading(), limit)


def land(world: World, i: int, vehicle: Vehicle, limit: Any) -> Motion:
    """Sink until something is touched, and stop the motors."""
    return Land(world.state(i), world.clock, duration("timeout_sec", limit))


def go_home(world: World, i: int, vehicle: Vehicle, limit: Any) -> Motion:
    """Fly back to above the start, at the present height."""
    goal = vehicle.start.copy()
    goal[2] = max(world.state(i)[0][2], goal[2] + TAKE_OFF_HEIGHT)
    return _path(world, i, [goal], 5.0, Heading(), limit)


def hover(world: World, i: int, vehicle: Vehicle) -> Motion:
    """Stay where the drone comes to rest."""
    return Stay(world.state(i), world.clock)


def move_to_position(
    world: World, i: int, vehicle: Vehicle, x: Any, y: Any, z: Any, speed: Any, limit: Any,
    drivetrain: Any, yaw_mode: Any, lookahead: Any = -1, adaptive: Any = 1
) -> Motion:  # fmt: skip
    """Fly straight to a place."""
    points = [_place(world, vehicle, x, y, z)]
    heading = _heading(drivetrain, yaw_mode)
    return _path(world, i, points, speed, heading, limit, lookahead, adaptive)


def move_on_path(
    world: World, i: int, vehicle: Vehicle, path: Any, speed: Any, limit: Any, drivetrain: Any,
    yaw_mode: Any, lookahead: Any = -1, adaptive: Any = 1
) -> Motion:  # fmt: skip
    """Fly straight from place to place."""
    points = as_sequence("path", path, most=MOST_POINTS)
    if not points:
        raise ValueError("path is empty: at least one point is needed")
    places = [_place(world, vehicle, *vector_in("point", one).tolist()) for one in points]
    heading = _heading(drivetrain, yaw_mode)
    return _path(world, i, places, speed, heading, limit, lookahead, adaptive)


def move_to_z(
    world: World, i: int, vehicle: Vehicle, z: Any, speed: Any, limit: Any, yaw_mode: Any,
    lookahead: Any = -1, adaptive: Any = 1
) -> Motion:  # fmt: skip
    """Rise or sink to a height."""
    goal = np.array(world.state(i)[0])
    goal[2] = _place(world, vehicle, 0.0, 0.0, z)[2]
    return _path(world, i, [goal], speed, _heading(0, yaw_mode), limit, lookahead, adaptive)


def _velocity(
    world: World, numbers: tuple[Any, ...], height: float | None, body: bool, limit: Any,
    heading: Heading
) -> Motion:  # fmt: skip
    """Hold a velocity, of the world or of the body; with a height to hold, or one upwards."""
    first, second, *down = (number("velocity", one) for one in numbers)
    across, xy = ("body", (first, -second)) if body else ("velocity", (second, first))
    upward, z = ("velocity", -down[0]) if height is None else ("position", height)
    wanted = Setpoint(across, xy, upward, z, heading.turning, heading.yaw)
    forward = heading.forward and not body
    return Hold(world.clock, duration("duration", limit), wanted, forward)


def move_by_velocity(
    world: World, i: int, vehicle: Vehicle, vx: Any, vy: Any, vz: Any, limit: Any,
    drivetrain: Any, yaw_mode: Any
) -> Motion:  # fmt: skip
    """Hold a velocity north, east, down."""
    return _velocity(world, (vx, vy, vz), None, False, limit, _heading(drivetrain, yaw_mode))


def move_by_velocity_z(
    world: World, i: int, vehicle: Vehicle, vx: Any, vy: Any, z: Any, limit: Any,
    drivetrain: Any, yaw_mode: Any
) -> Motion:  # fmt: skip
    """Hold a velocity north and east, and a height."""
    height = float(_place(world, vehicle, 0.0, 0.0, z)[2])
    return _velocity(world, (vx, vy), height, False, limit, _heading(drivetrain, yaw_mode))


def move_by_velocity_body(
    world: World, i: int, vehicle: Vehicle, vx: Any, vy: Any, vz: Any, limit: Any,
    drivetrain: Any, yaw_mode: Any
) -> Motion:  # fmt: skip
    """Hold a velocity forward, right, down."""
    return _velocity(world, (vx, vy, vz), None, True, limit, _heading(drivetrain, yaw_mode))


def move_by_velocity_z_body(
    world: World, i: int, vehicle: Vehicle, vx: Any, vy: Any, z: Any, limit: Any,
    drivetrain: Any, yaw_mode: Any
) -> Motion:  # fmt: skip
    """Hold a velocity forward and right, and a height."""
    height = float(_place(world, vehicle, 0.0, 0.0, z)[2])
    return _velocity(world, (vx, vy), height, True, limit, _heading(drivetrain, yaw_mode))


def rotate_to_yaw(
    world: World, i: int, vehicle: Vehicle, yaw: Any, limit: Any, margin: Any
) -> Motion:
    """Turn on the spot to a yaw, degrees clockwise from north."""
    times = (world.clock, duration("timeout_sec", limit))
    near = math.radians(max(number("margin", margin), 0.1))
    return Turn(world.state(i), *times, yaw_in(number("yaw", yaw)), near)


def rotate_by_yaw_rate(world: World, i: int, vehicle: Vehicle, yaw_rate: Any, limit: Any) -> Motion:
    """Turn on the spot at a rate, degrees a second, clockwise."""
    x, y, z = world.state(i)[0]
    rate = -math.radians(number("yaw_rate", yaw_rate))
    wanted = Setpoint("position", (x, y), "position", z, "rate", rate)
    return Hold(world.clock, duration("duration", limit), wanted)


def attitude(rates: bool, yaw_rate: bool, height: bool) -> MotionOf:
    """Make the function of a call of roll, pitch, yaw, and height or throttle.

    Args:
        rates: Whether roll, pitch and yaw are rates.
        yaw_rate: Whether the yaw is a rate.
        height: Whether the fourth number is a height, down; else a throttle from 0 to 1.

    Returns:
        The function. Angles are of forward, right, down; rad, and rad/s.
    """

    def motion(
        world: World, i: int, vehicle: Vehicle, roll: Any, pitch: Any, yaw: Any, last: Any,
        limit: Any
    ) -> Motion:  # fmt: skip
        # Rates and tilt stay within what a caller may ask for
        most = QUICKEST if rates else STEEPEST
        lean = [min(max(number("angle", one), -most), most) for one in (roll, pitch)]
        turn = number("yaw", yaw)
        # AirSim's yaw is clockwise from north, ours the other way from east
        turning, angle = ("rate", -turn) if rates or yaw_rate else ("angle", math.pi / 2 - turn)
        # The fourth number holds the height, or is the thrust itself
        if height:
            upward, z = "position", float(_place(world, vehicle, 0.0, 0.0, last)[2])
        else:
            share = min(max(number("throttle", last), 0.0), 1.0)
            upward, z = "thrust", share * world.airspace.airframes[i].max_thrust
        # Pitch of forward, right, down has the other sign in forward, left, up
        across = "rates" if rates else "attitude"
        wanted = Setpoint(across, (lean[0], -lean[1]), upward, z, turning, angle)
        return Hold(world.clock, duration("duration", limit), wanted)

    return motion


def move_by_motors(
    world: World, i: int, vehicle: Vehicle, front_right: Any, rear_left: Any, front_left: Any,
    rear_right: Any, limit: Any
) -> Motion:  # fmt: skip
    """Hold shares of the greatest thrust of each of four rotors."""
    thrusts = {(1, -1): front_right, (-1, 1): rear_left, (1, 1): front_left, (-1, -1): rear_right}
    shares = {
        corner: math.sqrt(min(max(number("pwm", thrust, MOST), 0.0), 1.0))
        for corner, thrust in thrusts.items()
    }
    speeds = corner_speeds(world.airspace.airframes[i], shares)
    order = Order(SetpointLevel.ROTOR, speeds)
    return Hold(world.clock, duration("duration", limit), order)


MOTIONS: Mapping[str, MotionOf] = {
    "takeoff": take_off,
    "land": land,
    "goHome": go_home,
    "hover": hover,
    "moveToPosition": move_to_position,
    "moveOnPath": move_on_path,
    "moveToZ": move_to_z,
    "moveByVelocity": move_by_velocity,
    "moveByVelocityZ": move_by_velocity_z,
    "moveByVelocityBodyFrame": move_by_velocity_body,
    "moveByVelocityZBodyFrame": move_by_velocity_z_body,
    "rotateToYaw": rotate_to_yaw,
    "rotateByYawRate": rotate_by_yaw_rate,
    "moveByRollPitchYawZ": attitude(False, False, True),
    "moveByRollPitchYawThrottle": attitude(False, False, False),
    "moveByRollPitchYawrateZ": attitude(False, True, True),
    "moveByRollPitchYawrateThrottle": attitude(False, True, False),
    "moveByAngleRatesZ": attitude(True, True, True),
    "moveByAngleRatesThrottle": attitude(True, True, False),
    "moveByMotorPWMs": move_by_motors,
}
"""Motion calls by the names on the wire; the vehicle's name comes last in each"""
