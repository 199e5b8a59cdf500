"""Kinematic dynamics: drones as points that follow velocity or acceleration setpoints, level, with the yaw of the setpoint.

`point_mass`         v' = limited((v_cmd - v) / tau) - k (v - wind): first-order velocity lag, acceleration limit, rotor drag
`single_integrator`  v = v_cmd, p+ = p + v dt
`double_integrator`  p+ = p + v dt + a dt^2 / 2, v+ = v + a dt

|v_cmd|, and |v| of the integrators, are limited to max_speed, the commanded acceleration to what tilting by the controller's
bound gives, by norm, not per axis. Within the limits the integration is exact for a constant setpoint. Rotors, ground effect
and downwash play no part; double and single integrator do not feel the wind. tau is that of the Lee controller's velocity
loop.
"""

import math

import numpy as np

from bulletuav.control.cascade import command_kinematic
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, Flight
from bulletuav.dynamics.path import Path
from bulletuav.dynamics.sweep import stop_at_first_touch
from bulletuav.geometry.rotation import dot, from_euler, quat4, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm, get, put

POINT_MASS, SINGLE_INTEGRATOR, DOUBLE_INTEGRATOR = range(3)


@func
def limited(vector, limit):
    """The vector, shortened to `limit` if it is longer."""
    size = math.sqrt(dot(vector, vector))
    scale = limit / size if size > limit else 1.0
    return scale * vector[0], scale * vector[1], scale * vector[2]


@func
def lagged_velocity(velocity, command, wind, lag, drag, most, dt):
    """Velocity and displacement of `point_mass` after dt; lag s, drag 1/s, most m/s^2.

    While the limit does not act, v' = (v_cmd - v) / lag - drag (v - wind) is linear and solved exactly; while it does, the
    acceleration is held for dt.
    """
    pull = (
        (command[0] - velocity[0]) / lag,
        (command[1] - velocity[1]) / lag,
        (command[2] - velocity[2]) / lag,
    )
    if dot(pull, pull) <= most * most:
        rate = 1.0 / lag + drag
        decay = math.exp(-rate * dt)
        e0 = (command[0] / lag + drag * wind[0]) / rate
        e1 = (command[1] / lag + drag * wind[1]) / rate
        e2 = (command[2] / lag + drag * wind[2]) / rate
        d0, d1, d2 = velocity[0] - e0, velocity[1] - e1, velocity[2] - e2
        share = (1.0 - decay) / rate
        after = (e0 + decay * d0, e1 + decay * d1, e2 + decay * d2)
        return after, (e0 * dt + share * d0, e1 * dt + share * d1, e2 * dt + share * d2)
    pull = limited(pull, most)
    a0 = pull[0] - drag * (velocity[0] - wind[0])
    a1 = pull[1] - drag * (velocity[1] - wind[1])
    a2 = pull[2] - drag * (velocity[2] - wind[2])
    half = 0.5 * dt * dt
    after = (velocity[0] + a0 * dt, velocity[1] + a1 * dt, velocity[2] + a2 * dt)
    return after, (
        velocity[0] * dt + a0 * half,
        velocity[1] * dt + a1 * half,
        velocity[2] * dt + a2 * half,
    )


@func
def accelerated(velocity, acceleration, fastest, dt):
    """Velocity and displacement of `double_integrator` after dt; past `fastest` m/s the velocity is cut to it."""
    after = (
        velocity[0] + acceleration[0] * dt,
        velocity[1] + acceleration[1] * dt,
        velocity[2] + acceleration[2] * dt,
    )
    after = limited(after, fastest)
    half = 0.5 * dt
    moved = (
        half * (velocity[0] + after[0]),
        half * (velocity[1] + after[1]),
        half * (velocity[2] + after[2]),
    )
    return after, moved


@kernel
def advance(kind, swarm, alive, level, setpoint, cascade, parameters, air, dt, path):
    """All substeps of one decision for all worlds; `swarm` and `path` are written."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            row, gain = parameters[w, i], cascade.gains[w, i]
            lag = 1.0 / (2.0 * gain.damping * gain.position_frequency)
            drag = 0.0
            for r in range(row.num_rotors):
                drag += row.drag_xy * swarm.rotor_speed[w, i, r] / row.mass
            most = air.gravity * gain.max_tilt
            position, quaternion, velocity, rates = get(swarm, w, i)
            wanted, wind = quat4(setpoint, w, i), vec3(air.wind, w, i)
            if alive[w, i]:
                quaternion = from_euler(0.0, 0.0, wanted[3])
            for substep in range(path.position.shape[0] - 1):
                if alive[w, i]:
                    target = command_kinematic(
                        level, kind == DOUBLE_INTEGRATOR, wanted, position, velocity, gain
                    )
                    if kind == DOUBLE_INTEGRATOR:
                        velocity, moved = accelerated(
                            velocity, limited(target, most), gain.max_speed, dt
                        )
                    elif kind == POINT_MASS:
                        target = limited(target, gain.max_speed)
                        velocity, moved = lagged_velocity(
                            velocity, target, wind, lag, drag, most, dt
                        )
                    else:
                        velocity = limited(target, gain.max_speed)
                        moved = (velocity[0] * dt, velocity[1] * dt, velocity[2] * dt)
                    position = (
                        position[0] + moved[0],
                        position[1] + moved[1],
                        position[2] + moved[2],
                    )
                for k in range(3):
                    path.position[substep + 1, w, i, k] = position[k]
                for k in range(4):
                    path.quaternion[substep + 1, w, i, k] = quaternion[k]
            put(swarm, w, i, (position, quaternion, velocity, rates))


class Kinematic(Dynamics):
    """The three kinematic levels, told apart by `kind`."""

    def __init__(self, kind: int, flight: Flight):
        super().__init__(flight)
        self._kind = kind

    @property
    def consumes(self) -> SetpointLevel:
        """VELOCITY, or ACCELERATION for the double integrator."""
        return (
            SetpointLevel.ACCELERATION
            if self._kind == DOUBLE_INTEGRATOR
            else SetpointLevel.VELOCITY
        )

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Points have no tilt and no rates."""
        swarm.quaternion[mask] = 0, 0, 0, 1
        swarm.rates[mask] = 0
        super().place(swarm, mask)

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
        straight = (
            self._kind == SINGLE_INTEGRATOR and level == SetpointLevel.VELOCITY
        )  # in one piece: nothing changes on the way
        pieces, span = (1, flight.substeps) if straight else (flight.substeps, 1)
        path, dt = Path.begin(swarm, motion, pieces, span), flight.dt * span
        air = Air(wind, np.full(alive.shape, -np.inf), flight.gravity)
        advance(
            self._kind,
            swarm,
            alive,
            int(level),
            setpoint,
            flight.cascade,
            flight.parameters,
            air,
            dt,
            path,
        )
        return stop_at_first_touch(flight.engine, path, swarm, alive, flight.parameters)
