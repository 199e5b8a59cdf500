"""An airspace: drones in Bullet that fly by a loop of one's own, without a task."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.compiled.deferred import compile_deferred
from bulletuav.compiled.program import Program
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.envs.airspace_inputs import (
    YAW,
    Angle,
    Drones,
    angles,
    filled,
    rows_of,
)
from bulletuav.envs.airspace_kernels import finish, headings, prepare
from bulletuav.envs.airspace_parts import STILL, AirspaceParts
from bulletuav.envs.airspace_setpoints import hold, level_of, setpoint_numbers
from bulletuav.envs.described import faces_of, parts_of
from bulletuav.envs.environment import exclusive
from bulletuav.envs.parts import add_obstacles
from bulletuav.envs.snapshot import (
    BODIES,
    MAX_STEPS,
    Bounds,
    Layout,
    Snapshot,
    contact_bounds,
    hashes_of,
    own_snapshot,
    pack,
    require_contacts,
    require_snapshot,
    state_bounds,
)
from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Contacts
from bulletuav.vehicle.wind import MOST_WIND


class Airspace(AirspaceParts):
    """One world of N drones that do what they are told, step by step: no goal, no reward, no end.

    Each drone holds the setpoint that it was told last. Until it is told one, these are zeros at
    the level that the dynamics consumes: motors off, or no motion.

        airspace = Airspace([(0.0, 0.0, 1.0)], decision_hz=48)
        airspace.command(0, SetpointLevel.POSITION, (1.0, 0.0, 1.0))
        for _ in range(48):
            airspace.step()
        print(airspace.swarm.position[0])

    Its arrays stay the same for its life, and each step writes them anew: copy what you keep. The
    same calls with the same seed give the same bits.

    Attributes:
        airframes: Airframe of each drone.
        swarm: State of the drones, arrays (N, ...); read-only, see `place`.
        hover_speed: (N, R) rotor speeds at which drones hover, rad/s.
        period: Duration of a step, s.
        consumes: Setpoint level that the dynamics consumes; commands are of it or above.
        levels: (N,) `SetpointLevel` that each drone holds; read-only.
        setpoint: (N, S) setpoint that each drone holds; read-only.
        readings: What sensors measured last, arrays (N, ...) by name, new ones each step.
    """

    _layout: Layout | None = None
    _parts: Mapping[str, str] | None = None
    _laid_out: Scenery | None = None

    @property
    def time(self) -> float:
        """Time since the airspace was made, s."""
        return float(self._time[0])

    @property
    def contacts(self) -> Contacts:
        """What touched what in the last step; the world of each row is 0."""
        return self._dynamics.touched().of_worlds(np.ones(1, dtype=bool))

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
        """Tell drones what to do from the next step on.

        Args:
            drones: Index of a drone, several, a mask (N,), or None for all.
            level: Meaning of the setpoint, or its name; `consumes` or above it.
            setpoint: Numbers of the level, see `SetpointLevel`: (S,) for all, or a row for each of
                the drones. With POSITION, VELOCITY and ACCELERATION the yaw may be left out. What a
                drone cannot do is cut to what it can.
            yaw: Yaw to hold, rad, or one for each of the drones. Left out, that which was held
                before, or the present one.
            yaw_rate: How fast the yaw to hold turns, rad/s, or one for each of the drones. It is
                at most 1 rad ahead of the drone; with "lee" that turns a cf2x at 2 rad/s.

        Raises:
            ValueError: There is no such drone or level, or numbers cannot be; nothing has changed.
        """
        self._require_open()
        # The usual call, checked and kept by compiled code
        if yaw is None and yaw_rate is None and not self._turns and type(level) is SetpointLevel:
            width = self._widths.get(level)
            held = (self._levels, self._setpoint, self._told)
            if width and hold(*held, drones, level, width, setpoint):
                return
        # Everything is checked before anything is kept
        rows, count = rows_of(drones, len(self.airframes))
        level = level_of(level, self.consumes, self._options)
        speaks = yaw is not None or yaw_rate is not None
        rotors = self.hover_speed.shape[1]
        numbers = setpoint_numbers(level, setpoint, count, rotors, speaks)
        turning = None if yaw_rate is None else angles("yaw_rate", yaw_rate, count)
        # Without a yaw in the setpoint, the present heading is held
        if yaw is not None:
            self._setpoint[0, rows, YAW] = angles("yaw", yaw, count)
        elif level < SetpointLevel.ATTITUDE and numbers.shape[-1] == YAW:
            self._hold_yaw(rows)
        # Held until told otherwise
        self._setpoint[0, rows, : numbers.shape[-1]] = numbers
        self._levels[0, rows] = int(level)
        self._told[0, rows] = True
        # Integrals of the PID would be stale after a flight without it
        if level == SetpointLevel.ROTOR and self._options.controller == "pid":
            self._dynamics.flight.cascade.memory[0, rows] = 0.0
        # From the first yaw rate on, drones that are told none stop turning
        if turning is not None or self._turns:
            self._turns = True
            self._yaw_rate[0, rows] = 0.0 if turning is None else turning

    def stop(self, drones: Drones = None) -> None:
        """Switch motors off, until the next command.

        Args:
            drones: Index of a drone, several, a mask (N,), or None for all.

        Raises:
            ValueError: There is no such drone, or the dynamics has no motors.
        """
        self.command(drones, SetpointLevel.ROTOR, np.zeros(self.hover_speed.shape[1]))

    def require_level(self, level: SetpointLevel | str) -> None:
        """Check that drones can be commanded a setpoint level.

        Args:
            level: The level, or its name.

        Raises:
            ValueError: There is no such level, or it cannot drive the dynamics.
        """
        level_of(level, self.consumes, self._options)

    @exclusive
    def apply(
        self,
        drones: Drones,
        force: Sequence[float] = STILL,
        torque: Sequence[float] = STILL,
    ) -> None:
        """Push drones during the next step, beside what pushes them already.

        Args:
            drones: Index of a drone, several, a mask (N,), or None for all.
            force: (3,) at the centre of mass, world axes, N; or a row for each of the drones.
            torque: The same in body axes, N m.

        Raises:
            ValueError: There is no such drone, numbers cannot be, or the dynamics does not feel it.
        """
        self._require_open()
        rows, count = rows_of(drones, len(self.airframes))
        shape = (*count, 3)
        push, twist = filled("force", force, shape), filled("torque", torque, shape)
        name = self._options.dynamics_name
        if push.any() and not self._dynamics.feels_force:
            raise ValueError(f"dynamics {name!r} feels no forces: use 'rigid_body' or 'bullet'")
        if twist.any() and not self._dynamics.feels_torque:
            raise ValueError(f"dynamics {name!r} feels no torques: use 'rigid_body' or 'bullet'")
        self._dynamics.force[0, rows] += push
        self._dynamics.torque[0, rows] += twist

    @exclusive
    def set_wind(self, wind: Sequence[float]) -> None:
        """Change the steady wind, from the next step on; gusts and profiles go on.

        Args:
            wind: (3,) east, north and up, m/s. It adds to a wind that is a function.

        Raises:
            ValueError: A number cannot be.
        """
        self._require_open()
        given = numbers_of("wind is", wind)
        if given.shape != (3,) or not (np.abs(given) <= MOST_WIND).all():
            raise ValueError(
                f"wind is {shown(wind)}: three numbers from {-MOST_WIND:g} to {MOST_WIND:g} m/s "
                f"are needed"
            )
        self._wind.steady[0] = given

    @exclusive
    def step(self) -> None:
        """Fly for `period` seconds.

        Raises:
            RuntimeError: A flight diverged, or the airspace is closed.
        """
        self._look()
        program = self._program or self._make_program()
        try:
            program.run()
        except BaseException:
            # So that `place` is enough to go on
            self._dynamics.force[:] = self._dynamics.torque[:] = 0.0
            raise

    def warm_up(self) -> None:
        """Fly a step, and compile what later ones may need, such as contacts.

        Otherwise the first touch waits for its code, half a minute at the first time.

        Raises:
            RuntimeError: As `step` does.
            TypeError: Something cannot be compiled.
        """
        self.step()
        compile_deferred()

    def _make_program(self) -> Program:
        """Make the program of a step, in the order in which things happen."""
        program, contact = Program(), self._dynamics.contact
        # What is around: wind, obstacles on their ways, headings that turn
        self._wind.add_to(program, self._swarm.position, self._time, self._air)
        obstacles = (self._obstacle, self._obstacle_velocity, contact.before, contact.after)
        turning = (self._swarm.quaternion, self._setpoint, self._yaw_rate)
        program.call(prepare, *turning, self.period, *obstacles)
        # The flight, and where obstacles are after it
        given = Setpoints(self._levels, self._setpoint)
        self._dynamics.add_to(program, self._swarm, self._alive, given, self._air)
        add_obstacles(program, self._engine, self._obstacle)
        # Forces that were applied act in one step
        pushes = (self._dynamics.force, self._dynamics.torque)
        hz = float(self._options.decision_hz)
        program.call(finish, self._steps, hz, self._time, *pushes)
        # Sensors and views come last, of the state after the step
        if self._sensors.sensors:
            program.turn(self._measure)
        if self._options.render_mode == "human":
            program.turn(self._show_live)
        program.compile()
        self._program = program
        return program

    @exclusive
    def save_state(self) -> Snapshot:
        """Save all that makes the future but which bodies there are; see `Aviary.save_state`."""
        self._require_open()
        require_contacts(self._options.contacts)
        layout, only = self._all_arrays(), np.zeros(1, dtype=int)
        # Bullet rounds what is written: both flights are to go on from that.
        self._dynamics.restore(self._swarm, self._alive)
        return own_snapshot(layout.pack([self.rng], only), layout.form)

    @exclusive
    def load_state(self, snapshot: Snapshot) -> None:
        """Go on from a state that was saved here, or in an airspace made alike.

        Obstacles go back to where they were; bodies that were added have to be the same.

        Args:
            snapshot: What `save_state` gave.

        Raises:
            ValueError: It does not fit; all stays as it was.
            RuntimeError: The airspace is closed.
        """
        self._require_open()
        require_snapshot(snapshot, Snapshot)
        self._all_arrays().require(snapshot, np.zeros(1, dtype=int))
        self._look()
        # What was read from `readings` before stays as it is.
        self.readings = {name: reading.copy() for name, reading in self.readings.items()}
        layout, rngs = self._all_arrays(), [self.rng]
        layout.unpack(snapshot.data, rngs, np.zeros(1, dtype=int))
        (self.rng,) = rngs
        self._turns = bool(self._yaw_rate.any())
        self._uncertainty.restore(np.zeros(1, dtype=int))
        obstacles = (self._obstacle, self._obstacle_turn, np.ones(1, dtype=bool))
        self._engine.set_obstacles(*obstacles)
        self._dynamics.restore(self._swarm, self._alive)

    @exclusive
    def state_hash(self) -> str:
        """Hash the state; see `Aviary.state_hash`."""
        self._require_open()
        (told,) = hashes_of(pack(self._state_arrays(), [self.rng], np.zeros(1, dtype=int)))
        return told

    def _all_arrays(self) -> Layout:
        arrays = {BODIES: self._engine.bodies, **self._state_arrays(), **self._more_arrays()}
        if self._parts is None:
            made: dict[str, Any] = {"obstacles": self._obstacles, "layout": faces_of(self._layouts)}
            self._parts = parts_of(self._options, **made)
        scenery = self._engine.scenery  # another one where bodies were added
        known = self._layout is not None and self._layout.is_of(arrays)
        if self._layout is None or not known or scenery is not self._laid_out:
            self._laid_out = scenery
            self._layout = Layout("airspace", self._parts, self._bounds(), arrays)
        return self._layout

    def _bounds(self) -> Bounds:
        """Return the bounds of arrays that a snapshot may write, by name."""
        return {
            **state_bounds(self._swarm),
            "levels": (0, int(self.consumes)),
            "steps": (0, MAX_STEPS),
            **self._sensors.kept_bounds(),
            **contact_bounds(self._engine.scenery),
        }

    def _state_arrays(self) -> dict[str, np.ndarray]:
        """Tell the arrays (1, ...) by name that are the state, whatever flew before."""
        # What was drawn at the start belongs to the state: it is not drawn again
        drawn = {f"drawn {name}": array for name, array in self._uncertainty.drawn.items()}
        return {
            **self._swarm._asdict(),
            **drawn,
            "levels": self._levels,
            "setpoint": self._setpoint,
            "told": self._told,
            "yaw_rate": self._yaw_rate,
            "steps": self._steps,
            "time": self._time,
            "obstacle": self._obstacle,
            "obstacle_velocity": self._obstacle_velocity,
            "obstacle_turn": self._obstacle_turn,
            "force": self._dynamics.force,
            "torque": self._dynamics.torque,
            "parameters": self._dynamics.flight.parameters,
            "controller": self._dynamics.flight.cascade.memory,
        }

    def _more_arrays(self) -> dict[str, np.ndarray]:
        """Tell what else its future follows from; something in them may be left from before."""
        told = {f"before {name}": array for name, array in self._before._asdict().items()}
        told |= {f"reading {name}": array[None] for name, array in self.readings.items()}
        for part in (self._wind, self._sensors, self._dynamics):
            told.update(part.kept())
        return told

    def _hold_yaw(self, rows: Any) -> None:
        """Let drones that hold no yaw hold the present one."""
        holds = self._told[0, rows] & (self._levels[0, rows] <= SetpointLevel.ACCELERATION)
        free = np.flatnonzero(~holds)
        if len(free):
            present = np.zeros(self._levels.shape)
            headings(self._swarm.quaternion, present)
            who = np.atleast_1d(np.arange(len(self.airframes))[rows])[free]
            self._setpoint[0, who, YAW] = present[0, who]
