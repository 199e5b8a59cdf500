"""States and sensor readings that AirSim's clients request from a vehicle.

Functions return maps with the field names of AirSim's structs. Positions are north, east, down from
the start position of the vehicle.
"""

import functools
import math
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_beams import RangeFinder
from bulletuav.bridges.airsim_settings import DISTANCE, FRAMES, LIDAR
from bulletuav.bridges.airsim_values import write_mount, write_pose, write_quaternion, write_vector
from bulletuav.bridges.airsim_vehicle import AirsimVehicle, Collision
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.earth import (
    Origin,
    attitude_to_ned,
    density,
    enu_to_ned,
    flu_to_frd,
    geopotential_height,
    magnetic_field,
    pressure,
    temperature,
)
from bulletuav.errors import unknown
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.geometry.rotation import to_body
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

GAUSS = 1e-4
"""Teslas per gauss"""
SEA_LEVEL = 1013.25
"""Pressure at sea level (QNH), hPa"""
RANGE_FINDERS = {
    LIDAR: ("lidar", "list it in the settings file, or start the server with --lidar"),
    DISTANCE: ("distance sensor", "list it in the settings file"),
}
"""Names of range finders in messages, and how to get one, by AirSim's sensor type"""


def make_timestamp(world: AirsimWorld) -> int:
    """Return the simulated time as a timestamp, ns."""
    return round(world.time * 1e9)


def kinematics(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the pose, velocities and accelerations of a vehicle as a KinematicsState."""
    swarm = world.airspace.swarm
    vectors = (swarm.position[i] - vehicle.start, swarm.velocity[i], world.acceleration[i])
    position, velocity, acceleration = enu_to_ned(np.array(vectors)).tolist()
    rates, angular_acceleration = flu_to_frd(
        np.array((swarm.rates[i], world.angular_acceleration[i]))
    ).tolist()
    return {
        "position": write_vector(position),
        "orientation": write_quaternion(attitude_to_ned(swarm.quaternion[i])),
        "linear_velocity": write_vector(velocity),
        "angular_velocity": write_vector(rates),
        "linear_acceleration": write_vector(acceleration),
        "angular_acceleration": write_vector(angular_acceleration),
    }


def geo_point(world: AirsimWorld, position: np.ndarray) -> dict[str, float]:
    """Convert a position in the airspace to a GeoPoint.

    Args:
        world: The vehicles.
        position: (3,) east, north, up of the origin, m.

    Returns:
        Latitude, longitude (degrees) and altitude (m).
    """
    names = ("latitude", "longitude", "altitude")
    return dict(zip(names, map(float, world.origin.to_geodetic(position)), strict=True))


def make_collision_info(vehicle: AirsimVehicle, collision: Collision) -> dict[str, Any]:
    """Return a collision of a vehicle as a CollisionInfo."""
    vectors = np.array(
        (collision.normal, collision.point - vehicle.start, collision.position - vehicle.start)
    )
    normal, point, position = enu_to_ned(vectors).tolist()
    return {
        "has_collided": collision.has_collided,
        "normal": write_vector(normal),
        "impact_point": write_vector(point),
        "position": write_vector(position),
        "penetration_depth": collision.depth,
        "time_stamp": round(collision.time * 1e9),
        "object_name": collision.object_name,
        "object_id": collision.object_id,
    }


def multirotor(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the complete state of a vehicle as a MultirotorState."""
    return {
        "collision": make_collision_info(vehicle, vehicle.collision),
        "kinematics_estimated": kinematics(world, i, vehicle),
        "gps_location": geo_point(world, world.airspace.swarm.position[i]),
        "timestamp": make_timestamp(world),
        "landed_state": int(not (vehicle.is_standing and not vehicle.is_flying)),
        "rc_data": {
            **dict.fromkeys(("left_z", "right_z"), 0.0),
            **vehicle.remote._asdict(),
            **dict.fromkeys(("timestamp", "switches"), 0),
            "vendor_id": "",
            "is_initialized": vehicle.remote.is_valid,
        },
        "ready": True,
        "ready_message": "",
        "can_arm": True,
    }


def environment(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return position, gravity and air properties at a vehicle as an EnvironmentState."""
    position = world.airspace.swarm.position[i]
    height = float(world.origin.altitude + position[2])
    return {
        "position": write_vector(enu_to_ned(position - vehicle.start)),
        "geo_point": geo_point(world, position),
        "gravity": write_vector((0.0, 0.0, STANDARD_GRAVITY)),
        "air_pressure": float(pressure(height)),
        "temperature": float(temperature(height)),
        "air_density": float(density(height)),
    }


def imu(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the reading of an inertial measurement unit without noise as ImuData."""
    swarm = world.airspace.swarm
    x, y, z = world.acceleration[i].tolist()
    force = to_body(swarm.quaternion[i], (x, y, z + STANDARD_GRAVITY))
    return {
        "time_stamp": make_timestamp(world),
        "orientation": write_quaternion(attitude_to_ned(swarm.quaternion[i])),
        "angular_velocity": write_vector(flu_to_frd(swarm.rates[i])),
        "linear_acceleration": write_vector(flu_to_frd(force)),
    }


def barometer(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the reading of a barometer without noise as BarometerData."""
    height = float(world.origin.altitude + world.airspace.swarm.position[i, 2])
    return {
        "time_stamp": make_timestamp(world),
        "altitude": float(geopotential_height(height)),
        "pressure": float(pressure(height)),
        "qnh": SEA_LEVEL,
    }


@functools.cache
def _compute_magnetic_field(origin: Origin) -> np.ndarray:
    """Return the magnetic field at the origin, gauss, east, north, up."""
    return magnetic_field(origin.latitude, origin.longitude, origin.altitude) / GAUSS


def magnetometer(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the reading of a magnetometer without noise as MagnetometerData."""
    field = _compute_magnetic_field(world.origin)
    body = to_body(world.airspace.swarm.quaternion[i], field)
    return {
        "time_stamp": make_timestamp(world),
        "magnetic_field_body": write_vector(flu_to_frd(body)),
        "magnetic_field_covariance": [],
    }


def gps(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the reading of a GPS receiver without noise as GpsData."""
    swarm = world.airspace.swarm
    return {
        "time_stamp": make_timestamp(world),
        "gnss": {
            "geo_point": geo_point(world, swarm.position[i]),
            "eph": 0.1,
            "epv": 0.1,
            "velocity": write_vector(enu_to_ned(swarm.velocity[i])),
            "fix_type": 3,
            "time_utc": make_timestamp(world) // 1000,
        },
        "is_valid": True,
    }


def _find_range_finder(vehicle: AirsimVehicle, kind: int, name: str) -> RangeFinder:
    """Return a lidar or a distance sensor of a vehicle.

    Args:
        vehicle: The vehicle.
        kind: `LIDAR` or `DISTANCE`.
        name: Name of the sensor; empty for the first of its kind.

    Raises:
        ValueError: If there is no such sensor.
    """
    sensors = {
        key: sensor for key, sensor in vehicle.range_finders.items() if sensor.settings.kind == kind
    }
    if not sensors:
        what, remedy = RANGE_FINDERS[kind]
        raise ValueError(f"vehicle {vehicle.name!r} has no {what}: {remedy}")
    if name and name not in sensors:
        raise unknown(RANGE_FINDERS[kind][0], name, sensors)
    return sensors[name or next(iter(sensors))]


def lidar(world: AirsimWorld, i: int, vehicle: AirsimVehicle, name: str) -> dict[str, Any]:
    """Return the points that the beams of a lidar hit as LidarData.

    Points are north, east, down from the start of the vehicle, or in the axes of the sensor.

    Raises:
        ValueError: If the vehicle has no such lidar.
    """
    sensor = _find_range_finder(vehicle, LIDAR, name)
    ranges, start, rotation = sensor.measure(world.airspace, i)
    # Beams without a hit are left out
    is_hit = ranges < sensor.settings.max_range
    points = ranges[is_hit, None] * sensor.directions[is_hit]
    position = start - vehicle.start
    if sensor.settings.frame == FRAMES[0]:
        points = flu_to_frd(points)
    else:
        points = enu_to_ned(position + rotate_vectors(np.array(rotation), points))
    return {
        "time_stamp": make_timestamp(world),
        "point_cloud": points.ravel().tolist(),
        "pose": write_pose(position, rotation),
        "segmentation": [],
    }


def distance(world: AirsimWorld, i: int, vehicle: AirsimVehicle, name: str) -> dict[str, Any]:
    """Return the reading of a distance sensor without noise as DistanceSensorData.

    Raises:
        ValueError: If the vehicle has no such sensor.
    """
    sensor = _find_range_finder(vehicle, DISTANCE, name)
    settings = sensor.settings
    (found,), _, _ = sensor.measure(world.airspace, i)
    return {
        "time_stamp": make_timestamp(world),
        "distance": float(max(found, settings.min_range)),
        "min_distance": settings.min_range,
        "max_distance": settings.max_range,
        "relative_pose": write_mount(*settings.mount),
    }


def rotors(world: AirsimWorld, i: int, vehicle: AirsimVehicle) -> dict[str, Any]:
    """Return the speed (rad/s), thrust (N) and torque (N m) of each rotor as RotorStates."""
    airframe = world.airspace.airframes[i]
    speeds = world.airspace.swarm.rotor_speed[i, : len(airframe.rotors)].tolist()
    thrusts = [airframe.thrust_coefficient * speed * speed for speed in speeds]
    return {
        "timestamp": make_timestamp(world),
        "rotors": [
            {
                "speed": speed,
                "thrust": thrust,
                "torque_scaler": math.copysign(thrust * airframe.torque_ratio, direction),
            }
            for speed, thrust, (_, _, direction) in zip(
                speeds, thrusts, airframe.rotors, strict=True
            )
        ],
    }
