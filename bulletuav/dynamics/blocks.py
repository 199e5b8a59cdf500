"""Drones that `rigid_body` moves together, in blocks of lanes.

Worlds are flown in groups of a few, whose drones are counted on from one world to the next. The
lanes of a block are `WIDTH` of them. Who needs more than one step of RK4, sleeps, or has too few
others to fly with is moved alone. That gives the same bits.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.gather import copy_numbers, four, gathered, three
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, is_any, lanes_of, lanes_row, room, where
from bulletuav.control.cascade import Cascade
from bulletuav.dynamics.integration import stepped, turn_rotors
from bulletuav.dynamics.steering import ALONE, Steering, remember_lane, steer
from bulletuav.vehicle.aerodynamics import is_near_surface
from bulletuav.vehicle.swarm import DroneArrays, Swarm
from bulletuav.vehicle.wakes import Wakes
from bulletuav.vehicle.wrench import MAX_PART_ROTATION, make_surroundings

DRONES = 4 * WIDTH
"""Drones of a group, about"""
FEWEST = 3
"""Drones that are moved together at least: fewer take longer in a block than one by one"""
CALM = 0.99 * MAX_PART_ROTATION
"""Turn in a substep that surely takes one step of RK4, rad"""


class Blocks(NamedTuple):
    """Room for a group of G worlds in B blocks; counted on, its drones are D.

    Attributes:
        swarm: State of all worlds, with one axis of drones beside one of length 1.
        rows: (W, N) rows of `PARAMETERS`, which tell their type.
        numbers: (W, N, P) the same as numbers.
        packed: (B, P, `WIDTH`) those of the group, block by block.
        held: (B, 11, `WIDTH`) wind, surface, force, torque and supply of the group's drones.
        decay: (G, N, 6) what `lag_stages` fills in.
        lag: (B, 6, `WIDTH`) the same, block by block.
        flown: (B,) bool, whether drones of a block are moved together.
        alike: (B,) bool, whether all drones of a block have as many rotors.
        together: (D,) bool, whether a drone is moved with others of its block.
        wakes: What drones of the group feel of each other.
        command: (G, N, R) commanded rotor speeds, rad/s.
        rotors: (5, R, `WIDTH`) speeds and commands of a block, and its speeds in a substep.
        alone: (3, R) the same speeds of one drone.
        state: (13, `WIDTH`) new state of a block.
        steering: Room for controllers.
    """

    swarm: Swarm
    rows: np.ndarray
    numbers: np.ndarray
    packed: np.ndarray
    held: np.ndarray
    decay: np.ndarray
    lag: np.ndarray
    flown: np.ndarray
    alike: np.ndarray
    together: np.ndarray
    wakes: Wakes
    command: np.ndarray
    rotors: np.ndarray
    alone: np.ndarray
    state: np.ndarray
    steering: Steering

    @classmethod
    def of(cls, drones: DroneArrays, cascade: Cascade) -> "Blocks":
        """Make room.

        Args:
            drones: Those of all worlds.
            cascade: Controllers of all worlds.
        """
        swarm, _, parameters = drones
        assert all(array.flags.c_contiguous for array in (*swarm, parameters))
        num_worlds, num_drones, num_rotors = swarm.rotor_speed.shape
        worlds = min(max(DRONES // num_drones, 1), num_worlds)
        blocks = -(-worlds * num_drones // WIDTH)
        numbers = parameters.view(np.float64).reshape(*parameters.shape, -1)
        return cls(
            swarm=Swarm(*(array.reshape(1, -1, array.shape[2]) for array in swarm)),
            rows=parameters,
            numbers=numbers,
            packed=room(blocks, numbers.shape[2]),
            held=room(blocks, 11),
            decay=np.zeros((worlds, num_drones, 6)),
            lag=room(blocks, 6),
            flown=np.zeros(blocks, dtype=bool),
            alike=np.zeros(blocks, dtype=bool),
            together=np.zeros(blocks * WIDTH, dtype=bool),
            wakes=Wakes.of(worlds, num_drones),
            command=np.zeros((worlds, num_drones, num_rotors)),
            rotors=room(5, num_rotors),
            alone=np.zeros((3, num_rotors)),
            state=room(13),
            steering=Steering.of(cascade, blocks),
        )


@kernel
def pack(blocks: Any, air: Any, first: int) -> None:
    """Lay out what the drones of a group have during a decision.

    Args:
        blocks: `Blocks`, of which `decay` is filled in.
        air: `Air`.
        first: The group's first drone, counted on from world to world.
    """
    # The last group may have fewer worlds
    count = min(-(-(blocks.rows.size - first) // WIDTH), blocks.packed.shape[0])
    for b in range(count):
        drone = first + b * WIDTH
        copy_numbers(blocks.numbers, drone, blocks.packed, b)
        copy_numbers(blocks.decay, b * WIDTH, blocks.lag, b)
        held = lanes_of(blocks.held, b)
        for k in range(3):
            held[k] = gathered(air.wind, drone, k)
            held[4 + k] = gathered(air.force, drone, k)
            held[7 + k] = gathered(air.torque, drone, k)
        held[3] = gathered(air.surface, drone, 0)
        held[10] = gathered(air.supply, drone, 0)
        blocks.alike[b] = _are_alike(blocks, drone)


@func
def _are_alike(blocks: Any, drone: int) -> bool:
    """Tell whether `WIDTH` drones from one on have equally many rotors.

    Behind the last drone of all nobody is asked.
    """
    num_drones = blocks.rows.shape[1]
    count = blocks.rows.shape[0] * num_drones
    rotors = blocks.rows[drone // num_drones, drone % num_drones].num_rotors
    for other in range(drone + 1, min(drone + WIDTH, count)):
        row = blocks.rows[other // num_drones, other % num_drones]
        if row.num_rotors != rotors:
            return False
    return True


@func
def is_block(blocks: Any, b: int) -> bool:
    """Tell whether enough drones of a block are marked to be moved together.

    Where they are too few, their marks are taken away: they are moved one by one.
    """
    count = 0
    for k in range(b * WIDTH, (b + 1) * WIDTH):
        count += blocks.together[k]
    if count >= FEWEST:
        return True
    for k in range(b * WIDTH, (b + 1) * WIDTH):
        blocks.together[k] = False
    return False


@func
def is_steered(blocks: Any, drone: int) -> bool:
    """Tell whether `fly_block` has the controller of a drone of the group, too."""
    return bool(blocks.together[drone]) and bool(blocks.steering.level[drone // WIDTH] != ALONE)


@deferred(types.none)
@kernel
def fly_block(blocks: Any, first: int, b: int, gravity: float, dt: float) -> None:
    """Steer and move those drones of a block that are marked, by one step of RK4.

    Args:
        blocks: `Blocks` of a group.
        first: The group's first drone, counted on.
        b: Index of the block.
        gravity: m/s^2, downwards.
        dt: Length of the step, s.
    """
    drone = first + b * WIDTH
    swarm = blocks.swarm
    row = lanes_row(blocks.rows, blocks.packed, b)
    held = lanes_of(blocks.held, b)
    speed = lanes_of(blocks.rotors, 0)
    command = lanes_of(blocks.rotors, 1)
    for r in range(row.num_rotors):
        speed[r] = gathered(swarm.rotor_speed, drone, r)
    state = (
        three(swarm.position, drone),
        four(swarm.quaternion, drone),
        three(swarm.velocity, drone),
        three(swarm.rates, drone),
    )
    # Controllers, which others of the world do not wait for: they do not feel each other's commands
    steered = blocks.steering.level[b] != ALONE
    if steered:
        steer(blocks.steering, b, drone, state, speed, gravity, dt, command)
    else:
        for r in range(row.num_rotors):
            command[r] = gathered(blocks.command, b * WIDTH, r)
    speeds = (lanes_of(blocks.rotors, 2), lanes_of(blocks.rotors, 3), lanes_of(blocks.rotors, 4))
    rotors = turn_rotors(speed, command, held[10], lanes_of(blocks.lag, b), row, speeds)

    # Surroundings
    near = is_near_surface(state[0][2] - held[3], state[2][2], dt, row)
    wind, force = (held[0], held[1], held[2]), (held[4], held[5], held[6])
    torque, wake = (held[7], held[8], held[9]), four(blocks.wakes.felt, b * WIDTH)
    # Who is far from a surface has none
    surface = where(near, held[3], -np.inf)
    around = make_surroundings(wind, surface, gravity, force, torque, wake)
    if is_any(near):
        state = stepped(state, speeds, rotors, dt, around, row.num_rotors, row)
    else:
        state = stepped(state, speeds, rotors, dt, around, 0, row)

    # Back to where each drone is
    new = lanes_of(blocks.state, 0)
    position, quaternion, velocity, rates = state
    for k in range(3):
        new[k] = position[k]
        new[3 + k] = velocity[k]
        new[6 + k] = rates[k]
    for k in range(4):
        new[9 + k] = quaternion[k]
    for lane in range(WIDTH):
        if blocks.together[b * WIDTH + lane]:
            for k in range(3):
                swarm.position[0, drone + lane, k] = blocks.state[k, lane]
                swarm.velocity[0, drone + lane, k] = blocks.state[3 + k, lane]
                swarm.rates[0, drone + lane, k] = blocks.state[6 + k, lane]
            for k in range(4):
                swarm.quaternion[0, drone + lane, k] = blocks.state[9 + k, lane]
            for r in range(row.num_rotors):
                swarm.rotor_speed[0, drone + lane, r] = blocks.rotors[0, r, lane]
            if steered:
                remember_lane(blocks.steering, lane, drone + lane)
