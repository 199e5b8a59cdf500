"""Kinematic dynamics: level points with a yaw that follow velocities or accelerations.

Aircraft that cannot hover fly as a Dubins airplane, see `bulletuav.dynamics.dubins`. All others:

- `point_mass`: v' = limited((v_cmd - v) / tau) - k (v - wind) + f / m: first-order velocity lag,
  acceleration limit, rotor drag, external forces.
- `single_integrator`: v = v_cmd, p+ = p + v dt.
- `double_integrator`: p+ = p + v dt + a dt^2 / 2, v+ = v + a dt, with a = limited(a_cmd) + f / m.

|v_cmd|, and |v| of the integrators, are limited to max_speed. The commanded acceleration is limited
to the one at the controller's largest tilt. Limits apply to the norm, not to each axis. Within the
limits the integration is exact for a constant setpoint. Rotors, ground effect and downwash are not
modelled; wind does not act on single and double integrator. tau is the time constant of the Lee
controller's velocity loop. Thrust balances the gravity that controllers know: if it changes in
flight, f / m includes the difference, except in `single_integrator`.
"""

import math
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import func, in_memory, kernel
from bulletuav.compiled.program import Program
from bulletuav.compiled.threads import CACHE_LINE
from bulletuav.contact.contact_state import ContactState
from bulletuav.contact.contacts import resolve_world, save_start_state, step_contacts
from bulletuav.contact.motion_bounds import update_budgets
from bulletuav.control.cascade import command_kinematic
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Decision, Dynamics
from bulletuav.dynamics.dubins import DOUBLE_INTEGRATOR, POINT_MASS, SINGLE_INTEGRATOR, fly_forward
from bulletuav.geometry.rotation import Vec3, dot, from_euler, plus, point, quat4, vec3
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm, TimeStep, get_state, set_state


@func
def limited(vector: Vec3, limit: float) -> Vec3:
    """Limit the norm of a vector; the direction does not change."""
    size = math.sqrt(dot(vector, vector))
    scale = limit / size if size > limit else 1.0
    return (scale * vector[0], scale * vector[1], scale * vector[2])


@func
def _relaxed(
    velocity: Vec3, command: Vec3, wind: Vec3, pull: Vec3, lag: float, drag: float, dt: float
) -> tuple[Vec3, Vec3]:
    """Solve v' = (v_cmd - v) / lag - drag (v - wind) + pull over dt.

    Returns:
        Velocity after dt, m/s, and displacement, m.
    """
    # Exponential approach to the velocity at which lag and drag balance
    rate = 1.0 / lag + drag
    decay = exp(-rate * dt)
    share = (1.0 - decay) / rate
    end0 = (command[0] / lag + drag * wind[0] + pull[0]) / rate
    end1 = (command[1] / lag + drag * wind[1] + pull[1]) / rate
    end2 = (command[2] / lag + drag * wind[2] + pull[2]) / rate
    # The difference from that velocity decays exponentially
    away0 = velocity[0] - end0
    away1 = velocity[1] - end1
    away2 = velocity[2] - end2
    after = (
        end0 + decay * away0,
        end1 + decay * away1,
        end2 + decay * away2,
    )
    # Integral of the velocity over dt
    moved = (
        end0 * dt + share * away0,
        end1 * dt + share * away1,
        end2 * dt + share * away2,
    )
    return after, moved


@func
def lagged_velocity(
    velocity: Vec3,
    command: Vec3,
    wind: Vec3,
    pull: Vec3,
    lag: float,
    drag: float,
    most: float,
    dt: float,
) -> tuple[Vec3, Vec3]:
    """Integrate the velocity of a `point_mass` over dt.

    Below the acceleration limit, v' = (v_cmd - v) / lag - drag (v - wind) + pull is linear and
    solved exactly. At the limit, the acceleration is held for dt.

    Args:
        velocity: Velocity, m/s.
        command: Commanded velocity, m/s.
        wind: Velocity of the air, m/s.
        pull: Acceleration by external forces, m/s^2.
        lag: Time constant of the velocity, s.
        drag: Drag coefficient per mass, 1/s.
        most: Limit of the commanded acceleration, m/s^2.
        dt: Duration, s.

    Returns:
        Velocity after dt, m/s, and displacement, m.
    """
    steered = (
        (command[0] - velocity[0]) / lag,
        (command[1] - velocity[1]) / lag,
        (command[2] - velocity[2]) / lag,
    )
    if dot(steered, steered) <= most * most:
        return _relaxed(velocity, command, wind, pull, lag, drag, dt)

    steered = limited(steered, most)
    acceleration0 = steered[0] - drag * (velocity[0] - wind[0]) + pull[0]
    acceleration1 = steered[1] - drag * (velocity[1] - wind[1]) + pull[1]
    acceleration2 = steered[2] - drag * (velocity[2] - wind[2]) + pull[2]
    # Exact for a constant acceleration
    half = 0.5 * dt * dt
    after = (
        velocity[0] + acceleration0 * dt,
        velocity[1] + acceleration1 * dt,
        velocity[2] + acceleration2 * dt,
    )
    moved = (
        velocity[0] * dt + acceleration0 * half,
        velocity[1] * dt + acceleration1 * half,
        velocity[2] * dt + acceleration2 * half,
    )
    return after, moved


@func
def accelerated(velocity: Vec3, acceleration: Vec3, fastest: float, dt: float) -> tuple[Vec3, Vec3]:
    """Integrate the velocity of a `double_integrator` over dt, with the speed limited to `fastest`.

    Args:
        velocity: Velocity, m/s.
        acceleration: Acceleration, held for dt, m/s^2.
        fastest: Limit of the speed, m/s.
        dt: Duration, s.

    Returns:
        Velocity after dt, m/s, and displacement, m.
    """
    after = (
        velocity[0] + acceleration[0] * dt,
        velocity[1] + acceleration[1] * dt,
        velocity[2] + acceleration[2] * dt,
    )
    after = limited(after, fastest)
    # Mean of the velocities before and after
    half = 0.5 * dt
    moved = (
        half * (velocity[0] + after[0]),
        half * (velocity[1] + after[1]),
        half * (velocity[2] + after[2]),
    )
    return after, moved


@func
def _drag_rate(swarm: Swarm, w: int, i: int, row: np.record) -> float:
    """Return the drag coefficient of a drone's rotors at their present speeds, per mass, 1/s."""
    drag = 0.0
    for rotor in range(row.num_rotors):
        drag += row.drag_xy * swarm.rotor_speed[w, i, rotor] / row.mass
    return drag


@func
def _advance_point(
    kind: int,
    target: Vec3,
    velocity: Vec3,
    wind: Vec3,
    pull: Vec3,
    fastest: float,
    lag: float,
    drag: float,
    most: float,
    dt: float,
) -> tuple[Vec3, Vec3]:
    """Return velocity and displacement of a point after dt, under the setpoint `target`."""
    # The limit applies to the commanded acceleration, not to external forces
    if kind == DOUBLE_INTEGRATOR:
        acceleration = plus(limited(target, most), 1.0, pull)
        return accelerated(velocity, acceleration, fastest, dt)
    command = limited(target, fastest)
    if kind == POINT_MASS:
        return lagged_velocity(velocity, command, wind, pull, lag, drag, most, dt)
    # A single integrator takes the commanded velocity immediately
    return command, (command[0] * dt, command[1] * dt, command[2] * dt)


@func
def _constants(
    swarm: Swarm, w: int, i: int, row: np.record, gain: np.record, gravity: float
) -> tuple[float, float, float]:
    """Return a drone's velocity lag (s), rotor drag (1/s) and limit of acceleration (m/s^2)."""
    lag = 1.0 / (2.0 * gain.damping * gain.position_frequency)
    return lag, _drag_rate(swarm, w, i, row), gravity * gain.max_tilt


@func
def _pieces(kind: int, decision: Decision, w: int) -> int:
    """Return the number of straight segments that a decision is integrated in, in world w.

    A single integrator under velocity setpoints needs one, as its velocity is constant, unless it
    has to turn.
    """
    levels, substeps = decision.setpoints.level, decision.step.substeps
    if kind != SINGLE_INTEGRATOR:
        return substeps
    for i in range(levels.shape[1]):
        if levels[w, i] != SetpointLevel.VELOCITY or decision.cascade.gains[w, i].min_speed > 0.0:
            return substeps
    return 1


@func
def _write_constants(
    decision: Decision, constants: np.ndarray, w: int, low: int, high: int
) -> None:
    """Write the constants of the drones from `low` to before `high` of world w, once a decision."""
    drones, gravity = decision.drones, decision.air.gravity
    for i in range(low, high):
        gain = decision.cascade.gains[w, i]
        constants[i] = _constants(drones.swarm, w, i, drones.parameters[w, i], gain, gravity)


@func
def _fly_drones(
    decision: Decision,
    contact: ContactState,
    kind: int,
    constants: np.ndarray,
    w: int,
    low: int,
    high: int,
    dt: float,
) -> None:
    """Fly the drones from `low` to before `high` of world w along one segment, without contacts."""
    drones, setpoints, cascade = decision.drones, decision.setpoints, decision.cascade
    swarm, alive, parameters, air = drones.swarm, drones.alive, drones.parameters, decision.air
    accelerates = kind == DOUBLE_INTEGRATOR
    save_start_state(contact, swarm, w, low, high)
    for i in range(low, high):
        if not alive[w, i] or contact.stopped[w, i]:
            continue
        position, quaternion, velocity, rates = get_state(swarm, w, i)
        wanted = quat4(setpoints.value, w, i)
        wind = vec3(air.wind, w, i)
        # Setpoints are net of the gravity that controllers know
        unknown = (0.0, 0.0, air.gravity - air.local_gravity[w, i])
        pull = plus(unknown, 1.0 / parameters[w, i].mass, vec3(air.force, w, i))
        gain = cascade.gains[w, i]
        level = setpoints.level[w, i]
        lag, drag, most = point(constants, i)
        if gain.min_speed > 0.0:
            state = (position, quaternion, velocity)
            memory = cascade.memory[w, i]
            velocity, moved, quaternion = fly_forward(
                kind, level, wanted, state, wind, pull, lag, gain, air.gravity, dt, memory
            )
        else:
            # The drone is level, with the commanded yaw
            quaternion = from_euler(0.0, 0.0, wanted[3])
            target = command_kinematic(level, accelerates, wanted, position, velocity, gain)
            velocity, moved = _advance_point(
                kind, target, velocity, wind, pull, gain.max_speed, lag, drag, most, dt
            )
        position = plus(position, 1.0, moved)
        set_state(swarm, w, i, (position, quaternion, velocity, rates))


@kernel
def advance_kinematic(
    first: int,
    last: int,
    decision: Decision,
    contact: ContactState,
    kind: int,
    constants: np.ndarray,
) -> None:
    """Fly all substeps of one decision in the worlds from `first` to before `last`.

    Args:
        first: Index of the first world.
        last: Index after the last world.
        decision: Inputs of the decision; only the gains of its controllers are used.
        contact: State of the contact solver.
        kind: POINT_MASS, SINGLE_INTEGRATOR or DOUBLE_INTEGRATOR.
        constants: (N, 3) work array.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    drones, step = decision.drones, decision.step
    num_drones = drones.alive.shape[1]
    for w in range(first, last):
        _write_constants(decision, constants, w, 0, num_drones)
        pieces = _pieces(kind, decision, w)
        dt = step.dt * (step.substeps // pieces)
        straight = in_memory(TimeStep(pieces, dt))
        for piece in range(pieces):
            _fly_drones(decision, contact, kind, constants, w, 0, num_drones, dt)
            step_contacts(contact, drones, w, piece, straight)


@kernel
def start_points(decision: Decision, kind: int, progress: np.ndarray) -> None:
    """Start a decision of a single world.

    Args:
        decision: Inputs of the decision.
        kind: POINT_MASS, SINGLE_INTEGRATOR or DOUBLE_INTEGRATOR.
        progress: (2,) index of the present segment, and number of segments; written.
    """
    progress[0] = 0
    progress[1] = _pieces(kind, decision, 0)


@kernel
def fly_points(
    low: int,
    high: int,
    decision: Decision,
    contact: ContactState,
    kind: int,
    constants: np.ndarray,
    progress: np.ndarray,
    found: np.ndarray,
) -> None:
    """Fly some drones of a single world along a segment, without contacts.

    Args:
        low: Index of the first drone.
        high: Index after the last drone.
        decision: Inputs of the decision.
        contact: State of the contact solver.
        kind: POINT_MASS, SINGLE_INTEGRATOR or DOUBLE_INTEGRATOR.
        constants: (N, 3) work array.
        progress: (2,) see `start_points`.
        found: (1,) set to 1 if a drone's motion budget is used up.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    drones, step = decision.drones, decision.step
    if progress[0] == progress[1]:
        return
    if progress[0] == 0:
        _write_constants(decision, constants, 0, low, high)
    dt = step.dt * (step.substeps // progress[1])
    _fly_drones(decision, contact, kind, constants, 0, low, high, dt)
    if update_budgets(contact, drones.swarm, drones.alive, 0, dt, low, high):
        found[0] = 1


@kernel
def finish_points(
    decision: Decision, contact: ContactState, progress: np.ndarray, found: np.ndarray
) -> None:
    """Resolve the contacts of a single world at the end of a segment.

    Args:
        decision: Inputs of the decision.
        contact: State of the contact solver.
        progress: (2,) see `start_points`; advanced.
        found: (T, 8) what `fly_points` found on each thread; cleared.
    """
    decision, contact = in_memory(decision), in_memory(contact)
    if progress[0] == progress[1]:
        return
    is_found = False
    for thread in range(found.shape[0]):
        is_found |= found[thread, 0] > 0
        found[thread, 0] = 0
    if is_found:
        step = decision.step
        straight = in_memory(TimeStep(progress[1], step.dt * (step.substeps // progress[1])))
        resolve_world(contact, decision.drones, 0, progress[0], straight)
    progress[0] += 1


@kernel
def _level(quaternion: np.ndarray, rates: np.ndarray, gains: np.ndarray, mask: np.ndarray) -> None:
    """Set zero rates for the drones of `mask` (W, N), and level attitudes if they can hover."""
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                for k in range(3):
                    rates[w, i, k] = 0.0
                if gains[w, i].min_speed > 0.0:
                    continue
                for k in range(3):
                    quaternion[w, i, k] = 0.0
                quaternion[w, i, 3] = 1.0


class Kinematic(Dynamics):
    """Base class of the three kinematic dynamics: points without tilt and rates.

    Attributes:
        kind: POINT_MASS, SINGLE_INTEGRATOR or DOUBLE_INTEGRATOR, for compiled code.
    """

    kind: ClassVar[int]
    contacts: ClassVar[tuple[str, ...]] = ("stop",)
    has_threads = True

    def _add_start(self, program: Program, swarm: Swarm, mask: np.ndarray) -> None:
        """Add calls that also set level attitudes and zero rates; see the base class."""
        gains = self.flight.cascade.gains
        program.call(_level, swarm.quaternion, swarm.rates, gains, mask)
        super()._add_start(program, swarm, mask)

    def add_flight(self, program: Program, decision: Decision) -> None:
        """Add all substeps as one compiled call; see the base class.

        Several threads fly worlds, or the drones of a single world segment by segment.
        """
        worlds, drones = decision.drones.alive.shape
        if program.threads > 1 and worlds == 1:
            self._add_points(program, decision)
            return
        contact, own = self.contact, []
        for _ in range(program.threads):
            own.append((contact, self.kind, np.empty((drones, 3))))
            contact = contact.for_thread()
        program.call(*program.shared(advance_kinematic, worlds, decision, own=own))

    def _add_points(self, program: Program, decision: Decision) -> None:
        """Add the segments of a single world, whose drones several threads fly."""
        drones = decision.drones.alive.shape[1]
        constants, progress = np.empty((drones, 3)), np.zeros(2, dtype=np.int64)
        found = np.zeros((program.threads, CACHE_LINE), dtype=np.int64)
        given = (decision, self.contact, self.kind, constants, progress)
        own = [(one,) for one in found]
        flight = program.shared(fly_points, drones, *given, own=own)
        program.call(start_points, decision, self.kind, progress)
        for _ in range(decision.step.substeps):
            program.call(*flight)
            program.call(finish_points, decision, self.contact, progress, found)


@register("dynamics")
class SingleIntegrator(Kinematic):
    """Points that move at the commanded velocity."""

    name = "single_integrator"
    consumes = SetpointLevel.VELOCITY
    kind = SINGLE_INTEGRATOR


@register("dynamics")
class DoubleIntegrator(Kinematic):
    """Points that move with the commanded acceleration, up to a limit."""

    name = "double_integrator"
    consumes = SetpointLevel.ACCELERATION
    feels_force = True
    feels_gravity = True
    kind = DOUBLE_INTEGRATOR


@register("dynamics")
class PointMass(Kinematic):
    """Points that follow the commanded velocity with a first-order lag, in wind."""

    name = "point_mass"
    consumes = SetpointLevel.VELOCITY
    feels_force = True
    feels_mass = True
    feels_gravity = True
    kind = POINT_MASS
