"""Lidars and distance sensors of AirSim's vehicles, measured when a client reads them."""

import functools

import numpy as np

from bulletuav.bridges.airsim_settings import LIDAR, BeamSensor, MountPose
from bulletuav.compiled.functions import cos, sin
from bulletuav.envs.airspace import Airspace
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.geometry.rotation import Quat4, product, to_world

DEFAULT_LIDAR = BeamSensor(
    LIDAR,
    MountPose(np.zeros(3), (0.0, 0.0, 0.0, 1.0)),
    min_range=0.0,
    max_range=40.0,
    num_azimuths=36,
    elevations=(-45.0, -30.0, -15.0, 0.0, 15.0),
    azimuths=(0.0, 350.0),
)
"""Lidar of vehicles that are not listed in a settings file"""
DEFAULT_LIDAR_NAME = "LidarSensor1"


class RangeFinder:
    """Lidar or distance sensor of a vehicle.

    Attributes:
        settings: Settings of the sensor.
    """

    def __init__(self, settings: BeamSensor) -> None:
        """Compute the directions of the beams."""
        self.settings = settings

    @functools.cached_property
    def directions(self) -> np.ndarray:
        """Unit vectors (B, 3) of the beams in the sensor's axes (FLU)."""
        first, last = self.settings.azimuths
        last = last + 360.0 if last < first else last
        azimuth = -np.radians(np.linspace(first, last, self.settings.num_azimuths))
        elevation = np.radians(np.array(self.settings.elevations))
        elevation, azimuth = (
            grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij")
        )
        horizontal = cos(elevation)
        return np.stack(
            [horizontal * cos(azimuth), horizontal * sin(azimuth), sin(elevation)], axis=1
        )

    def measure(self, airspace: Airspace, i: int) -> tuple[np.ndarray, np.ndarray, Quat4]:
        """Cast the beams.

        Args:
            airspace: Airspace of the vehicles.
            i: Index of the vehicle, which beams do not hit.

        Returns:
            Ranges (B,), m, at most the maximum range; position (3,) of the sensor, m; and its
            quaternion, sensor to world.
        """
        state = airspace.world.state
        attitude = airspace.swarm.quaternion[i]
        start = airspace.swarm.position[i] + to_world(attitude, self.settings.mount.position)
        rotation = product(attitude, self.settings.mount.rotation)
        rays = self.settings.max_range * rotate_vectors(np.array(rotation), self.directions)
        others = state.alive.copy()
        others[0, i] = False
        starts = np.repeat(start[None], len(rays), axis=0)
        world_index = np.zeros(len(rays), dtype=int)
        fraction = airspace.world.engine.cast_rays(
            starts, starts + rays, world_index, (state.swarm, others)
        )
        return fraction * self.settings.max_range, start, rotation
