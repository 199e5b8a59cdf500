"""Dynamics `bullet`: Bullet integrates the shared wrench and resolves contacts.

Scheme of one substep: rotor lag; wrench at the state before the substep with the rotor speeds after
it; velocity v+ = v + dt F / m, position p+ = p + dt v+; body rates by Euler's equation (RK4,
constant torque), attitude R+ = R exp(dt w+). Bullet alone would take an explicit Euler step of the
rates, which gains energy; the torque that it is given makes its step land on the accurate rates.
The height above the surface is taken anew in every substep.

Bullet turns bodies by pi/4 a substep at most (188 rad/s at 240 Hz); faster spins lag in attitude,
not in rates. Contacts of drones too fast for a substep are caught on the way (see
`contacts.catch_fast`).
"""

from typing import NamedTuple

import numpy as np

from bulletuav.control.cascade import Cascade, command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, Flight, require_sane
from bulletuav.dynamics.broad_phase import Pair, suspects
from bulletuav.dynamics.contacts import catch_fast
from bulletuav.dynamics.path import Path
from bulletuav.engine.c_extension import Port, substep, surface_below
from bulletuav.geometry.rotation import Vec3, cross, quat4, vec3
from bulletuav.kernel import func, kernel
from bulletuav.registry import register
from bulletuav.vehicle.aerodynamics import wakes
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm
from bulletuav.vehicle.wrench import body_acceleration, wrench


@func
def _ahead(rates: Vec3, slope: Vec3, dt: float) -> Vec3:
    """Return rates + dt * slope."""
    return (
        rates[0] + dt * slope[0],
        rates[1] + dt * slope[1],
        rates[2] + dt * slope[2],
    )


@func
def engine_torque(
    rates: Vec3,
    torque: Vec3,
    dt: float,
    row: np.record,
) -> Vec3:
    """Return the torque M' with which Bullet's step of the rates lands on the RK4 solution for M.

    Bullet's step is explicit: w + dt J^-1 (M' - w x J w).

    Args:
        rates: Body rates w before the substep, rad/s.
        torque: M in body axes, N m.
        dt: Duration of the substep, s.
        row: Row of `PARAMETERS` of the drone.

    Returns:
        M' in body axes, N m.
    """
    # Four slopes of the rates, and six times their weighted mean
    k1 = body_acceleration(rates, torque, row)
    k2 = body_acceleration(_ahead(rates, k1, 0.5 * dt), torque, row)
    k3 = body_acceleration(_ahead(rates, k2, 0.5 * dt), torque, row)
    k4 = body_acceleration(_ahead(rates, k3, dt), torque, row)
    total = (
        k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0],
        k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1],
        k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2],
    )

    # What Bullet takes off again: w x J w
    inertia = row.inertia
    momentum = (
        inertia[0] * rates[0],
        inertia[1] * rates[1],
        inertia[2] * rates[2],
    )
    gyroscopic = cross(rates, momentum)
    return (
        gyroscopic[0] + inertia[0] * total[0] / 6.0,
        gyroscopic[1] + inertia[1] * total[1] / 6.0,
        gyroscopic[2] + inertia[2] * total[2] / 6.0,
    )


@kernel
def drive(
    swarm: Swarm,
    alive: np.ndarray,
    level: int,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    dt: float,
    force: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Run controllers and rotors of one substep, and fill in the wrenches for the engine.

    Args:
        swarm: State before the substep; its rotor speeds are advanced.
        alive: (W, N) bool, drones that fly.
        level: Level of the setpoints.
        setpoint: (W, N, S) setpoints.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones.
        dt: Duration of the substep, s.
        force: (W, N, 3) forces to be written, world axes, N.
        torque: (W, N, 3) torques to be written, body axes, N m.
    """
    num_rotors = swarm.rotor_speed.shape[2]
    command = np.empty(num_rotors)
    speed = np.empty(num_rotors)
    wake = np.empty(alive.shape[1])
    for w in range(alive.shape[0]):
        # Downwash of all on all
        wakes(w, swarm.position, alive, parameters, air.gravity, wake)
        for i in range(alive.shape[1]):
            if alive[w, i]:
                # Controllers, then the lag of the rotors
                row = parameters[w, i]
                decay = lag_decay(dt, row)
                command_rotors(level, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                for rotor in range(row.num_rotors):
                    now = swarm.rotor_speed[w, i, rotor]
                    after = lagged(now, command[rotor], decay)
                    swarm.rotor_speed[w, i, rotor] = after
                    speed[rotor] = after

                # Wrench at the state before the substep with the rotor speeds after it
                around = (
                    vec3(air.wind, w, i),
                    air.surface[w, i],
                    air.gravity,
                )
                quaternion = quat4(swarm.quaternion, w, i)
                velocity = vec3(swarm.velocity, w, i)
                altitude = swarm.position[w, i, 2]
                rotors = rotor_wrench(speed, row)
                push, turn = wrench(quaternion, velocity, altitude, rotors, around, wake[i], row)
                turn = engine_torque(vec3(swarm.rates, w, i), turn, dt, row)
                for k in range(3):
                    force[w, i, k] = push[k]
                    torque[w, i, k] = turn[k]


@kernel
def advance(
    port: Port,
    substeps: int,
    near_ground: bool,
    swarm: Swarm,
    alive: np.ndarray,
    level: int,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    dt: float,
    force: np.ndarray,
    torque: np.ndarray,
    path: Path,
) -> tuple[int, bool]:
    """Fly up to so many substeps in one call, through the C extension.

    It ends early after a substep that needs a closer look: one in which something touched, or
    moved fast past something near.

    Args:
        port: Session of the extension, and the arrays of the worlds.
        substeps: Most substeps to fly.
        near_ground: Whether the ground effect wants the surface below.
        swarm: State of all drones, moved in place.
        alive: (W, N) bool, drones that fly.
        level: Level of the setpoints.
        setpoint: (W, N, S) setpoints.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones; its surface is written.
        dt: Duration of a substep, s.
        force: (W, N, 3) room for forces, N.
        torque: (W, N, 3) room for torques, N m.
        path: One piece; it is given the poses before and after the last substep.

    Returns:
        How many substeps were flown, and whether the last needs the closer look.
    """
    for flown in range(substeps):
        # Wrenches from the state before the substep
        if near_ground:
            surface_below(port, swarm.position, alive, air.surface)
        drive(swarm, alive, level, setpoint, cascade, parameters, air, dt, force, torque)
        # The engine's step, between poses that are kept
        path.position[0] = swarm.position
        path.quaternion[0] = swarm.quaternion
        touching = substep(port, force, torque, alive, swarm)
        path.position[1] = swarm.position
        path.quaternion[1] = swarm.quaternion
        # Contacts are read, and fast drones caught, outside
        if touching > 0:
            return flown + 1, True
        if suspects(path, alive, parameters, port.obstacle_radius, port.city_grid):
            return flown + 1, True
    return substeps, False


class _Inputs(NamedTuple):
    """Arguments that `advance` and its slow twin share, in their order."""

    swarm: Swarm
    alive: np.ndarray
    level: int
    setpoint: np.ndarray
    cascade: Cascade
    parameters: np.ndarray
    air: Air
    dt: float
    force: np.ndarray
    torque: np.ndarray
    path: Path


@register("dynamics")
class BulletDynamics(Dynamics):
    """The full engine: contacts push back, and every substep goes through Bullet."""

    name = "bullet"
    consumes = SetpointLevel.ROTOR
    feels_surface = True

    def __init__(self, flight: Flight) -> None:
        """Make room for the wrenches."""
        super().__init__(flight)
        self._force, self._torque = np.zeros((2, *flight.parameters.shape, 3))

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Leave the engine's bodies, which are where the swarm is."""

    def fly(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        level: SetpointLevel,
        setpoint: np.ndarray,
        wind: np.ndarray,
        motion: Motion,
    ) -> Contacts:
        """Fly through the engine, many substeps in one call where nothing happens between them.

        See the base class; contacts push back here, and their impulses are summed up.
        """
        flight = self.flight
        engine = flight.engine
        # C reads arrays as they lie
        alive = np.ascontiguousarray(alive, dtype=bool)
        assert all(array.flags.c_contiguous for array in swarm)
        path = Path.begin(swarm, motion, 1)
        surface = np.full(alive.shape, -np.inf)
        inputs = _Inputs(
            swarm=swarm,
            alive=alive,
            level=int(level),
            setpoint=setpoint,
            cascade=flight.cascade,
            parameters=flight.parameters,
            air=Air(wind, surface, flight.gravity),
            dt=flight.dt,
            force=self._force,
            torque=self._torque,
            path=path,
        )
        # Up to the next event in one call, where the C extension is there
        port = engine.port
        touched: dict[Pair, float] = {}
        flown = 0
        while flown < flight.substeps:
            substeps = flight.substeps - flown
            if motion.moving:
                # Obstacles are set anew in every substep
                substeps = 1
                path.obstacle[0] = motion.at(flown / flight.substeps)
                path.obstacle[1] = motion.at((flown + 1) / flight.substeps)
                flying = np.any(alive, axis=1)
                engine.set_obstacles(path.obstacle[1], motion.quaternion, flying)
            if port is not None:
                new, eventful = advance(port, substeps, self._near_ground, *inputs)
            else:
                new, eventful = self._advance_once(inputs)
            flown += new
            if eventful:
                self._add_contacts(touched, inputs)
        require_sane(swarm, alive, engine.first_world)
        return Contacts.merge(touched)

    def _advance_once(self, inputs: _Inputs) -> tuple[int, bool]:
        """Fly one substep through the engine's own calls; returns what `advance` does."""
        engine = self.flight.engine
        path = inputs.path
        swarm = inputs.swarm
        alive = inputs.alive
        inputs.air.surface[:] = self._surface(swarm, alive)
        drive(*inputs[:-1])
        engine.apply_wrenches(inputs.force, inputs.torque, alive)
        path.position[0] = swarm.position
        path.quaternion[0] = swarm.quaternion
        engine.step()
        engine.read_states(swarm, alive)
        path.position[1] = swarm.position
        path.quaternion[1] = swarm.quaternion
        return 1, True

    def _add_contacts(self, touched: dict[Pair, float], inputs: _Inputs) -> None:
        """Add the impulses of the last substep to `touched`, and catch who was too fast."""
        engine = self.flight.engine
        # Before catching, which makes the engine forget them
        for w, drone, other, force in engine.contacts():
            key = (w, drone, other)
            before = touched.get(key, 0.0)
            touched[key] = before + force * self.flight.dt
        caught = catch_fast(
            engine,
            inputs.path,
            inputs.swarm,
            inputs.alive,
            parameters=inputs.parameters,
        )
        for key in caught:
            touched.setdefault(key, 0.0)
