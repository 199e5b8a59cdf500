"""Base class of the dynamics models: each model moves the same swarm through one decision.

An author implements one substep of flight (`Dynamics.advance_substep`), or a whole decision as a
compiled call (`Dynamics.add_flight`). The base class runs the controllers, resolves contacts, finds
the surface below each drone and checks for flights that diverge.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.program import Program
from bulletuav.contact.contact_state import make_contact_state
from bulletuav.contact.contacts import (
    find_overlaps,
    get_state_arrays,
    list_contacts,
    replace_scenery,
    save_all_start_states,
    start_decision,
    step_all_contacts,
)
from bulletuav.contact.reset import reset_contacts
from bulletuav.control.cascade import Cascade
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.dynamics.cables import make_cables
from bulletuav.dynamics.divergence import any_lost
from bulletuav.dynamics.setpoints import convert
from bulletuav.engine.c_extension import surface_below
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import vec3
from bulletuav.vehicle.swarm import Contacts, DroneArrays, ObstacleMotion, Swarm, TimeStep
from bulletuav.vehicle.wings import WingTable
from bulletuav.vehicle.wrench import Surroundings, make_surroundings


class Air(NamedTuple):
    """Air, gravity and external loads on the drones during a decision.

    Attributes:
        wind: (W, N, 3) velocity of the air at each drone, world axes, m/s.
        surface: (W, N) height z of the surface below each drone, m; -inf where it was not
            requested.
        gravity: Gravitational acceleration that controllers know, m/s^2, downwards.
        force: (W, N, 3) external force on each drone, world axes, N.
        torque: (W, N, 3) external torque on each drone, body axes, N m.
        supply: (W, N) fraction of the commanded rotor speed that the battery's voltage supports.
        rotor_ratio: (W, N, R) fraction of its commanded speed that each rotor reaches.
        local_gravity: (W, N) gravitational acceleration that acts on each drone, m/s^2, downwards.
    """

    wind: np.ndarray
    surface: np.ndarray
    gravity: float
    force: np.ndarray
    torque: np.ndarray
    supply: np.ndarray
    rotor_ratio: np.ndarray
    local_gravity: np.ndarray


class Decision(NamedTuple):
    """Inputs of one decision, the argument of the compiled function of every dynamics.

    Attributes:
        drones: All drones; their state is updated in place.
        setpoints: Setpoints, held during the decision.
        cascade: Controllers from these setpoints down to those that the dynamics consumes.
        air: Air, gravity and external loads, held during the decision.
        step: Number and duration of the substeps.
        wings: Wings of all drones, None in a swarm without wings.
    """

    drones: DroneArrays
    setpoints: Setpoints
    cascade: Cascade
    air: Air
    step: TimeStep
    wings: WingTable | None


@func
def surroundings(air: Air, w: int, i: int, wake: np.ndarray) -> Surroundings:
    """Return the surroundings of drone i of world w in the wakes (N, 4), for `compute_wrench`."""
    blown = (wake[i, 0], wake[i, 1], wake[i, 2], wake[i, 3])
    wind, force, torque = vec3(air.wind, w, i), vec3(air.force, w, i), vec3(air.torque, w, i)
    gravity = air.local_gravity[w, i]
    return make_surroundings(wind, air.surface[w, i], gravity, force, torque, blown)


@dataclass(frozen=True)
class FlightSetup:
    """Constructor argument of a dynamics: worlds, drone parameters, controllers and time step.

    Attributes:
        engine: Worlds with their bodies, obstacles and cities.
        parameters: (W, N) rows of `PARAMETERS`, the true parameters of the drones.
        cascade: Controllers from an action's setpoints down to those that the dynamics consumes.
        dt: Duration of a substep, s.
        substeps: Number of substeps in a decision.
        gravity: Gravitational acceleration, m/s^2, downwards, which controllers know.
        contacts: Response to contacts, one of `Dynamics.contacts`.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Coefficient of restitution of the ground and of buildings.
        wings: Wings of all drones, None in a swarm without wings.
    """

    engine: Engine
    parameters: np.ndarray
    cascade: Cascade
    dt: float
    substeps: int
    gravity: float
    contacts: str
    friction: float
    restitution: float
    wings: WingTable | None = None


class _Placing(NamedTuple):
    """Program that initialises the drones of a mask (W, N) from the state of a swarm."""

    swarm: Swarm
    mask: np.ndarray
    program: Program


class Dynamics(ABC):
    """Base class of dynamics models, which move drones under setpoints of one level.

    Controllers convert setpoints above that level. A subclass declares the level that the dynamics
    `consumes`, and implements one substep of flight:

        class Gliding(Dynamics):
            '''Acceleration as commanded, and a drag that grows with speed through the air.'''

            consumes = SetpointLevel.ACCELERATION

            def advance_substep(self, swarm, alive, setpoint, air):
                dt = self.flight.dt
                drag = -0.2 * (swarm.velocity - air.wind)
                swarm.velocity[:] += dt * (setpoint[..., :3] + drag)
                swarm.position[:] += dt * swarm.velocity

        env = bulletuav.parallel_env("crossing", dynamics=Gliding)

    The base class restores the state of drones that are not alive, resolves contacts, and raises
    RuntimeError for states that are not finite. Compiled dynamics override `add_flight`.

    Attributes:
        name: Name by which users select the dynamics; the class name by default.
        feels_surface: Whether the dynamics reads `air.surface`, for the ground effect. It costs
            rays.
        feels_force: Whether the dynamics applies `air.force`.
        feels_torque: Whether the dynamics applies `air.torque`.
        feels_rotors: Whether the dynamics applies `air.rotor_ratio`.
        feels_mass: Whether the flight depends on the mass in `flight.parameters`.
        feels_inertia: Whether the flight depends on the inertia in `flight.parameters`.
        feels_gravity: Whether the dynamics applies `air.local_gravity`.
        feels_cables: Whether the dynamics moves bodies without rotors, and applies `cables`.
        contacts: Supported responses to contacts, the default first. "stop": a drone that touches
            something stays there until the decision ends. "impulse": contact impulses push the
            drone, and it slides and comes to rest; the velocities and rates of the swarm must be
            those of the flight.
        sleeps: Whether drones at rest are put to sleep until their forces change, see
            `bulletuav.contact.contact_state.bears`.
        has_threads: Whether several threads can fly a decision; `add_flight` then makes its calls
            by `Program.shared`.
        flight: Constructor argument: worlds, drone parameters, controllers and time step.
        contact: State of the contact solver.
        force: (W, N, 3) external force on each drone, world axes, N; zero unless written.
        torque: (W, N, 3) external torque on each drone, body axes, N m; zero unless written.
        supply: (W, N) fraction of the commanded rotor speed that motors reach; one unless written.
        rotor_ratio: (W, N, R) square root of the effectiveness of each rotor, the fraction of its
            commanded speed that it reaches; one unless written.
        local_gravity: (W, N) gravitational acceleration that acts on each drone, m/s^2, downwards;
            that of `flight` unless written.
        cables: Cables between the bodies; none unless replaced. Programs must then be built again.
    """

    name: ClassVar[str]
    feels_surface: ClassVar[bool] = False
    feels_force: ClassVar[bool] = False
    feels_torque: ClassVar[bool] = False
    feels_rotors: ClassVar[bool] = False
    feels_mass: ClassVar[bool] = False
    feels_inertia: ClassVar[bool] = False
    feels_gravity: ClassVar[bool] = False
    feels_cables: ClassVar[bool] = False
    contacts: ClassVar[tuple[str, ...]] = ("stop", "impulse")
    sleeps: ClassVar[bool] = False
    has_threads: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "name" not in vars(cls):
            cls.name = cls.__name__

    def __init__(self, flight: FlightSetup) -> None:
        """Initialise the contact solver and the external loads.

        Args:
            flight: Worlds, drone parameters, controllers and time step.
        """
        self.flight = flight
        self.contact = make_contact_state(
            flight.engine.scenery,
            (*flight.engine.shape, flight.engine.obstacle_radius.size),
            flight.contacts == "stop",
            self.sleeps,
            flight.friction,
            flight.restitution,
        )
        gains = flight.parameters["ground_effect_gain"]
        self.force, self.torque = np.zeros((2, *flight.parameters.shape, 3))
        self.supply = np.ones(flight.parameters.shape)
        rotors = max(int(flight.parameters["num_rotors"].max(initial=0)), 1)
        self.rotor_ratio = np.ones((*flight.parameters.shape, rotors))
        self.local_gravity = np.full(flight.parameters.shape, float(flight.gravity))
        self.cables = make_cables((*flight.parameters.shape, rotors), 0)
        self._near_ground = self.feels_surface and bool((gains > 0).any())
        self._placing: _Placing | None = None

    @property
    @abstractmethod
    def consumes(self) -> SetpointLevel:
        """Setpoint level that the dynamics takes; a class attribute is enough."""

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Initialise the drones of `mask` (W, N) from their state, without any past contacts."""
        if self._placing is None or self._placing.swarm is not swarm:
            placing = _Placing(swarm, np.zeros(mask.shape, dtype=bool), Program())
            self._add_start(placing.program, swarm, placing.mask)
            self._placing = placing
        self._placing.mask[:] = mask
        self._placing.program.run()

    def add_place(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add a call equivalent to `place` to a program."""
        if type(self).place is Dynamics.place:
            self._add_start(program, swarm, mask)
        else:  # an author's own
            program.callback(lambda: self.place(swarm, mask))

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add a call that initialises the drones of a mask from their state to a program."""
        kept = self.contact
        program.call(reset_contacts, mask, kept.budget, kept.asleep, kept.quiet, kept.memory.number)

    def kept(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, ...) by name that, with the swarm, determine the next flight."""
        return get_state_arrays(self.contact)

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:  # noqa: B027
        """Resume drones of `mask` (W, N) after the arrays of `kept` were written.

        The default implementation does nothing.
        """

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Move the engine's bodies to the drones, for rendering; the flight does not change.

        Args:
            swarm: State of all drones.
            mask: (W, N) bool, drones whose bodies to move.
        """
        self.flight.engine.set_poses(swarm, mask)

    def fly(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        levels: SetpointLevel | np.ndarray,
        setpoint: np.ndarray,
        wind: np.ndarray,
        motion: ObstacleMotion,
    ) -> Contacts:
        """Move the active drones through one decision, and return their contacts.

        Args:
            swarm: State of all drones, updated in place.
            alive: (W, N) bool, drones that fly; the others neither move nor act.
            levels: Level of all setpoints, `consumes` or above; or (W, N) level of each drone.
            setpoint: (W, N, S) setpoints, held during the decision.
            wind: (W, N, 3) wind, held during the decision, m/s.
            motion: Motion of the obstacles during the decision; obstacles stay in place if it is
                empty.

        Returns:
            Contacts of active drones.

        Raises:
            RuntimeError: If a flight diverged.
        """
        self.look_around()
        obstacles = self.contact.before.shape[1]
        stand = self.contact.scenery.place[:, :obstacles]
        given = motion.before.shape[1] > 0
        self.contact.before[:] = motion.before if given else stand
        self.contact.after[:] = motion.after if given else stand
        program = Program()
        levels = np.array(np.broadcast_to(levels, alive.shape), dtype=np.int64)
        self.add_to(program, swarm, alive, Setpoints(levels, setpoint), wind)
        program.run()
        return self.touched()

    def look_around(self) -> bool:
        """Update the contact solver if the scenery changed.

        Returns:
            True if it changed; programs must then be built again.
        """
        scenery = self.flight.engine.scenery
        if scenery is self.contact.scenery:
            return False
        self.contact = replace_scenery(self.contact, scenery)
        return True

    def add_to(
        self,
        program: Program,
        swarm: Swarm,
        alive: np.ndarray,
        setpoints: Setpoints,
        wind: np.ndarray,
    ) -> None:
        """Add the flight of a decision to a program; see `fly` for the arguments.

        The motion of obstacles is read from `contact.before` and `contact.after`.
        """
        flight = self.flight
        program.call(start_decision, self.contact, alive, flight.substeps * flight.dt)
        drones = DroneArrays(swarm, alive, flight.parameters)
        surface = np.full(alive.shape, -np.inf)
        given = (self.supply, self.rotor_ratio, self.local_gravity)
        air = Air(wind, surface, flight.gravity, self.force, self.torque, *given)
        step = TimeStep(flight.substeps, flight.dt)
        cascade = flight.cascade.in_wind(wind)
        decision = Decision(drones, setpoints, cascade, air, step, flight.wings)
        if self._near_ground:
            self._add_surface(program, drones, air.surface)
        self.add_flight(program, decision)
        lost = np.zeros(2, dtype=np.int64)

        def refuse() -> None:
            w, i = lost.tolist()
            speed, spin = map(np.linalg.norm, (swarm.velocity[w, i], swarm.rates[w, i]))
            raise RuntimeError(
                f"the flight of drone {i} in world {flight.engine.first_world + w} diverged "
                f"({speed:.3g} m/s, {spin:.3g} rad/s): raise physics_hz or check the inertia of "
                f"its airframe; reset() restarts the world, place() restarts a drone of an airspace"
            )

        program.call(any_lost, swarm, alive, lost, otherwise=refuse)

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps of a decision to a program, by default one by one in Python.

        Args:
            program: Program that the calls are added to.
            decision: Inputs of the decision; setpoints are at the level `consumes` or above.
        """
        program.callback(lambda: self._advance_decision(decision))

    def touched(self) -> Contacts:
        """Return the contacts of the last decision."""
        return list_contacts(self.contact)

    def overlaps(self, swarm: Swarm, moved: np.ndarray, alive: np.ndarray) -> Contacts:
        """Find the overlaps of drones that were moved elsewhere; see `contacts.find_overlaps`."""
        return find_overlaps(self.contact, DroneArrays(swarm, alive, self.flight.parameters), moved)

    def _advance_decision(self, decision: Decision) -> None:
        """Fly all substeps of a decision, one by one."""
        drones, setpoints, cascade, air, step, _ = decision
        swarm, contact = drones.swarm, self.contact
        for substep in range(step.substeps):
            save_all_start_states(contact, swarm)
            before = swarm.copy()
            flying = drones.alive & ~contact.stopped
            moved = drones._replace(alive=flying)
            target = convert(setpoints, self.consumes, moved, cascade, step.dt, air.gravity)
            self.advance_substep(swarm, flying, target, air)
            # Drones that do not fly are restored, so that authors need not mask them
            for array, old in zip(swarm, before, strict=True):
                array[~flying] = old[~flying]
            self._require_finite(swarm)
            step_all_contacts(contact, drones, substep, step)

    def advance_substep(
        self, swarm: Swarm, alive: np.ndarray, setpoint: np.ndarray, air: Air
    ) -> None:
        """Move the drones through one substep of `flight.dt` seconds.

        Args:
            swarm: State of all drones, to be written in place (`swarm.position[:] = ...`).
            alive: (W, N) bool, drones that fly; changes to other drones are undone.
            setpoint: (W, N, 4) or (W, N, R + S) setpoints at the level `consumes`, in the columns
                of `SetpointLevel`.
            air: Air, gravity and external loads.
        """
        raise NotImplementedError(
            f"dynamics {self.name!r} lacks advance_substep(swarm, alive, setpoint, air)"
        )

    def _add_surface(self, program: Program, drones: DroneArrays, surface: np.ndarray) -> None:
        """Add a call that writes the height of the surface below each drone once a decision."""
        engine, position, alive = self.flight.engine, drones.swarm.position, drones.alive
        port = engine.surface_port
        if port is not None:
            program.call(surface_below, port, position, alive, surface)
            return

        def look() -> None:
            surface[:] = engine.surface_below(position, alive)

        program.callback(look)

    def _require_finite(self, swarm: Swarm) -> None:
        """Raise RuntimeError for a position, attitude or rotor speed that is not finite."""
        for field in ("position", "quaternion", "rotor_speed"):
            finite = np.isfinite(getattr(swarm, field)).all(axis=-1)
            broken = np.argwhere(~finite)
            if len(broken):
                w, i = broken[0].tolist()
                world = self.flight.engine.first_world + w
                raise RuntimeError(
                    f"dynamics {self.name!r} gave drone {i} in world {world} a {field} that is "
                    f"not finite"
                )
