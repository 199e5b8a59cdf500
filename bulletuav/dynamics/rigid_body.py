"""Dynamics `rigid_body`: the shared wrench, integrated by RK4 in one compiled loop over a decision.

Within a substep the setpoint's rotor command, the wind and the downwash of other drones are held.
Rotor lag, drag, ground effect and attitude are followed exactly by the stages. The height of the
surface below is sampled once a decision. Over level ground that is exact; past an edge the ground
effect lags by up to one decision (at 20 m/s and 10 Hz, 2 m of flight).
"""

import numpy as np

from bulletuav.contact.contacts import meet, remember
from bulletuav.contact.rest import Contact, bears
from bulletuav.contact.rest import wake as rouse
from bulletuav.control.cascade import Cascade, command_rotors
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics, surroundings
from bulletuav.geometry.rotation import Quat4, Vec3, normalised
from bulletuav.kernel import allocating, borrowed, func, in_memory
from bulletuav.program import Program
from bulletuav.registry import register
from bulletuav.vehicle.aerodynamics import lifted_rotors
from bulletuav.vehicle.rotors import Rotors, lag_decay, lag_rates, lagged, rotor_wrench, spin_up
from bulletuav.vehicle.swarm import Swarm, get, put
from bulletuav.vehicle.wake import wakes
from bulletuav.vehicle.wrench import SMALL_TURN, Around, body_acceleration, spin_parts, wrench

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position, quaternion, velocity and rates of one drone, or their slopes"""
Stages = tuple[Rotors, Rotors, Rotors]
"""What the rotors do at the begin, middle and end of a substep"""
Speeds = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rotor speeds (R,) at the same times, rad/s"""


@func
def _slope(
    state: State,
    speed: np.ndarray,
    rotors: Rotors,
    around: Around,
    lifted: int,
    row: np.record,
) -> State:
    """Return the time derivative of a state under rotors at some speed (R,)."""
    position, quaternion, velocity, rates = state
    force, torque = wrench(quaternion, velocity, position[2], speed, rotors, around, lifted, row)

    # Kinematics of the quaternion (x, y, z, w) under body rates (p, q, r)
    x, y, z, w = quaternion
    p, q, r = rates
    turning = (
        0.5 * (w * p + y * r - z * q),
        0.5 * (w * q + z * p - x * r),
        0.5 * (w * r + x * q - y * p),
        -0.5 * (x * p + y * q + z * r),
    )

    # A division that all stages share
    lightness = 1.0 / row.mass
    acceleration = (
        lightness * force[0],
        lightness * force[1],
        lightness * force[2],
    )
    spinning = body_acceleration(rates, torque, rotors[2], rotors[3], row)
    return velocity, turning, acceleration, spinning


@func
def _moved(
    state: State,
    time: float,
    slope: State,
) -> State:
    """Return state + time * slope."""
    x, q, v, w = state
    dx, dq, dv, dw = slope
    return (
        (
            x[0] + time * dx[0],
            x[1] + time * dx[1],
            x[2] + time * dx[2],
        ),
        (
            q[0] + time * dq[0],
            q[1] + time * dq[1],
            q[2] + time * dq[2],
            q[3] + time * dq[3],
        ),
        (
            v[0] + time * dv[0],
            v[1] + time * dv[1],
            v[2] + time * dv[2],
        ),
        (
            w[0] + time * dw[0],
            w[1] + time * dw[1],
            w[2] + time * dw[2],
        ),
    )


@func
def rk4(
    state: State,
    speeds: Speeds,
    rotors: Stages,
    dt: float,
    around: Around,
    row: np.record,
) -> State:
    """Return a state after one classical Runge-Kutta step."""
    lifted = lifted_rotors(state[0][2] - around[1], state[2][2], dt, row)
    # Numbers known here let the compiler leave out what stays at 0, and write out four rotors
    if lifted == 0:
        return _stepped(state, speeds, rotors, dt, around, 0, row)
    if lifted == 4:
        return _stepped(state, speeds, rotors, dt, around, 4, row)
    return _stepped(state, speeds, rotors, dt, around, lifted, row)


@func
def _stepped(
    state: State,
    speeds: Speeds,
    rotors: Stages,
    dt: float,
    around: Around,
    lifted: int,
    row: np.record,
) -> State:
    """Do the step of `rk4`, in which a surface may lift so many rotors."""
    k1 = _slope(state, speeds[0], rotors[0], around, lifted, row)
    k2 = _slope(_moved(state, 0.5 * dt, k1), speeds[1], rotors[1], around, lifted, row)
    k3 = _slope(_moved(state, 0.5 * dt, k2), speeds[1], rotors[1], around, lifted, row)
    k4 = _slope(_moved(state, dt, k3), speeds[2], rotors[2], around, lifted, row)
    # k1 + 2 k2 + 2 k3 + k4
    total = _moved(k1, 2.0, k2)
    total = _moved(total, 2.0, k3)
    total = _moved(total, 1.0, k4)
    # Normalised once, as the stages leave the unit sphere by little
    position, quaternion, velocity, rates = _moved(state, dt / 6.0, total)
    return position, normalised(quaternion), velocity, rates


@func
def lag_stages(
    parameters: np.ndarray,
    w: int,
    dt: float,
    decay: np.ndarray,
) -> None:
    """Fill `decay` (N, 3, 2): rotor lag until the begin, middle and end of a substep."""
    for i in range(decay.shape[0]):
        for stage in range(3):
            elapsed = 0.5 * stage * dt
            up, down = lag_decay(elapsed, parameters[w, i])
            decay[i, stage, 0] = up
            decay[i, stage, 1] = down


@func
def turn_rotors(
    speed: np.ndarray,
    command: np.ndarray,
    supply: float,
    decay: np.ndarray,
    w: int,
    i: int,
    row: np.record,
    speeds: Speeds,
) -> Stages:
    """Let the rotors of drone i in world w follow their commands for a substep.

    `supply` is the share of the commands that they reach. `decay` (N, 3, 2) is their lag until its
    begin, middle and end. `speeds` is room for the rotor speeds then. Returns what they do then.
    """
    begin, middle, end = speeds
    at_begin = (decay[i, 0, 0], decay[i, 0, 1])
    at_middle = (decay[i, 1, 0], decay[i, 1, 1])
    at_end = (decay[i, 2, 0], decay[i, 2, 1])
    rate = lag_rates(row)
    winding0 = winding1 = winding2 = 0.0
    for rotor in range(row.num_rotors):
        now = speed[w, i, rotor]
        wanted = supply * command[i, rotor]
        begin[rotor] = lagged(now, wanted, at_begin)
        middle[rotor] = lagged(now, wanted, at_middle)
        end[rotor] = lagged(now, wanted, at_end)
        speed[w, i, rotor] = end[rotor]
        # What is left of the way, and with it the acceleration, shrinks as the lag tells
        turn = row.rotor_turn[rotor] * spin_up(begin[rotor], wanted, rate)
        faster = wanted > now
        winding0 += turn
        winding1 += turn * (at_middle[0] if faster else at_middle[1])
        winding2 += turn * (at_end[0] if faster else at_end[1])
    return (
        rotor_wrench(begin, winding0, row),
        rotor_wrench(middle, winding1, row),
        rotor_wrench(end, winding2, row),
    )


@allocating
def advance(
    swarm: Swarm,
    alive: np.ndarray,
    levels: np.ndarray,
    setpoint: np.ndarray,
    cascade: Cascade,
    parameters: np.ndarray,
    air: Air,
    substeps: int,
    dt: float,
    contact: Contact,
) -> None:
    """Fly all substeps of one decision in all worlds.

    Args:
        swarm: State of all drones, moved in place.
        alive: (W, N) bool, drones that fly.
        levels: (W, N) `SetpointLevel` of each drone's setpoint.
        setpoint: (W, N, S) setpoints, held during the decision.
        cascade: The controllers.
        parameters: (W, N) rows of `PARAMETERS`.
        air: What surrounds the drones.
        substeps: Number of substeps.
        dt: Duration of a substep, s.
        contact: What contacts need.
    """
    swarm, cascade, air = borrowed((swarm, cascade, air))
    contact = in_memory(contact)
    # Room that all worlds share
    num_drones, num_rotors = swarm.rotor_speed.shape[1:]
    wake = np.empty((num_drones, 4))
    commands = np.empty((num_drones, num_rotors))
    command = np.empty(num_rotors)
    begin = np.empty(num_rotors)
    middle = np.empty(num_rotors)
    end = np.empty(num_rotors)
    decay = np.empty((num_drones, 3, 2))
    for w in range(alive.shape[0]):
        # The same in all substeps
        lag_stages(parameters, w, dt, decay)
        for substep in range(substeps):
            remember(contact, swarm, w)
            # Wakes and commands of all drones come from the state before any of them moves
            wakes(w, swarm, alive, parameters, wake)
            for i in range(num_drones):
                if alive[w, i] and not contact.stopped[w, i]:
                    command_rotors(levels, setpoint, w, i, swarm, cascade, dt, air.gravity, command)
                    for rotor in range(num_rotors):
                        commands[i, rotor] = command[rotor]

            # From here on each drone by itself
            for i in range(num_drones):
                if alive[w, i] and not contact.stopped[w, i]:
                    row = parameters[w, i]
                    speed = swarm.rotor_speed
                    supply = air.supply[w, i]
                    speeds = (begin, middle, end)
                    rotors = turn_rotors(speed, commands, supply, decay, w, i, row, speeds)
                    around = surroundings(air, w, i, wake)
                    state = get(swarm, w, i)
                    if contact.asleep[w, i]:
                        # Who rests is left alone as long as it bears its forces
                        lifted = lifted_rotors(state[0][2] - around[1], state[2][2], dt, row)
                        slope = _slope(state, end, rotors[2], around, lifted, row)
                        pull, spinning = slope[2:]
                        if bears(contact, w, i, state[1], pull, spinning, row, dt):
                            continue
                        rouse(contact, w, i)
                    # Fast spins in pieces: their precession is stiff
                    parts = spin_parts(state[3], dt, SMALL_TURN)
                    for _ in range(parts):
                        state = rk4(state, speeds, rotors, dt / parts, around, row)
                    put(swarm, w, i, state)

            # What they would have flown into
            meet(contact, swarm, alive, parameters, w, substep, substeps, dt)


@register("dynamics")
class RigidBody(Dynamics):
    """Six degrees of freedom without the engine."""

    name = "rigid_body"
    consumes = SetpointLevel.ROTOR
    feels_surface = True
    feels_force = True
    feels_torque = True
    contacts = ("impulse", "stop")
    sleeps = True

    def add_flight(
        self,
        program: Program,
        swarm: Swarm,
        alive: np.ndarray,
        levels: np.ndarray,
        setpoint: np.ndarray,
        air: Air,
    ) -> None:
        """Add all substeps as one compiled call; see the base class."""
        flight = self.flight
        program.call(
            advance,
            swarm,
            alive,
            levels,
            setpoint,
            flight.cascade,
            flight.parameters,
            air,
            flight.substeps,
            flight.dt,
            self.contact,
        )
