"""Components and state of an airspace: one world of N drones without a task."""

from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.contact.contacts import find_overlaps, replace_scenery
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.dynamics.cables import cable_bounds
from bulletuav.dynamics.setpoints import convert
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.envs.airspace_inputs import UPRIGHT, YAW
from bulletuav.envs.bodies import Motion, follow_motion, park_body, set_body
from bulletuav.envs.cables import loosen
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.parts import BODY_BOUNDS, CONDITION_BOUNDS, Parts, num_surfaces, sensor_setup
from bulletuav.envs.snapshot import Bounds, contact_bounds, state_bounds
from bulletuav.envs.state import STATE, AirspaceState, Sizes, with_prefix
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import from_euler, heading, quat4
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Moment, Sensor
from bulletuav.tasks.frame import STANDING_TOLERANCE
from bulletuav.vehicle.swarm import CITY, GROUND, DroneArrays, Swarm

ALL = np.ones(1, dtype=bool)
"""Mask (1,) of the only world"""


class AirspaceWorld(Parts):
    """Components and state of an airspace.

    Attributes:
        state: All arrays.
        readings: Last sensor readings, arrays (N, ...) by name; new arrays in each step.
        rng: Random generator, in a list as sensors need it.
        motions: Functions of time that bodies follow, by index of the body.
    """

    def __init__(
        self,
        options: EnvOptions,
        obstacles: tuple[Obstacle, ...],
        layouts: tuple[Solids, ...],
        sensors: dict[str, Sensor],
    ) -> None:
        """Create all components and the static scene; obstacles are parked below the ground.

        Args:
            options: Common options.
            obstacles: The K obstacles.
            layouts: The city, if any.
            sensors: Sensors that all drones carry, by name.
        """
        wanted = frozenset(name for one in sensors.values() for name in one.gives)
        super().__init__(options, obstacles, layouts, sensors, sensor_setup(options, 1, wanted))
        consumes = self.dynamics.consumes
        options.check_setpoint_levels({consumes.name: consumes}, consumes)
        # Setpoints have a yaw, or a number for each rotor and control surface
        rotors, surfaces = self.hover_speed.shape[1], num_surfaces(options)
        sizes = Sizes(
            W=1,
            N=options.num_drones,
            S=max(YAW + 1, rotors + surfaces),
            K=len(obstacles),
            R=rotors,
            F=surfaces,
        )
        self.state = state = AirspaceState.make(sizes)
        state.levels[:] = int(consumes)
        state.alive[:] = True
        state.obstacle[..., 2] = -PARKING_HEIGHT
        state.obstacle_turn[:] = UPRIGHT
        self.readings = {}
        self.motions: dict[int, Motion] = {}
        self.rng = [np.random.default_rng(options.seed)]
        if layouts:
            self.engine.set_layouts(np.zeros(1, dtype=int), ALL)
        self.set_obstacles()
        self.dynamics.look_around()

    def set_obstacles(self) -> None:
        """Copy the poses of obstacles from the state to the engine."""
        self.engine.set_obstacles(self.state.obstacle, self.state.obstacle_turn, ALL)

    def place_obstacle(
        self, k: int, position: np.ndarray, quaternion: np.ndarray, velocity: np.ndarray
    ) -> None:
        """Set the pose and velocity of an obstacle.

        Raises:
            ValueError: If the obstacle would overlap a drone; the state is unchanged.
        """
        state, scenery = self.state, self.engine.scenery
        trial = scenery._replace(place=scenery.place.copy(), quaternion=scenery.quaternion.copy())
        trial.place[0, k], trial.quaternion[0, k] = position, quaternion
        self.require_free(state.swarm, state.alive, trial)
        state.obstacle_velocity[0, k] = velocity
        state.obstacle[0, k], state.obstacle_turn[0, k] = position, quaternion
        self.set_obstacles()
        # Cached contact pairs are stale
        replace_scenery(self.dynamics.contact, scenery)

    def move_body(
        self,
        b: int,
        pose: tuple[np.ndarray, np.ndarray],
        velocities: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Set the pose and the velocities of a body.

        Raises:
            ValueError: If the body would overlap a drone; the state is unchanged.
        """
        state, engine, bodies = self.state, self.engine, self.engine.scenery.bodies
        before = [array[0, b].copy() for array in bodies[:4]]
        set_body(engine, 0, b, pose, velocities)
        try:
            self.require_free(state.swarm, state.alive, engine.scenery)
        except ValueError:
            set_body(engine, 0, b, (before[0], before[1]), (before[2], before[3]))
            raise
        # Cached contact pairs are stale
        replace_scenery(self.dynamics.contact, engine.scenery)

    def remove_body(self, b: int) -> None:
        """Remove a body from the world."""
        park_body(self.engine, 0, b)
        replace_scenery(self.dynamics.contact, self.engine.scenery)

    def follow_motions(self) -> None:
        """Set the velocities of bodies that follow functions, up to the end of the next step."""
        hz = float(self.options.decision_hz)
        later = (int(self.state.steps[0]) + 1) / hz
        for b, motion in self.motions.items():
            follow_motion(self.engine, 0, b, motion, later, 1 / hz)

    def max_rotor_speed(self, rows: Any) -> np.ndarray:
        """Return the maximum speeds (M, R) of rotors, rad/s; 0 for rotors that a drone lacks."""
        fastest = np.expand_dims(self.parameters["max_rotor_speed"][0, rows], -1)
        count = np.expand_dims(self.parameters["num_rotors"][0, rows], -1)
        return np.where(np.arange(self.hover_speed.shape[1]) < count, fastest, 0.0)

    def place(
        self,
        rows: Any,
        given: tuple[np.ndarray, ...],
        cruises: bool = False,
        cruises_by_rotors: bool = False,
    ) -> None:
        """Set the state of drones.

        Args:
            rows: Drones, as an index into an axis of N.
            given: States of the drones, in the order of `Swarm`.
            cruises: Whether aircraft that cannot hover start in cruise above the ground.
            cruises_by_rotors: Whether their rotors have the speed of cruise, too.

        Raises:
            ValueError: If drones would overlap each other or the scene, or a cable would be too
                short; the state is unchanged.
        """
        swarm, before, dynamics = self.state.swarm, self.state.before, self.dynamics
        after = swarm.copy()
        # Control surfaces are centred
        for array, numbers in zip(after, (*given, 0.0), strict=True):
            array[0, rows] = numbers
        moved = np.zeros_like(self.state.alive)
        moved[0, rows] = True
        if cruises:
            self._start_cruise(after, moved[0], cruises_by_rotors)
        if dynamics.consumes < SetpointLevel.ROTOR:
            after.rotor_speed[0] = self.hover_speed
        self.require_free(after, moved, self.engine.scenery)
        loosen(dynamics, after, moved)
        for array, numbers in zip(swarm, after, strict=True):
            array[:] = numbers
        self.cascade.memory[moved] = 0.0
        dynamics.force[moved] = dynamics.torque[moved] = 0.0
        dynamics.place(swarm, moved)
        # Drones that the dynamics levelled keep their yaw
        level = np.argwhere(moved & (swarm.quaternion != after.quaternion).any(axis=-1))
        yaw = yaws(after.quaternion)
        for w, i in level.tolist():
            swarm.quaternion[w, i] = from_euler(0.0, 0.0, yaw[w, i])
        for array, numbers in zip(before, swarm, strict=True):
            array[moved] = numbers[moved]

    def _start_cruise(self, after: Swarm, moved: np.ndarray, sets_rotors: bool) -> None:
        """Write the cruise of the drones of `moved` (N,) that cannot hover and are in the air."""
        standing = np.array([one.standing_height for one in self.options.airframe])
        is_up = moved & (after.position[0, :, 2] > standing + STANDING_TOLERANCE)
        drones = self.cruise.drones[is_up[self.cruise.drones]]
        motion = (after.velocity[0], after.quaternion[0], after.rates[0])
        wind = self.carrying_wind(after.position, self.state.steps / self.options.decision_hz)
        self.cruise.write(motion, drones, np.zeros(wind[0].shape), wind[0])
        after.deflection[0, drones] = self.cruise.deflection[drones]
        if sets_rotors:
            after.rotor_speed[0, drones] = self.cruise.rotor_speed[drones]

    def require_free(self, after: Swarm, moved: np.ndarray, scenery: Scenery) -> None:
        """Raise ValueError if drones of `moved` (1, N) would overlap a body."""
        contact = self.dynamics.contact._replace(scenery=scenery)
        kept = [array.copy() for array in contact.touches]
        drones = DroneArrays(after, self.state.alive, self.parameters)
        found = find_overlaps(contact, drones, moved)
        for array, before in zip(contact.touches, kept, strict=True):
            array[:] = before
        deep = np.flatnonzero(found.depth > CONTACT_DISTANCE)
        if len(deep):
            row = deep[found.depth[deep].argmax()]
            i, other = int(found.drone[row]), int(found.other[row])
            names = {GROUND: "the ground", CITY: "a building"}
            what = f"drone {other}" if other >= 0 else names.get(other, "a body")
            height = self.options.airframe[i].standing_height
            raise ValueError(
                f"drone {i} at {after.position[0, i]} m would overlap {what} by "
                f"{found.depth[row]:.3g} m: choose another position (on the ground it stands at "
                f"standing_height = {height:.4g} m)"
            )

    def hold_heading(self, rows: Any) -> None:
        """Set the yaw setpoint of drones that hold none to their present yaw."""
        state = self.state
        holds = state.commanded[0, rows] & (state.levels[0, rows] <= SetpointLevel.ACCELERATION)
        free = np.flatnonzero(~holds)
        if len(free):
            drones = np.atleast_1d(np.arange(state.levels.shape[1])[rows])[free]
            state.setpoint[0, drones, YAW] = yaws(state.swarm.quaternion)[0, drones]

    def rotor_commands(self) -> np.ndarray:
        """Compute the rotor speeds (N, R) that controllers command at the present state, rad/s."""
        state, flight = self.state, self.dynamics.flight
        # Controllers advance their memory: here a copy of it
        cascade = self.cascade._replace(memory=self.cascade.memory.copy()).in_wind(state.wind)
        setpoints = Setpoints(state.levels, state.setpoint)
        drones = DroneArrays(state.swarm, state.alive, self.parameters)
        commands = (SetpointLevel.ROTOR, drones, cascade, flight.dt, flight.gravity)
        # A drone's deflections follow its own rotors
        numbers = convert(setpoints, *commands)[0, :, : self.hover_speed.shape[1]]
        rotors = np.arange(numbers.shape[1])
        speeds: np.ndarray = np.where(
            rotors < self.parameters["num_rotors"][0, :, None], numbers, 0.0
        )
        return speeds

    def measure(self) -> None:
        """Measure with all sensors, and store the state for the next finite differences."""
        if not self.sensors.sensors:
            return
        state = self.state
        targets = np.zeros((1, 0, 3))
        states = (state.before, state.swarm, targets, state.alive)
        wind = self.measured_wind(state.swarm, state.steps)
        given = (np.zeros((*state.alive.shape, 0)), self.dynamics.local_gravity, wind)
        moment = Moment(*states, state.steps, self.rng, {}, *given)
        for name, reading in self.sensors.measure(moment, self.show).items():
            self.readings[name] = reading[0].copy()
        for array, numbers in zip(state.before, state.swarm, strict=True):
            array[:] = numbers

    def show_live(self) -> None:
        """Update the live window."""
        swarm, alive = self.state.swarm, self.state.alive
        self.show(swarm, alive)
        self.renderer.show(swarm, alive, 1 / self.options.decision_hz)

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the state; see `Parts.state_arrays`."""
        return {
            **self.state.swarm._asdict(),
            # Parameters drawn at the start belong to the state: they are not drawn again
            **with_prefix("drawn", self.uncertainty.drawn),
            **self.state.kept(STATE),
            "force": self.dynamics.force,
            "torque": self.dynamics.torque,
            "parameters": self.parameters,
            "controller": self.cascade.memory,
            **self.body_arrays(),
            **self.dynamics.cables.kept(),
        }

    def last_arrays(self) -> dict[str, np.ndarray]:
        """Return the other arrays that later steps depend on; see `Parts.last_arrays`."""
        parts = (self.wind, self.sensors, self.dynamics)
        return {
            **with_prefix("before", self.state.before._asdict()),
            **{f"reading {name}": array[None] for name, array in self.readings.items()},
            **{name: array for part in parts for name, array in part.kept().items()},
            **self.condition_arrays(),
        }

    def bounds(self) -> Bounds:
        """Return the bounds of the arrays that a snapshot may write, by name."""
        return {
            **state_bounds(self.state.swarm),
            **self.state.bounds(),
            "levels": (0, int(self.dynamics.consumes)),
            **self.sensors.kept_bounds(),
            **CONDITION_BOUNDS,
            **contact_bounds(self.engine.scenery),
            **BODY_BOUNDS,
            **cable_bounds(self.options.num_drones),
        }


def yaws(quaternion: np.ndarray) -> np.ndarray:
    """Compute the yaws (W, N) of attitudes (W, N, 4), rad."""
    yaw = np.zeros(quaternion.shape[:2])
    headings(quaternion, yaw)
    return yaw


@kernel
def headings(quaternion: np.ndarray, yaw: np.ndarray) -> None:
    """Compute the yaws (W, N) of attitudes (W, N, 4), rad."""
    for w in range(yaw.shape[0]):
        for i in range(yaw.shape[1]):
            yaw[w, i] = heading(quat4(quaternion, w, i))
