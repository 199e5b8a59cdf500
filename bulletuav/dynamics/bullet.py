"""Dynamics `bullet`: Bullet integrates the shared wrench and resolves contacts.

Scheme of one substep: rotor lag; wrench at the state before the substep with the rotor speeds after it; velocity
v+ = v + dt F / m, position p+ = p + dt v+; body rates by Euler's equation (RK4, constant torque), attitude
R+ = R exp(dt w+). Bullet alone would take an explicit Euler step of the rates, which gains energy; the torque that it is
given makes its step land on the accurate rates. The height above the surface is taken anew in every substep.
Bullet turns bodies by pi/4 a substep at most (188 rad/s at 240 Hz); faster spins lag in attitude, not in rates. Contacts of
drones too fast for a substep are caught on the way (see `sweep.catch_fast`).
"""

import numpy as np

from bulletuav.control.cascade import command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, Flight, require_sane
from bulletuav.dynamics.path import Path
from bulletuav.dynamics.sweep import catch_fast, suspects
from bulletuav.engine.c_extension import substep, surface_below
from bulletuav.geometry.rotation import cross, quat4, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.aerodynamics import wakes
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm
from bulletuav.vehicle.wrench import body_acceleration, wrench


@func
def _ahead(rates, slope, dt):
    return rates[0] + dt * slope[0], rates[1] + dt * slope[1], rates[2] + dt * slope[2]


@func
def engine_torque(rates, torque, dt, row):
    """Torque (N m, body) with which Bullet's explicit step w + dt J^-1 (M' - w x J w) lands on the RK4 solution for M."""
    k1 = body_acceleration(rates, torque, row)
    k2 = body_acceleration(_ahead(rates, k1, 0.5 * dt), torque, row)
    k3 = body_acceleration(_ahead(rates, k2, 0.5 * dt), torque, row)
    k4 = body_acceleration(_ahead(rates, k3, dt), torque, row)
    gyroscopic = cross(
        rates, (row.inertia[0] * rates[0], row.inertia[1] * rates[1], row.inertia[2] * rates[2])
    )
    return (
        gyroscopic[0] + row.inertia[0] * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0]) / 6.0,
        gyroscopic[1] + row.inertia[1] * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1]) / 6.0,
        gyroscopic[2] + row.inertia[2] * (k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2]) / 6.0,
    )


@kernel
def drive(swarm, alive, level, setpoint, cascade, parameters, air, dt, force, torque):
    """Controllers, rotors and wrenches of one substep: advances rotor speeds, fills force (world) and torque (body)."""
    command, speed = np.empty(swarm.rotor_speed.shape[2]), np.empty(swarm.rotor_speed.shape[2])
    wake = np.empty(alive.shape[1])
    for w in range(alive.shape[0]):
        wakes(w, swarm.position, alive, parameters, air.gravity, wake)
        for i in range(alive.shape[1]):
            if alive[w, i]:
                row = parameters[w, i]
                decay = lag_decay(dt, row)
                command_rotors(level, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                for r in range(row.num_rotors):
                    swarm.rotor_speed[w, i, r] = speed[r] = lagged(
                        swarm.rotor_speed[w, i, r], command[r], decay
                    )
                around = (vec3(air.wind, w, i), air.surface[w, i], air.gravity)
                quaternion, velocity = quat4(swarm.quaternion, w, i), vec3(swarm.velocity, w, i)
                rotors = rotor_wrench(speed, row)
                push, turn = wrench(
                    quaternion, velocity, swarm.position[w, i, 2], rotors, around, wake[i], row
                )
                turn = engine_torque(vec3(swarm.rates, w, i), turn, dt, row)
                for k in range(3):
                    force[w, i, k], torque[w, i, k] = push[k], turn[k]


@kernel
def advance(
    port,
    substeps,
    near_ground,
    swarm,
    alive,
    level,
    setpoint,
    cascade,
    parameters,
    air,
    dt,
    force,
    torque,
    path,
):
    """Up to `substeps` substeps in one call; ends early after one that needs a closer look.

    That is one in which something touched or moved fast past something near; `path` holds the poses of the last substep.
    Returns how many were flown, and whether the last needs the closer look.
    """
    for flown in range(substeps):
        if near_ground:
            surface_below(port, swarm.position, alive, air.surface)
        drive(swarm, alive, level, setpoint, cascade, parameters, air, dt, force, torque)
        path.position[0], path.quaternion[0] = swarm.position, swarm.quaternion
        touching = substep(port, force, torque, alive, swarm)
        path.position[1], path.quaternion[1] = swarm.position, swarm.quaternion
        if touching > 0 or suspects(path, alive, parameters, port.obstacle_radius, port.city_grid):
            return flown + 1, True
    return substeps, False


class BulletDynamics(Dynamics):
    """The full engine: contacts push back, and every substep goes through Bullet."""

    @property
    def consumes(self) -> SetpointLevel:
        """Rotor speeds."""
        return SetpointLevel.ROTOR

    def __init__(self, flight: Flight):
        super().__init__(flight)
        self._force, self._torque = np.zeros((2, *flight.parameters.shape, 3))

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Nothing to do: the engine's bodies are where the swarm is."""

    def fly(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        level: SetpointLevel,
        setpoint: np.ndarray,
        wind: np.ndarray,
        motion: Motion,
    ) -> Contacts:
        """Substeps through the engine, many in one call where nothing happens between them."""
        flight, engine, port = self.flight, self.flight.engine, self.flight.engine.port
        alive = np.ascontiguousarray(alive, dtype=bool)  # which C reads as it lies
        assert all(array.flags.c_contiguous for array in swarm)
        path = Path.begin(swarm, motion, 1)
        air = Air(wind, np.full(alive.shape, -np.inf), flight.gravity)
        inputs = (
            swarm,
            alive,
            int(level),
            setpoint,
            flight.cascade,
            flight.parameters,
            air,
            flight.dt,
            self._force,
            self._torque,
        )
        touched: dict[tuple[int, int, int], float] = {}
        flown = 0
        while flown < flight.substeps:
            substeps = 1 if motion.moving else flight.substeps - flown
            if motion.moving:
                path.obstacle[:] = (
                    motion.at(flown / flight.substeps),
                    motion.at((flown + 1) / flight.substeps),
                )
                engine.set_obstacles(path.obstacle[1], motion.quaternion, np.any(alive, axis=1))
            if port is not None:
                new, eventful = advance(port, substeps, self._near_ground, *inputs, path)
            else:
                new, eventful = self._advance(*inputs, path)
            flown += new
            if eventful:
                for (
                    w,
                    drone,
                    other,
                    force,
                ) in engine.contacts():  # before catching, which forgets them
                    touched[w, drone, other] = (
                        touched.get((w, drone, other), 0.0) + force * flight.dt
                    )
                for key in catch_fast(engine, path, swarm, alive, flight.parameters):
                    touched.setdefault(key, 0.0)
        require_sane(swarm, alive, flight.engine.first_world)
        return Contacts.merge(touched)

    def _advance(
        self, swarm, alive, level, setpoint, cascade, parameters, air, dt, force, torque, path: Path
    ):
        """`advance` by one substep, through the world's own calls."""
        engine = self.flight.engine
        air.surface[:] = self._surface(swarm, alive)
        drive(swarm, alive, level, setpoint, cascade, parameters, air, dt, force, torque)
        engine.apply_wrenches(force, torque, alive)
        path.position[0], path.quaternion[0] = swarm.position, swarm.quaternion
        engine.step()
        engine.read_states(swarm, alive)
        path.position[1], path.quaternion[1] = swarm.position, swarm.quaternion
        return 1, True
