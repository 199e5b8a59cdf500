"""Dynamics `rigid_body`: the shared wrench, integrated by RK4 in one compiled loop over all substeps of a decision.

Within a substep the setpoint's rotor command, the wind and the downwash of other drones are held, while rotor lag, drag,
ground effect and attitude are followed exactly by the stages. The surface height below is sampled once a decision: over
level ground that is exact; past an edge the ground effect lags by up to one decision (at 20 m/s and 10 Hz, 2 m of flight).
"""

import math

import numpy as np

from bulletuav.control.cascade import command_rotors
from bulletuav.control.levels import Level
from bulletuav.kernel import kernel
from bulletuav.physics.aerodynamics import downwash_on
from bulletuav.physics.dynamics import Air, Dynamics, require_sane
from bulletuav.physics.rotors import lagged
from bulletuav.physics.swarm import Contacts, Motion, Swarm
from bulletuav.physics.sweep import Path, stop_at_first_touch
from bulletuav.physics.wrench import body_acceleration, wrench


@kernel
def _slope(state, rotor_speed, command, elapsed, around, wake, row, out):
    """Time derivative of (position, quaternion, velocity, rates) (13,), into `out`."""
    quaternion, velocity, rates = state[3:7], state[7:10], state[10:13]
    force, torque = wrench(quaternion, velocity, state[2], rotor_speed, command, elapsed, around, wake, row)
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    p, q, r = rates[0], rates[1], rates[2]
    out[0:3] = velocity
    out[3] = 0.5 * (w * p + y * r - z * q)
    out[4] = 0.5 * (w * q + z * p - x * r)
    out[5] = 0.5 * (w * r + x * q - y * p)
    out[6] = -0.5 * (x * p + y * q + z * r)
    turn = body_acceleration(rates, torque, row)
    for k in range(3):
        out[7 + k] = force[k] / row.mass
        out[10 + k] = turn[k]


@kernel
def _rk4(state, rotor_speed, command, dt, around, wake, row, stage, slopes):
    """One classical Runge-Kutta step of `state` (13,), in place; stage (13,) and slopes (4, 13) are scratch."""
    for s in range(4):
        part = 0.0 if s == 0 else (dt if s == 3 else 0.5 * dt)
        for k in range(13):
            stage[k] = state[k] + (part * slopes[s - 1, k] if s > 0 else 0.0)
        _slope(stage, rotor_speed, command, part, around, wake, row, slopes[s])
    for k in range(13):
        state[k] += dt / 6.0 * (slopes[0, k] + 2.0 * slopes[1, k] + 2.0 * slopes[2, k] + slopes[3, k])
    size = math.sqrt(state[3] ** 2 + state[4] ** 2 + state[5] ** 2 + state[6] ** 2)
    for k in range(3, 7):
        state[k] /= size


@kernel
def advance(swarm, alive, level, setpoint, cascade, parameters, air, dt, path):
    """All substeps of one decision for all worlds; `swarm` and `path` (poses at every substep's end) are written."""
    rotors = swarm.rotor_speed.shape[2]
    command = np.empty((alive.shape[1], rotors))
    wake = np.empty(alive.shape[1])
    state, stage, slopes = np.empty(13), np.empty(13), np.empty((4, 13))
    for w in range(alive.shape[0]):
        for substep in range(path.position.shape[0] - 1):
            for i in range(alive.shape[1]):
                if alive[w, i]:
                    command_rotors(level, setpoint[w, i], w, i, swarm, cascade, dt, air.gravity, command[i])
                    wake[i] = downwash_on(w, i, swarm.position, alive, parameters, air.gravity)
            for i in range(alive.shape[1]):
                if alive[w, i]:
                    row, speed = parameters[w, i], swarm.rotor_speed[w, i]
                    state[0:3], state[3:7] = swarm.position[w, i], swarm.quaternion[w, i]
                    state[7:10], state[10:13] = swarm.velocity[w, i], swarm.rates[w, i]
                    around = (air.wind[w, i], air.surface[w, i], air.gravity)
                    _rk4(state, speed, command[i], dt, around, wake[i], row, stage, slopes)
                    swarm.position[w, i], swarm.quaternion[w, i] = state[0:3], state[3:7]
                    swarm.velocity[w, i], swarm.rates[w, i] = state[7:10], state[10:13]
                    for r in range(row.num_rotors):
                        speed[r] = lagged(speed[r], command[i, r], dt, row)
                path.position[substep + 1, w, i] = swarm.position[w, i]
                path.quaternion[substep + 1, w, i] = swarm.quaternion[w, i]


class RigidBody(Dynamics):
    """Six degrees of freedom without the engine's step; a drone that touches something stops there."""

    @property
    def consumes(self) -> Level:
        """Rotor speeds."""
        return Level.ROTOR

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Nothing to do: the swarm's arrays are the state."""

    def fly(
        self, swarm: Swarm, alive: np.ndarray, level: Level, setpoint: np.ndarray, wind: np.ndarray, motion: Motion
    ) -> Contacts:
        """One compiled call, then the swept contact check."""
        flight = self.flight
        path = Path.begin(swarm, motion, flight.substeps)
        air = Air(wind, self._surface(swarm, alive), flight.gravity)
        advance(swarm, alive, level, setpoint, flight.cascade, flight.parameters, air, flight.dt, path)
        require_sane(swarm, alive)
        return stop_at_first_touch(flight.world, path, swarm, alive, flight.parameters)
