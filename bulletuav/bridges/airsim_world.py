"""Vehicles of AirSim's API in one airspace: motions, contacts and states, without a network."""

import math
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
from bulletuav.errors import as_int, as_sequence, former_names, points_of, shown, unknown
from bulletuav.sensors.imperfect import Imperfect
from bulletuav.sensors.lidar import Lidar
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
MAX_VEHICLES = 256
"""Maximum number of vehicles"""
LIDAR_OPTIONS: dict[str, Any] = {
    "num_beams": 36,
    "lidar_elevations": (-45.0, -30.0, -15.0, 0.0, 15.0),
    "max_range": 40.0,
}
"""Options of `Airspace` for the beams of the lidar"""
LIDAR_HZ = 10
"""Rate of lidar measurements, Hz"""


class Collision:
    """Last collision of a vehicle since a client read it.

    Attributes:
        has_collided: Whether the vehicle has collided.
        time: Time of the collision, s.
        object_name: Name of the other object.
        object_id: Number of the other object in `Contacts`; -1 for none.
        point, normal: (3,) contact point, m, and contact normal towards the vehicle, east, north,
            up.
        position: (3,) position of the vehicle at the collision, m.
        depth: Penetration depth, m.
    """

    def __init__(self) -> None:
        """Create a record without a collision."""
        self.has_collided, self.time, self.object_name, self.object_id = False, 0.0, "", -1
        self.point = self.normal = self.position = np.zeros(3)
        self.depth = 0.0


class AirsimVehicle:
    """State of one vehicle: control, arming, motion and collision.

    Attributes:
        name: Name that clients use.
        start: (3,) start position, m: the origin of the vehicle's coordinates.
        is_api_controlled: Whether a client has API control.
        is_armed: Whether the motors are armed.
        collision: Last collision.
        is_standing: Whether the vehicle touches a surface that it can stand on.
    """

    def __init__(self, name: str, start: np.ndarray, controller: SetpointController) -> None:
        """Create a vehicle on the ground with stopped motors."""
        self.name, self.start, self._controller = name, start, controller
        self.collision = Collision()
        self._motion: MotionPrimitive = MotorsOff()
        self._done_callback: DoneCallback | None = None
        self.restart()

    def restart(self) -> None:
        """Reset the vehicle to its initial state; the present motion fails."""
        self.finish(False)
        self._controller.reset()
        self._motion = MotorsOff()
        self.is_api_controlled = self.is_armed = False
        self.collision, self.is_standing = Collision(), True

    @property
    def is_flying(self) -> bool:
        """Whether the motors turn."""
        return not isinstance(self._motion, MotorsOff)

    def start_motion(self, motion: MotionPrimitive, done_callback: DoneCallback) -> None:
        """Start a motion; the present motion fails.

        Args:
            motion: The motion.
            done_callback: Function that is called with the outcome when the motion ends.
        """
        self.finish(False)
        self._motion, self._done_callback = motion, done_callback

    def finish(self, success: bool) -> None:
        """Report the outcome of the present motion to its client."""
        done_callback, self._done_callback = self._done_callback, None
        if done_callback is not None:
            done_callback(success)

    def hold_position(self, state: State) -> None:
        """End the present motion, and hold the position if the motors turn."""
        self.finish(False)
        if self.is_flying:
            self._motion = HoldPosition(state)

    def reset_after_placement(self, state: State) -> None:
        """Clear the collision and the held yaw after a placement, and hold the position."""
        self.collision = Collision()
        self._controller.reset()
        self.hold_position(state)

    def stop_motors(self) -> None:
        """End the present motion and stop the motors."""
        self.finish(False)
        self._motion = MotorsOff()

    def compute_command(self, state: State, now: float, period: float) -> AirspaceCommand | None:
        """Return the command of the next step; None stops the motors.

        Args:
            state: State of the vehicle.
            now: Time, s.
            period: Duration of the step, s.
        """
        setpoint = self._motion.get_setpoint(state, now) if self.is_armed else None
        if isinstance(setpoint, Setpoint):
            return self._controller.compute_command(setpoint, state, period)
        return setpoint

    def check_motion(self, state: State, now: float) -> None:
        """End the present motion if it has succeeded or failed."""
        if self._done_callback is None:
            return
        outcome = self._motion.check_outcome(state, now, self.is_standing)
        if outcome is not None:
            self._motion = self._motion.get_next_motion(state)
            self.finish(outcome)


class AirsimWorld:
    """N vehicles in one airspace that clients fly.

    Attributes:
        airspace: Airspace of the vehicles.
        vehicles: Vehicles by name, in order.
        origin: Geodetic position of the origin of the airspace.
        paused: Whether simulated time stands still.
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
        home: Sequence[float] = HOME,
        lidar: bool = False,
        **options: Any,
    ) -> None:
        """Place vehicles on the ground, facing north.

        Args:
            drones: Number of vehicles, or their names. By default one vehicle is called
                "SimpleFlight", several are "Drone1", "Drone2" and so on, as in AirSim's
                documentation.
            airframe: Airframe of the vehicles.
            places: (N, 2) start positions, east and north, m; by default 2 m apart to the east.
            home: Latitude, longitude (degrees) and altitude (m) of the origin.
            lidar: Whether vehicles carry a lidar with 180 beams.
            **options: Other options of `Airspace`, such as obstacles, a layout, sensors or wind.

        Raises:
            ValueError: If an option is invalid.
        """
        # Validate names and places together
        airframe_data = load_airframe(airframe)
        names = _make_names(drones)
        start_xy = [(SPACING * k, 0.0) for k in range(len(names))] if places is None else places
        if len(start_xy) != len(names):
            raise ValueError(f"places are {len(start_xy)}: one for each of {len(names)} is needed")
        self._starts = points_of(
            "places", [(*one, airframe_data.standing_height) for one in start_xy]
        )
        # Clients rely on AirSim's rate
        if "decision_hz" in options:
            raise ValueError(
                f"decision_hz is fixed at {DECISION_HZ} for clients of AirSim: leave it out"
            )
        # Options of the caller override the defaults
        airspace_options = {"physics_hz": PHYSICS_HZ, "decision_hz": DECISION_HZ, **options}
        if lidar:
            airspace_options |= {"sensors": (Imperfect(Lidar(), rate=LIDAR_HZ),), **LIDAR_OPTIONS}
        self.airspace = make_airspace(self._starts, airframe_data, **airspace_options)
        self.origin = Origin(*as_sequence("home", home, 3))
        # Each vehicle has a controller of its own
        self.vehicles = {
            name: AirsimVehicle(name, start, SetpointController(airframe_data))
            for name, start in zip(names, self._starts, strict=True)
        }
        # Clock, and accelerations, which are computed from differences of velocities
        self.paused = False
        self._due, self._ticks = 0.0, 0
        self._velocity = self.airspace.swarm.velocity.copy()
        self._rates = self.airspace.swarm.rates.copy()
        self.acceleration = np.zeros_like(self._velocity)
        self.angular_acceleration = np.zeros_like(self._rates)
        self.reset()

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.airspace.time

    @property
    def clock(self) -> float:
        """Time since the last reset, s.

        Motions use this clock, so that they repeat to the last bit.
        """
        return self._ticks / DECISION_HZ

    def vehicle(self, name: Any) -> tuple[int, AirsimVehicle]:
        """Return the index of a vehicle, and the vehicle.

        Args:
            name: Name of the vehicle; empty for the first.

        Raises:
            ValueError: If no vehicle has that name.
        """
        if name == "":
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
            hit.object_name, hit.object_id = self._get_object_name(other), other
            hit.point, hit.normal = contacts.point[k].copy(), normal.copy()
            hit.position = self.airspace.swarm.position[i].copy()
            hit.depth = float(contacts.depth[k])

    def _get_object_name(self, other: int) -> str:
        """Return the name of an object, given its number in `Contacts`."""
        if other >= 0:
            return list(self.vehicles)[other]
        if other <= FIRST_OBSTACLE:
            return f"Obstacle{FIRST_OBSTACLE - other}"
        return {GROUND: "Ground", CITY: "Building"}[other]

    def place(self, i: int, position: np.ndarray, orientation: np.ndarray) -> None:
        """Place a vehicle at rest; a flying vehicle holds the position.

        Args:
            i: Index of the vehicle.
            position: (3,) position north, east, down of the vehicle's start, m; NaN leaves a
                coordinate unchanged.
            orientation: (4,) quaternion x, y, z, w (FRD to NED); NaN leaves the attitude unchanged.

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
        self.airspace.place(i, target.tolist(), attitude.tolist(), rotor_speed=rotor_speed)
        self._reset_accelerations(i)
        vehicle.reset_after_placement(self.state(i))

    def _reset_accelerations(self, drones: Any) -> None:
        """Clear the velocity differences of drones that were placed."""
        self._velocity[drones] = self._rates[drones] = 0.0
        self.acceleration[drones] = self.angular_acceleration[drones] = 0.0

    def reset(self) -> None:
        """Place all vehicles at their start positions with stopped motors; time goes on."""
        for vehicle in self.vehicles.values():
            vehicle.restart()
        self.airspace.place(None, self._starts, NORTH)
        self._reset_accelerations(slice(None))
        self._due, self._ticks = 0.0, 0

    def warm_up(self) -> None:
        """Compile the simulation, which takes a minute the first time; the vehicles do not move."""
        self.airspace.warm_up()
        self.reset()

    def close(self) -> None:
        """Close the airspace."""
        self.airspace.close()


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
    if len(set(names)) < len(names):
        raise ValueError(f"drones is {shown(drones)}: names must be unique")
    return names


__getattr__ = former_names(__name__, {"World": "AirsimWorld"})
