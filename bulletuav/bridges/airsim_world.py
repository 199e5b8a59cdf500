"""Vehicles of AirSim's API in one airspace: motions, contacts and states, without a network."""

import functools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.analysis.markers import MarkerLog
from bulletuav.bridges.airsim_beams import DEFAULT_LIDAR, DEFAULT_LIDAR_NAME, RangeFinder
from bulletuav.bridges.airsim_cameras import make_cameras, make_external_cameras
from bulletuav.bridges.airsim_settings import AirsimSettings, VehicleSettings
from bulletuav.bridges.airsim_values import attitude_from_airsim, yaw_from_airsim
from bulletuav.bridges.airsim_vehicle import AirsimVehicle, Collision
from bulletuav.bridges.setpoints import (
    SetpointController,
    State,
    apply_commands,
    make_airspace,
    require_hovering,
)
from bulletuav.earth import Origin, ned_to_enu
from bulletuav.envs.airspace import Airspace
from bulletuav.errors import as_int, as_sequence, former_names, points_of, shown, unknown
from bulletuav.geometry.rotation import from_euler
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND

PHYSICS_HZ, DECISION_HZ = 500, 100
"""Rates of physics steps and of commands, Hz"""
HOME = (47.641468, -122.140165, 122.0)
"""Origin of AirSim's worlds: latitude, longitude (degrees), altitude (m)"""
SPACING = 2.0
"""Default distance between neighbours at the start, m"""
MIN_COLLISION_SPEED = 1.0
"""Minimum impact speed at which ground contact counts as a collision, m/s"""
MAX_VEHICLES, MAX_NAME = 256, 64
"""Maximum number of vehicles, and maximum length of their names"""
OBJECT_NAMES = re.compile(r"Ground|Building|Obstacle\d+")
"""Names of objects of the scene, which vehicles cannot have"""
CLEARANCE = 100.0
"""Height above all others at which a new vehicle is created before it is placed, m"""
DEFAULT_NAMES = ("SimpleFlight", "PX4")
"""Names of AirSim's default vehicles, which also mean a single vehicle of another name"""


class AirsimWorld:
    """N vehicles in one airspace that clients fly.

    Attributes:
        airspace: Airspace of the vehicles.
        vehicles: Vehicles by name, in order.
        external_cameras: Cameras that stand in the world, by name.
        settings: Settings of the world.
        origin: Geodetic position of the origin of the airspace.
        segmentation_ids: Segmentation ids that were set, by name of the object.
        paused: Whether simulated time stands still.
        markers: Log of the markers that clients plot; None if no replay shows them.
        acceleration: (N, 3) accelerations in the last step, m/s^2, east, north, up.
        angular_acceleration: (N, 3) angular accelerations in the last step, rad/s^2, body axes
            (FLU).
    """

    def __init__(
        self,
        drones: int | Sequence[str] = 1,
        airframe: Any = "iris",
        *,
        places: Any = None,
        home: Sequence[float] | None = None,
        lidar: bool = False,
        settings: AirsimSettings | None = None,
        **options: Any,
    ) -> None:
        """Place vehicles on the ground, facing north.

        Args:
            drones: Number of vehicles, or their names. By default one vehicle is called
                "SimpleFlight", several are "Drone1", "Drone2" and so on, as in AirSim's
                documentation.
            airframe: Airframe of the vehicles.
            places: (N, 2) start positions, east and north, m; by default 2 m apart to the east.
            home: Latitude, longitude (degrees) and altitude (m) of the origin; by default that of
                the settings, or of AirSim's worlds.
            lidar: Whether vehicles carry a lidar with 180 beams.
            settings: Settings of a file, see `read_airsim_settings`. Its vehicles replace
                `drones` and `places`; `home` and `wind` override the origin and wind of the
                settings.
            **options: Other options of `Airspace`, such as obstacles, a layout, sensors or wind.

        Raises:
            ValueError: If an option is invalid.
        """
        self.settings = settings = settings or AirsimSettings()
        self._airframe, self._has_lidar = load_airframe(airframe), lidar
        require_hovering(self._airframe, "AirSim")
        vehicles = _list_vehicles(drones, places, settings)
        # Clients rely on AirSim's rate
        if "decision_hz" in options:
            raise ValueError(
                f"decision_hz is fixed at {DECISION_HZ} for clients of AirSim: leave it out"
            )
        self.vehicles = {name: self._make_vehicle(name, one) for name, one in vehicles.items()}
        self.segmentation_ids: dict[str, int] = {}
        self.external_cameras = make_external_cameras(settings.external_cameras)
        # Options of the caller override the defaults and the settings
        wind = {} if settings.wind is None else {"wind": tuple(ned_to_enu(settings.wind).tolist())}
        self._options = {
            "physics_hz": PHYSICS_HZ,
            "decision_hz": DECISION_HZ,
            **wind,
            **options,
        }
        self.airspace = make_airspace(self._starts, self._airframe, **self._options)
        self.origin = Origin(*as_sequence("home", home or settings.origin or HOME, 3))
        # Clock, and accelerations, which are computed from differences of velocities
        self.paused = False
        self.markers: MarkerLog | None = None
        self._due, self._ticks, self._start_time = 0.0, 0, 0.0
        self._velocity = self.airspace.swarm.velocity.copy()
        self._rates = self.airspace.swarm.rates.copy()
        self.acceleration = np.zeros_like(self._velocity)
        self.angular_acceleration = np.zeros_like(self._rates)
        self.reset()

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._start_time + self.airspace.time

    @property
    def _starts(self) -> np.ndarray:
        """Start positions (N, 3) of the vehicles, m."""
        return np.array([vehicle.start for vehicle in self.vehicles.values()])

    def _make_vehicle(self, name: str, settings: VehicleSettings) -> AirsimVehicle:
        """Return a vehicle that stands at its place, or starts above it."""
        north, east, down = settings.place
        height = self._airframe.standing_height + max(-down, 0.0)
        sensors = dict(settings.sensors)
        if self._has_lidar:
            sensors.setdefault(DEFAULT_LIDAR_NAME, DEFAULT_LIDAR)
        return AirsimVehicle(
            name,
            np.array((east, north, height)),
            SetpointController(self._airframe),
            from_euler(0.0, 0.0, yaw_from_airsim(settings.yaw)),
            settings.is_armed,
            make_cameras(self._airframe, self.settings.cameras, settings.cameras),
            {name: RangeFinder(one) for name, one in sensors.items()},
        )

    @property
    def clock(self) -> float:
        """Time since the last reset, s.

        Motions use this clock, so that they repeat to the last bit.
        """
        return self._ticks / DECISION_HZ

    def add_vehicle(self, name: str, settings: VehicleSettings) -> None:
        """Add a vehicle, at the next free place to the east of its own.

        An airspace has a fixed number of drones. Therefore a new one replaces it, with the states
        of the vehicles and obstacles; gusts start again.

        Args:
            name: Name of the vehicle.
            settings: Its place, cameras and sensors.

        Raises:
            ValueError: If the name is not free, there is no free place, or the airspace has bodies
                of `add_body`.
        """
        check_new_name(name, self.vehicles)
        old = self.airspace
        if len(old.world.engine.scenery.bodies.reach):
            raise ValueError("no vehicle can be added to an airspace with bodies of add_body")
        vehicle = self._make_vehicle(name, settings)
        swarm, state, count = old.swarm, old.world.state, len(self.vehicles)
        above = np.array((0.0, 0.0, swarm.position[:, 2].max() + CLEARANCE))
        airspace = make_airspace(
            np.vstack([swarm.position, vehicle.start + above]),
            self._airframe,
            **self._options,
            quaternion=np.vstack([swarm.quaternion, vehicle.attitude]),
        )
        try:
            airspace.set_wind(old.world.wind.steady[0].tolist())
            for k in range(state.obstacle.shape[1]):
                pose = (state.obstacle[0, k].tolist(), state.obstacle_turn[0, k].tolist())
                airspace.place_obstacle(k, *pose, state.obstacle_velocity[0, k].tolist())
            airspace.place(list(range(count)), *(array.tolist() for array in swarm[:5]))
            _place_beside(airspace, count, vehicle)
        except ValueError:
            airspace.close()
            raise
        self._start_time = self.time
        self.airspace, self.vehicles = airspace, {**self.vehicles, name: vehicle}
        old.close()
        for field in ("_velocity", "_rates", "acceleration", "angular_acceleration"):
            setattr(self, field, np.vstack([getattr(self, field), np.zeros(3)]))

    def vehicle(self, name: Any) -> tuple[int, AirsimVehicle]:
        """Return the index of a vehicle, and the vehicle.

        Args:
            name: Name of the vehicle; empty for the first. A single vehicle also answers to
                `DEFAULT_NAMES`.

        Raises:
            ValueError: If no vehicle has that name.
        """
        is_default = len(self.vehicles) == 1 and name in DEFAULT_NAMES
        if name == "" or is_default:
            name = next(iter(self.vehicles))
        if not isinstance(name, str) or name not in self.vehicles:
            raise unknown("vehicle", name, self.vehicles)
        return list(self.vehicles).index(name), self.vehicles[name]

    def state(self, i: int) -> State:
        """Return position, quaternion, velocity and angular rates of vehicle `i`."""
        swarm = self.airspace.swarm
        return (
            swarm.position[i].tolist(),
            swarm.quaternion[i].tolist(),
            swarm.velocity[i].tolist(),
            swarm.rates[i].tolist(),
        )

    def step(self) -> None:
        """Step the simulation by 10 ms.

        Raises:
            RuntimeError: If the simulation diverged, or the airspace is closed.
        """
        commands = [
            vehicle.compute_command(self.state(i), self.clock, self.airspace.period)
            for i, vehicle in enumerate(self.vehicles.values())
        ]
        apply_commands(self.airspace, commands)
        self.airspace.step()
        self._ticks += 1
        swarm, period = self.airspace.swarm, self.airspace.period
        self.acceleration = (swarm.velocity - self._velocity) / period
        self.angular_acceleration = (swarm.rates - self._rates) / period
        self._velocity, self._rates = swarm.velocity.copy(), swarm.rates.copy()
        self._record_contacts()
        for i, vehicle in enumerate(self.vehicles.values()):
            vehicle.check_motion(self.state(i), self.clock)

    def count_steps(self, seconds: float) -> int:
        """Convert a duration to a number of steps, and carry the remainder over to the next call.

        Args:
            seconds: Simulated duration, s.

        Returns:
            Number of steps.
        """
        self._due += seconds * DECISION_HZ
        steps = math.floor(self._due + 1e-6)
        self._due -= steps
        return max(steps, 0)

    def _record_contacts(self) -> None:
        """Update collisions and standing of all vehicles from the contacts of the last step."""
        contacts = self.airspace.contacts
        vehicles = list(self.vehicles.values())
        # Standing is determined in each step
        for vehicle in vehicles:
            vehicle.is_standing = False
        for k, i in enumerate(contacts.drone.tolist()):
            # A vehicle stands on a contact whose normal points up
            other, normal = int(contacts.other[k]), contacts.normal[k]
            vehicle = vehicles[i]
            vehicle.is_standing = vehicle.is_standing or bool(normal[2] > 0.7)
            # A soft landing is not a collision
            if other == GROUND and -contacts.velocity[k, 2] < MIN_COLLISION_SPEED:
                continue
            hit = vehicle.collision = Collision()
            hit.has_collided, hit.time = True, self.time
            hit.object_name, hit.object_id = self.object_name(other), other
            hit.point, hit.normal = contacts.point[k].copy(), normal.copy()
            hit.position = self.airspace.swarm.position[i].copy()
            hit.depth = float(contacts.depth[k])

    def object_name(self, other: int) -> str:
        """Return the name of an object, given its number in `Contacts`."""
        if other >= 0:
            return list(self.vehicles)[other]
        if other <= FIRST_OBSTACLE:
            return f"Obstacle{FIRST_OBSTACLE - other}"
        return {GROUND: "Ground", CITY: "Building"}[other]

    def place(
        self,
        i: int,
        position: np.ndarray,
        orientation: np.ndarray,
        velocity: Sequence[float] = (0.0, 0.0, 0.0),
        rates: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Place a vehicle, by default at rest; a flying vehicle then holds the position.

        Args:
            i: Index of the vehicle.
            position: (3,) position north, east, down of the vehicle's start, m; NaN leaves a
                coordinate unchanged.
            orientation: (4,) quaternion x, y, z, w (FRD to NED); NaN leaves the attitude unchanged.
            velocity: (3,) east, north, up, m/s.
            rates: (3,) angular velocity in body axes (FLU), rad/s.

        Raises:
            ValueError: If the vehicle would overlap another object; nothing changes then.
        """
        swarm, vehicle = self.airspace.swarm, list(self.vehicles.values())[i]
        target = vehicle.start + np.array([position[1], position[0], -position[2]])
        target = np.where(np.isfinite(target), target, swarm.position[i])
        # A vehicle that is placed on the ground stands on it, despite rounding of coordinates
        if abs(target[2] - vehicle.start[2]) < 1e-3:
            target[2] = vehicle.start[2]
        attitude = (
            attitude_from_airsim(orientation)
            if np.isfinite(orientation).all()
            else swarm.quaternion[i].copy()
        )
        rotor_speed = "hover" if vehicle.is_flying else 0.0
        # Lists, because errors show their numbers plainly
        place = functools.partial(
            self.airspace.place, i, velocity=velocity, rates=rates, rotor_speed=rotor_speed
        )
        try:
            place(target.tolist(), attitude.tolist())
        except ValueError:
            # A tilted vehicle on the ground is lifted, as AirSim does
            lowest = self._airframe.collision_radius
            if not 0.0 <= target[2] < lowest:
                raise
            place([*target[:2].tolist(), lowest], attitude.tolist())
        self._reset_accelerations(i)
        vehicle.reset_after_placement(self.state(i))

    def _reset_accelerations(self, drones: Any) -> None:
        """Clear the velocity differences of drones that were placed."""
        self._velocity[drones] = self.airspace.swarm.velocity[drones]
        self._rates[drones] = self.airspace.swarm.rates[drones]
        self.acceleration[drones] = self.angular_acceleration[drones] = 0.0

    def reset(self) -> None:
        """Place all vehicles at their start positions with stopped motors; time goes on."""
        for vehicle in self.vehicles.values():
            vehicle.restart()
        attitudes = [vehicle.attitude for vehicle in self.vehicles.values()]
        self.airspace.place(None, self._starts, attitudes)
        self._reset_accelerations(slice(None))
        self._due, self._ticks = 0.0, 0

    def warm_up(self) -> None:
        """Compile the simulation, which takes a minute the first time; the vehicles do not move."""
        self.airspace.warm_up()
        self.reset()

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()


def check_new_name(name: str, names: Collection[str]) -> None:
    """Raise ValueError if a new vehicle cannot have a name."""
    if OBJECT_NAMES.fullmatch(name):
        raise ValueError(
            f"vehicle_name is {shown(name)}, the name of another object: choose another name"
        )
    if not 0 < len(name) <= MAX_NAME or not name.isprintable() or name in names:
        raise ValueError(
            f"vehicle_name is {shown(name)}: a new name of 1 to {MAX_NAME} printable letters is "
            f"needed"
        )
    if len(names) >= MAX_VEHICLES:
        raise ValueError(f"there are {MAX_VEHICLES} vehicles, which is the maximum")


def _place_beside(airspace: Airspace, i: int, vehicle: AirsimVehicle) -> None:
    """Place a new drone at its start, or at the next free place to the east.

    Raises:
        ValueError: If there is no free place.
    """
    for k in range(MAX_VEHICLES + 1):
        try:
            airspace.place(i, vehicle.start.tolist(), vehicle.attitude)
        except ValueError:
            if k == MAX_VEHICLES:
                raise
            vehicle.start[0] += SPACING
        else:
            return


def _list_vehicles(
    drones: int | Sequence[str], places: Any, settings: AirsimSettings
) -> Mapping[str, VehicleSettings]:
    """Return the settings of the vehicles by name.

    Raises:
        ValueError: If a name, a number or a place is invalid.
    """
    if settings.vehicles is not None:
        for name in settings.vehicles:
            check_new_name(name, ())
        if drones != 1 or places is not None:
            raise ValueError(
                f"drones is {shown(drones)} and places are {shown(places)}, but the settings list "
                f"the vehicles {', '.join(settings.vehicles)}: leave drones and places out"
            )
        return settings.vehicles
    names = _make_names(drones)
    start_xy = [(SPACING * k, 0.0) for k in range(len(names))] if places is None else places
    if len(start_xy) != len(names):
        raise ValueError(f"places are {len(start_xy)}: one for each of {len(names)} is needed")
    points = points_of("places", [(*one, 0.0) for one in start_xy]).tolist()
    return {
        name: VehicleSettings((north, east, 0.0), sensors=settings.sensors)
        for name, (east, north, _) in zip(names, points, strict=True)
    }


def _make_names(drones: int | Sequence[str]) -> tuple[str, ...]:
    """Return the names of the vehicles, given their number or their names."""
    if isinstance(drones, int):
        count = as_int("drones", drones, 1, MAX_VEHICLES)
        return ("SimpleFlight",) if count == 1 else tuple(f"Drone{k + 1}" for k in range(count))
    names = as_sequence("drones", drones, most=MAX_VEHICLES)
    if not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError(
            f"drones is {shown(drones)}: a number of vehicles, or their names, is needed"
        )
    for name in names:
        check_new_name(name, ())
    if len(set(names)) < len(names):
        raise ValueError(f"drones is {shown(drones)}: names must be unique")
    return names


__getattr__ = former_names(__name__, {"World": "AirsimWorld"})
