"""The interface of all dynamics: each moves the same swarm through one decision.

An author writes the flight of one substep (`Dynamics.advance_substep`), or of a whole decision as a
compiled call (`Dynamics.add_flight`). The base class does the rest: controllers, contacts, the
surface below, and the check for flights that diverge.
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
from bulletuav.dynamics.divergence import any_lost
from bulletuav.dynamics.setpoints import convert
from bulletuav.engine.c_extension import surface_below
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import vec3
from bulletuav.vehicle.swarm import Contacts, DroneArrays, ObstacleMotion, Swarm, TimeStep
from bulletuav.vehicle.wrench import Surroundings, make_surroundings


class Air(NamedTuple):
    """What surrounds the drones during a decision.

    Attributes:
        wind: (W, N, 3) velocity of the air at each drone, world axes, m/s.
        surface: (W, N) height z of the surface below each drone, m; -inf where nobody asked.
        gravity: m/s^2, downwards.
        force: (W, N, 3) what pushes each drone from outside, world axes, N.
        torque: (W, N, 3) what turns it from outside, body axes, N m.
        supply: (W, N) share of the commanded rotor speed that the battery's voltage gives.
    """

    wind: np.ndarray
    surface: np.ndarray
    gravity: float
    force: np.ndarray
    torque: np.ndarray
    supply: np.ndarray


class Decision(NamedTuple):
    """The flight of one decision, as the compiled function of every dynamics takes it.

    Attributes:
        drones: All drones; their state is moved in place.
        setpoints: Setpoints, held during the decision.
        cascade: Controllers between these and the setpoints that the dynamics consumes.
        air: What surrounds the drones, held during the decision.
        step: How the decision is divided.
    """

    drones: DroneArrays
    setpoints: Setpoints
    cascade: Cascade
    air: Air
    step: TimeStep


@func
def surroundings(air: Air, w: int, i: int, wake: np.ndarray) -> Surroundings:
    """Return what surrounds drone i of world w, which feels the wakes (N, 4), for `wrench`."""
    blown = (wake[i, 0], wake[i, 1], wake[i, 2], wake[i, 3])
    wind, force, torque = vec3(air.wind, w, i), vec3(air.force, w, i), vec3(air.torque, w, i)
    return make_surroundings(wind, air.surface[w, i], air.gravity, force, torque, blown)


@dataclass(frozen=True)
class Flight:
    """What a dynamics is built from.

    Attributes:
        engine: Worlds with their bodies, obstacles and cities.
        parameters: (W, N) rows of `PARAMETERS`, with which the drones fly.
        cascade: Controllers between an action's setpoints and those that the dynamics consumes.
        dt: Duration of a substep, s.
        substeps: Substeps of a decision.
        gravity: m/s^2, downwards.
        contacts: What contacts do, one of `Dynamics.contacts`.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
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


class _Placing(NamedTuple):
    """A program that starts drones of a mask (W, N) from the state of a swarm."""

    swarm: Swarm
    mask: np.ndarray
    program: Program


class Dynamics(ABC):
    """How drones move under setpoints of one level; setpoints above it go through the controllers.

    Derive from it, tell what the dynamics `consumes`, and write the flight of one substep:

        class Gliding(Dynamics):
            '''Acceleration as commanded, and a drag that grows with speed through the air.'''

            consumes = SetpointLevel.ACCELERATION

            def advance_substep(self, swarm, alive, setpoint, air):
                dt = self.flight.dt
                drag = -0.2 * (swarm.velocity - air.wind)
                swarm.velocity[:] += dt * (setpoint[..., :3] + drag)
                swarm.position[:] += dt * swarm.velocity

        env = bulletuav.parallel_env("crossing", dynamics=Gliding)

    The base class puts back drones that are not alive, lets drones touch what they fly into, and
    refuses states that are not finite. Dynamics that are compiled override `add_flight`.

    Attributes:
        name: What users call it; the name of the class where it tells none.
        feels_surface: Whether `air.surface` is wanted, for the ground effect. It costs rays.
        feels_force: Whether `air.force` moves its drones.
        feels_torque: Whether `air.torque` turns them.
        contacts: What contacts can do, the default first. "stop": a drone stays where it touches
            something until the decision ends. "impulse": it is pushed, slides and rests there;
            this needs velocities and rates that are those of the flight.
        sleeps: Whether it leaves drones that rest alone until their forces change, see
            `bulletuav.contact.contact_state.stays_asleep`.
        flight: What it was built from.
        contact: What its contacts need.
        force: (W, N, 3) what pushes drones from outside, world axes, N; zeros unless written to.
        torque: (W, N, 3) what turns them from outside, body axes, N m; zeros unless written to.
        supply: (W, N) share of the commanded rotor speed that motors reach; ones unless written to.
    """

    name: ClassVar[str]
    feels_surface: ClassVar[bool] = False
    feels_force: ClassVar[bool] = False
    feels_torque: ClassVar[bool] = False
    contacts: ClassVar[tuple[str, ...]] = ("stop", "impulse")
    sleeps: ClassVar[bool] = False

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "name" not in vars(cls):
            cls.name = cls.__name__

    def __init__(self, flight: Flight) -> None:
        """Keep what the dynamics is built from, and prepare for contacts."""
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
        self._near_ground = self.feels_surface and bool((gains > 0).any())
        self._placing: _Placing | None = None

    @property
    @abstractmethod
    def consumes(self) -> SetpointLevel:
        """Setpoint level that drives it; a class attribute will do."""

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Start drones of `mask` (W, N) from their state, as if nothing had been before."""
        if self._placing is None or self._placing.swarm is not swarm:
            placing = _Placing(swarm, np.zeros(mask.shape, dtype=bool), Program())
            self._add_start(placing.program, swarm, placing.mask)
            self._placing = placing
        self._placing.mask[:] = mask
        self._placing.program.run()

    def add_place(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add to a program what `place` does."""
        if type(self).place is Dynamics.place:
            self._add_start(program, swarm, mask)
        else:  # an author's own
            program.turn(lambda: self.place(swarm, mask))

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add to a program that drones start from their state."""
        kept = self.contact
        program.call(reset_contacts, mask, kept.budget, kept.asleep, kept.quiet, kept.memory.number)

    def kept(self) -> dict[str, np.ndarray]:
        """Tell the arrays (W, ...) by name that flights follow from, beside the swarm."""
        return get_state_arrays(self.contact)

    def restore(self, swarm: Swarm, mask: np.ndarray) -> None:  # noqa: B027
        """Go on with drones of `mask` (W, N) after `kept` was written; by default nothing to do."""

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Have the engine's bodies stand where drones are, for pictures; changes nothing in flight.

        Args:
            swarm: State of all drones.
            mask: (W, N) bool, drones whose bodies are moved.
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
        """Move the living drones through one decision, and tell what they touched.

        Args:
            swarm: State of all drones, moved in place.
            alive: (W, N) bool, drones that fly; the others neither move nor act.
            levels: Level of the setpoints, `consumes` or above; or (W, N) that of each drone.
            setpoint: (W, N, S) setpoints, held during the decision.
            wind: (W, N, 3) wind, held during the decision, m/s.
            motion: Where obstacles go meanwhile; with none they stay where they are.

        Returns:
            Contacts of living drones.

        Raises:
            RuntimeError: A flight diverged.
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
        """See whether something else stands now; programs must then be made anew."""
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

        Where obstacles go stands in `contact.before` and `contact.after`.
        """
        flight = self.flight
        program.call(start_decision, self.contact, alive, flight.substeps * flight.dt)
        drones = DroneArrays(swarm, alive, flight.parameters)
        surface = np.full(alive.shape, -np.inf)
        air = Air(wind, surface, flight.gravity, self.force, self.torque, self.supply)
        step = TimeStep(flight.substeps, flight.dt)
        decision = Decision(drones, setpoints, flight.cascade, air, step)
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
                f"its airframe; reset() starts the world anew, place() a drone of an airspace"
            )

        program.call(any_lost, swarm, alive, lost, otherwise=refuse)

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps of a decision to a program, by default one by one in Python.

        Args:
            program: To be added to.
            decision: What is flown; setpoints are at the level `consumes` or above.
        """
        program.turn(lambda: self._advance_decision(decision))

    def touched(self) -> Contacts:
        """Tell what was touched in the last decision."""
        return list_contacts(self.contact)

    def overlaps(self, swarm: Swarm, moved: np.ndarray, alive: np.ndarray) -> Contacts:
        """Find what drones touch that were put somewhere else; see `contacts.find_overlaps`."""
        return find_overlaps(self.contact, DroneArrays(swarm, alive, self.flight.parameters), moved)

    def _advance_decision(self, decision: Decision) -> None:
        """Fly all substeps of a decision, one by one."""
        drones, setpoints, cascade, air, step = decision
        swarm, contact = drones.swarm, self.contact
        for substep in range(step.substeps):
            save_all_start_states(contact, swarm)
            before = swarm.copy()
            flying = drones.alive & ~contact.stopped
            moved = drones._replace(alive=flying)
            target = convert(setpoints, self.consumes, moved, cascade, step.dt, air.gravity)
            self.advance_substep(swarm, flying, target, air)
            # Drones that do not fly are put back, so that authors need not mind them
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
            alive: (W, N) bool, drones that fly; what is written for others is undone.
            setpoint: (W, N, 4) or (W, N, R) setpoints at the level that is consumed, in the
                columns of `SetpointLevel`.
            air: What surrounds the drones.
        """
        raise NotImplementedError(
            f"dynamics {self.name!r} lacks advance_substep(swarm, alive, setpoint, air)"
        )

    def _add_surface(self, program: Program, drones: DroneArrays, surface: np.ndarray) -> None:
        """Add to a program that the height of the surface below drones is written once."""
        engine, position, alive = self.flight.engine, drones.swarm.position, drones.alive
        port = engine.surface_port
        if port is not None:
            program.call(surface_below, port, position, alive, surface)
            return

        def look() -> None:
            surface[:] = engine.surface_below(position, alive)

        program.turn(look)

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
