"""Vehicles of AirSim's calls in one airspace: what they do, touch and feel, without a network."""

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_values import attitude_from_airsim
from bulletuav.bridges.motions import DoneCallback, HoldPosition, MotionPrimitive, MotorsOff
from bulletuav.bridges.setpoints import (
    NORTH,
    AirspaceCommand,
    Setpoint,
    SetpointController,
    State,
    apply_commands,
    make_airspace,
)
from bulletuav.earth import Origin
from bulletuav.errors import as_int, as_sequence, points_of, shown, unknown
from bulletuav.sensors.imperfect import Imperfect
from bulletuav.sensors.lidar import Lidar
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND

PHYSICS_HZ, DECISION_HZ = 500, 100
"""Steps of physics, and of commands, a second"""
HOME = (47.641468, -122.140165, 122.0)
"""Where AirSim's worlds are: latitude, longitude (degrees), altitude (m)"""
SPACING = 2.0
"""Distance between neighbours at the start, m"""
MIN_COLLISION_SPEED = 1.0
"""Speed onto the ground from which on a touch is a collision, m/s"""
MAX_VEHICLES = 256
LIDAR_OPTIONS: dict[str, Any] = {
    "num_beams": 36,
    "lidar_elevations": (-45.0, -30.0, -15.0, 0.0, 15.0),
    "max_range": 40.0,
}
"""Beams of the range finder: options of `Airspace`"""
LIDAR_HZ = 10
"""How often it measures a second"""


class Collision:
    """What a vehicle has hit since somebody asked.

    Attributes:
        has_collided: Whether it has hit something.
        time: When, s.
        name: Of what it hit.
        number: Of what it hit; -1 for nothing.
        point, normal: (3,) where, m, and in which direction it was pushed, east, north, up.
        place: (3,) of the vehicle then, m.
        depth: How deep shapes overlapped, m.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.has_collided, self.time, self.object_name, self.object_id = False, 0.0, "", -1
        self.point = self.normal = self.position = np.zeros(3)
        self.depth = 0.0


class AirsimVehicle:
    """One drone.

    Attributes:
        name: As clients call it.
        start: (3,) where it starts, m: the origin of its coordinates.
        is_ours: Whether a client has asked for control.
        is_armed: Whether motors may turn.
        collision: What it has hit.
        stands: Whether it touches what it can stand on.
    """

    def __init__(self, name: str, start: np.ndarray, controller: SetpointController) -> None:
        """Begin on the ground, motors off."""
        self.name, self.start, self._controller = name, start, controller
        self.collision = Collision()
        self._motion: MotionPrimitive = MotorsOff()
        self._done_callback: DoneCallback | None = None
        self.restart()

    def restart(self) -> None:
        """Begin anew; a motion that goes on ends."""
        self.finish(False)
        self._controller.reset()
        self._motion = MotorsOff()
        self.is_api_controlled = self.is_armed = False
        self.collision, self.is_standing = Collision(), True

    @property
    def is_flying(self) -> bool:
        """Whether its motors turn."""
        return not isinstance(self._motion, MotorsOff)

    def start_motion(self, motion: MotionPrimitive, done_callback: DoneCallback) -> None:
        """Do something else from now on; who asked for what it did is told that it is over."""
        self.finish(False)
        self._motion, self._done_callback = motion, done_callback

    def finish(self, success: bool) -> None:
        """Tell who asked for the motion that it is over."""
        done_callback, self._done_callback = self._done_callback, None
        if done_callback is not None:
            done_callback(success)

    def hold_position(self, state: State) -> None:
        """Stay where it is, if it flies."""
        self.finish(False)
        if self.is_flying:
            self._motion = HoldPosition(state)

    def reset_after_placement(self, state: State) -> None:
        """Stay where it was put, if it flies; it has hit nothing there."""
        self.collision = Collision()
        self._controller.reset()
        self.hold_position(state)

    def stop_motors(self) -> None:
        """Switch motors off."""
        self.finish(False)
        self._motion = MotorsOff()

    def compute_command(self, state: State, now: float, period: float) -> AirspaceCommand | None:
        """Tell the command of the next step; None for motors off."""
        setpoint = self._motion.get_setpoint(state, now) if self.is_armed else None
        if isinstance(setpoint, Setpoint):
            return self._controller.compute_command(setpoint, state, period)
        return setpoint

    def check_motion(self, state: State, now: float) -> None:
        """Look whether the motion has come to its end."""
        if self._done_callback is None:
            return
        outcome = self._motion.check_outcome(state, now, self.is_standing)
        if outcome is not None:
            self._motion = self._motion.get_next_motion(state)
            self.finish(outcome)


class AirsimWorld:
    """N vehicles in one airspace, which clients fly.

    Attributes:
        airspace: Where they fly.
        vehicles: By name, in order.
        origin: Place on the Earth of the airspace's origin.
        paused: Whether time stands still.
        acceleration: (N, 3) of the last step, m/s^2, east, north, up.
        turning: (N, 3) angular acceleration of the last step, rad/s^2, body.
    """

    def __init__(
        self,
        drones: int | Sequence[str] = 1,
        airframe: Any = "iris",
        *,
        places: Any = None,
        home: Sequence[float] = HOME,
        lidar: bool = False,
        **options: Any,
    ) -> None:
        """Put vehicles on the ground; they look north.

        Args:
            drones: How many there are, or their names. One is called "SimpleFlight", several
                "Drone1" and so on, as in AirSim's documentation.
            airframe: Their airframe.
            places: (N, 2) where they stand, east and north, m; left out, 2 m apart to the east.
            home: Latitude, longitude (degrees) and altitude (m) of the origin.
            lidar: Whether vehicles carry a range finder of 180 beams.
            **options: More options of `Airspace`, such as obstacles, a layout, sensors or wind.

        Raises:
            ValueError: An option cannot be.
        """
        # Names and places, checked together
        airframe_data = load_airframe(airframe)
        names = _make_names(drones)
        flat = [(SPACING * k, 0.0) for k in range(len(names))] if places is None else places
        if len(flat) != len(names):
            raise ValueError(f"places are {len(flat)}: one for each of {len(names)} is needed")
        self._starts = points_of("places", [(*one, airframe_data.standing_height) for one in flat])
        # Clients count on the rate of AirSim
        if "decision_hz" in options:
            raise ValueError(f"decision_hz is {DECISION_HZ} for clients of AirSim: leave it out")
        # Options of the caller go before the usual ones
        known = {"physics_hz": PHYSICS_HZ, "decision_hz": DECISION_HZ, **options}
        if lidar:
            known |= {"sensors": (Imperfect(Lidar(), rate=LIDAR_HZ),), **LIDAR_OPTIONS}
        self.airspace = make_airspace(self._starts, airframe_data, **known)
        self.origin = Origin(*as_sequence("home", home, 3))
        # Each vehicle starts on its feet and has a guide of its own
        self.vehicles = {
            name: AirsimVehicle(name, start, SetpointController(airframe_data))
            for name, start in zip(names, self._starts, strict=True)
        }
        # Clock, and accelerations, which come from differences of velocities
        self.paused = False
        self._due, self._ticks = 0.0, 0
        self._velocity = self.airspace.swarm.velocity.copy()
        self._rates = self.airspace.swarm.rates.copy()
        self.acceleration = np.zeros_like(self._velocity)
        self.angular_acceleration = np.zeros_like(self._rates)
        self.reset()

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.airspace.time

    @property
    def clock(self) -> float:
        """Time since the last reset, s: motions go by it, so that they repeat to the last bit."""
        return self._ticks / DECISION_HZ

    def vehicle(self, name: Any) -> tuple[int, AirsimVehicle]:
        """Find a vehicle.

        Args:
            name: Its name; empty for the first.

        Raises:
            ValueError: There is none of that name.
        """
        if name == "":
            name = next(iter(self.vehicles))
        if not isinstance(name, str) or name not in self.vehicles:
            raise unknown("vehicle", name, self.vehicles)
        return list(self.vehicles).index(name), self.vehicles[name]

    def state(self, i: int) -> State:
        """Tell position, quaternion, velocity and rates of a drone."""
        swarm = self.airspace.swarm
        return (
            swarm.position[i].tolist(),
            swarm.quaternion[i].tolist(),
            swarm.velocity[i].tolist(),
            swarm.rates[i].tolist(),
        )

    def step(self) -> None:
        """Fly for 10 ms.

        Raises:
            RuntimeError: The flight diverged, or the airspace is closed.
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
        """Tell how many steps a time takes; what is left over counts for the next time.

        Args:
            seconds: Time to fly, s.

        Returns:
            Steps.
        """
        self._due += seconds * DECISION_HZ
        steps = math.floor(self._due + 1e-6)
        self._due -= steps
        return max(steps, 0)

    def _record_contacts(self) -> None:
        """Note what was touched in the last step."""
        contacts = self.airspace.contacts
        vehicles = list(self.vehicles.values())
        # Standing is told anew in each step
        for vehicle in vehicles:
            vehicle.is_standing = False
        for k, i in enumerate(contacts.drone.tolist()):
            # A contact from below is what it stands on
            other, normal = int(contacts.other[k]), contacts.normal[k]
            vehicle = vehicles[i]
            vehicle.is_standing = vehicle.is_standing or bool(normal[2] > 0.7)
            # A soft landing is no collision
            if other == GROUND and -contacts.velocity[k, 2] < MIN_COLLISION_SPEED:
                continue
            hit = vehicle.collision = Collision()
            hit.has_collided, hit.time = True, self.time
            hit.object_name, hit.object_id = self._get_object_name(other), other
            hit.point, hit.normal = contacts.point[k].copy(), normal.copy()
            hit.position = self.airspace.swarm.position[i].copy()
            hit.depth = float(contacts.depth[k])

    def _get_object_name(self, other: int) -> str:
        """Name what was touched, by its number in `Contacts`."""
        if other >= 0:
            return list(self.vehicles)[other]
        if other <= FIRST_OBSTACLE:
            return f"Obstacle{FIRST_OBSTACLE - other}"
        return {GROUND: "Ground", CITY: "Building"}[other]

    def place(self, i: int, position: np.ndarray, orientation: np.ndarray) -> None:
        """Put a drone somewhere at rest, where it stays if it flew.

        Args:
            i: Its index.
            place: (3,) north, east, down of its start, m; NaN for as it is.
            turn: (4,) x, y, z, w of its orientation; NaN for as it is.

        Raises:
            ValueError: It would overlap something; all stays as it was.
        """
        swarm, vehicle = self.airspace.swarm, list(self.vehicles.values())[i]
        target = vehicle.start + np.array([position[1], position[0], -position[2]])
        target = np.where(np.isfinite(target), target, swarm.position[i])
        # Who is put onto the ground stands on it, however coordinates are rounded.
        if abs(target[2] - vehicle.start[2]) < 1e-3:
            target[2] = vehicle.start[2]
        attitude = (
            attitude_from_airsim(orientation)
            if np.isfinite(orientation).all()
            else swarm.quaternion[i].copy()
        )
        rotor_speed = "hover" if vehicle.is_flying else 0.0
        # As lists, so that errors show plain numbers
        self.airspace.place(i, target.tolist(), attitude.tolist(), rotor_speed=rotor_speed)
        self._reset_accelerations(i)
        vehicle.reset_after_placement(self.state(i))

    def _reset_accelerations(self, drones: Any) -> None:
        """Forget how drones moved before they were placed."""
        self._velocity[drones] = self._rates[drones] = 0.0
        self.acceleration[drones] = self.angular_acceleration[drones] = 0.0

    def reset(self) -> None:
        """Put all vehicles back to where they started, motors off; time goes on."""
        for vehicle in self.vehicles.values():
            vehicle.restart()
        self.airspace.place(None, self._starts, NORTH)
        self._reset_accelerations(slice(None))
        self._due, self._ticks = 0.0, 0

    def warm_up(self) -> None:
        """Compile what flies, which takes a minute the first time; drones stay where they are."""
        self.airspace.warm_up()
        self.reset()

    def close(self) -> None:
        """Free the airspace."""
        self.airspace.close()


def _make_names(drones: int | Sequence[str]) -> tuple[str, ...]:
    """Tell the names of vehicles, of which there are some or which are given."""
    if isinstance(drones, int):
        count = as_int("drones", drones, 1, MAX_VEHICLES)
        return ("SimpleFlight",) if count == 1 else tuple(f"Drone{k + 1}" for k in range(count))
    names = as_sequence("drones", drones, most=MAX_VEHICLES)
    if not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError(f"drones is {shown(drones)}: names, or how many, are needed")
    if len(set(names)) < len(names):
        raise ValueError(f"drones is {shown(drones)}: names that differ are needed")
    return names


def __getattr__(name: str) -> Any:
    """Return `AirsimWorld` for its old name `World`, with a warning.

    Raises:
        AttributeError: If the module has no such name.
    """
    if name == "World":
        warnings.warn(
            "World of bulletuav.bridges.airsim_world is now AirsimWorld; "
            "the old name goes in the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        return AirsimWorld
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
