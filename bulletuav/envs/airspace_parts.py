"""What an airspace is made of, and how things are put into it; `Airspace` flies it."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.contact.contacts import overlaps, see
from bulletuav.contact.touch import TOUCH
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.body_source import BodySource, pose_of
from bulletuav.engine.body_table import Contents
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.scene_copy import ScenePoses
from bulletuav.envs.airspace_inputs import (
    YAW,
    Drones,
    airspace_options,
    filled,
    require_bodies,
    rows_of,
    state_numbers,
)
from bulletuav.envs.airspace_kernels import headings
from bulletuav.envs.airspace_setpoints import usual_widths
from bulletuav.envs.environment import Environment, exclusive, in_plain_python
from bulletuav.envs.marks import drone_marks
from bulletuav.envs.parts import hover_speeds, make_dynamics, make_engine, sensor_setup
from bulletuav.envs.randomization import Uncertainty
from bulletuav.envs.renderer import FIELD_OF_VIEW, Renderer
from bulletuav.errors import as_int, as_sequence, find_choice, finite, points_of, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, from_euler, product, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import Picture, Shot, projection_matrix, view_matrix
from bulletuav.sensors.base import Moment
from bulletuav.sensors.suite import SensorSuite
from bulletuav.vehicle.swarm import CITY, GROUND, Swarm
from bulletuav.vehicle.wind import Wind

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
STILL = (0.0, 0.0, 0.0)
UP, NORTH = np.array((0.0, 0.0, 1.0)), np.array((0.0, 1.0, 0.0))


class AirspaceParts(Environment):
    """Engine, dynamics, sensors and arrays of one world of N drones; see `Airspace`."""

    def __init__(
        self,
        position: Sequence[Sequence[float]] | np.ndarray,
        airframe: Any = "cf2x",
        *,
        physics_hz: int = 240,
        decision_hz: int = 240,
        rotor_speed: float | str | Sequence[Any] | np.ndarray = 0.0,
        obstacles: Sequence[Obstacle] = (),
        layout: Solids | None = None,
        sensors: Sequence[Any] = (),
        **options: Any,
    ) -> None:
        """Make an airspace, with drones at rest and level.

        Args:
            position: (N, 3) where drones start, m. To stand on the ground takes a height of
                `Airframe.standing_height`.
            airframe: Name of an airframe, path of a URDF, or an `Airframe`; or one for each drone.
            physics_hz: Substeps a second.
            decision_hz: Steps a second; must divide physics_hz.
            rotor_speed: Speeds with which rotors start, rad/s; see `place`.
            obstacles: What `place_obstacle` can put somewhere.
            layout: Buildings that stand.
            sensors: Names of sensors, or objects, that all drones carry.
            **options: dynamics, seed, effects, wind, wind_profile, turbulence, gravity, max_speed,
                controller, contacts, friction, restitution, randomization, rays, camera_size,
                camera_hz, num_beams, max_range, lidar_elevations, lidar_frame, render_mode,
                render_size, debug; see `EnvOptions`.

        Raises:
            ValueError: An option cannot be, or drones overlap each other or what stands.
        """
        require_bodies(obstacles, layout)
        rates = {"physics_hz": physics_hz, "decision_hz": decision_hz}
        known, carried = airspace_options(position, airframe, sensors, {**options, **rates})
        layouts = () if layout is None else (layout,)
        self._options, self.airframes = known, known.airframe
        self._obstacles, self._layouts = tuple(obstacles), layouts
        self._engine = make_engine(known, 1, obstacles, layouts)
        self._dynamics = make_dynamics(known, self._engine)
        self._renderer = Renderer(self._engine, known.render_size)
        self.consumes, self.period = self._dynamics.consumes, 1 / known.decision_hz
        known.check_setpoint_levels(self.consumes, self.consumes)
        self.hover_speed = hover_speeds(known)
        self.hover_speed.flags.writeable = False
        self._make_arrays((1, known.num_drones), len(obstacles))
        self.rng = np.random.default_rng(known.seed)
        self._wind = Wind(known.wind, known.wind20, 1, known.wind_profile)
        parameters = self._dynamics.flight.parameters
        self._uncertainty = Uncertainty(known.randomization, self._engine, parameters, self._wind)
        wanted = frozenset(name for one in carried.values() for name in one.gives)
        setup = sensor_setup(known, 1, wanted)
        self._sensors = SensorSuite(carried, setup, self._engine, self._uncertainty.drawn)
        self._program: Program | None = None
        self._put_up(layouts)
        self._wind.reset(0, self.rng)
        self._uncertainty.reset(0, self.rng)
        self._before = self._swarm.copy()
        self.place(None, position, rotor_speed=rotor_speed)
        self._sensors.reset(0, self._swarm, self.rng)
        self._measure()
        if known.debug:
            in_plain_python(self, ("step", "place", "command"))

    def _make_arrays(self, shape: tuple[int, int], obstacles: int) -> None:
        """Make the arrays that steps read and write, and what shows them."""
        rotors = self.hover_speed.shape[1]
        self._swarm, self._alive = Swarm.zeros(*shape, rotors), np.ones(shape, dtype=bool)
        self._levels = np.full(shape, int(self.consumes))
        self._setpoint = np.zeros((*shape, max(YAW + 1, rotors)))
        self._yaw_rate, self._turns, self._told = np.zeros(shape), False, np.zeros(shape, bool)
        self._widths = usual_widths(self.consumes, self._options, rotors)
        self._air = np.zeros((*shape, 3))
        self._steps, self._time = np.zeros(1, dtype=np.int64), np.zeros(1)
        self._obstacle, self._obstacle_velocity = np.zeros((2, 1, obstacles, 3))
        self._obstacle_turn = np.tile(UPRIGHT, (1, obstacles, 1))
        self.swarm = Swarm(*map(_shown, self._swarm))
        self.levels, self.setpoint = _shown(self._levels), _shown(self._setpoint)
        self.readings: dict[str, np.ndarray] = {}

    def _put_up(self, layouts: tuple[Solids, ...]) -> None:
        """Put up what stands; obstacles wait deep below."""
        if layouts:
            self._engine.set_layouts(np.zeros(1, dtype=int), np.ones(1, dtype=bool))
        self._obstacle[..., 2] = -PARKING_HEIGHT
        self._engine.set_obstacles(self._obstacle, self._obstacle_turn, np.ones(1, dtype=bool))
        self._dynamics.look_around()

    @exclusive
    def place(
        self,
        drones: Drones,
        position: Any,
        quaternion: Any = UPRIGHT,
        velocity: Any = STILL,
        rates: Any = STILL,
        rotor_speed: Any = 0.0,
    ) -> None:
        """Put drones somewhere, as if nothing had been before.

        They hold their setpoints. Gusts, and biases of sensors, go on.

        Args:
            drones: Index of a drone, several, a mask (N,), or None for all.
            position: (3,) m, or a row for each of the drones.
            quaternion: (4,) body to world, or rows. Dynamics without tilt take its heading alone.
            velocity: (3,) world axes, m/s, or rows.
            rates: (3,) body axes, rad/s, or rows.
            rotor_speed: (R,) or rows, or one number for all rotors, rad/s; or "hover". Dynamics
                without motors always have that of hovering.

        Raises:
            ValueError: There is no such drone, numbers cannot be, or drones would overlap each
                other or what stands; nothing has changed.
        """
        self._require_open()
        rows, _ = rows_of(drones, len(self.airframes))
        if isinstance(rotor_speed, str):
            rotor_speed = find_choice("rotor_speed", rotor_speed, {"hover": self.hover_speed})[rows]
        fastest = self._dynamics.flight.parameters["max_rotor_speed"][0, rows]
        rotors = self._dynamics.flight.parameters["num_rotors"][0, rows]
        has = np.arange(self.hover_speed.shape[1]) < np.expand_dims(rotors, -1)
        most = np.where(has, np.expand_dims(fastest, -1), 0.0)
        given = (position, quaternion, velocity, rates, rotor_speed)
        state = state_numbers(most, *given)
        after = self._swarm.copy()
        for array, numbers in zip(after, state, strict=True):
            array[0, rows] = numbers
        if self.consumes < SetpointLevel.ROTOR:
            after.rotor_speed[0] = self.hover_speed
        moved = np.zeros_like(self._alive)
        moved[0, rows] = True
        self._look()
        self._refuse_overlap(after, moved, self._engine.scenery)
        for array, numbers in zip(self._swarm, after, strict=True):
            array[:] = numbers
        self._dynamics.flight.cascade.memory[moved] = 0.0
        self._dynamics.force[moved] = self._dynamics.torque[moved] = 0.0
        self._dynamics.place(self._swarm, moved)
        self._keep_headings(after.quaternion, moved)
        for array, numbers in zip(self._before, self._swarm, strict=True):
            array[moved] = numbers[moved]

    def _keep_headings(self, given: np.ndarray, moved: np.ndarray) -> None:
        """Turn drones of `moved` (1, N) that the dynamics made level to where they are to head."""
        level = np.argwhere(moved & (self._swarm.quaternion != given).any(axis=-1))
        yaw = np.zeros(moved.shape)
        headings(given, yaw)
        for w, i in level.tolist():
            self._swarm.quaternion[w, i] = from_euler(0.0, 0.0, yaw[w, i])

    def _refuse_overlap(self, after: Swarm, moved: np.ndarray, scenery: Scenery) -> None:
        """Raise ValueError if drones of `moved` (1, N) would overlap something."""
        contact = self._dynamics.contact._replace(scenery=scenery)
        told = [array.copy() for array in contact.touches]
        found = overlaps(contact, after, moved, self._alive, self._dynamics.flight.parameters)
        for array, before in zip(contact.touches, told, strict=True):
            array[:] = before
        deep = np.flatnonzero(found.depth > TOUCH)
        if len(deep):
            row = deep[found.depth[deep].argmax()]
            i, other = int(found.drone[row]), int(found.other[row])
            names = {GROUND: "the ground", CITY: "a building"}
            what = f"drone {other}" if other >= 0 else names.get(other, "a body")
            raise ValueError(
                f"drone {i} at {after.position[0, i]} m would overlap {what} by "
                f"{found.depth[row]:.3g} m: choose another place (on the ground it stands at "
                f"standing_height = {self.airframes[i].standing_height:.4g} m)"
            )

    @exclusive
    def place_obstacle(
        self,
        obstacle: int,
        position: Sequence[float],
        quaternion: Sequence[float] = UPRIGHT,
        velocity: Any = STILL,
    ) -> None:
        """Put one of `obstacles` somewhere; it moves on from there without turning.

        Args:
            obstacle: Its index.
            position: (3,) m.
            quaternion: (4,) body to world.
            velocity: (3,) m/s.

        Raises:
            ValueError: There is no such obstacle, numbers cannot be, or it would overlap a drone.
        """
        self._require_open()
        if not self._obstacle.size:
            raise ValueError("there are no obstacles: make the airspace with the option obstacles")
        k = as_int("obstacle", obstacle, 0, self._obstacle.shape[1] - 1)
        place, turn = pose_of(position, quaternion)
        moving = filled("velocity", velocity, (3,))
        self._look()
        scenery = self._engine.scenery
        trial = scenery._replace(place=scenery.place.copy(), quaternion=scenery.quaternion.copy())
        trial.place[0, k], trial.quaternion[0, k] = place, turn
        self._refuse_overlap(self._swarm, self._alive, trial)
        self._obstacle_velocity[0, k] = moving
        self._obstacle[0, k], self._obstacle_turn[0, k] = place, turn
        self._engine.set_obstacles(self._obstacle, self._obstacle_turn, np.ones(1, dtype=bool))
        # All look anew at what is near
        see(self._dynamics.contact, scenery)

    @exclusive
    def add_body(
        self,
        source: BodySource,
        position: Sequence[float],
        quaternion: Sequence[float] = UPRIGHT,
        friction: float | None = None,
        restitution: float | None = None,
    ) -> int:
        """Put up a body that stands still, for good; see `Aviary.add_body`.

        Returns:
            What `Contacts.other` calls it.

        Raises:
            ValueError: The source or a number cannot be, or the body would overlap a drone.
            FileNotFoundError: There is no such file.
        """
        self._look()
        pose, surface = (position, quaternion), (friction, restitution)
        return self._engine.add_body(source, *pose, None, *surface, check=self._refuse_body)

    def _refuse_body(self, scenery: Scenery) -> None:
        """Raise ValueError if drones would overlap what stands then."""
        self._refuse_overlap(self._swarm, self._alive, scenery)

    def _look(self) -> None:
        """Take over what stands now; a program knows only what stood when it was made."""
        self._require_open()
        if self._dynamics.look_around():
            self._program = None

    def _measure(self) -> None:
        """Measure with all sensors."""
        if not self._sensors.sensors:
            return
        nothing = np.zeros((1, 0, 3))
        states = (self._before, self._swarm)
        moment = Moment(*states, nothing, self._alive, self._steps, [self.rng], {})
        for name, reading in self._sensors.measure(moment, self._show).items():
            self.readings[name] = reading[0].copy()
        self._before = self._swarm.copy()

    def _show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Have the engine's bodies stand where drones of `mask` (1, N) and obstacles are."""
        self._dynamics.show(swarm, mask)
        self._engine.show_obstacles()

    def _show_live(self) -> None:
        """Bring the live window up to date."""
        self._show(self._swarm, self._alive)
        self._renderer.show(self._swarm, self._alive, self.period)

    @exclusive
    def render(self) -> np.ndarray:
        """Take a picture from afar: rings on drones, arrows of a second's flight, lidar beams.

        Returns:
            (height, width, 3) uint8.
        """
        self._require_open()
        self._show(self._swarm, self._alive)
        marks = drone_marks(self._swarm, self._alive, 0, self._sensors.sensors.values())
        return self._renderer.picture(0, self._swarm, marks, self._alive)

    @exclusive
    def picture(
        self,
        drone: int | None = None,
        position: Sequence[float] | None = None,
        quaternion: Sequence[float] = UPRIGHT,
        target: Sequence[float] | None = None,
        size: Sequence[int] = (640, 480),
        field_of_view: float = FIELD_OF_VIEW,
    ) -> Picture:
        """Take a picture with a camera that looks along its own x axis, z up.

        Args:
            drone: Index of the drone that carries it; None for one that stands in the world.
            position: (3,) of the camera in body axes of the drone, or in the world, m. Left out, at
                the nose of the drone, or the world's origin.
            quaternion: (4,) of the camera, to body axes or to the world.
            target: (3,) point in the world to look at, m, in place of the quaternion.
            size: Width and height, pixels.
            field_of_view: Vertical angle, degrees.

        Returns:
            Colours, depth and labels of the pixels.

        Raises:
            ValueError: There is no such drone, or a number cannot be.
        """
        shot = self.shot(drone, position, quaternion, target, size, field_of_view)
        return self.draw(shot)

    @exclusive
    def draw(self, shot: Shot) -> Picture:
        """Draw what a camera sees, as `picture` does.

        Args:
            shot: What `shot` returned.
        """
        self._require_open()
        self._show(self._swarm, self._alive)
        return self._engine.picture(0, *shot)

    @exclusive
    def shot(
        self,
        drone: int | None,
        position: Sequence[float] | None,
        quaternion: Sequence[float],
        target: Sequence[float] | None,
        size: Sequence[int],
        field_of_view: float,
    ) -> Shot:
        """Return what a camera sees from its present place, to be drawn now or elsewhere.

        Arguments and errors are those of `picture`.
        """
        self._require_open()
        if drone is not None:
            i = as_int("drone", drone, 0, len(self.airframes) - 1)
        if position is None:
            nose = 0.0 if drone is None else self.airframes[i].collision_radius
            position = (nose, 0.0, 0.0)
        place, turn = pose_of(position, quaternion)
        width, height = (as_int("size", one, 8, 4096) for one in as_sequence("size", size, 2))
        angle = finite("field_of_view", field_of_view, 1, 170)
        if drone is not None:
            body = self._swarm.quaternion[0, i]
            place = self._swarm.position[0, i] + to_world(body, place)
            turn = np.array(product(body, turn))
        forward, _, up = (np.array(axis) for axis in axes(turn))
        if target is not None:
            (ahead,) = points_of("target", [target])
            forward = ahead - place
            level = np.abs(forward[:2]).max() > 1e-6 * np.abs(forward).max()
            up = UP if level else NORTH
            if not forward.any():
                raise ValueError(f"target is {shown(target)}, where the camera is: look elsewhere")
        view = view_matrix(place, place + forward, up.tolist())
        projection = projection_matrix(width / height, angle)
        return Shot(view, projection, (width, height))

    @exclusive
    def scene_poses(self) -> ScenePoses:
        """Return where everything is that pictures show now, as a copy; see `SceneCopy`."""
        self._require_open()
        return self._engine.scene_poses(self._swarm)

    @property
    def scene_setup(self) -> tuple[Contents, bool]:
        """The arguments with which a `SceneCopy` of this airspace is made."""
        return self._engine.contents, self._engine.asks_bodies

    def __repr__(self) -> str:
        """Tell what flies, how, and for how long."""
        kinds = ", ".join(dict.fromkeys(one.name for one in self.airframes))
        flown = f"{self._options.dynamics_name}, {self._time[0]:g} s"
        return f"<Airspace of {len(self.airframes)} {kinds}, {flown}>"

    def __enter__(self) -> Self:
        """Return itself, which is closed at the end of the `with`."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close it."""
        self.close()

    def _require_open(self) -> None:
        if self._engine.closed:
            raise RuntimeError("this airspace is closed: make a new one")

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._engine.close()


def _shown(array: np.ndarray) -> np.ndarray:
    """Show the only world of an array (1, ...), read-only."""
    view: np.ndarray = array[0]
    view.flags.writeable = False
    return view
