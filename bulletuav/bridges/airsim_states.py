"""What AirSim's clients read of a vehicle: state, poses, sensors."""

import functools
import math
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_values import pose_of, quaternion, vector
from bulletuav.bridges.airsim_world import LIDAR, Collision, Vehicle, World
from bulletuav.bridges.setpoints import euler
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
from bulletuav.geometry.rotation import to_body
from bulletuav.sensors.lidar import make_beams
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

GAUSS = 1e-4
"""Teslas in a gauss"""
SEA_LEVEL = 1013.25
"""hPa"""


def stamp(world: World) -> int:
    """Tell the time, ns."""
    return round(world.time * 1e9)


def kinematics(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell how a vehicle moves: a KinematicsState, from its own start."""
    swarm = world.airspace.swarm
    ways = (swarm.position[i] - vehicle.start, swarm.velocity[i], world.acceleration[i])
    position, velocity, acceleration = enu_to_ned(np.array(ways)).tolist()
    rates, turning = flu_to_frd(np.array((swarm.rates[i], world.turning[i]))).tolist()
    return {
        "position": vector(position),
        "orientation": quaternion(attitude_to_ned(swarm.quaternion[i])),
        "linear_velocity": vector(velocity),
        "angular_velocity": vector(rates),
        "linear_acceleration": vector(acceleration),
        "angular_acceleration": vector(turning),
    }


def geo_point(world: World, place: np.ndarray) -> dict[str, float]:
    """Tell a place of the airspace as latitude, longitude (degrees) and altitude (m)."""
    names = ("latitude", "longitude", "altitude")
    return dict(zip(names, map(float, world.origin.to_geodetic(place)), strict=True))


def collision(vehicle: Vehicle, told: Collision) -> dict[str, Any]:
    """Tell what a vehicle hit: a CollisionInfo."""
    ways = np.array((told.normal, told.point - vehicle.start, told.place - vehicle.start))
    normal, point, place = enu_to_ned(ways).tolist()
    return {
        "has_collided": told.has_collided,
        "normal": vector(normal),
        "impact_point": vector(point),
        "position": vector(place),
        "penetration_depth": told.depth,
        "time_stamp": round(told.time * 1e9),
        "object_name": told.name,
        "object_id": told.number,
    }


def multirotor(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell all at once: a MultirotorState."""
    return {
        "collision": collision(vehicle, vehicle.collision),
        "kinematics_estimated": kinematics(world, i, vehicle),
        "gps_location": geo_point(world, world.airspace.swarm.position[i]),
        "timestamp": stamp(world),
        "landed_state": int(not (vehicle.stands and not vehicle.flies)),
        "rc_data": {
            **dict.fromkeys(("pitch", "roll", "throttle", "yaw", "left_z", "right_z"), 0.0),
            **dict.fromkeys(("timestamp", "switches"), 0),
            "vendor_id": "",
            "is_initialized": False,
            "is_valid": False,
        },
        "ready": True,
        "ready_message": "",
        "can_arm": True,
    }


def environment(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell the air around: an EnvironmentState."""
    place = world.airspace.swarm.position[i]
    height = float(world.origin.altitude + place[2])
    return {
        "position": vector(enu_to_ned(place - vehicle.start)),
        "geo_point": geo_point(world, place),
        "gravity": vector((0.0, 0.0, STANDARD_GRAVITY)),
        "air_pressure": float(pressure(height)),
        "temperature": float(temperature(height)),
        "air_density": float(density(height)),
    }


def imu(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell what an inertial unit feels, without noise: an ImuData."""
    swarm = world.airspace.swarm
    x, y, z = world.acceleration[i].tolist()
    force = to_body(swarm.quaternion[i], (x, y, z + STANDARD_GRAVITY))
    return {
        "time_stamp": stamp(world),
        "orientation": quaternion(attitude_to_ned(swarm.quaternion[i])),
        "angular_velocity": vector(flu_to_frd(swarm.rates[i])),
        "linear_acceleration": vector(flu_to_frd(force)),
    }


def barometer(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell what a barometer measures, without noise: a BarometerData."""
    height = float(world.origin.altitude + world.airspace.swarm.position[i, 2])
    return {
        "time_stamp": stamp(world),
        "altitude": float(geopotential_height(height)),
        "pressure": float(pressure(height)),
        "qnh": SEA_LEVEL,
    }


@functools.cache
def _field(origin: Origin) -> np.ndarray:
    """Tell the magnetic field of a world, gauss, east, north, up; near enough all over it."""
    return magnetic_field(origin.latitude, origin.longitude, origin.altitude) / GAUSS


def magnetometer(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell what a compass measures, without noise: a MagnetometerData."""
    field = _field(world.origin)
    body = to_body(world.airspace.swarm.quaternion[i], field)
    return {
        "time_stamp": stamp(world),
        "magnetic_field_body": vector(flu_to_frd(body)),
        "magnetic_field_covariance": [],
    }


def gps(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell what a satellite receiver measures, without noise: a GpsData."""
    swarm = world.airspace.swarm
    return {
        "time_stamp": stamp(world),
        "gnss": {
            "geo_point": geo_point(world, swarm.position[i]),
            "eph": 0.1,
            "epv": 0.1,
            "velocity": vector(enu_to_ned(swarm.velocity[i])),
            "fix_type": 3,
            "time_utc": stamp(world) // 1000,
        },
        "is_valid": True,
    }


def lidar(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell points that beams hit, north, east, down of the vehicle's start: a LidarData.

    Raises:
        ValueError: The world was made without the sensor "lidar".
    """
    if "lidar" not in world.airspace.readings:
        raise ValueError("there is no lidar: start the server with --lidar")
    # Beams stay level, and turn with the drone's heading
    place = world.airspace.swarm.position[i] - vehicle.start
    yaw = euler(world.airspace.swarm.quaternion[i].tolist())[2]
    beams = np.radians(make_beams(LIDAR["num_beams"], LIDAR["lidar_elevations"]))
    azimuth, elevation = beams[:, 0] + yaw, beams[:, 1]
    ranges = world.airspace.readings["lidar"][i]
    # From ranges and angles to points, without beams that met nothing
    flat = ranges * np.cos(elevation)
    ways = (flat * np.cos(azimuth), flat * np.sin(azimuth), ranges * np.sin(elevation))
    points = enu_to_ned(place + np.stack(ways, axis=1)[ranges < LIDAR["max_range"]])
    return {
        "time_stamp": stamp(world),
        "point_cloud": points.ravel().tolist(),
        "pose": pose_of(place, world.airspace.swarm.quaternion[i]),
        "segmentation": [],
    }


def rotors(world: World, i: int, vehicle: Vehicle) -> dict[str, Any]:
    """Tell speed (rad/s), thrust (N) and torque (N m) of each rotor: RotorStates."""
    frame = world.airspace.airframes[i]
    speeds = world.airspace.swarm.rotor_speed[i, : len(frame.rotors)].tolist()
    thrusts = [frame.thrust_coefficient * one * one for one in speeds]
    return {
        "timestamp": stamp(world),
        "rotors": [
            {
                "speed": speed,
                "thrust": thrust,
                "torque_scaler": math.copysign(thrust * frame.torque_ratio, turn),
            }
            for speed, thrust, (_, _, turn) in zip(speeds, thrusts, frame.rotors, strict=True)
        ],
    }
