"""Controllers of a block of drones in SIMD lanes; see `bulletuav.dynamics.blocks`.

Multirotors are flown by the Lee controller, and VTOLs by the attitude loop of the autopilot. The
outer loops of VTOLs, which have more branches and run at 50 Hz, are computed drone by drone. So is
the autopilot of aeroplanes, as it holds its commands between its runs.
"""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.gather import copy_numbers, gathered
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_of, lanes_row
from bulletuav.control.autopilot import (
    AUTOPILOT_MEMORY,
    BANK,
    FORWARD_SPEED,
    LIFT,
    PITCH,
    TURN_RATE,
    WING_BORNE,
    Autopilot,
)
from bulletuav.control.cascade import LEE, Cascade, rates_of_motion, turn_by
from bulletuav.control.fixed_wing import (
    advance_loops,
    attitude_goal,
    has_autopilot,
    is_vtol,
    stabilise,
)
from bulletuav.control.lee import nose
from bulletuav.control.observers import MEMORY, PUSHES, learned
from bulletuav.control.setpoint import SetpointLevel, Setpoints
from bulletuav.geometry.rotation import Quat4, Vec3
from bulletuav.vehicle.rotors import rotor_wrench
from bulletuav.vehicle.swarm import get_state

ALONE = -1
"""Value in place of a level: the controllers of the block's drones run one by one"""


class Steering(NamedTuple):
    """Work arrays for the controllers of a group of worlds in B blocks.

    Attributes:
        nominal_rows: (W, N) rows of `PARAMETERS`, the nominal parameters in the controller's model.
        gain_rows: (W, N) rows of `GAINS`.
        memory: (W, N, M) state of the controllers.
        integral: Whether observers estimate steady disturbance forces.
        autopilot: Controller of the aircraft with wings; None in a swarm without any.
        is_lee: Whether the controller is Lee's.
        nominal_numbers: (W, N, P) nominal parameters as float64.
        gain_numbers: (W, N, Q) gains as float64.
        nominal: (B, P, `WIDTH`) nominal parameters of the group's drones by block.
        gain: (B, Q, `WIDTH`) gains of the group's drones by block.
        goal: (B, 6, `WIDTH`) setpoints, and the horizontal direction of the yaw; of VTOLs, the
            result of `attitude_goal`.
        level: (B,) level of all setpoints of a block, or `ALONE`.
        remembered: (M, `WIDTH`) observer state of one block.
    """

    nominal_rows: np.ndarray
    gain_rows: np.ndarray
    memory: np.ndarray
    integral: bool
    autopilot: Autopilot | None
    is_lee: bool
    nominal_numbers: np.ndarray
    gain_numbers: np.ndarray
    nominal: np.ndarray
    gain: np.ndarray
    goal: np.ndarray
    level: np.ndarray
    remembered: np.ndarray

    @classmethod
    def of(cls, cascade: Cascade, blocks: int) -> "Steering":
        """Allocate the arrays for a number of blocks."""
        nominal, gains, memory = cascade.nominal, cascade.gains, cascade.memory
        assert all(array.flags.c_contiguous for array in (nominal, gains, memory))
        nominal_numbers = nominal.view(np.float64).reshape(*nominal.shape, -1)
        gain_numbers = gains.view(np.float64).reshape(*gains.shape, -1)
        return cls(
            nominal_rows=nominal,
            gain_rows=gains,
            memory=memory,
            integral=cascade.integral,
            autopilot=cascade.autopilot,
            is_lee=cascade.controller == LEE,
            nominal_numbers=nominal_numbers,
            gain_numbers=gain_numbers,
            nominal=lane_zeros(blocks, nominal_numbers.shape[2]),
            gain=lane_zeros(blocks, gain_numbers.shape[2]),
            goal=lane_zeros(blocks, 6),
            level=np.full(blocks, ALONE),
            remembered=lane_zeros(MEMORY),
        )


@func
def _common_level(steering: Any, levels: np.ndarray, drone: int) -> int:
    """Return the setpoint level that `WIDTH` drones from `drone` on share, or `ALONE`.

    Loads, which have no controller, are ignored unless they come first.
    """
    num_drones, autopilot = levels.shape[1], steering.autopilot
    w, i = drone // num_drones, drone % num_drones
    level, tips = levels[w, i], steering.nominal_rows[w, i].drag_height > 0.0
    hovers = is_vtol(autopilot, w, i)
    if hovers:
        if level == SetpointLevel.ROTOR:
            return ALONE
    elif not steering.is_lee or level > SetpointLevel.ACCELERATION:
        return ALONE
    for other in range(drone, min(drone + WIDTH, levels.size)):
        w, i = other // num_drones, other % num_drones
        row = steering.nominal_rows[w, i]
        differs = levels[w, i] != level or (row.drag_height > 0.0) != tips
        flown = has_autopilot(autopilot, w, i)
        if row.num_rotors > 0 and (
            differs or flown != hovers or is_vtol(autopilot, w, i) != hovers
        ):
            return ALONE
    return int(level)


@kernel
def pack_steering(steering: Any, setpoints: Setpoints, first: int, begin: int, end: int) -> None:
    """Pack the setpoints, gains and nominal parameters of a group into blocks, once a decision.

    Args:
        steering: `Steering`.
        setpoints: Setpoints of all drones.
        first: Number of the group's first drone, counted over all worlds.
        begin: Index of the first block to pack.
        end: Index after the last block to pack.
    """
    levels = setpoints.level
    for b in range(begin, end):
        drone = first + b * WIDTH
        level = ALONE if drone >= levels.size else _common_level(steering, levels, drone)
        steering.level[b] = level
        if level != ALONE:
            copy_numbers(steering.nominal_numbers, drone, steering.nominal, b)
            copy_numbers(steering.gain_numbers, drone, steering.gain, b)
            goal = lanes_of(steering.goal, b)
            for k in range(4):
                goal[k] = gathered(setpoints.value, drone, k)
            w, i = drone // levels.shape[1], drone % levels.shape[1]
            hovers = is_vtol(steering.autopilot, w, i)
            # Sines are computed only once a decision
            for lane in range(WIDTH):
                one = steering.goal[b, :, lane]
                if hovers:
                    turned = attitude_goal(level, (one[0], one[1], one[2], one[3]))
                    for k in range(6):
                        one[k] = turned[k]
                else:
                    one[4], one[5], _ = nose(one[3])


@func
def _first_remembered(steering: Any) -> int:
    """Return the index of the first memory element in use: those about pushes come first."""
    return 0 if steering.integral else PUSHES


@func
def advance_lanes(
    steering: Any,
    autopilot: Any,
    swarm: Any,
    marks: np.ndarray,
    b: int,
    drone: int,
    gravity: float,
    dt: float,
) -> None:
    """Run the outer loops of the VTOLs of a block that are due.

    Args:
        steering: `Steering`; the level of the block is not `ALONE`.
        autopilot: Its autopilot; None in a swarm without wings.
        swarm: State of the drones of all worlds, with axes (1, W N, ...).
        marks: (D,) bool, drones of the group that are steered.
        b: Index of the block.
        drone: Number of the block's first drone, counted over all worlds.
        gravity: Gravitational acceleration, m/s^2, downwards.
        dt: Time since the last call, s.
    """
    if autopilot is None:
        return
    num_drones, goal = steering.memory.shape[1], steering.goal
    if not has_autopilot(autopilot, drone // num_drones, drone % num_drones):
        return
    for lane in range(WIDTH):
        if marks[b * WIDTH + lane]:
            one = drone + lane
            w, i = one // num_drones, one % num_drones
            target = (goal[b, 0, lane], goal[b, 1, lane], goal[b, 2, lane], goal[b, 3, lane])
            state, memory = get_state(swarm, 0, one), steering.memory[w, i]
            level = steering.level[b]
            row, gain = steering.nominal_rows[w, i], steering.gain_rows[w, i]
            advance_loops(autopilot, level, target, state, memory, w, i, dt, gravity, row, gain)


@func
def _stabilise_lanes(
    steering: Any,
    autopilot: Any,
    b: int,
    drone: int,
    state: tuple[Vec3, Quat4, Vec3, Vec3],
    gravity: float,
    command: Any,
) -> bool:
    """Compute the commands of a block of VTOLs; return False for a block of multirotors.

    The arguments are those of `steer`. All drones of the block have the same row of `AUTOPILOT`.
    """
    if autopilot is None:
        return False
    num_drones = steering.memory.shape[1]
    w, i = drone // num_drones, drone % num_drones
    if not has_autopilot(autopilot, w, i):
        return False
    first = steering.memory.shape[2] - AUTOPILOT_MEMORY
    # In the same order as in `fixed_wing.stabilise_one`
    loops = (
        gathered(steering.memory, drone, first + BANK),
        gathered(steering.memory, drone, first + PITCH),
        gathered(steering.memory, drone, first + TURN_RATE),
        gathered(steering.memory, drone, first + LIFT),
        gathered(steering.memory, drone, first + FORWARD_SPEED),
        gathered(steering.memory, drone, first + WING_BORNE),
    )
    air = autopilot.wind
    wind = (gathered(air, drone, 0), gathered(air, drone, 1), gathered(air, drone, 2))
    packed = lanes_of(steering.goal, b)
    goal = (packed[0], packed[1], packed[2], packed[3], packed[4], packed[5])
    nominal = lanes_row(steering.nominal_rows, steering.nominal, b)
    gain = lanes_row(steering.gain_rows, steering.gain, b)
    pilot = autopilot.rows[w, i]
    stabilise(steering.level[b], goal, loops, state, wind, gravity, nominal, pilot, gain, command)
    return True


@func
def steer(
    steering: Any,
    b: int,
    drone: int,
    state: tuple[Vec3, Quat4, Vec3, Vec3],
    speed: Any,
    gravity: float,
    dt: float,
    command: Any,
) -> bool:
    """Compute the commands of a block, and advance the observers of its controllers.

    Args:
        steering: `Steering`; the level of the block is not `ALONE`.
        b: Index of the block.
        drone: Number of the block's first drone, counted over all worlds.
        state: State of the drones.
        speed: Rotor speeds of the drones, rad/s.
        gravity: Gravitational acceleration, m/s^2, downwards.
        dt: Time since the last call, s.
        command: Commanded rotor speeds, rad/s, and deflections, rad; written.

    Returns:
        Whether there are observers, see `remember_lane`.
    """
    if _stabilise_lanes(steering, steering.autopilot, b, drone, state, gravity, command):
        return False
    nominal = lanes_row(steering.nominal_rows, steering.nominal, b)
    gain = lanes_row(steering.gain_rows, steering.gain, b)
    goal = lanes_of(steering.goal, b)
    memory = lanes_of(steering.remembered, 0)
    for k in range(_first_remembered(steering), steering.remembered.shape[0]):
        memory[k] = gathered(steering.memory, drone, k)
    rotors = rotor_wrench(speed, 0.0, nominal)
    push, twist = learned(state, rotors, memory, steering.integral, dt, gravity, nominal, gain)
    target, ahead = (goal[0], goal[1], goal[2]), (goal[4], goal[5], 0.0)
    thrust, rates = rates_of_motion(
        steering.level[b], target, ahead, state, rotors[2], push, nominal, gain, gravity
    )
    turn_by(thrust, rates, state[3], rotors[2], twist, nominal, gain, command)
    return True


@func
def remember_lane(steering: Any, lane: int, drone: int) -> None:
    """Store the observer state of one drone of the block that `steer` computed last.

    The blocks of multirotors have observers, those of VTOLs not.
    """
    num_drones = steering.memory.shape[1]
    for k in range(_first_remembered(steering), steering.remembered.shape[0]):
        new = steering.remembered[k, lane]
        steering.memory[drone // num_drones, drone % num_drones, k] = new
