"""AirSim's motion calls: conversion of their arguments to motion primitives.

Every function takes the world, the index of the vehicle, the vehicle and the arguments of the call.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_objects import read_geo_point
from bulletuav.bridges.airsim_values import (
    MAX_VALUE,
    check_duration,
    check_flag,
    check_number,
    read_vector,
    yaw_from_airsim,
)
from bulletuav.bridges.airsim_vehicle import AirsimVehicle
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.motions import (
    FollowPath,
    Heading,
    HoldPosition,
    HoldSetpoint,
    Land,
    MotionPrimitive,
    TurnToYaw,
)
from bulletuav.bridges.setpoints import (
    AirspaceCommand,
    Setpoint,
    State,
    compute_corner_speeds,
    euler,
)
from bulletuav.compiled.functions import cos, sin
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.errors import as_int, as_sequence, shown

TAKE_OFF_HEIGHT = 3.0
"""Height gained in a take-off, m, as in AirSim"""
TAKE_OFF_SPEED = 1.5
"""Climb rate of a take-off, m/s"""
MAX_PATH_POINTS = 1000
"""Maximum number of points of a path"""
MAX_TILT = math.radians(60)
"""Maximum roll and pitch; larger values are clamped, rad"""
MAX_RATE = 20.0
"""Maximum roll and pitch rates; larger values are clamped, rad/s"""
MAX_STICK_VALUE, FULL_DEFLECTION = 1e9, 10_000
"""Maximum magnitude of the limits of manual flight, and full deflection of a stick"""
MotionFactory = Callable[..., MotionPrimitive]
"""Function that creates a motion from world, vehicle index, vehicle and arguments of a call"""


def _read_heading(drivetrain: Any, yaw_mode: Any) -> Heading:
    """Convert AirSim's drivetrain and yaw mode to a heading.

    Drivetrain 1 faces the direction of flight. Yaws and yaw rates are clockwise, in degrees.
    """
    as_int("drivetrain", drivetrain, 0, 1)
    if not isinstance(yaw_mode, Mapping):
        raise ValueError(
            f"yaw_mode is {shown(yaw_mode)}: a map of is_rate and yaw_or_rate is needed"
        )
    degrees = check_number("yaw_or_rate", yaw_mode.get("yaw_or_rate"))
    if check_flag("is_rate", yaw_mode.get("is_rate", False)):
        return Heading("rate", -math.radians(degrees), drivetrain == 1)
    return Heading("angle", yaw_from_airsim(degrees), drivetrain == 1)


def _convert_position(
    world: AirsimWorld, vehicle: AirsimVehicle, x: Any, y: Any, z: Any
) -> np.ndarray:
    """Convert a position from north, east, down of a vehicle's start to airspace axes, (3,), m."""
    offsets = (check_number("y", y), check_number("x", x), -check_number("z", z))
    return np.array(
        [coordinate + offset for coordinate, offset in zip(vehicle.start, offsets, strict=True)]
    )


def _make_path(
    world: AirsimWorld,
    i: int,
    points: list[np.ndarray],
    speed: Any,
    heading: Heading,
    timeout_sec: Any,
    lookahead: Any = -1,
    adaptive: Any = 1,
) -> MotionPrimitive:
    """Create a motion along waypoints; AirSim's look-ahead parameters are checked but not used."""
    check_number("lookahead", lookahead)
    check_number("adaptive_lookahead", adaptive)
    max_speed = check_number("velocity", speed)
    if max_speed <= 0:
        raise ValueError(f"velocity is {max_speed:g} m/s: more than 0 is needed")
    times = (world.clock, check_duration("timeout_sec", timeout_sec))
    return FollowPath(world.state(i), points, max_speed, heading, times)


def take_off(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, timeout_sec: Any
) -> MotionPrimitive:
    """Climb by 3 m at the present position."""
    goal = np.array(world.state(i)[0])
    goal[2] += TAKE_OFF_HEIGHT
    return _make_path(world, i, [goal], TAKE_OFF_SPEED, Heading(), timeout_sec)


def land_vehicle(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, timeout_sec: Any
) -> MotionPrimitive:
    """Descend until the vehicle touches a surface, then stop the motors."""
    return Land(world.state(i), world.clock, check_duration("timeout_sec", timeout_sec))


def go_home(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, timeout_sec: Any
) -> MotionPrimitive:
    """Fly back above the start at the present height, at least at the take-off height."""
    goal = vehicle.start.copy()
    goal[2] = max(world.state(i)[0][2], goal[2] + TAKE_OFF_HEIGHT)
    return _make_path(world, i, [goal], 5.0, Heading(), timeout_sec)


def hover(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> MotionPrimitive:
    """Brake and hold the position."""
    return HoldPosition(world.state(i), world.clock)


def move_to_position(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, x: Any, y: Any, z: Any, speed: Any,
    timeout_sec: Any, drivetrain: Any, yaw_mode: Any, lookahead: Any = -1, adaptive: Any = 1,
) -> MotionPrimitive:  # fmt: skip
    """Fly in a straight line to a position."""
    points = [_convert_position(world, vehicle, x, y, z)]
    heading = _read_heading(drivetrain, yaw_mode)
    return _make_path(world, i, points, speed, heading, timeout_sec, lookahead, adaptive)


def move_on_path(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, path: Any, speed: Any, timeout_sec: Any,
    drivetrain: Any, yaw_mode: Any, lookahead: Any = -1, adaptive: Any = 1,
) -> MotionPrimitive:  # fmt: skip
    """Fly along a polyline."""
    points = as_sequence("path", path, most=MAX_PATH_POINTS)
    if not points:
        raise ValueError("path is empty: at least one point is needed")
    waypoints = [
        _convert_position(world, vehicle, *read_vector("point", point).tolist()) for point in points
    ]
    heading = _read_heading(drivetrain, yaw_mode)
    return _make_path(world, i, waypoints, speed, heading, timeout_sec, lookahead, adaptive)


def move_to_z(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, z: Any, speed: Any, timeout_sec: Any,
    yaw_mode: Any, lookahead: Any = -1, adaptive: Any = 1,
) -> MotionPrimitive:  # fmt: skip
    """Climb or descend to a height."""
    goal = np.array(world.state(i)[0])
    goal[2] = _convert_position(world, vehicle, 0.0, 0.0, z)[2]
    return _make_path(
        world, i, [goal], speed, _read_heading(0, yaw_mode), timeout_sec, lookahead, adaptive
    )


def _make_velocity_motion(
    world: AirsimWorld, numbers: tuple[Any, ...], height: float | None, is_body_frame: bool,
    duration: Any, heading: Heading,
) -> MotionPrimitive:  # fmt: skip
    """Create a motion that holds a velocity.

    Args:
        world: The vehicles.
        numbers: Velocity north, east (or forward, right) and, if `height` is None, down, m/s.
        height: Height to hold, m.
        is_body_frame: Whether the velocity is in the heading frame of the vehicle.
        duration: Duration, s.
        heading: Yaw policy.
    """
    first, second, *vertical = (check_number("velocity", component) for component in numbers)
    xy_mode, xy = ("body", (first, -second)) if is_body_frame else ("velocity", (second, first))
    z_mode, z = ("velocity", -vertical[0]) if height is None else ("position", height)
    setpoint = Setpoint(xy_mode, xy, z_mode, z, heading.yaw_mode, heading.yaw)
    forward = heading.forward and not is_body_frame
    return HoldSetpoint(world.clock, check_duration("duration", duration), setpoint, forward)


def move_by_velocity(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, vx: Any, vy: Any, vz: Any,
    duration: Any, drivetrain: Any, yaw_mode: Any,
) -> MotionPrimitive:  # fmt: skip
    """Hold a velocity north, east, down."""
    return _make_velocity_motion(
        world, (vx, vy, vz), None, False, duration, _read_heading(drivetrain, yaw_mode)
    )


def move_by_velocity_z(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, vx: Any, vy: Any, z: Any, duration: Any,
    drivetrain: Any, yaw_mode: Any,
) -> MotionPrimitive:  # fmt: skip
    """Hold a velocity north and east, and a height."""
    height = float(_convert_position(world, vehicle, 0.0, 0.0, z)[2])
    return _make_velocity_motion(
        world, (vx, vy), height, False, duration, _read_heading(drivetrain, yaw_mode)
    )


def move_by_velocity_body(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, vx: Any, vy: Any, vz: Any,
    duration: Any, drivetrain: Any, yaw_mode: Any,
) -> MotionPrimitive:  # fmt: skip
    """Hold a velocity forward, right, down."""
    return _make_velocity_motion(
        world, (vx, vy, vz), None, True, duration, _read_heading(drivetrain, yaw_mode)
    )


def move_by_velocity_z_body(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, vx: Any, vy: Any, z: Any, duration: Any,
    drivetrain: Any, yaw_mode: Any,
) -> MotionPrimitive:  # fmt: skip
    """Hold a velocity forward and right, and a height."""
    height = float(_convert_position(world, vehicle, 0.0, 0.0, z)[2])
    return _make_velocity_motion(
        world, (vx, vy), height, True, duration, _read_heading(drivetrain, yaw_mode)
    )


def rotate_to_yaw(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, yaw: Any, timeout_sec: Any, margin: Any
) -> MotionPrimitive:
    """Turn at a fixed position to a yaw in degrees clockwise from north."""
    times = (world.clock, check_duration("timeout_sec", timeout_sec))
    tolerance = math.radians(max(check_number("margin", margin), 0.1))
    return TurnToYaw(world.state(i), *times, yaw_from_airsim(check_number("yaw", yaw)), tolerance)


def rotate_by_yaw_rate(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, yaw_rate: Any, duration: Any
) -> MotionPrimitive:
    """Turn at a fixed position at a clockwise yaw rate in degrees per second."""
    x, y, z = world.state(i)[0]
    rate = -math.radians(check_number("yaw_rate", yaw_rate))
    setpoint = Setpoint("position", (x, y), "position", z, "rate", rate)
    return HoldSetpoint(world.clock, check_duration("duration", duration), setpoint)


def make_attitude_motion(is_rates: bool, is_yaw_rate: bool, has_height: bool) -> MotionFactory:
    """Create the factory of a call with roll, pitch, yaw, and height or throttle.

    Args:
        is_rates: Whether roll, pitch and yaw are rates.
        is_yaw_rate: Whether the yaw is a rate.
        has_height: Whether the fourth number is a height, down; else a throttle from 0 to 1.

    Returns:
        The factory. Its angles are in forward, right, down axes; rad and rad/s.
    """

    def make_motion(
        world: AirsimWorld, i: int, vehicle: AirsimVehicle, roll: Any, pitch: Any, yaw: Any,
        z_or_throttle: Any, duration: Any,
    ) -> MotionPrimitive:  # fmt: skip
        # Clamp rates and tilt to what a client may command
        max_size = MAX_RATE if is_rates else MAX_TILT
        roll_pitch = [
            min(max(check_number("angle", angle_value), -max_size), max_size)
            for angle_value in (roll, pitch)
        ]
        yaw_value = check_number("yaw", yaw)
        # AirSim's yaw is clockwise from north, ours counter-clockwise from east
        yaw_mode, yaw_command = (
            ("rate", -yaw_value) if is_rates or is_yaw_rate else ("angle", math.pi / 2 - yaw_value)
        )
        # The fourth number is a height to hold, or the throttle
        if has_height:
            z_mode, z = (
                "position",
                float(_convert_position(world, vehicle, 0.0, 0.0, z_or_throttle)[2]),
            )
        else:
            throttle = min(max(check_number("throttle", z_or_throttle), 0.0), 1.0)
            z_mode, z = "thrust", throttle * world.airspace.airframes[i].max_thrust
        # Pitch has the opposite sign in forward, left, up axes
        xy_mode = "rates" if is_rates else "attitude"
        setpoint = Setpoint(
            xy_mode, (roll_pitch[0], -roll_pitch[1]), z_mode, z, yaw_mode, yaw_command
        )
        return HoldSetpoint(world.clock, check_duration("duration", duration), setpoint)

    return make_motion


def move_by_motors(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, front_right: Any, rear_left: Any,
    front_left: Any, rear_right: Any, duration: Any,
) -> MotionPrimitive:  # fmt: skip
    """Hold the thrust of each of the four rotors, as fractions of the maximum thrust."""
    thrusts = {(1, -1): front_right, (-1, 1): rear_left, (1, 1): front_left, (-1, -1): rear_right}
    fractions = {
        corner: math.sqrt(min(max(check_number("pwm", thrust, MAX_VALUE), 0.0), 1.0))
        for corner, thrust in thrusts.items()
    }
    speeds = compute_corner_speeds(world.airspace.airframes[i], fractions)
    command = AirspaceCommand(SetpointLevel.ROTOR, speeds)
    return HoldSetpoint(world.clock, check_duration("duration", duration), command)


class StickFlight(MotionPrimitive):
    """Fly by the sticks that a client sends, for a duration."""

    def __init__(
        self,
        world: AirsimWorld,
        i: int,
        vehicle: AirsimVehicle,
        limits: tuple[float, float, float],
        duration: float,
        heading: Heading,
    ) -> None:
        """Hold the position until valid sticks arrive.

        Args:
            world: The vehicles.
            i: Index of the vehicle.
            vehicle: The vehicle.
            limits: Velocity forward and to the right at full deflection, m/s, and height above the
                vehicle at full throttle, m, downwards.
            duration: Duration, s.
            heading: Yaw policy.
        """
        super().__init__(world.clock, duration)
        state = world.state(i)
        self._vehicle, self._limits, self._heading = vehicle, limits, heading
        self._hold, self._yaw = HoldPosition(state), euler(state[1])[2]
        self._max_speed = world.airspace.airframes[i].max_speed

    def get_setpoint(self, state: State, now: float) -> Setpoint:
        """Return the velocity and height of the sticks, in the heading at the start of the motion.

        AirSim's source has the scales: the deflection of 10,000, and 100 degrees per second of yaw.
        """
        remote = self._vehicle.remote
        if not remote.is_valid:
            return self._hold.get_setpoint(state, now)
        scales = [limit / FULL_DEFLECTION for limit in self._limits]
        forward, right = remote.pitch * scales[0], remote.roll * scales[1]
        size = max(math.sqrt(forward**2 + right**2) / self._max_speed, 1.0)
        forward, right = forward / size, right / size
        cosine, sine = cos(self._yaw), sin(self._yaw)
        x, y = forward * cosine + right * sine, forward * sine - right * cosine
        height = state[0][2] - remote.throttle * scales[2]
        yaw_mode, yaw = self._heading.get_yaw_command((x, y))
        change = math.radians(remote.yaw * 100.0 / FULL_DEFLECTION)
        return Setpoint("velocity", (x, y), "position", height, yaw_mode, yaw - change)


def move_by_manual(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, vx_max: Any, vy_max: Any, z_min: Any,
    duration: Any, drivetrain: Any, yaw_mode: Any,
) -> MotionPrimitive:  # fmt: skip
    """Fly by the sticks of `moveByRC`."""
    limits = (
        check_number("vx_max", vx_max, MAX_STICK_VALUE),
        check_number("vy_max", vy_max, MAX_STICK_VALUE),
        check_number("z_min", z_min, MAX_STICK_VALUE),
    )
    heading = _read_heading(drivetrain, yaw_mode)
    return StickFlight(world, i, vehicle, limits, check_duration("duration", duration), heading)


def move_to_gps(
    world: AirsimWorld, i: int, vehicle: AirsimVehicle, latitude: Any, longitude: Any,
    altitude: Any, speed: Any, timeout_sec: Any, drivetrain: Any, yaw_mode: Any,
    lookahead: Any = -1, adaptive: Any = 1,
) -> MotionPrimitive:  # fmt: skip
    """Fly in a straight line to a geodetic position, degrees and m."""
    point = {"latitude": latitude, "longitude": longitude, "altitude": altitude}
    goal = read_geo_point(world, point)
    if np.abs(goal).max() > MAX_VALUE:
        raise ValueError(
            f"latitude is {latitude:g}, longitude {longitude:g}, altitude {altitude:g}: a place "
            f"within {MAX_VALUE / 1000:g} km is needed"
        )
    heading = _read_heading(drivetrain, yaw_mode)
    return _make_path(world, i, [goal], speed, heading, timeout_sec, lookahead, adaptive)


MOTIONS: Mapping[str, MotionFactory] = {
    "takeoff": take_off,
    "land": land_vehicle,
    "goHome": go_home,
    "hover": hover,
    "moveToPosition": move_to_position,
    "moveOnPath": move_on_path,
    "moveToZ": move_to_z,
    "moveToGPS": move_to_gps,
    "moveByManual": move_by_manual,
    "moveByVelocity": move_by_velocity,
    "moveByVelocityZ": move_by_velocity_z,
    "moveByVelocityBodyFrame": move_by_velocity_body,
    "moveByVelocityZBodyFrame": move_by_velocity_z_body,
    "rotateToYaw": rotate_to_yaw,
    "rotateByYawRate": rotate_by_yaw_rate,
    "moveByRollPitchYawZ": make_attitude_motion(False, False, True),
    "moveByRollPitchYawThrottle": make_attitude_motion(False, False, False),
    "moveByRollPitchYawrateZ": make_attitude_motion(False, True, True),
    "moveByRollPitchYawrateThrottle": make_attitude_motion(False, True, False),
    "moveByAngleRatesZ": make_attitude_motion(True, True, True),
    "moveByAngleRatesThrottle": make_attitude_motion(True, True, False),
    "moveByMotorPWMs": move_by_motors,
}
"""Factories of motion calls by their names on the wire; the vehicle's name is the last argument"""
