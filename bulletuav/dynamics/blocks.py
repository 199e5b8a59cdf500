"""SIMD blocks of `WIDTH` drones that `rigid_body` integrates together, one drone in each lane.

Worlds are flown in groups, and the drones of a group are numbered consecutively over its worlds. A
drone that needs more than one step of RK4, or whose block has fewer than `FEWEST` drones to
integrate, is integrated alone. The forces on the sleeping drones of a block are computed together,
too. The results are equal to the bit.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.gather import copy_numbers, four, gathered, three
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, is_any, lane_zeros, lanes_of, lanes_row, where
from bulletuav.contact.contact_state import press_support, withstands
from bulletuav.control.cascade import Cascade
from bulletuav.dynamics.integration import slope_of, stepped, turn_rotors
from bulletuav.dynamics.steering import ALONE, Steering, advance_lanes, remember_lane, steer
from bulletuav.vehicle.aerodynamics import is_near_surface
from bulletuav.vehicle.swarm import DroneArrays, Swarm
from bulletuav.vehicle.wakes import Wakes
from bulletuav.vehicle.wings import WingTable, add_winding, deflection_after
from bulletuav.vehicle.wrench import MAX_PART_ROTATION, make_surroundings

DRONES = 4 * WIDTH
"""Approximate number of drones in a group of worlds"""
FEWEST = 3
"""Minimum number of drones to integrate in a block: fewer drones are faster one by one"""
CALM = 0.99 * MAX_PART_ROTATION
"""Rotation in a substep below which one step of RK4 is enough, rad"""


class Blocks(NamedTuple):
    """Work arrays for a group of G worlds, whose D drones fill B blocks.

    Attributes:
        swarm: State of the drones of all worlds, with axes (1, W N, ...).
        rows: (W, N) rows of `PARAMETERS`; compiled code takes the type of the rows from them.
        numbers: (W, N, P) the same parameters as float64.
        packed: (B, P, `WIDTH`) parameters of the group's drones by block.
        held: (B, 12, `WIDTH`) wind, surface, force, torque, supply and gravity of the group's
            drones.
        decay: (G, N, 6) decay factors of the rotor lag, written by `lag_stages`.
        lag: (B, 6, `WIDTH`) the same factors by block.
        wings: Wings of all drones, None in a swarm without wings.
        deflection: (1, S, `WIDTH`) deflections of the control surfaces of a block, rad.
        sleeping: (D,) bool, drones that slept at the beginning of the substep.
        flown: (B,) bool, whether the marked drones of a block are integrated together.
        alike: (B,) bool, whether all drones of a block have the same number of rotors, and the same
            wings.
        has_rotors: (D,) bool, bodies of such blocks that are no loads.
        together: (D,) bool, whether a drone is integrated with its block.
        resting: (D,) bool, sleeping drones whose forces are computed with those of their block.
        steered: (D,) bool, drones that fly alone, but whose controllers run with their block.
        wakes: Wakes that act on the group's drones.
        command: (G, N, R + S) commanded rotor speeds of each drone, rad/s, followed by the
            deflections of its control surfaces, rad.
        ratio: (B, R, `WIDTH`) fractions of their commanded speeds that rotors reach.
        rotors: (5, R + S, `WIDTH`) rotor speeds of a block, commands, and speeds at the begin,
            middle and end of a substep, rad/s; deflections follow the commands, rad.
        alone: (3, R) rotor speeds of one drone at the begin, middle and end of a substep, rad/s.
        state: (13, `WIDTH`) new state of a block.
        support: (1, 6, `WIDTH`) rows of `SUPPORT` of the sleeping drones of a block.
        load: (8, `WIDTH`) their accelerations (m/s^2) and angular accelerations (rad/s^2) without
            contacts, the force on their supports (N), and 1 if these can bear it, else 0.
        steering: Work arrays of the controllers.
    """

    swarm: Swarm
    rows: np.ndarray
    numbers: np.ndarray
    packed: np.ndarray
    held: np.ndarray
    decay: np.ndarray
    lag: np.ndarray
    wings: WingTable | None
    deflection: np.ndarray
    sleeping: np.ndarray
    flown: np.ndarray
    alike: np.ndarray
    has_rotors: np.ndarray
    together: np.ndarray
    resting: np.ndarray
    steered: np.ndarray
    wakes: Wakes
    command: np.ndarray
    ratio: np.ndarray
    rotors: np.ndarray
    alone: np.ndarray
    state: np.ndarray
    support: np.ndarray
    load: np.ndarray
    steering: Steering

    @classmethod
    def of(
        cls,
        drones: DroneArrays,
        cascade: Cascade,
        wings: WingTable | None,
        at_least: int = DRONES,
    ) -> "Blocks":
        """Allocate the arrays.

        Args:
            drones: Drones of all worlds.
            cascade: Controllers of all worlds.
            wings: Wings of all drones, None in a swarm without wings.
            at_least: Number of drones from which on a group of worlds is large enough.
        """
        swarm, _, parameters = drones
        assert all(array.flags.c_contiguous for array in (*swarm, parameters))
        num_worlds, num_drones, num_rotors = swarm.rotor_speed.shape
        worlds = min(max(at_least // num_drones, 1), num_worlds)
        blocks = -(-worlds * num_drones // WIDTH)
        numbers = parameters.view(np.float64).reshape(*parameters.shape, -1)
        num_commands, drones_in_all = num_rotors + swarm.deflection.shape[2], parameters.size
        return cls(
            swarm=Swarm(*(array.reshape(1, drones_in_all, array.shape[2]) for array in swarm)),
            rows=parameters,
            numbers=numbers,
            packed=lane_zeros(blocks, numbers.shape[2]),
            held=lane_zeros(blocks, 12),
            decay=np.zeros((worlds, num_drones, 6)),
            lag=lane_zeros(blocks, 6),
            wings=wings,
            deflection=lane_zeros(1, swarm.deflection.shape[2]),
            sleeping=np.zeros(blocks * WIDTH, dtype=bool),
            flown=np.zeros(blocks, dtype=bool),
            alike=np.zeros(blocks, dtype=bool),
            has_rotors=np.zeros(blocks * WIDTH, dtype=bool),
            together=np.zeros(blocks * WIDTH, dtype=bool),
            resting=np.zeros(blocks * WIDTH, dtype=bool),
            steered=np.zeros(blocks * WIDTH, dtype=bool),
            wakes=Wakes.of(worlds, num_drones),
            command=np.zeros((worlds, num_drones, num_commands)),
            ratio=lane_zeros(blocks, num_rotors),
            rotors=lane_zeros(5, num_commands),
            alone=np.zeros((3, num_rotors)),
            state=lane_zeros(13),
            support=lane_zeros(1, 6),
            load=lane_zeros(8),
            steering=Steering.of(cascade, blocks),
        )

    def for_thread(self) -> "Blocks":
        """Return the same blocks for another thread, with its own scratch arrays."""
        remembered = lane_zeros(len(self.steering.remembered))
        return self._replace(
            rotors=lane_zeros(5, self.rotors.shape[1]),
            alone=np.zeros_like(self.alone),
            deflection=lane_zeros(1, self.deflection.shape[1]),
            state=lane_zeros(13),
            support=lane_zeros(1, 6),
            load=lane_zeros(8),
            steering=self.steering._replace(remembered=remembered),
        )


@kernel
def pack_blocks(blocks: Any, air: Any, first: int, begin: int, end: int) -> None:
    """Pack the parameters, rotor lag and air of a group's drones into blocks, once a decision.

    Args:
        blocks: `Blocks` with `decay` already written.
        air: `Air` of all worlds.
        first: Number of the group's first drone, counted over all worlds.
        begin: Index of the first block to pack.
        end: Index after the last block to pack.
    """
    # The last group may have fewer worlds
    count = min(-(-(blocks.rows.size - first) // WIDTH), end)
    for b in range(begin, count):
        drone = first + b * WIDTH
        copy_numbers(blocks.numbers, drone, blocks.packed, b)
        copy_numbers(blocks.decay, b * WIDTH, blocks.lag, b)
        held = lanes_of(blocks.held, b)
        for k in range(3):
            held[k] = gathered(air.wind, drone, k)
            held[4 + k] = gathered(air.force, drone, k)
            held[7 + k] = gathered(air.torque, drone, k)
        held[10] = gathered(air.supply, drone, 0)
        held[11] = gathered(air.local_gravity, drone, 0)
        ratio = lanes_of(blocks.ratio, b)
        for r in range(air.rotor_ratio.shape[2]):
            ratio[r] = gathered(air.rotor_ratio, drone, r)
        blocks.alike[b] = _are_alike(blocks, drone, b * WIDTH)
    _pack_heights(blocks, air, first, begin, end)


@kernel
def pack_surface(blocks: Any, air: Any, first: int) -> None:
    """Pack the heights of the surface below a group's drones; see `pack_blocks`."""
    _pack_heights(blocks, air, first, 0, blocks.packed.shape[0])


@func
def _pack_heights(blocks: Any, air: Any, first: int, begin: int, end: int) -> None:
    """Pack the heights of the surface of some blocks; see `pack_blocks`."""
    count = min(-(-(blocks.rows.size - first) // WIDTH), end)
    for b in range(begin, count):
        lanes_of(blocks.held, b)[3] = gathered(air.surface, first + b * WIDTH, 0)


@func
def count_panels(wings: Any, w: int, i: int) -> int:
    """Return the number of panels of drone i of world w; `wings` is a `WingTable` or None."""
    if wings is None:
        return 0
    return int(wings.rows[wings.kind[w, i]].num_panels)


@func
def _has_same_wings(wings: Any, drone: int, other: int) -> bool:
    """Check whether two drones have the same wings, by their numbers over all worlds."""
    if wings is None:
        return True
    num_drones = wings.kind.shape[1]
    one = wings.kind[drone // num_drones, drone % num_drones]
    return bool(one == wings.kind[other // num_drones, other % num_drones])


@func
def _num_commands(blocks: Any, wings: Any, drone: int) -> int:
    """Return the number of rotors and control surfaces of a drone, counted over all worlds."""
    num_drones = blocks.rows.shape[1]
    w, i = drone // num_drones, drone % num_drones
    num_rotors = int(blocks.rows[w, i].num_rotors)
    if wings is None:
        return num_rotors
    return num_rotors + int(wings.rows[wings.kind[w, i]].num_surfaces)


@func
def _move_block_surfaces(
    blocks: Any, wings: Any, drone: int, command: Any, first: int, dt: float
) -> None:
    """Read the deflections of a block, and move its control surfaces for a substep.

    Those of `command` begin at the index `first`.
    """
    if wings is not None:
        num_drones = wings.kind.shape[1]
        wing = wings.rows[wings.kind[drone // num_drones, drone % num_drones]]
        now = lanes_of(blocks.deflection, 0)
        for k in range(wing.num_surfaces):
            before = gathered(blocks.swarm.deflection, drone, k)
            now[k] = deflection_after(before, command[first + k], k, dt, wing)


@func
def _step_block(
    state: Any,
    speeds: Any,
    rotors: Any,
    dt: float,
    around: Any,
    lifted: int,
    row: Any,
    blocks: Any,
    wings: Any,
    drone: int,
) -> Any:
    """Integrate the block of a drone over a substep, see `stepped`."""
    if wings is None:
        return stepped(state, speeds, rotors, dt, around, lifted, row, None, None)
    num_drones, deflection = wings.kind.shape[1], lanes_of(blocks.deflection, 0)
    # All drones of the block have the same wings
    wing = wings.rows[wings.kind[drone // num_drones, drone % num_drones]]
    around = add_winding(around, speeds[0], speeds[2], dt, row, wing)
    return stepped(state, speeds, rotors, dt, around, lifted, row, wing, deflection)


@func
def _are_alike(blocks: Any, drone: int, first: int) -> bool:
    """Check whether the drones of a block have the same rotors and wings, and find its loads.

    The block has the `WIDTH` bodies from `drone` on. Those without rotors are ignored unless they
    come first, and lanes after the last body of all worlds, too.
    """
    num_drones = blocks.rows.shape[1]
    count = blocks.rows.shape[0] * num_drones
    rotors = blocks.rows[drone // num_drones, drone % num_drones].num_rotors
    are_alike = rotors > 0
    for lane in range(min(WIDTH, count - drone)):
        other = drone + lane
        row = blocks.rows[other // num_drones, other % num_drones]
        blocks.has_rotors[first + lane] = row.num_rotors > 0
        are_alike = are_alike and row.num_rotors in (0, rotors)
        if row.num_rotors > 0:
            are_alike = are_alike and _has_same_wings(blocks.wings, drone, other)
    return bool(are_alike)


@func
def has_enough(marks: np.ndarray, b: int) -> bool:
    """Check whether at least `FEWEST` drones of a block are marked; clear the marks otherwise."""
    count = 0
    for k in range(b * WIDTH, (b + 1) * WIDTH):
        count += marks[k]
    if count >= FEWEST:
        return True
    for k in range(b * WIDTH, (b + 1) * WIDTH):
        marks[k] = False
    return False


@func
def _state_of(swarm: Any, drone: int) -> tuple[Any, Any, Any, Any]:
    """Return the states of `WIDTH` drones from `drone` on as lanes."""
    return (
        three(swarm.position, drone),
        four(swarm.quaternion, drone),
        three(swarm.velocity, drone),
        three(swarm.rates, drone),
    )


@deferred(types.none)
@kernel
def steer_block(blocks: Any, first: int, b: int, gravity: float, dt: float) -> None:
    """Run the controllers of the drones of a block in `steered`, and write their commands.

    Args:
        blocks: `Blocks` of a group; the block has a common level of setpoints.
        first: Number of the group's first drone, counted over all worlds.
        b: Index of the block.
        gravity: Gravitational acceleration that controllers know, m/s^2, downwards.
        dt: Duration of the step, s.
    """
    drone, num_drones = first + b * WIDTH, blocks.rows.shape[1]
    num_rotors = lanes_row(blocks.rows, blocks.packed, b).num_rotors
    speed, command = lanes_of(blocks.rotors, 0), lanes_of(blocks.rotors, 1)
    for r in range(num_rotors):
        speed[r] = gathered(blocks.swarm.rotor_speed, drone, r)
    state = _state_of(blocks.swarm, drone)
    steered, autopilot = blocks.steered, blocks.steering.autopilot
    advance_lanes(blocks.steering, autopilot, blocks.swarm, steered, b, drone, gravity, dt)
    observes = steer(blocks.steering, b, drone, state, speed, gravity, dt, command)
    # The Lee controller commands no surfaces
    count = num_rotors if observes else _num_commands(blocks, blocks.wings, drone)
    for lane in range(WIDTH):
        one = b * WIDTH + lane
        if steered[one]:
            for k in range(count):
                blocks.command[one // num_drones, one % num_drones, k] = blocks.rotors[1, k, lane]
            if observes:
                remember_lane(blocks.steering, lane, drone + lane)


@func
def is_steered(blocks: Any, drone: int) -> bool:
    """Check whether `fly_block` also runs the controller of a drone of the group."""
    return bool(blocks.together[drone]) and bool(blocks.steering.level[drone // WIDTH] != ALONE)


@func
def _turn_rotors(blocks: Any, b: int, command: Any, row: Any, num_panels: int) -> tuple[Any, Any]:
    """Advance the rotors of a block from its speeds in `rotors`, see `turn_rotors`."""
    held, speed = lanes_of(blocks.held, b), lanes_of(blocks.rotors, 0)
    speeds = (lanes_of(blocks.rotors, 2), lanes_of(blocks.rotors, 3), lanes_of(blocks.rotors, 4))
    motors = (held[10], lanes_of(blocks.ratio, b))
    lag = lanes_of(blocks.lag, b)
    return speeds, turn_rotors(speed, command, *motors, lag, row, speeds, num_panels)


@func
def _make_surroundings(blocks: Any, b: int, state: Any, dt: float, row: Any) -> tuple[Any, Any]:
    """Return where a surface below is near, and the surroundings of the drones of a block."""
    held = lanes_of(blocks.held, b)
    near = is_near_surface(state[0][2] - held[3], state[2][2], dt, row)
    wind, force = (held[0], held[1], held[2]), (held[4], held[5], held[6])
    torque, wake = (held[7], held[8], held[9]), four(blocks.wakes.felt, b * WIDTH)
    # A drone far from the surface feels no ground effect
    surface = where(near, held[3], -np.inf)
    return near, make_surroundings(wind, surface, held[11], force, torque, wake)


@deferred(types.none)
@kernel
def fly_block(blocks: Any, first: int, b: int, gravity: float, dt: float) -> None:
    """Run the controllers of a block's marked drones, and integrate the drones by one RK4 step.

    Args:
        blocks: `Blocks` of a group.
        first: Number of the group's first drone, counted over all worlds.
        b: Index of the block.
        gravity: Gravitational acceleration that controllers know, m/s^2, downwards.
        dt: Duration of the step, s.
    """
    drone = first + b * WIDTH
    swarm = blocks.swarm
    row = lanes_row(blocks.rows, blocks.packed, b)
    speed = lanes_of(blocks.rotors, 0)
    command = lanes_of(blocks.rotors, 1)
    for r in range(row.num_rotors):
        speed[r] = gathered(swarm.rotor_speed, drone, r)
    state = _state_of(swarm, drone)
    num_commands = _num_commands(blocks, blocks.wings, drone)
    # Controllers may run here, as the commands of other drones have no effect on them
    observes, begin = False, 0
    if blocks.steering.level[b] != ALONE:
        together, autopilot = blocks.together, blocks.steering.autopilot
        advance_lanes(blocks.steering, autopilot, swarm, together, b, drone, gravity, dt)
        observes = steer(blocks.steering, b, drone, state, speed, gravity, dt, command)
        # The Lee controller commands no surfaces
        begin = row.num_rotors if observes else num_commands
    for k in range(begin, num_commands):
        command[k] = gathered(blocks.command, b * WIDTH, k)
    num_drones = blocks.rows.shape[1]
    num_panels = count_panels(blocks.wings, drone // num_drones, drone % num_drones)
    speeds, rotors = _turn_rotors(blocks, b, command, row, num_panels)
    _move_block_surfaces(blocks, blocks.wings, drone, command, row.num_rotors, dt)
    near, around = _make_surroundings(blocks, b, state, dt, row)
    # Constants let the compiler remove the ground effect
    wings = blocks.wings
    if is_any(near):
        count = row.num_rotors
        state = _step_block(state, speeds, rotors, dt, around, count, row, blocks, wings, drone)
    else:
        state = _step_block(state, speeds, rotors, dt, around, 0, row, blocks, wings, drone)

    # Write the lanes back to the drones
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
            for k in range(num_commands - row.num_rotors):
                swarm.deflection[0, drone + lane, k] = blocks.deflection[0, k, lane]
            if observes:
                remember_lane(blocks.steering, lane, drone + lane)


@deferred(types.none)
@kernel
def load_block(blocks: Any, supports: np.ndarray, first: int, b: int, dt: float) -> None:
    """Compute the forces on a block's sleeping drones, and those on their supports, into `load`.

    Args:
        blocks: `Blocks` of a group; the new rotor speeds are written into its `rotors` only.
        supports: (W, N) rows of `SUPPORT`, what sleeping drones rest on.
        first: Number of the group's first drone, counted over all worlds.
        b: Index of the block.
        dt: Duration of the step, s.
    """
    drone, num_drones = first + b * WIDTH, supports.shape[1]
    row = lanes_row(blocks.rows, blocks.packed, b)
    speed, command = lanes_of(blocks.rotors, 0), lanes_of(blocks.rotors, 1)
    for r in range(row.num_rotors):
        speed[r] = gathered(blocks.swarm.rotor_speed, drone, r)
        command[r] = gathered(blocks.command, b * WIDTH, r)
    w, i = drone // num_drones, drone % num_drones
    for lane in range(WIDTH):
        if blocks.resting[b * WIDTH + lane]:
            support = supports[w, i]
            for k in range(3):
                blocks.support[0, k, lane] = support.normal[k]
            blocks.support[0, 3, lane] = support.height
            blocks.support[0, 4, lane] = support.span
            blocks.support[0, 5, lane] = support.friction
        i += 1
        if i == num_drones:
            w, i = w + 1, 0
    state = _state_of(blocks.swarm, drone)
    speeds, rotors = _turn_rotors(blocks, b, command, row, 0)
    near, around = _make_surroundings(blocks, b, state, dt, row)
    lifted = row.num_rotors if is_any(near) else 0
    # The forces at the end of the substep
    # Sleeping drones with wings are computed alone
    slope = slope_of(state, speeds[2], rotors[2], around, lifted, row, None, None)
    acceleration, spinning = slope[2:]
    held = lanes_row(supports, blocks.support, 0)
    pressed, is_safe = press_support(held, state[1], acceleration, spinning, row)
    load = lanes_of(blocks.load, 0)
    for k in range(3):
        load[k] = acceleration[k]
        load[3 + k] = spinning[k]
    load[6] = pressed
    load[7] = where(is_safe, 1.0, 0.0)


@func
def stays_in_block(blocks: Any, contact: Any, w: int, i: int, drone: int, dt: float) -> bool:
    """Check whether a sleeping drone stays at rest under the forces that `load_block` computed.

    Args:
        blocks: `Blocks` of a group, with the forces on the block of the drone.
        contact: `ContactState`; see `stays_asleep`.
        w: Index of the world.
        i: Index of the drone.
        drone: Index of the drone in the group.
        dt: Duration of the step, s.
    """
    load, lane = blocks.load, drone % WIDTH
    acceleration = (load[0, lane], load[1, lane], load[2, lane])
    spinning = (load[3, lane], load[4, lane], load[5, lane])
    pressed, is_safe = load[6, lane], load[7, lane] > 0.0
    stays: bool = withstands(contact, w, i, acceleration, spinning, pressed, is_safe, dt)
    if stays:
        speed = blocks.swarm.rotor_speed
        number = w * contact.asleep.shape[1] + i
        for r in range(blocks.rows[w, i].num_rotors):
            speed[0, number, r] = blocks.rotors[0, r, lane]
    return stays
