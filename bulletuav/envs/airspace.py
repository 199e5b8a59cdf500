"""Airspace: drones without a task, flown by a loop of your own."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from bulletuav.compiled.deferred import compile_deferred
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.body_source import BodySource, check_pose
from bulletuav.engine.body_table import Contents
from bulletuav.engine.visual_scene import ScenePoses
from bulletuav.envs.airspace_inputs import (
    STILL,
    UPRIGHT,
    YAW,
    Angle,
    Drones,
    airspace_options,
    angles,
    hold,
    level_of,
    numbers_of_shape,
    require_bodies,
    rows_of,
    setpoint_numbers,
    setpoint_widths,
    state_numbers,
    without_loads,
)
from bulletuav.envs.airspace_simulation import AirspaceSimulation
from bulletuav.envs.airspace_world import ALL, AirspaceWorld
from bulletuav.envs.bodies import Body, Motion, check_velocities, set_body
from bulletuav.envs.cables import attach, check_ends, detach, list_ends
from bulletuav.envs.conditions import Condition, apply_condition, check_condition
from bulletuav.envs.descriptions import describe_parts, faces_of
from bulletuav.envs.environment import Environment, exclusive, in_plain_python
from bulletuav.envs.marks import drone_marks
from bulletuav.envs.renderer import FIELD_OF_VIEW
from bulletuav.envs.snapshot import (
    Snapshot,
    SnapshotLayout,
    own_snapshot,
    require_contacts,
    require_snapshot,
)
from bulletuav.errors import as_int, as_sequence, find_choice, finite, numbers_of, points_of, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import axes, product, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import CameraMatrices, Picture, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, Contacts, Swarm
from bulletuav.vehicle.wind import MAX_WIND

UP, NORTH = np.array((0.0, 0.0, 1.0)), np.array((0.0, 1.0, 0.0))
CHANGES = (
    *("step", "place", "command", "apply", "set_condition", "set_wind"),
    *("place_obstacle", "add_body", "move_body", "remove_body", "load_state"),
    *("attach_cable", "detach_cable"),
)
"""Methods of an `Airspace` that change its state"""
ONLY = np.zeros(1, dtype=int)
"""Indices (1,) of the only world"""


class Airspace(Environment):
    """A world of N drones that hold setpoints, step by step, without goals, rewards or episodes.

    Each drone holds its last commanded setpoint. Before the first command the setpoint is zero at
    the level that the dynamics consumes: motors off, or no motion. For example::

        airspace = Airspace([(0.0, 0.0, 1.0)], decision_hz=48)
        airspace.command(0, SetpointLevel.POSITION, (1.0, 0.0, 1.0))
        for _ in range(48):
            airspace.step()
        print(airspace.swarm.position[0])

    The arrays are allocated once and overwritten in each step: copy what you keep. The same calls
    with the same seed give the same bits.

    Attributes:
        airframes: Airframe of each drone.
        swarm: State of the drones, arrays (N, ...); read-only, see `place`.
        hover_speed: (N, R) rotor speeds at which the drones hover, rad/s.
        period: Duration of a step, s.
        consumes: Setpoint level that the dynamics consumes; commands are of this level or above.
        levels: (N,) `SetpointLevel` that each drone holds; read-only.
        setpoint: (N, S) setpoint that each drone holds; read-only.
        world: Components and state of the world.
        simulation: Stages of a step.
    """

    _parts: Mapping[str, str] | None = None

    def __init__(
        self,
        position: Sequence[Sequence[float]] | np.ndarray,
        airframe: Any = "cf2x",
        *,
        physics_hz: int = 240,
        decision_hz: int = 240,
        quaternion: Any = UPRIGHT,
        rotor_speed: float | str | Sequence[Any] | np.ndarray | None = None,
        obstacles: Sequence[Obstacle] = (),
        layout: Solids | None = None,
        sensors: Sequence[Any] = (),
        **options: Any,
    ) -> None:
        """Create an airspace with drones at rest, or in cruise if they cannot hover; see `place`.

        Args:
            position: (N, 3) start positions, m. A drone that stands on the ground has a height of
                `Airframe.standing_height`.
            airframe: Name of an airframe, path of a URDF, or an `Airframe`; or one for each drone.
            physics_hz: Physics substeps per second.
            decision_hz: Steps per second; must divide physics_hz.
            quaternion: Initial attitudes, level by default; see `place`.
            rotor_speed: Initial rotor speeds, rad/s; see `place`.
            obstacles: Obstacles that `place_obstacle` can move into the world.
            layout: Static buildings.
            sensors: Names of sensors, or sensor objects, that all drones carry.
            **options: dynamics, seed, effects, wind, wind_profile, turbulence, thermals, gravity,
                max_speed, controller, contacts, friction, restitution, randomization, rays, camera,
                camera_size, camera_hz, camera_range, camera_depth, camera_mounts, num_beams,
                max_range, lidar_elevations, lidar_frame, render_mode, render_size, debug,
                threads; see `EnvOptions`.

        Raises:
            ValueError: If an option is invalid, or drones overlap each other or the scene.
        """
        require_bodies(obstacles, layout)
        rates = {"physics_hz": physics_hz, "decision_hz": decision_hz}
        known, carried = airspace_options(position, airframe, sensors, {**options, **rates})
        layouts = () if layout is None else (layout,)
        self._options, self.airframes = known, known.airframe
        self._made: dict[str, Any] = {"obstacles": tuple(obstacles), "layout": faces_of(layouts)}
        self.world = world = AirspaceWorld(known, tuple(obstacles), layouts, carried)
        self.simulation = AirspaceSimulation(world)
        self.consumes, self.period = world.dynamics.consumes, 1 / known.decision_hz
        self.hover_speed = world.hover_speed
        self.hover_speed.flags.writeable = False
        state = world.state
        self.swarm = Swarm(*map(_shown, state.swarm))
        self.levels, self.setpoint = _shown(state.levels), _shown(state.setpoint)
        self._held = (state.levels, state.setpoint, state.commanded)
        # A number for each rotor and control surface of the drone with the most
        self._rotor_numbers = max(len(one.rotors) + len(one.surfaces) for one in known.airframe)
        self._widths = setpoint_widths(self.consumes, known, self._rotor_numbers)
        self._turns = False
        self._has_loads = any(one.is_load for one in self.airframes)
        world.wind.reset(0, self.rng)
        world.uncertainty.reset(0, self.rng)
        self.place(None, position, quaternion, rotor_speed=rotor_speed)
        world.sensors.reset(0, state.swarm, self.rng)
        world.measure()
        if known.debug:
            in_plain_python(self, ("step", "place", "command"))

    @property
    def time(self) -> float:
        """Simulated time since the airspace was created, s."""
        return float(self.world.state.time[0])

    @property
    def rng(self) -> np.random.Generator:
        """Random generator of the world."""
        return self.world.rng[0]

    @property
    def readings(self) -> dict[str, np.ndarray]:
        """Last sensor readings, arrays (N, ...) by name; new arrays in each step."""
        return self.world.readings

    @property
    def contacts(self) -> Contacts:
        """Contacts of the last step; the world of each row is 0."""
        return self.world.dynamics.touched().of_worlds(ALL)

    @exclusive
    def place(
        self,
        drones: Drones,
        position: Any,
        quaternion: Any = UPRIGHT,
        velocity: Any = None,
        rates: Any = STILL,
        rotor_speed: Any = None,
    ) -> None:
        """Set the state of drones and clear their history.

        The drones keep their setpoints. Gusts and sensor biases continue. Without a velocity,
        aircraft that cannot hover and are placed above the ground fly level at cruise speed along
        their heading, in trim: with the pitch, rotor speeds and deflections of level flight.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all.
            position: (3,) m, or a row for each of the drones.
            quaternion: (4,) body to world, or rows. Dynamics without tilt use the heading only.
            velocity: (3,) in world axes, m/s, or rows. None for rest, or cruise.
            rates: (3,) in body axes, rad/s, or rows.
            rotor_speed: (R,) or rows, or one number for all rotors, rad/s; or "hover". None for 0,
                or the speed of cruise. Dynamics without motors always have the hover speed.

        Raises:
            ValueError: If there is no such drone, a number is invalid, or drones would overlap each
                other or the scene; the state is unchanged.
        """
        self._require_open()
        rows, _ = rows_of(drones, len(self.airframes))
        if isinstance(rotor_speed, str):
            rotor_speed = find_choice("rotor_speed", rotor_speed, {"hover": self.hover_speed})[rows]
        most = self.world.max_rotor_speed(rows)
        motion = (STILL if velocity is None else velocity, rates)
        speed = 0.0 if rotor_speed is None else rotor_speed
        state = state_numbers(most, position, quaternion, *motion, speed)
        self.simulation.update_scene()
        self.world.place(rows, state, velocity is None, rotor_speed is None)

    @exclusive
    def place_obstacle(
        self,
        obstacle: int,
        position: Sequence[float],
        quaternion: Sequence[float] = UPRIGHT,
        velocity: Any = STILL,
    ) -> None:
        """Set the pose and velocity of an obstacle, which then moves without rotation.

        Args:
            obstacle: Index of the obstacle.
            position: (3,) m.
            quaternion: (4,) body to world.
            velocity: (3,) m/s.

        Raises:
            ValueError: If there is no such obstacle, a number is invalid, or the obstacle would
                overlap a drone.
        """
        self._require_open()
        count = self.world.state.obstacle.shape[1]
        if not count:
            raise ValueError("there are no obstacles: make the airspace with the option obstacles")
        k = as_int("obstacle", obstacle, 0, count - 1)
        pose, moving = (
            check_pose(position, quaternion),
            numbers_of_shape("velocity", velocity, (3,)),
        )
        self.simulation.update_scene()
        self.world.place_obstacle(k, *pose, moving)

    @exclusive
    def add_body(
        self,
        source: BodySource,
        position: Sequence[float] | None = None,
        quaternion: Sequence[float] = UPRIGHT,
        friction: float | None = None,
        restitution: float | None = None,
        *,
        velocity: Sequence[float] = STILL,
        angular_velocity: Sequence[float] = STILL,
        motion: Motion | None = None,
    ) -> int:
        """Add a body, which stands still, moves and turns evenly, or follows a function of time.

        Drones do not move the body, whatever they weigh.

        Args:
            source: Path of a URDF or of an OBJ, corners (V, 3) of a hull in m, or an `Obstacle`.
            position: (3,) position of the body's origin, m.
            quaternion: (4,) attitude, body to world.
            friction: Coefficient of friction. None for that of the obstacle, or 0.5.
            restitution: Coefficient of restitution. None for that of the obstacle, or 0.
            velocity: (3,) velocity of the origin, m/s.
            angular_velocity: (3,) angular velocity about the origin, world axes, rad/s.
            motion: Function from `time`, s, to the position, m, and the quaternion of the body,
                instead of these arguments. Between two steps the body moves and turns evenly.

        Returns:
            Identifier of the body in `Contacts.other`, for `move_body` and `remove_body`.

        Raises:
            ValueError: If the source or a number is invalid, or the body would overlap a drone.
            FileNotFoundError: If there is no such file.
        """
        self._require_open()
        body = Body(source, position, quaternion, velocity, angular_velocity, motion)
        pose, velocities = body.start(self.time)
        self.simulation.update_scene()
        world, engine, surface = self.world, self.world.engine, (friction, restitution)

        def check(scenery: Scenery) -> None:
            world.require_free(world.state.swarm, world.state.alive, scenery)

        here, turn = (one.tolist() for one in pose)
        other = engine.add_body(source, here, turn, None, *surface, check=check, is_static=False)
        set_body(engine, 0, self._body(other), pose, velocities)
        if motion is not None:
            world.motions[self._body(other)] = motion
        return other

    def _body(self, body: int) -> int:
        """Return the index in `Scenery.bodies` of a body, given by its identifier."""
        first = FIRST_OBSTACLE - self.world.state.obstacle.shape[1]
        count = len(self.world.engine.scenery.bodies.reach)
        if not count:
            raise ValueError("there are no bodies: add one by add_body")
        return int(first - as_int("body", body, first - count + 1, first))

    @exclusive
    def move_body(
        self,
        body: int,
        position: Sequence[float],
        quaternion: Sequence[float] = UPRIGHT,
        velocity: Sequence[float] = STILL,
        angular_velocity: Sequence[float] = STILL,
    ) -> None:
        """Set the pose and the velocities of a body; a removed body returns into the world.

        Args:
            body: Identifier that `add_body` returned.
            position: (3,) m.
            quaternion: (4,) body to world.
            velocity: (3,) m/s.
            angular_velocity: (3,) world axes, rad/s.

        Raises:
            ValueError: If there is no such body, a number is invalid, the body follows a function
                of time, or the body would overlap a drone.
        """
        self._require_open()
        b = self._body(body)
        if b in self.world.motions:
            raise ValueError(
                f"body {body} follows its function of time: remove it by remove_body first"
            )
        pose = check_pose(position, quaternion)
        velocities = check_velocities(velocity, angular_velocity)
        self.simulation.update_scene()
        self.world.move_body(b, pose, velocities)

    @exclusive
    def remove_body(self, body: int) -> None:
        """Remove a body from the world; its shape is kept for `move_body`.

        Args:
            body: Identifier that `add_body` returned.

        Raises:
            ValueError: If there is no such body.
        """
        self._require_open()
        b = self._body(body)
        self.simulation.update_scene()
        self.world.motions.pop(b, None)
        self.world.remove_body(b)

    @exclusive
    def attach_cable(
        self,
        body: int,
        other: int | None,
        length: float | None = None,
        *,
        point: Sequence[float] = STILL,
        other_point: Sequence[float] = STILL,
    ) -> int:
        """Attach a cable between two drones or loads, or from one to a fixed point in the world.

        The cable is massless and inextensible, pulls only, and has no shape: it passes through
        bodies. It needs dynamics "rigid_body" or "bullet". See `bulletuav.vehicle.load.make_load`
        for loads, and `cable_tension` for the tensions.

        Args:
            body: Index of a drone or load.
            other: Index of another, or None for a fixed point.
            length: Length, m. None for the present distance of the ends.
            point: (3,) end at `body`, in its axes from its centre of mass, m.
            other_point: (3,) end at `other`, in its axes, or in the world if `other` is None, m.

        Returns:
            Index of the cable.

        Raises:
            ValueError: If there is no such body, a number is invalid, the length is less than the
                distance of the ends, or the dynamics has no cables; the state is unchanged.
        """
        self._require_open()
        world = self.world
        ends = check_ends(world.dynamics, body, other, point, other_point)
        cable = attach(world.dynamics, world.state.swarm, ends, length)
        self.simulation.program = None
        return cable

    @exclusive
    def detach_cable(self, cable: int) -> None:
        """Detach a cable from both ends.

        Args:
            cable: Index that `attach_cable` returned, and that a later cable may get.

        Raises:
            ValueError: If there is no such cable.
        """
        self._require_open()
        detach(self.world.dynamics, cable)

    @property
    def cable_tension(self) -> np.ndarray:
        """(C,) mean tension of each cable in the last substep, N; a copy.

        A cable that becomes taut with a jerk adds its impulse, divided by the duration of the
        substep.
        """
        tension: np.ndarray = self.world.dynamics.cables.tension[0].copy()
        return tension

    @exclusive
    def command(
        self,
        drones: Drones,
        level: SetpointLevel | str,
        setpoint: Any,
        *,
        yaw: Angle | None = None,
        yaw_rate: Angle | None = None,
    ) -> None:
        """Command setpoints, which the drones hold from the next step on.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all; loads, which
                have no rotors, cannot be commanded, and None leaves them out.
            level: Setpoint level or its name; `consumes` or a level above.
            setpoint: Numbers of the level, see `SetpointLevel`: (S,) for all, or a row for each of
                the drones. With POSITION, VELOCITY and ACCELERATION the yaw may be left out. Values
                beyond a drone's limits are clipped.
            yaw: Yaw to hold, rad, or one for each of the drones. If None, the drone keeps the yaw
                that it held before, or its present yaw.
            yaw_rate: Rate of the held yaw, rad/s, or one for each of the drones. The held yaw is at
                most 1 rad ahead of the drone; with "lee" that turns a cf2x at 2 rad/s.

        Raises:
            ValueError: If there is no such drone or level, or a number is invalid; the state is
                unchanged.
        """
        self._require_open()
        if self._has_loads:
            drones = without_loads(drones, self.airframes)
        # Fast path: compiled code checks and stores the usual arguments
        if yaw is None and yaw_rate is None and not self._turns and type(level) is SetpointLevel:
            width = self._widths.get(level)
            if width and hold(*self._held, drones, level, width, setpoint):
                return
        # All arguments are checked before any is stored
        state = self.world.state
        rows, count = rows_of(drones, len(self.airframes))
        level = level_of(level, self.consumes, self._options)
        speaks = yaw is not None or yaw_rate is not None
        numbers = setpoint_numbers(level, setpoint, count, self._rotor_numbers, speaks)
        turning = None if yaw_rate is None else angles("yaw_rate", yaw_rate, count)
        # Without a yaw in the setpoint, the present heading is held
        if yaw is not None:
            state.setpoint[0, rows, YAW] = angles("yaw", yaw, count)
        elif level < SetpointLevel.ATTITUDE and numbers.shape[-1] == YAW:
            self.world.hold_heading(rows)
        state.setpoint[0, rows, : numbers.shape[-1]] = numbers
        state.levels[0, rows] = int(level)
        state.commanded[0, rows] = True
        # Integrals of the PID would be stale after a flight without the controller
        if level == SetpointLevel.ROTOR and self._options.controller == "pid":
            self.world.cascade.memory[0, rows] = 0.0
        # After the first yaw rate, commands without a yaw rate stop the turn
        if turning is not None or self._turns:
            self._turns = True
            state.yaw_rate[0, rows] = 0.0 if turning is None else turning

    def stop(self, drones: Drones = None) -> None:
        """Switch motors off until the next command; control surfaces return to 0.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all.

        Raises:
            ValueError: If there is no such drone, or the dynamics has no motors.
        """
        self.command(drones, SetpointLevel.ROTOR, np.zeros(self._rotor_numbers))

    def require_level(self, level: SetpointLevel | str) -> None:
        """Check that a setpoint level can be commanded.

        Args:
            level: Setpoint level, or its name.

        Raises:
            ValueError: If there is no such level, or it cannot drive the dynamics.
        """
        level_of(level, self.consumes, self._options)

    @exclusive
    def apply(
        self, drones: Drones, force: Sequence[float] = STILL, torque: Sequence[float] = STILL
    ) -> None:
        """Apply an external force and torque to drones during the next step.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all.
            force: (3,) at the centre of mass, in world axes, N; or a row for each of the drones.
            torque: (3,) in body axes, N m; or a row for each of the drones.

        Raises:
            ValueError: If there is no such drone, a number is invalid, or the dynamics ignores
                external forces or torques.
        """
        self._require_open()
        rows, count = rows_of(drones, len(self.airframes))
        shape = (*count, 3)
        push, twist = (
            numbers_of_shape("force", force, shape),
            numbers_of_shape("torque", torque, shape),
        )
        dynamics, name = self.world.dynamics, self._options.dynamics_name
        if push.any() and not dynamics.feels_force:
            raise ValueError(f"dynamics {name!r} ignores forces: use 'rigid_body' or 'bullet'")
        if twist.any() and not dynamics.feels_torque:
            raise ValueError(f"dynamics {name!r} ignores torques: use 'rigid_body' or 'bullet'")
        dynamics.force[0, rows] += push
        dynamics.torque[0, rows] += twist

    @exclusive
    def set_condition(
        self,
        drones: Drones = None,
        *,
        rotor_effectiveness: Any = None,
        added_mass: Any = None,
        added_inertia: Any = None,
        gravity: Any = None,
    ) -> None:
        """Change drones in flight, from the next step on: rotors, mass, inertia and gravity.

        Conditions stay until they are set again, also over `place`. They are absolute: an added
        mass of 0 removes the earlier one. Controllers know the nominal airframe and the option
        `gravity` only. See `bulletuav.envs.conditions`.

        Args:
            drones: Index of a drone, several indices, a mask (N,), or None for all.
            rotor_effectiveness: (R,) fraction of the commanded thrust and torque that each rotor
                provides, from 0 (failed) to 1, or a row for each of the drones.
            added_mass: Mass in addition to the drone's own, at its centre of mass, kg, such as of a
                parcel, or one for each of the drones. It may be negative.
            added_inertia: (3,) moments of inertia about the body axes in addition to the drone's
                own, kg m^2, or a row for each of the drones.
            gravity: Gravitational acceleration of the world, m/s^2, downwards; for all drones.

        Raises:
            ValueError: If there is no such drone, no condition is given, a number is invalid, the
                dynamics ignores a condition, gravity is given for some of the drones, or a drone
                would have less than a tenth or more than ten times the mass or inertia of its
                airframe; nothing is changed.
        """
        self._require_open()
        world = self.world
        rows, count = rows_of(drones, len(self.airframes))
        if gravity is not None and drones is not None:
            raise ValueError(
                f"drones is {shown(drones)}, and gravity is that of the world: set it with None"
            )
        given = Condition(rotor_effectiveness, added_mass, added_inertia, gravity)
        rotors = np.atleast_1d(world.parameters["num_rotors"][0, rows])
        checked = check_condition(given, world.dynamics, rotors, count)
        apply_condition(world, 0, rows, checked)

    @property
    def rotor_effectiveness(self) -> np.ndarray:
        """(N, R) fraction of the commanded thrust that each rotor provides; see `set_condition`."""
        effectiveness: np.ndarray = self.world.dynamics.rotor_ratio[0] ** 2
        return effectiveness

    @property
    def gravity(self) -> float:
        """Gravitational acceleration that acts on the drones, m/s^2; see `set_condition`."""
        return float(self.world.dynamics.local_gravity[0, 0])

    @exclusive
    def rotor_commands(self) -> np.ndarray:
        """Compute the rotor speeds that the controllers command at the present state.

        They follow from the held setpoints, and are those of the next substep. A control allocation
        of your own can take them as the demand of the controller, and command other speeds with
        `SetpointLevel.ROTOR`. Integrals and observers of the controllers do not advance here.

        Returns:
            (N, R) rad/s, a new array; 0 for rotors that a drone lacks.

        Raises:
            ValueError: If the dynamics has no rotors.
        """
        self._require_open()
        if self.consumes < SetpointLevel.ROTOR:
            raise ValueError(
                f"dynamics {self._options.dynamics_name!r} has no rotors: use 'rigid_body' or "
                f"'bullet'"
            )
        return self.world.rotor_commands()

    @exclusive
    def set_wind(self, wind: Sequence[float]) -> None:
        """Set the steady wind from the next step on; gusts and wind profiles continue.

        Args:
            wind: (3,) east, north and up, m/s. It is added to a wind that is a function.

        Raises:
            ValueError: If a number is invalid.
        """
        self._require_open()
        given = numbers_of("wind is", wind)
        if given.shape != (3,) or not (np.abs(given) <= MAX_WIND).all():
            raise ValueError(
                f"wind is {shown(wind)}: three numbers from {-MAX_WIND:g} to {MAX_WIND:g} m/s "
                f"are needed"
            )
        self.world.wind.steady[0] = given

    @exclusive
    def step(self) -> None:
        """Simulate `period` seconds.

        Raises:
            RuntimeError: If a flight diverged, or the airspace is closed.
        """
        self._require_open()
        self.simulation.step()

    def warm_up(self) -> None:
        """Simulate a step, and compile code that later steps may need, such as contacts.

        Otherwise the first contact waits for its compilation, about half a minute on the first run.

        Raises:
            RuntimeError: See `step`.
            TypeError: If a function cannot be compiled.
        """
        self.step()
        compile_deferred()

    @exclusive
    def save_state(self) -> Snapshot:
        """Save the complete state, except for which bodies were added; see `Aviary.save_state`."""
        self._require_open()
        require_contacts(self._options.contacts)
        layout, world = self._layout(), self.world
        # Bullet rounds the state that is written: both flights continue from the rounded one
        world.dynamics.restore(world.state.swarm, world.state.alive)
        return own_snapshot(layout.pack_worlds(world.rng, ONLY), layout.form)

    @exclusive
    def load_state(self, snapshot: Snapshot) -> None:
        """Restore a state that was saved here, or in an airspace made from the same options.

        Obstacles and bodies return to their saved poses. The same bodies have to be added, in the
        same order, and as many cables attached; which of them were detached is saved. The
        function of time that a body follows is not saved.

        Args:
            snapshot: Result of `save_state`.

        Raises:
            ValueError: If the snapshot does not fit; the state is unchanged.
            RuntimeError: If the airspace is closed.
        """
        self._require_open()
        require_snapshot(snapshot, Snapshot)
        self._layout().require(snapshot, ONLY)
        self.simulation.update_scene()
        world = self.world
        # Arrays that the caller has read from `readings` do not change
        world.readings = {name: reading.copy() for name, reading in world.readings.items()}
        self._layout().unpack_worlds(snapshot.data, world.rng, ONLY)
        self._turns = bool(world.state.yaw_rate.any())
        world.uncertainty.restore(ONLY)
        world.set_obstacles()
        world.engine.place_bodies([0])
        world.dynamics.restore(world.state.swarm, world.state.alive)

    @exclusive
    def state_hash(self) -> str:
        """Compute a hash of the state; see `Aviary.state_hash`."""
        self._require_open()
        (digest,) = self.world.state_hashes(self.world.rng, ONLY)
        return digest

    def _layout(self) -> SnapshotLayout:
        if self._parts is None:
            self._parts = describe_parts(self._options, **self._made)
        return self.world.layout("airspace", self._parts)

    @exclusive
    def render(self) -> np.ndarray:
        """Render the world from outside, with rings, velocity arrows, lidar beams and cables.

        Returns:
            (height, width, 3) uint8.
        """
        self._require_open()
        world, shown = self.world, (self.world.state.swarm, self.world.state.alive)
        marks = drone_marks(*shown, 0, world.sensors.sensors.values())
        marks = marks._replace(cable=list_ends(world.dynamics.cables, world.state.swarm))
        return world.renderer.picture(0, shown[0], marks, shown[1])

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
        """Render the view of a camera that looks along its own x axis, with z up.

        Args:
            drone: Index of the drone that carries the camera; None for a camera that stands in the
                world.
            position: (3,) position of the camera in body axes of the drone, or in the world, m. If
                None, the nose of the drone, or the world's origin.
            quaternion: (4,) attitude of the camera, relative to body axes or to the world.
            target: (3,) point in the world to look at, m, instead of the quaternion.
            size: Width and height, pixels.
            field_of_view: Vertical angle, degrees.

        Returns:
            Colours, depth and labels of the pixels.

        Raises:
            ValueError: If there is no such drone, or a number is invalid.
        """
        shot = self.shot(drone, position, quaternion, target, size, field_of_view)
        picture, _ = self.draw(shot)
        return picture

    @exclusive
    def draw(
        self, shot: CameraMatrices, with_bodies: bool = False
    ) -> tuple[Picture, np.ndarray | None]:
        """Render the view of a camera, as `picture` does, and find the bodies in it.

        Args:
            shot: Result of `shot`.
            with_bodies: Whether to find the body at each pixel.

        Returns:
            The picture, and the bodies; see `VisualScene.draw`.
        """
        self._require_open()
        state = self.world.state
        drones = (state.swarm, state.alive)
        return self.world.engine.draw(0, shot, drones, with_bodies=with_bodies)

    @exclusive
    def shot(
        self,
        drone: int | None,
        position: Sequence[float] | None,
        quaternion: Sequence[float],
        target: Sequence[float] | None,
        size: Sequence[int],
        field_of_view: float,
    ) -> CameraMatrices:
        """Return the present view of a camera, to be rendered now or in another process.

        Arguments and errors are those of `picture`.
        """
        self._require_open()
        if drone is not None:
            i = as_int("drone", drone, 0, len(self.airframes) - 1)
        if position is None:
            nose = 0.0 if drone is None else self.airframes[i].collision_radius
            position = (nose, 0.0, 0.0)
        place, turn = check_pose(position, quaternion)
        width, height = (as_int("size", one, 8, 4096) for one in as_sequence("size", size, 2))
        angle = finite("field_of_view", field_of_view, 1, 170)
        if drone is not None:
            body = self.swarm.quaternion[i]
            place = self.swarm.position[i] + to_world(body, place)
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
        return CameraMatrices(view, projection, (width, height))

    @exclusive
    def scene_poses(self) -> ScenePoses:
        """Return a copy of the poses of everything that is drawn; see `VisualScene`."""
        self._require_open()
        return self.world.engine.scene_poses(self.world.state.swarm)

    @property
    def scene_contents(self) -> Contents:
        """Contents of the world, from which a `VisualScene` of this airspace is made."""
        return self.world.engine.contents

    def __repr__(self) -> str:
        """Return the drones, the dynamics and the simulated time as text."""
        kinds = ", ".join(dict.fromkeys(one.name for one in self.airframes))
        flown = f"{self._options.dynamics_name}, {self.time:g} s"
        return f"<Airspace of {len(self.airframes)} {kinds}, {flown}>"

    def __enter__(self) -> Self:
        """Return the airspace, which is closed at the end of the `with` statement."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the airspace."""
        self.close()

    def _require_open(self) -> None:
        if self.world.engine.closed:
            raise RuntimeError("this airspace is closed: make a new one")

    @exclusive
    def close(self) -> None:
        """Free the engine. Further calls do nothing."""
        self.world.engine.close()


def _shown(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of the only world of an array (1, ...)."""
    view: np.ndarray = array[0]
    view.flags.writeable = False
    return view
