"""Fleet of MAVLink vehicles in one airspace, without sockets: messages in, messages out."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.bridges.mavlink_camera import PICTURE_SIZE, VERTICAL_FOV, MavlinkCamera
from bulletuav.bridges.mavlink_coordinates import Site
from bulletuav.bridges.mavlink_gimbal import compute_heading
from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage, Sender
from bulletuav.bridges.mavlink_services import Services
from bulletuav.bridges.mavlink_telemetry import STEP_HZ
from bulletuav.bridges.mavlink_vehicle import MavlinkVehicle
from bulletuav.bridges.setpoints import NORTH, apply_commands, get_states, make_airspace
from bulletuav.bridges.starts import make_start_positions
from bulletuav.earth import Origin, attitude_to_ned
from bulletuav.errors import as_int, as_sequence, shown
from bulletuav.geometry.rotation import from_euler, product
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import load_airframe

PHYSICS_HZ = 500
"""Physics steps per second, and steps of the attitude and rate controllers"""
HOME = (47.397742, 8.545594, 488.0)
"""Default home of PX4's simulated vehicles: latitude, longitude (degrees), altitude (m)"""
SPACING = 2.0
"""Least distance between neighbours at the start, m"""
SPACING_RADII = 2.5
"""Least distance between neighbours at the start, in radii of their collision shapes"""
MAX_VEHICLES = 250
"""Maximum number of vehicles; higher system IDs belong to ground stations"""
MIN_SUPPORT_NORMAL = 0.7
"""Minimum upward component of a contact normal for a contact that supports the vehicle"""


class MavlinkFleet:
    """N vehicles that fly, and collide, in one airspace; they face north at the start.

        fleet = MavlinkFleet(2)
        answers = fleet.take(0, message, sender)
        messages = fleet.step()

    Attributes:
        airspace: Airspace in which they fly.
        services: Message handler of each vehicle.
        origin: Geodetic position of the airspace's origin.
        tick: Number of steps, of 10 ms each.
    """

    def __init__(
        self,
        drones: int | Sequence[Sequence[float]] = 1,
        airframe: Any = "iris",
        *,
        home: Sequence[float] = HOME,
        pictures: str | Path | None = None,
        **options: Any,
    ) -> None:
        """Place the vehicles on the ground, and switch them on.

        Args:
            drones: Number of vehicles, in rows 2 m apart, or more if they are large; or their
                positions, (N, 2), m.
            airframe: Airframe of all vehicles.
            home: Latitude, longitude (degrees) and altitude (m) of the airspace's origin.
            pictures: Folder for the pictures of cameras, whose numbers continue those of earlier
                pictures there; None for vehicles without cameras.
            **options: Further options of `Airspace`, such as wind or obstacles.

        Raises:
            ValueError: If an option is invalid.
            NotADirectoryError: If there is no folder for pictures.
        """
        if pictures is not None and not Path(pictures).is_dir():
            raise NotADirectoryError(f"no folder {shown(str(pictures))}: create it for pictures")
        self._has_cameras = pictures is not None
        frame = load_airframe(airframe)
        spacing = max(SPACING, SPACING_RADII * frame.collision_radius)
        places = make_start_positions(drones, frame.standing_height, spacing)
        as_int("number of drones", len(places), 1, MAX_VEHICLES)
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {STEP_HZ} for MAVLink clients: omit the option")
        self.origin = Origin(*as_sequence("home", home, 3))
        settings = {
            "physics_hz": PHYSICS_HZ,
            "decision_hz": STEP_HZ,
            "quaternion": NORTH,
            **options,
        }
        self.airspace = make_airspace(places, airframe, **settings)
        sites = [Site.from_start(self.origin, place) for place in places]
        self.services = [
            Services(self._make_vehicle(k, frame, site), self._make_camera(k, pictures))
            for k, site in enumerate(sites)
        ]
        self.tick, self._starts = 0, places
        self._velocity = self.airspace.swarm.velocity.copy()
        self._update_vehicles()

    def _make_vehicle(self, i: int, airframe: Airframe, site: Site) -> MavlinkVehicle:
        """Return the autopilot of a vehicle."""
        set_rotors = partial(self._set_rotors, i)
        pilot = self.airspace.world.cascade.autopilot
        row = None if pilot is None else pilot.rows[0, i]
        get_wind, locate = partial(self._read_wind, i), partial(self._locate, i)
        return MavlinkVehicle(i + 1, airframe, site, locate, set_rotors, row, get_wind)

    def _read_wind(self, i: int) -> list[float]:
        """Return the velocity of the air at a vehicle, (3,), m/s."""
        wind: list[float] = self.airspace.world.state.wind[0, i].tolist()
        return wind

    def _make_camera(self, i: int, folder: str | Path | None) -> MavlinkCamera | None:
        """Return the camera of a vehicle, or None without a folder for its pictures."""
        if folder is None:
            return None
        return MavlinkCamera(Path(folder), i + 1, partial(self._take_picture, i))

    def _take_picture(self, i: int) -> tuple[np.ndarray, tuple[float, ...]]:
        """Return the view of a vehicle's gimbal, and its pose; see `MavlinkCamera`."""
        vehicle = self.services[i].vehicle
        state, gimbal = vehicle.pilot.state, vehicle.gimbal
        heading = math.pi / 2 - compute_heading(state) - gimbal.relative_yaw(state)
        view = from_euler(0.0, -gimbal.pitch, heading)
        # Below the body, stabilised against its tilt
        place = (0.0, 0.0, -vehicle.airframe.standing_height)
        x, y, z, w = state[1]
        mount = product((-x, -y, -z, w), view)
        picture = self.airspace.picture(i, place, mount, None, PICTURE_SIZE, VERTICAL_FOV)
        latitude, longitude, altitude = vehicle.locate()[:3]
        attitude = attitude_to_ned(np.array(view), scalar_first=True).tolist()
        height = altitude - vehicle.site.altitude
        return picture.pixels, (latitude, longitude, altitude, height, *attitude)

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.services)

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.tick / STEP_HZ

    def take(self, drone: int, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Pass a message to a vehicle, and return the vehicle's answers."""
        return self.services[drone].answer(message, sender)

    def step(self) -> list[list[OutgoingMessage]]:
        """Fly for one step of 10 ms.

        Returns:
            Messages of each vehicle to all its clients.

        Raises:
            RuntimeError: If the flight diverged, or the airspace is closed.
        """
        period = self.airspace.period
        apply_commands(
            self.airspace, [service.vehicle.pilot.order(period) for service in self.services]
        )
        for i, service in enumerate(self.services):
            force = service.vehicle.pilot.get_launch_force()
            if force is not None:
                self.airspace.apply(i, force)
        self.airspace.step()
        self.tick += 1
        self._update_vehicles()
        return [service.due(self.tick) for service in self.services]

    def warm_up(self) -> None:
        """Compile the simulation, which takes a minute the first time; the vehicles do not move."""
        self.airspace.warm_up()
        if self._has_cameras:
            self._take_picture(0)
        self.airspace.place(None, self._starts, NORTH)

    def _update_vehicles(self) -> None:
        """Pass the state of each body to its vehicle."""
        swarm, contacts = self.airspace.swarm, self.airspace.contacts
        change = ((swarm.velocity - self._velocity) / self.airspace.period).tolist()
        self._velocity = swarm.velocity.copy()
        touching = set(contacts.drone[contacts.normal[:, 2] > MIN_SUPPORT_NORMAL].tolist())
        self._geodetic_poses: list[list[float]] | None = None
        for i, (service, state) in enumerate(zip(self.services, get_states(swarm), strict=True)):
            service.vehicle.acceleration = change[i]
            service.vehicle.throttle = self._read_throttle(i)
            service.vehicle.gimbal.update(state, self.time)
            service.vehicle.pilot.update_state(state, self.time, i in touching or self.tick == 0)

    def _read_throttle(self, i: int) -> float:
        """Return the mean speed of the forward rotors of a vehicle relative to the maximum."""
        airframe = self.airspace.airframes[i]
        rotors = list(airframe.forward_rotors)
        if not rotors:
            return 0.0
        mean = float(self.airspace.swarm.rotor_speed[i, rotors].mean())
        return mean / airframe.max_rotor_speed

    def _set_rotors(self, i: int, effectiveness: Sequence[float]) -> None:
        """Set the effectiveness of the rotors of a vehicle, see `Airspace.set_condition`."""
        self.airspace.set_condition(i, rotor_effectiveness=effectiveness)

    def _locate(self, i: int) -> list[float]:
        """Return the geodetic pose of a vehicle, see `MavlinkVehicle.locate`.

        All poses of a step are computed together, when the first one is requested.
        """
        if self._geodetic_poses is None:
            swarm = self.airspace.swarm
            turns = attitude_to_ned(swarm.quaternion, scalar_first=True)
            places = self.origin.to_geodetic(swarm.position)
            self._geodetic_poses = np.concatenate([places, turns], axis=1).tolist()
        return self._geodetic_poses[i]

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()
