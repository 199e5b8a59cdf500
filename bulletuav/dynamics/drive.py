"""Rotor speeds and wrenches of one substep of `bullet`, computed before the engine's step."""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, in_memory, kernel
from bulletuav.control.cascade import command_rotors
from bulletuav.dynamics.base import Decision, surroundings
from bulletuav.geometry.rotation import Vec3, cross, plus, quat4, vec3
from bulletuav.vehicle.aerodynamics import num_lifted_rotors
from bulletuav.vehicle.airframe import MAX_ROTORS
from bulletuav.vehicle.rotors import lag_decay, rotor_speed_after, rotor_wrench
from bulletuav.vehicle.wakes import Wakes, sum_wakes
from bulletuav.vehicle.wrench import (
    MAX_PART_ROTATION,
    Wrenches,
    compute_wrench,
    num_spin_steps,
    rk4_rate_slopes,
)


class Scratch(NamedTuple):
    """Work arrays of a substep of `bullet`, for W worlds of N drones.

    Attributes:
        wrenches: Forces and torques that the engine applies to the drones.
        rotors: (2, `MAX_ROTORS`) commands and speeds of one drone's rotors, rad/s.
        wakes: Wakes of all drones.
        driven: (W, N) bool, drones whose rotors turn.
        flying: (W, N) bool, drones that the engine moves.
    """

    wrenches: Wrenches
    rotors: np.ndarray
    wakes: Wakes
    driven: np.ndarray
    flying: np.ndarray

    @classmethod
    def of(cls, num_worlds: int, num_drones: int) -> "Scratch":
        """Allocate the arrays."""
        shape = (num_worlds, num_drones)
        wrenches, rotors = Wrenches(*np.zeros((2, *shape, 3))), np.zeros((2, MAX_ROTORS))
        return cls(wrenches, rotors, Wakes.of(*shape), *np.zeros((2, *shape), dtype=bool))


@func
def engine_torque(
    rates: Vec3, torque: Vec3, total_speed: float, momentum: float, dt: float, row: np.record
) -> Vec3:
    """Compute the torque M' with which Bullet's step of the rates equals the RK4 solution for M.

    Bullet's step is explicit Euler: w + dt J^-1 (M' - w x J w).

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
    # Fast spins need several RK4 steps in a substep
    parts = num_spin_steps(rates, dt, MAX_PART_ROTATION)
    step = dt / parts
    slope = rk4_rate_slopes(rates, torque, total_speed, momentum, step, row)
    total = slope
    now = rates
    for _ in range(parts - 1):
        now = plus(now, step / 6.0, slope)
        slope = rk4_rate_slopes(now, torque, total_speed, momentum, step, row)
        total = plus(total, 1.0, slope)
    # Mean of the RK4 slopes over the steps: six times the mean angular acceleration
    total = (total[0] / parts, total[1] / parts, total[2] / parts)

    # Bullet subtracts the gyroscopic torque w x J w
    inertia = row.inertia
    carried = (
        inertia[0] * rates[0],
        inertia[1] * rates[1],
        inertia[2] * rates[2],
    )
    gyroscopic = cross(rates, carried)
    # J times the angular acceleration, plus the torque that Bullet subtracts
    return (
        gyroscopic[0] + inertia[0] * total[0] / 6.0,
        gyroscopic[1] + inertia[1] * total[1] / 6.0,
        gyroscopic[2] + inertia[2] * total[2] / 6.0,
    )


@kernel
def drive(decision: Decision, scratch: Scratch) -> None:
    """Run controllers and rotors of one substep, and write the wrenches for the engine.

    Args:
        decision: Inputs of the decision; the drones' rotor speeds are advanced.
        scratch: Work arrays; the wrenches of `driven` drones are written.
    """
    decision, scratch = in_memory(decision), in_memory(scratch)
    swarm, parameters, air = decision.drones.swarm, decision.drones.parameters, decision.air
    setpoints, cascade, dt = decision.setpoints, decision.cascade, decision.step.dt
    wrenches, wakes, alive = scratch.wrenches, scratch.wakes, scratch.driven
    command, speed = scratch.rotors[0], scratch.rotors[1]
    sum_wakes(swarm, alive, parameters, 0, alive.shape[0], False, 0.0, wakes)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i]:
                # Controllers, then the lag of the rotors
                row = parameters[w, i]
                decay = lag_decay(dt, row)
                command_rotors(cascade, setpoints, swarm, w, i, dt, air.gravity, command)
                winding = 0.0
                for rotor in range(row.num_rotors):
                    now = swarm.rotor_speed[w, i, rotor]
                    # A low battery voltage and weak motors limit the rotor speed
                    wanted = air.supply[w, i] * (air.rotor_ratio[w, i, rotor] * command[rotor])
                    after = rotor_speed_after(now, wanted, decay)
                    swarm.rotor_speed[w, i, rotor] = after
                    speed[rotor] = after
                    # Reaction torque of the rotors' angular acceleration
                    if row.lag_up > 0.0:
                        winding += row.rotor_turn[rotor] * (after - now) / dt

                # Wrench at the state before the substep with the rotor speeds after it
                around = surroundings(air, w, i, wakes.felt[w])
                quaternion = quat4(swarm.quaternion, w, i)
                velocity = vec3(swarm.velocity, w, i)
                altitude = swarm.position[w, i, 2]
                lifted = num_lifted_rotors(altitude - around[1], velocity[2], dt, row)
                rotors = rotor_wrench(speed, winding, row)
                push, turn = compute_wrench(
                    quaternion, velocity, altitude, speed, rotors, around, lifted, row
                )
                # The torque corrects the error of Bullet's explicit step of the rates
                rates = vec3(swarm.rates, w, i)
                turn = engine_torque(rates, turn, rotors[2], rotors[3], dt, row)
                for k in range(3):
                    wrenches.force[w, i, k] = push[k]
                    wrenches.torque[w, i, k] = turn[k]
