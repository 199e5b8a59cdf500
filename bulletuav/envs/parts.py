"""Components of worlds, with a task or without: engine, dynamics, controllers, sensors."""

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.contact.moving_bodies import finish_bodies
from bulletuav.control.autopilot import autopilot_rows
from bulletuav.control.cascade import Cascade
from bulletuav.control.gains import gain_rows
from bulletuav.dynamics import find_dynamics
from bulletuav.dynamics.base import Dynamics, FlightSetup
from bulletuav.engine.body_source import UNIT
from bulletuav.engine.engine import Engine
from bulletuav.envs.bodies import MAX_SPEED, MAX_SPIN
from bulletuav.envs.cruise import CruiseStarts
from bulletuav.envs.events import MAX_GRAVITY
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.randomization import Uncertainty
from bulletuav.envs.renderer import Renderer
from bulletuav.envs.snapshot import (
    BODIES,
    Bounds,
    SnapshotLayout,
    hash_array_rows,
    pack_worlds,
)
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Sensor, SensorSetup
from bulletuav.sensors.lidar import make_beams
from bulletuav.sensors.mounts import as_mounts
from bulletuav.sensors.suite import SensorSuite
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wind import Wind
from bulletuav.vehicle.wings import WingTable

WITHOUT_WIND = ("single_integrator", "double_integrator")
"""Dynamics that ignore wind"""
BODY_STATE = ("position", "quaternion", "velocity", "spin")
"""Arrays of `Scenery.bodies` that are in snapshots"""
MAX_PLACE = 1e7
"""Maximum coordinate of a body in a snapshot, m, which the fastest one reaches after a day"""
BODY_BOUNDS: Bounds = {
    "body position": (-MAX_PLACE, MAX_PLACE),
    "body quaternion": (-1.0 - UNIT, 1.0 + UNIT),
    "body velocity": (-MAX_SPEED, MAX_SPEED),
    "body spin": (-MAX_SPIN, MAX_SPIN),
}
"""Bounds of these arrays in snapshots"""
CONDITION_BOUNDS: Bounds = MappingProxyType(
    {"rotor ratio": (0.0, 1.0), "gravity": (0.0, MAX_GRAVITY)}
)
"""Bounds of `Parts.condition_arrays`"""


class Parts(ABC):
    """Components of W worlds of N drones.

    Attributes:
        options: Common options.
        engine: Bodies, obstacles, cities, rays and pictures.
        dynamics: Dynamics of the drones.
        parameters: (W, N) rows of `PARAMETERS` that the dynamics uses; those of loads follow in
            `dynamics.flight`.
        cascade: Controllers.
        cruise: Cruise of the drones that cannot hover.
        hover_speed: (N, R) rotor speeds at which the drones hover, or cruise if they cannot hover,
            rad/s.
        wind: Steady wind and gusts.
        uncertainty: Randomized parameters of the episodes.
        sensors: All sensors.
        renderer: Pictures and the live window.
        readings: Last sensor readings, by name.
    """

    readings: dict[str, np.ndarray]
    _layout: SnapshotLayout | None = None
    _varying: Sequence[object] = ()

    def __init__(
        self,
        options: EnvOptions,
        obstacles: Sequence[Obstacle],
        layouts: Sequence[Solids],
        sensors: dict[str, Sensor],
        setup: SensorSetup,
        first_world: int = 0,
        loads: Sequence[Airframe] = (),
    ) -> None:
        """Create all components; see `make_engine` and `SensorSuite`."""
        num_worlds, _ = setup.shape
        self.options = options
        airframes = (*options.airframe, *loads)
        self.engine = make_engine(options, airframes, num_worlds, obstacles, layouts, first_world)
        self.dynamics = make_dynamics(options, airframes, self.engine)
        self.parameters = self.dynamics.flight.parameters[:, : options.num_drones]
        self.cascade = self.dynamics.flight.cascade
        self.cruise = CruiseStarts(options.airframe, num_surfaces(options))
        self.hover_speed = hover_speeds(options) + self.cruise.rotor_speed
        self.wind = Wind(
            options.wind, options.wind20, num_worlds, options.wind_profile, options.thermals
        )
        self.uncertainty = Uncertainty(
            options.randomization, self.engine, self.parameters, self.wind
        )
        self.sensors = SensorSuite(sensors, setup, self.engine, self.uncertainty.drawn)
        self.renderer = Renderer(self.engine, options.render_size)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Update the poses of drones of `mask` (W, N) and of obstacles in the engine."""
        self.dynamics.show(swarm, mask)
        self.engine.show_obstacles()

    def shown(self, swarm: Swarm, mask: np.ndarray) -> tuple[Swarm, np.ndarray]:
        """Return the state and the mask (W, N) of the bodies that are shown: the drones."""
        return swarm, mask

    def measured_wind(self, swarm: Swarm, steps: np.ndarray) -> np.ndarray | None:
        """Return the wind (W, N, 3) at the drones after a number of decisions (W,), m/s.

        It is None if no sensor reads the wind.
        """
        if not self.sensors.needs_wind:
            return None
        return self.wind.sample(swarm.position, steps / self.options.decision_hz)

    def carrying_wind(self, position: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the wind that carries drones: calm air in dynamics that ignore wind.

        Args:
            position: (W, N, 3) positions, m.
            time: (W,) time of each world, s.

        Returns:
            (W, N, 3) wind, world axes, m/s.
        """
        if self.options.dynamics_name in WITHOUT_WIND:
            return np.zeros(position.shape)
        return self.wind.sample(position, time)

    def layout(self, of: str, parts: Mapping[str, str]) -> SnapshotLayout:
        """Return the layout of arrays in snapshots.

        Args:
            of: See `snapshot.Form`, like the parts.
            parts: Descriptions of the simulation's components.
        """
        # Sensors may replace arrays, readings add some, and bodies change the bounds
        varying: list[object] = [*self.sensors.kept().values(), *self.dynamics.kept().values()]
        varying += [*self.readings.values(), self.engine.scenery]
        varying += self.dynamics.cables.kept().values()
        known = self._varying
        is_known = len(known) == len(varying) and all(map(operator.is_, known, varying))
        if self._layout is None or not is_known:
            bodies = {BODIES: self.engine.bodies}
            arrays = {**bodies, **self.state_arrays(), **self.last_arrays()}
            self._layout = SnapshotLayout(of, parts, self.bounds(), arrays)
            self._varying = varying
        return self._layout

    def body_arrays(self) -> dict[str, np.ndarray]:
        """Return the poses and velocities of added bodies, for snapshots; none without bodies."""
        bodies = self.engine.scenery.bodies
        if not len(bodies.reach):
            return {}
        return {f"body {name}": getattr(bodies, name) for name in BODY_STATE}

    def condition_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, ...) by name that `conditions` change."""
        dynamics = self.dynamics
        return {"rotor ratio": dynamics.rotor_ratio, "gravity": dynamics.local_gravity}

    def state_hashes(self, rng: list[np.random.Generator], worlds: np.ndarray) -> tuple[str, ...]:
        """Return a hash of the state of worlds (S,), with their random generators."""
        data, rows = pack_worlds(self.state_arrays(), rng, worlds), []
        usual = {"rotor ratio": 1.0, "gravity": self.options.gravity}
        for w, row in zip(worlds.tolist(), data, strict=True):
            # Worlds without weak rotors and another gravity have the hash of their other arrays
            changed = [
                array[w].ravel().view(np.uint8)
                for name, array in self.condition_arrays().items()
                if (array[w] != usual[name]).any()
            ]
            rows.append(np.concatenate([row, *changed]))
        return hash_array_rows(rows)

    @abstractmethod
    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, ...) by name that are a world's state, whatever flew before."""

    @abstractmethod
    def last_arrays(self) -> dict[str, np.ndarray]:
        """Return the other arrays that the future depends on; they may be from before a reset."""

    @abstractmethod
    def bounds(self) -> Bounds:
        """Return the bounds of the arrays that a snapshot may write, by name."""


def make_engine(
    options: EnvOptions,
    airframes: Sequence[Airframe],
    num_worlds: int,
    obstacles: Sequence[Obstacle],
    layouts: Sequence[Solids],
    first_world: int = 0,
) -> Engine:
    """Create the engine with all its bodies.

    Args:
        options: Common options.
        airframes: Drones of a world, and loads after them.
        num_worlds: Number of worlds W.
        obstacles: The K obstacles of each world.
        layouts: Cities, one of which can be in a world at a time.
        first_world: Index of the first world among those of several processes.
    """
    return Engine(
        airframes,
        num_worlds,
        1 / options.physics_hz,
        obstacles,
        layouts,
        first_world,
        options.render_mode == "human",
        options.rays,
        options.contacts == "bullet",
    )


def make_dynamics(options: EnvOptions, airframes: Sequence[Airframe], engine: Engine) -> Dynamics:
    """Create the dynamics of all drones with their controllers; see `Dynamics.flight`.

    Raises:
        ValueError: If aircraft with wings fly with loads, whose cables ignore wings.
    """
    winged = [one.name for one in airframes if one.wings]
    if winged and any(one.is_load for one in airframes):
        raise ValueError(
            f"airframe {winged[0]!r} has wings, and cannot carry loads: choose a multirotor"
        )
    # Controllers have a copy with the nominal airframe, whatever is randomized
    worlds = (engine.shape[0], 1)
    parameters = np.tile(parameter_rows(airframes, options.effects), worlds)
    gains = np.tile(gain_rows(airframes, options.max_speed), worlds)
    pilots = autopilot_rows(airframes, options.max_speed)
    flight = FlightSetup(
        engine,
        parameters,
        Cascade.of(
            options.controller,
            parameters.copy(),
            gains,
            options.integral,
            None if pilots is None else np.tile(pilots, worlds),
        ),
        1 / options.physics_hz,
        options.substeps,
        options.gravity,
        options.contacts or "",
        options.friction,
        options.restitution,
        WingTable.of(airframes, engine.shape[0]),
    )
    return find_dynamics(options.dynamics)(flight)


def add_obstacles(program: Program, engine: Engine, obstacle: np.ndarray) -> None:
    """Add that obstacles are moved to (W, K, 3), m, and bodies to their ends, after a flight."""
    if obstacle.shape[1]:
        program.call(copy_vectors, obstacle, engine.scenery.place)
    has_bodies = len(engine.scenery.bodies.reach) > 0
    if has_bodies:
        program.call(finish_bodies, engine.scenery)
    if engine.asks_bodies and (has_bodies or obstacle.shape[1]):
        program.callback(engine.show_obstacles)


def hover_speeds(options: EnvOptions) -> np.ndarray:
    """Return the rotor speeds (N, R) at which drones hover, rad/s; 0 for missing rotors.

    They are 0 for aircraft that cannot hover.
    """
    # At least one column, as arrays of the airspace of a load alone could not be reshaped
    rotors = max(1, *(len(one.rotors) for one in options.airframe))
    speeds = np.zeros((options.num_drones, rotors))
    for row, airframe in zip(speeds, options.airframe, strict=True):
        if airframe.needs_airspeed:
            continue
        row[: len(airframe.rotors)] = airframe.hover_speed(options.gravity)
        row[list(airframe.forward_rotors)] = 0.0
    return speeds


def num_surfaces(options: EnvOptions) -> int:
    """Return the maximum number of control surfaces of a drone, at least 1 if any has wings."""
    # Panels without a surface read the first
    return max(len(one.surfaces) or min(len(one.wings), 1) for one in options.airframe)


def sensor_setup(options: EnvOptions, num_worlds: int, wanted: frozenset[str]) -> SensorSetup:
    """Describe the environment for sensors, except for a task's targets and arena.

    Args:
        options: Common options.
        num_worlds: Number of worlds W.
        wanted: Readings that are needed.
    """

    def longest(name: str) -> float:
        """Return the maximum of a delay, s."""
        known = name in options.randomization.known
        return options.randomization.bounds(name)[1] if known else 0.0

    return SensorSetup(
        shape=(num_worlds, options.num_drones),
        period=1 / options.decision_hz,
        gravity=options.gravity,
        radius=tuple(airframe.collision_radius for airframe in options.airframe),
        max_range=options.max_range,
        beams=make_beams(options.num_beams, options.lidar_elevations),
        beam_frame=options.lidar_frame,
        camera=options.camera,
        camera_size=options.camera_size,
        camera_every=int(options.decision_hz / (options.camera_hz or options.decision_hz)),
        camera_range=options.camera_range,
        camera_depth=options.camera_depth,
        camera_mounts=as_mounts(options.camera_mounts),
        num_neighbours=options.num_neighbours,
        wanted=wanted,
        longest_delay=longest("radio_delay"),
        longest_picture_delay=longest("camera_delay"),
    )


@kernel
def copy_vectors(given: np.ndarray, out: np.ndarray) -> None:
    """Copy the first three numbers of `given` (W, K, ...) to `out` (W, K or more, 3)."""
    for w in range(given.shape[0]):
        for m in range(given.shape[1]):
            for k in range(3):
                out[w, m, k] = given[w, m, k]
