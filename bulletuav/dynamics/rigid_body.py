"""Dynamics `rigid_body`: the shared wrench, integrated by RK4 in one compiled loop over all substeps of a decision.

Within a substep the setpoint's rotor command, the wind and the downwash of other drones are held, while rotor lag, drag,
ground effect and attitude are followed exactly by the stages. The surface height below is sampled once a decision: over
level ground that is exact; past an edge the ground effect lags by up to one decision (at 20 m/s and 10 Hz, 2 m of flight).
"""

import numpy as np

from bulletuav.control.cascade import command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, require_sane
from bulletuav.dynamics.path import Path
from bulletuav.dynamics.sweep import stop_at_first_touch
from bulletuav.geometry.rotation import normalised, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.aerodynamics import wakes
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm, get, put
from bulletuav.vehicle.wrench import body_acceleration, wrench


@func
def _slope(state, rotors, around, wake, row):
    """Time derivative of `state`: (position, quaternion, velocity, rates), like itself."""
    position, quaternion, velocity, rates = state
    force, torque = wrench(quaternion, velocity, position[2], rotors, around, wake, row)
    x, y, z, w = quaternion
    p, q, r = rates
    turning = (
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
        -0.5 * (x * p + y * q + z * r),
    )
    lightness = 1.0 / row.mass  # a division that all stages share
    acceleration = (lightness * force[0], lightness * force[1], lightness * force[2])
    return velocity, turning, acceleration, body_acceleration(rates, torque, row)


@func
def _moved(state, time, slope):
    """State + time slope."""
    (x, q, v, w), (dx, dq, dv, dw) = state, slope
    return (
        (x[0] + time * dx[0], x[1] + time * dx[1], x[2] + time * dx[2]),
        (q[0] + time * dq[0], q[1] + time * dq[1], q[2] + time * dq[2], q[3] + time * dq[3]),
        (v[0] + time * dv[0], v[1] + time * dv[1], v[2] + time * dv[2]),
        (w[0] + time * dw[0], w[1] + time * dw[1], w[2] + time * dw[2]),
    )


@func
def _rk4(state, rotors, dt, around, wake, row):
    """`state` after one classical Runge-Kutta step; `rotors` is what `rotor_wrench` tells at its begin, middle and end."""
    begin, middle, end = rotors
    k1 = _slope(state, begin, around, wake, row)
    k2 = _slope(_moved(state, 0.5 * dt, k1), middle, around, wake, row)
    k3 = _slope(_moved(state, 0.5 * dt, k2), middle, around, wake, row)
    k4 = _slope(_moved(state, dt, k3), end, around, wake, row)
    total = _moved(_moved(_moved(k1, 2.0, k2), 2.0, k3), 1.0, k4)
    position, quaternion, velocity, rates = _moved(state, dt / 6.0, total)
    return position, normalised(quaternion), velocity, rates


@kernel
def advance(swarm, alive, level, setpoint, cascade, parameters, air, dt, path):
    """All substeps of one decision for all worlds; `swarm` and `path` (poses at every substep's end) are written."""
    num_drones, num_rotors = swarm.rotor_speed.shape[1:]
    wake, commands = np.empty(num_drones), np.empty((num_drones, num_rotors))
    command, begin, middle, end = (
        np.empty(num_rotors),
        np.empty(num_rotors),
        np.empty(num_rotors),
        np.empty(num_rotors),
    )
    decay = np.empty((num_drones, 3, 2))
    for w in range(alive.shape[0]):
        for i in range(num_drones):
            for stage in range(3):  # begin, middle and end of a substep
                decay[i, stage, 0], decay[i, stage, 1] = lag_decay(
                    0.5 * stage * dt, parameters[w, i]
                )
        for substep in range(path.position.shape[0] - 1):
            wakes(w, swarm.position, alive, parameters, air.gravity, wake)
            for i in range(num_drones):
                if alive[w, i]:
                    command_rotors(level, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                    for r in range(num_rotors):
                        commands[i, r] = command[r]
            for i in range(num_drones):
                if alive[w, i]:
                    row = parameters[w, i]
                    for r in range(row.num_rotors):
                        now, wanted = swarm.rotor_speed[w, i, r], commands[i, r]
                        begin[r] = lagged(now, wanted, (decay[i, 0, 0], decay[i, 0, 1]))
                        middle[r] = lagged(now, wanted, (decay[i, 1, 0], decay[i, 1, 1]))
                        end[r] = lagged(now, wanted, (decay[i, 2, 0], decay[i, 2, 1]))
                        swarm.rotor_speed[w, i, r] = end[r]
                    rotors = (
                        rotor_wrench(begin, row),
                        rotor_wrench(middle, row),
                        rotor_wrench(end, row),
                    )
                    around = (vec3(air.wind, w, i), air.surface[w, i], air.gravity)
                    put(swarm, w, i, _rk4(get(swarm, w, i), rotors, dt, around, wake[i], row))
                for k in range(3):
                    path.position[substep + 1, w, i, k] = swarm.position[w, i, k]
                for k in range(4):
                    path.quaternion[substep + 1, w, i, k] = swarm.quaternion[w, i, k]


class RigidBody(Dynamics):
    """Six degrees of freedom without the engine's step; a drone that touches something stops there."""

    @property
    def consumes(self) -> SetpointLevel:
        """Rotor speeds."""
        return SetpointLevel.ROTOR

    def fly(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        level: SetpointLevel,
        setpoint: np.ndarray,
        wind: np.ndarray,
        motion: Motion,
    ) -> Contacts:
        """One compiled call, then the swept contact check."""
        flight = self.flight
        path = Path.begin(swarm, motion, flight.substeps)
        air = Air(wind, self._surface(swarm, alive), flight.gravity)
        advance(
            swarm,
            alive,
            int(level),
            setpoint,
            flight.cascade,
            flight.parameters,
            air,
            flight.dt,
            path,
        )
        require_sane(swarm, alive, flight.engine.first_world)
        return stop_at_first_touch(flight.engine, path, swarm, alive, flight.parameters)
