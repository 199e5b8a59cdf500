"""One substep of rotors and wrenches for `bullet`, before the engine's own step."""

import numpy as np

from bulletuav.control.cascade import Cascade, command_rotors
from bulletuav.dynamics.base import Air, surroundings
from bulletuav.geometry.rotation import Vec3, cross, plus, quat4, vec3
from bulletuav.kernel import borrowed, func, kernel
from bulletuav.vehicle.aerodynamics import lifted_rotors
from bulletuav.vehicle.rotors import lag_decay, lagged, rotor_wrench
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wake import wakes
from bulletuav.vehicle.wrench import SMALL_TURN, body_acceleration, spin_parts, wrench


@func
def _slopes(
    rates: Vec3, torque: Vec3, total_speed: float, momentum: float, dt: float, row: np.record
) -> Vec3:
    """Return six times the weighted mean of the four slopes of the rates (RK4), rad/s^2."""
    k1 = body_acceleration(rates, torque, total_speed, momentum, row)
    k2 = body_acceleration(plus(rates, 0.5 * dt, k1), torque, total_speed, momentum, row)
    k3 = body_acceleration(plus(rates, 0.5 * dt, k2), torque, total_speed, momentum, row)
    k4 = body_acceleration(plus(rates, dt, k3), torque, total_speed, momentum, row)
    return (
        k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0],
        k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1],
        k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2],
    )


@func
def engine_torque(
    rates: Vec3,
    torque: Vec3,
    total_speed: float,
    momentum: float,
    dt: float,
    row: np.record,
) -> Vec3:
    """Return the torque M' with which Bullet's step of the rates lands on the RK4 solution for M.

    Bullet's step is explicit: w + dt J^-1 (M' - w x J w).

    Args:
        rates: Body rates w before the substep, rad/s.
        torque: M in body axes, N m.
        total_speed: Sum of the rotor speeds, rad/s.
        momentum: Angular momentum of the rotors about the body's z axis, N m s.
        dt: Duration of the substep, s.
        row: Row of `PARAMETERS` of the drone.

    Returns:
        M' in body axes, N m.
    """
    parts = spin_parts(rates, dt, SMALL_TURN)
    step = dt / parts
    slope = _slopes(rates, torque, total_speed, momentum, step, row)
    total = slope
    now = rates
    for _ in range(parts - 1):
        now = plus(now, step / 6.0, slope)
        slope = _slopes(now, torque, total_speed, momentum, step, row)
        total = plus(total, 1.0, slope)
    total = (total[0] / parts, total[1] / parts, total[2] / parts)

    # What Bullet takes off again: w x J w
    inertia = row.inertia
    carried = (
        inertia[0] * rates[0],
        inertia[1] * rates[1],
        inertia[2] * rates[2],
    )
    gyroscopic = cross(rates, carried)
    return (
        gyroscopic[0] + inertia[0] * total[0] / 6.0,
        gyroscopic[1] + inertia[1] * total[1] / 6.0,
        gyroscopic[2] + inertia[2] * total[2] / 6.0,
    )


@kernel
def drive(
    swarm: Swarm,
    alive: np.ndarray,
    levels: np.ndarray,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    dt: float,
    force: np.ndarray,
    torque: np.ndarray,
    room: np.ndarray,
    wake: np.ndarray,
) -> None:
    """Run controllers and rotors of one substep, and fill in the wrenches for the engine.

    Args:
        swarm: State before the substep; its rotor speeds are advanced.
        alive: (W, N) bool, drones that fly.
        levels: (W, N) `SetpointLevel` of each drone's setpoint.
        setpoint: (W, N, S) setpoints.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones.
        dt: Duration of the substep, s.
        force: (W, N, 3) forces to be written, world axes, N.
        torque: (W, N, 3) torques to be written, body axes, N m.
        room: (2, `MAX_ROTORS`) room for commands and rotor speeds.
        wake: (N, 4) room for wakes.
    """
    swarm, cascade, air, room, wake = borrowed((swarm, cascade, air, room, wake))
    command, speed = room[0], room[1]
    for w in range(alive.shape[0]):
        # Downwash of all on all
        wakes(w, swarm, alive, parameters, wake)
        for i in range(alive.shape[1]):
            if alive[w, i]:
                # Controllers, then the lag of the rotors
                row = parameters[w, i]
                decay = lag_decay(dt, row)
                command_rotors(levels, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                winding = 0.0
                for rotor in range(row.num_rotors):
                    now = swarm.rotor_speed[w, i, rotor]
                    after = lagged(now, air.supply[w, i] * command[rotor], decay)
                    swarm.rotor_speed[w, i, rotor] = after
                    speed[rotor] = after
                    if row.lag_up > 0.0:
                        winding += row.rotor_turn[rotor] * (after - now) / dt

                # Wrench at the state before the substep with the rotor speeds after it
                around = surroundings(air, w, i, wake)
                quaternion = quat4(swarm.quaternion, w, i)
                velocity = vec3(swarm.velocity, w, i)
                altitude = swarm.position[w, i, 2]
                lifted = lifted_rotors(altitude - around[1], velocity[2], dt, row)
                rotors = rotor_wrench(speed, winding, row)
                push, turn = wrench(
                    quaternion, velocity, altitude, speed, rotors, around, lifted, row
                )
                rates = vec3(swarm.rates, w, i)
                turn = engine_torque(rates, turn, rotors[2], rotors[3], dt, row)
                for k in range(3):
                    force[w, i, k] = push[k]
                    torque[w, i, k] = turn[k]
