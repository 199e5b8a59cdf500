"""Autopilot of one aircraft with wings: L1 guidance, total energy control, surfaces, transition.

The loops of aeroplanes run at 50 Hz, the default of ArduPlane. Those of VTOLs do, too, but for the
attitude loop, which runs in every substep as that of multirotors:

1. Guidance makes a lateral acceleration, an airspeed and a climb rate of a setpoint.
2. The total energy control system (TECS) makes thrust and pitch of airspeed and climb rate.
3. The attitude loop makes torques of bank and pitch, with the turn rate of a coordinated turn.
4. Torques are allocated to the control surfaces, whose effect grows with the dynamic pressure.

The functions of the last two, from `stabilise` down, compute one aircraft, or several in SIMD lanes
that have the same row of `AUTOPILOT`.

A VTOL flies on its lift rotors below the transition speed. They carry the weight that the wings do
not carry yet, while the forward rotors accelerate.

Bank is positive to the left here, and pitch positive nose up, as pilots count them.

References:
    S. Park, J. Deyst, J. How, A new nonlinear guidance logic for trajectory tracking, AIAA 2004.
    A. Lambregts, Vertical flight path and speed control autopilot design using total energy
    principles, AIAA 1983.
    ArduPilot, AP_L1_Control and AP_TECS: the loiter, and limits at low airspeed.
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012: coordinated turns.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.functions import sin, tan
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import is_any, where
from bulletuav.control.autopilot import (
    AUTOPILOT_MEMORY,
    BANK,
    CLIMB,
    COUNTDOWN,
    FORWARD_SPEED,
    HELD,
    L1_DAMPING,
    LAST_AIRSPEED,
    LIFT,
    LOITER_BANK,
    PITCH,
    PITCH_INTEGRAL,
    PUSH,
    THRUST_INTEGRAL,
    TURN_RATE,
    WAYPOINT_PHASE,
    WING_BORNE,
    Autopilot,
    AutopilotRow,
)
from bulletuav.control.gains import GainRow
from bulletuav.control.lee import mix, nose, velocity_setpoint
from bulletuav.control.setpoint import SetpointLevel, is_flying_speed
from bulletuav.control.waypoint import EXTENDING, HOMING, orbit_course, update_phase
from bulletuav.geometry.rotation import (
    Quat4,
    Quat4Like,
    Vec3,
    Vec3Like,
    axes,
    cross,
    dot,
    minus,
    vec3,
)
from bulletuav.vehicle.wing_power import STALL_MARGIN, propeller_speed, wing_share

State = tuple[Vec3, Quat4, Vec3, Vec3]
"""Position (m), quaternion, velocity (m/s) and body rates (rad/s) of one aircraft"""

SixNumbers = tuple[float, float, float, float, float, float]
"""Numbers of a setpoint, or of the outer loops, for `stabilise`"""

PERIOD = 0.02
"""Time between runs of the loops, s: 50 Hz, the default rate of ArduPlane's loops"""
SPEED_RATE = 0.7
"""Rate at which airspeed errors decay, 1/s"""
HEIGHT_RATE = 0.5
"""Rate at which height errors decay, 1/s"""
CLIMB_RATE = 2.0
"""Rate at which the reference climb follows its command, 1/s: slower than the path angle, so that
the integrals do not wind up"""
ENERGY_DAMPING = 0.5
"""Proportional gain of both loops of the TECS"""
ENERGY_RATE = 0.3
"""Integral gain of both loops of the TECS, 1/s"""
MAX_PITCH = 0.5
"""Sine of the largest commanded pitch"""
MAX_PITCH_TRIM = 0.15
"""Bound of the integral of the pitch, rad"""
MAX_ROLL = 1.3
"""Largest commanded roll, rad"""
MAX_ATTITUDE_ERROR = 1.0
"""Largest attitude error that the rates follow, rad"""
MAX_PUSH = 4.0
"""Bound of the estimated disturbance of a VTOL on its lift rotors, m/s^2"""
MAX_TILT_PUSH = 4.0
"""Largest horizontal acceleration of a VTOL on its lift rotors, m/s^2: a tilt of 22 degrees"""
TURN_GAIN = 1.5
"""Rate at which heading errors of a VTOL on its lift rotors decay, 1/s"""
MAX_TURN = 1.0
"""Largest turn rate of a VTOL on its lift rotors, rad/s"""


@func
def _clip(value: float, low: float, high: float) -> float:
    """Limit a number to an interval."""
    return min(max(value, low), high)


@func
def _length(x: float, y: float) -> float:
    """Return the length of a horizontal vector, above 0."""
    return math.sqrt(x * x + y * y + 1e-12)


@func
def turn_towards(velocity: Vec3Like, x: float, y: float, pilot: AutopilotRow) -> float:
    """Compute the lateral acceleration towards a course: L1 guidance to a point far ahead.

    The law is 4 pi z V sin(e) / P for a course error e, the L1 period P and damping z; errors above
    90 degrees turn as those of 90 degrees.

    Args:
        velocity: Velocity over ground, m/s, world.
        x: East component of the course direction, of any length above 0.
        y: North component.
        pilot: Row of `AUTOPILOT`.

    Returns:
        Acceleration across the velocity, positive to the left, m/s^2.
    """
    speed, length = _length(velocity[0], velocity[1]), _length(x, y)
    sine = (velocity[0] * y - velocity[1] * x) / (speed * length)
    ahead = velocity[0] * x + velocity[1] * y
    if ahead < 0.0:
        sine = 1.0 if sine >= 0.0 else -1.0
    return pilot.course_rate * speed * sine


@func
def circle(position: Vec3Like, velocity: Vec3Like, centre: Vec3Like, pilot: AutopilotRow) -> float:
    """Compute the lateral acceleration that leads to a circle around a point, to the left.

    Far away it is L1 guidance to the point. On the circle it is the centripetal acceleration, with
    a proportional and derivative law of the distance (`update_loiter` of ArduPilot). Inside, while
    the sum of outward and clockwise speed is positive, it is L1 guidance along `orbit_course`,
    which turns left at the centre.

    Args:
        position: Position, m, world.
        velocity: Velocity over ground, m/s, world.
        centre: The point, m, world.
        pilot: Row of `AUTOPILOT`.

    Returns:
        Acceleration across the velocity, positive to the left, m/s^2.
    """
    x, y = centre[0] - position[0], centre[1] - position[1]
    distance = _length(x, y)
    capture = turn_towards(velocity, x, y, pilot)
    # Velocity towards the centre, and around it anticlockwise
    inward = (velocity[0] * x + velocity[1] * y) / distance
    around = (velocity[0] * y - velocity[1] * x) / distance
    radius = pilot.loiter_radius
    beyond = distance - radius
    if beyond < 0.0 and around < -inward:
        east, north = orbit_course(x, y, radius)
        return turn_towards(velocity, east, north, pilot)
    # The natural frequency 2 pi / P of the L1 guidance, from its rate 4 pi z / P
    frequency = pilot.course_rate / (2.0 * L1_DAMPING)
    correction = frequency * frequency * beyond - 2.0 * L1_DAMPING * frequency * inward
    if inward < 0.0 and around < 0.0:
        # Flying outward and clockwise, it turns left
        correction = max(correction, 0.0)
    orbit = correction + around * around / max(0.5 * radius, distance)
    return capture if beyond > 0.0 and capture < orbit else orbit


@func
def guide(
    level: int,
    target: Quat4Like,
    state: State,
    wind: Vec3Like,
    airspeed: float,
    dt: float,
    gravity: float,
    memory: np.ndarray,
    first: int,
    pilot: AutopilotRow,
) -> Vec3:
    """Compute lateral acceleration, airspeed and climb rate from a setpoint.

    Args:
        level: `SetpointLevel` of the setpoint, at most ACCELERATION.
        target: The setpoint's four numbers.
        state: State of the aircraft.
        wind: Velocity of the air, m/s, world.
        airspeed: Present airspeed, m/s.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        memory: State of the controller; the phase of the flight to a position is updated.
        first: Index of the autopilot's first number in it.
        pilot: Row of `AUTOPILOT`.

    Returns:
        Acceleration across the velocity over ground, positive to the left (m/s^2), airspeed and
        climb rate (m/s).
    """
    position, _, velocity, _ = state
    phase_index = first + WAYPOINT_PHASE
    if level != SetpointLevel.POSITION or memory[first + LAST_AIRSPEED] <= 0.0:
        # Another flight, or the first run after a pause
        memory[phase_index] = HOMING
    if level == SetpointLevel.POSITION:
        goal = (target[0], target[1], target[2])
        most = pilot.max_bank * gravity
        phase = update_phase(position, velocity, goal, airspeed, most, dt, memory, phase_index)
        if phase == EXTENDING:
            lateral = 0.0
        elif phase == HOMING:
            lateral = turn_towards(velocity, goal[0] - position[0], goal[1] - position[1], pilot)
        else:
            lateral = circle(position, velocity, goal, pilot)
        return lateral, pilot.cruise_speed, HEIGHT_RATE * (goal[2] - position[2])
    if level == SetpointLevel.VELOCITY:
        if pilot.can_hover == 0 and not is_flying_speed(target[0], target[1], pilot.min_speed):
            # Too slow to fly: loiter
            return LOITER_BANK * pilot.max_bank * gravity, pilot.min_speed, target[2]
        # The airspeed that gives the ground speed
        wanted = _length(target[0] - wind[0], target[1] - wind[1])
        return turn_towards(velocity, target[0], target[1], pilot), wanted, target[2]
    speed = _length(velocity[0], velocity[1])
    along = (target[0] * velocity[0] + target[1] * velocity[1]) / speed
    across = (target[1] * velocity[0] - target[0] * velocity[1]) / speed
    rise = memory[first + CLIMB] + target[2] / CLIMB_RATE
    return across, airspeed + along / SPEED_RATE, rise


@func
def max_forward_thrust(airspeed: float, row: np.record, pilot: AutopilotRow) -> float:
    """Return the thrust of the forward rotors at full speed, N."""
    fastest = row.max_rotor_speed
    one = row.thrust_coefficient * fastest * (fastest - pilot.thrust_slope * airspeed)
    return float(pilot.num_forward * max(one, 0.0))


@func
def forward_rotor_speed(
    thrust: float, airspeed: float, row: np.record, pilot: AutopilotRow
) -> float:
    """Return the speed of each forward rotor for a thrust of all, rad/s."""
    each = thrust / (row.thrust_coefficient * max(pilot.num_forward, 1))
    needed = propeller_speed(each, pilot.thrust_slope * airspeed, 1.0)
    speed: float = min(needed, row.max_rotor_speed)
    return speed


@func
def control_energy(
    wanted: Vec3,
    airspeed: float,
    faster: float,
    climb: float,
    dt: float,
    gravity: float,
    memory: np.ndarray,
    first: int,
    row: np.record,
    pilot: AutopilotRow,
) -> tuple[float, float]:
    """Compute thrust and flight path angle by total energy control.

    Thrust controls the rate of total energy, g h' + V V', and the flight path angle distributes it:
    g h' - V V'. Below the margin to the stall, thrust is full and the path angle controls the
    airspeed only. An integral stops where its output is limited.

    Args:
        wanted: Airspeed (m/s), climb rate (m/s) and load factor.
        airspeed: Present airspeed V, m/s.
        faster: Its rate V', m/s^2.
        climb: Present climb rate h', m/s.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        memory: State of the controller; integrals are updated.
        first: Index of the autopilot's first number in it.
        row: Row of the nominal `PARAMETERS`.
        pilot: Row of `AUTOPILOT`.

    Returns:
        Thrust, N, and flight path angle relative to the ground, rad.
    """
    speed, rise, load = wanted
    square = airspeed * airspeed
    # Half of the excess power accelerates, so that the other half climbs
    most = gravity / airspeed
    gain = SPEED_RATE * (speed - airspeed)
    gain = _clip(gain, -most * pilot.max_sink, 0.5 * most * pilot.max_climb)
    # Close to the stall, height is given up for airspeed
    margin = airspeed / (pilot.stall_speed * math.sqrt(load)) - 1.0
    weight = _clip((margin - 0.02) / 0.06, 0.0, 1.0)

    missed_climb, missed_gain = gravity * (rise - climb), airspeed * (gain - faster)
    total = gravity * rise + airspeed * gain
    missed = missed_climb + missed_gain
    drag = pilot.drag[0] * square + pilot.drag[1] * load * load / square
    full = max_forward_thrust(airspeed, row, pilot)
    per_power = row.mass / airspeed
    thrust = drag + per_power * (total + ENERGY_DAMPING * missed + memory[first + THRUST_INTEGRAL])
    thrust += (1.0 - weight) * full
    if (thrust < full or missed < 0.0) and (thrust > 0.0 or missed > 0.0):
        memory[first + THRUST_INTEGRAL] += dt * ENERGY_RATE * missed
    thrust = _clip(thrust, 0.0, full)

    per_energy = 1.0 / (gravity * airspeed)
    balance = weight * missed_climb - missed_gain
    steep = weight * rise / airspeed + per_energy * ENERGY_DAMPING * balance
    integral = memory[first + PITCH_INTEGRAL] + dt * ENERGY_RATE * per_energy * balance
    memory[first + PITCH_INTEGRAL] = _clip(integral, -MAX_PITCH_TRIM, MAX_PITCH_TRIM)
    return thrust, steep + memory[first + PITCH_INTEGRAL]


@func
def fly_on_wings(
    wanted: Vec3,
    state: State,
    wind: Vec3Like,
    airspeed: float,
    dt: float,
    gravity: float,
    memory: np.ndarray,
    first: int,
    row: np.record,
    pilot: AutopilotRow,
) -> None:
    """Write the commanded bank, pitch and speed of forward rotors of flight on wings into memory.

    Args:
        wanted: Result of `guide`.
        state: State of the aircraft.
        wind: Velocity of the air, m/s, world.
        airspeed: Present airspeed, m/s.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        memory: State of the controller; updated.
        first: Index of the autopilot's first number in it.
        row: Row of the nominal `PARAMETERS`.
        pilot: Row of `AUTOPILOT`.
    """
    lateral, speed, rise = wanted
    slow = max(airspeed, 0.5 * pilot.stall_speed)
    # The stall speed grows with the square root of the load factor 1 / cos(bank)
    margin = slow / (STALL_MARGIN * pilot.stall_speed)
    largest = math.sqrt(max(margin * margin * margin * margin - 1.0, 0.0))
    steepest = min(pilot.max_bank, largest)
    bank = _clip(lateral / gravity, -pilot.max_bank, pilot.max_bank)
    load = math.sqrt(1.0 + bank * bank)
    slowest = max(pilot.min_speed, STALL_MARGIN * pilot.stall_speed * math.sqrt(load))
    bank = _clip(bank, -steepest, steepest)
    load = math.sqrt(1.0 + bank * bank)
    speed = _clip(speed, slowest, max(pilot.max_speed, slowest))
    rise = _clip(rise, -pilot.max_sink, pilot.max_climb)
    climb = state[2][2]
    last = memory[first + LAST_AIRSPEED]
    if last <= 0.0:
        # First run, or first after a pause: forget the flight before, as AP_TECS does
        last = slow
        memory[first + CLIMB] = _clip(climb, -pilot.max_sink, pilot.max_climb)
        memory[first + THRUST_INTEGRAL] = 0.0
        memory[first + PITCH_INTEGRAL] = 0.0
    faster = (slow - last) / dt
    memory[first + LAST_AIRSPEED] = slow
    rise = memory[first + CLIMB] + min(CLIMB_RATE * dt, 1.0) * (rise - memory[first + CLIMB])
    memory[first + CLIMB] = rise
    thrust, steep = control_energy(
        (speed, rise, load), slow, faster, climb, dt, gravity, memory, first, row, pilot
    )
    # Pitch is the path angle in the air plus the angle of attack, in the plane of the lift
    angle = pilot.alpha[0] + pilot.alpha[1] * load / (slow * slow)
    pitch = steep - wind[2] / slow + angle / load
    memory[first + BANK] = bank
    memory[first + PITCH] = _clip(pitch, -MAX_PITCH, MAX_PITCH)
    memory[first + FORWARD_SPEED] = forward_rotor_speed(thrust, slow, row, pilot)
    memory[first + TURN_RATE] = 0.0


@func
def attitude_rates(
    up: Vec3,
    bank: float,
    pitch: float,
    turn: float,
    frequency: Vec3,
    damping: float,
) -> Vec3:
    """Compute the body rates towards a bank and a pitch, at a turn rate about the vertical.

    A wing beyond 90 degrees of bank rolls first, without pitching.

    Args:
        up: World z axis in body axes.
        bank: Tangent of the bank to the left.
        pitch: Sine of the pitch, positive nose up.
        turn: Turn rate about the world z axis, rad/s, positive to the left.
        frequency: Frequencies of the attitude loop about x, y, z, rad/s.
        damping: Damping ratio of the attitude loop.

    Returns:
        Body rates, rad/s.
    """
    level = math.sqrt(up[1] * up[1] + up[2] * up[2] + 1e-6)
    # Cosine and sine of the present and the desired bank
    cosine, sine = up[2] / level, -up[1] / level
    wanted_cosine = 1.0 / math.sqrt(1.0 + bank * bank)
    wanted_sine = bank * wanted_cosine
    error = wanted_sine * cosine - wanted_cosine * sine
    is_beyond = wanted_cosine * cosine + wanted_sine * sine < 0.0
    error = where(is_beyond, where(error >= 0.0, 1.0, -1.0), error)
    # A left bank is a negative rotation about x, a raised nose one about y
    roll = -0.5 * frequency[0] / damping * error
    rise = _clip((pitch - up[0]) / max(level, 0.2), -MAX_ATTITUDE_ERROR, MAX_ATTITUDE_ERROR)
    rise *= 0.5 * frequency[1] / damping
    return (
        roll + turn * up[0],
        turn * up[1] - rise * max(cosine, 0.0),
        turn * up[2] - rise * sine,
    )


@func
def allocate_surfaces(
    torque: Vec3,
    load: float,
    airspeed: float,
    share: float,
    num_rotors: int,
    pilot: AutopilotRow,
    command: np.ndarray,
) -> None:
    """Write the deflections for a torque, about those of trimmed flight.

    Args:
        torque: Torque about the body axes, N m.
        load: Load factor.
        airspeed: Airspeed, m/s.
        share: Fraction of the torque, and of the trim, that the surfaces provide.
        num_rotors: Number of rotor columns of the command.
        pilot: Row of `AUTOPILOT`.
        command: Rotor speeds, rad/s, then deflections, rad; written.
    """
    inverse = 1.0 / (airspeed * airspeed)
    scale = share * inverse
    for k in range(pilot.num_surfaces):
        trim = pilot.trim[k, 0] + pilot.trim[k, 1] * (load * inverse)
        turn = (
            pilot.mixer[k, 0] * torque[0]
            + pilot.mixer[k, 1] * torque[1]
            + pilot.mixer[k, 2] * torque[2]
        )
        wanted = share * trim + scale * turn
        command[num_rotors + k] = _clip(wanted, pilot.surface_low[k], pilot.surface_high[k])


@func
def fly_on_rotors(
    wanted: Vec3,
    yaw: float,
    state: State,
    body: Vec3,
    wind: Vec3Like,
    dt: float,
    gravity: float,
    memory: np.ndarray,
    first: int,
    row: np.record,
    pilot: AutopilotRow,
    gain: GainRow,
) -> None:
    """Write the commands of a VTOL on its lift rotors into memory, such as during a transition.

    Forward accelerations are those of the forward rotors. Lift rotors carry the weight that the
    wings do not carry, and tilt backward no further than the wings lift the weight alone, so that
    the aircraft keeps its height while it slows down.

    Args:
        wanted: The velocity that the setpoint gives, m/s, world.
        yaw: Yaw of the setpoint, rad.
        state: State of the aircraft.
        body: Velocity relative to the air, body axes, m/s.
        wind: Velocity of the air, m/s, world.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        memory: State of the controller; updated.
        first: Index of the autopilot's first number in it.
        row: Row of the nominal `PARAMETERS`.
        pilot: Row of `AUTOPILOT`.
        gain: Row of `GAINS`.
    """
    _, quaternion, velocity, _ = state
    ahead, _, top = axes(quaternion)
    # Nose and left, horizontal
    size = _length(ahead[0], ahead[1])
    x, y = ahead[0] / size, ahead[1] / size
    rate = 2.0 * gain.damping * gain.position_frequency
    # Errors decay, and their integrals are the disturbances
    integral = 0.25 * rate * rate * dt
    push = first + PUSH
    for k in range(3):
        missed = _clip(wanted[k] - velocity[k], -1.0, 1.0)
        memory[push + k] = _clip(memory[push + k] + integral * missed, -MAX_PUSH, MAX_PUSH)
    east = rate * (wanted[0] - velocity[0]) + memory[push]
    north = rate * (wanted[1] - velocity[1]) + memory[push + 1]
    rise = _clip(rate * (wanted[2] - velocity[2]) + memory[push + 2], -0.5 * gravity, gravity)
    forward = _clip(east * x + north * y, -MAX_TILT_PUSH, MAX_TILT_PUSH)
    left = _clip(north * x - east * y, -MAX_TILT_PUSH, MAX_TILT_PUSH)

    # Lift of the wings as a load factor, and the pitch at which it is 1
    square = body[0] * body[0] + 1e-6
    slow = transition_speed(pilot)
    share = surface_share(body[0], pilot)
    angle = _clip(-body[2] / max(body[0], 1.0), -pilot.max_alpha, pilot.max_alpha)
    lifted = max(angle - pilot.alpha[0], 0.0) * square / pilot.alpha[1] if body[0] > 0.0 else 0.0
    # Path angle in the plane of the lift: sideslip changes the angle of attack at a bank
    path = _clip(ahead[2] + body[2] / max(body[0], 1.0), -0.3, 0.3)
    load = 1.0
    if forward < 0.0:
        # At the pitch of a descent it would glide, and never slow down. To stop a climb, the wings
        # carry less, as no rotor pulls down.
        path = max(path, 0.0)
        climb = max(velocity[2] - max(wanted[2], 0.0), 0.0)
        load -= min(rate * climb / gravity, 0.5)
    level_pitch = path + pilot.alpha[0] + pilot.alpha[1] * load / square
    pitch = share * min(level_pitch, pilot.max_alpha)
    if forward < 0.0:
        pitch = min(pitch - forward / gravity, max(level_pitch, 0.0))
        push_thrust = 0.0
    else:
        push_thrust = row.mass * forward + pilot.drag[0] * square
    memory[first + BANK] = left / gravity
    memory[first + PITCH] = pitch
    memory[first + FORWARD_SPEED] = forward_rotor_speed(
        min(push_thrust, max_forward_thrust(body[0], row, pilot)), max(body[0], 0.0), row, pilot
    )
    weight = row.mass * gravity
    lift = row.mass * (gravity + rise) / max(top[2], 0.5) - lifted * weight
    memory[first + LIFT] = _clip(lift, 0.15 * (1.0 - share) * weight, 0.9 * gain.max_thrust)

    # The nose points along a fast velocity, into the flow while slowing down, else to the yaw
    east, north = wanted[0], wanted[1]
    if east * east + north * north < 0.25 * slow * slow:
        east, north = velocity[0] - wind[0], velocity[1] - wind[1]
        if east * east + north * north < 0.25 * slow * slow:
            goal = nose(yaw)
            east, north = goal[0], goal[1]
    size = _length(east, north)
    sine, cosine = (x * north - y * east) / size, (x * east + y * north) / size
    if cosine < 0.0:
        sine = 1.0 if sine >= 0.0 else -1.0
    memory[first + TURN_RATE] = _clip(TURN_GAIN * sine, -MAX_TURN, MAX_TURN)


@func
def transition_speed(pilot: AutopilotRow) -> float:
    """Return the airspeed at which a VTOL changes to flight on its wings, m/s."""
    return float(STALL_MARGIN * pilot.stall_speed)


@func
def flies_on_wings(wanted: Vec3, body: Vec3, was: bool, pilot: AutopilotRow) -> bool:
    """Decide whether a VTOL flies on its wings: if it is commanded to be fast, and is.

    It does not start at an angle of attack above the one that carries the weight at stall speed.

    Args:
        wanted: Commanded velocity, m/s, world.
        body: Velocity relative to the air, body axes, m/s.
        was: Whether it flew on its wings before; limits are lower then.
        pilot: Row of `AUTOPILOT`.
    """
    commanded = pilot.min_speed * (0.9 if was else 1.0)
    flown = pilot.stall_speed if was else transition_speed(pilot)
    largest = pilot.alpha[0] + pilot.alpha[1] / (pilot.stall_speed * pilot.stall_speed)
    is_steep = not was and -body[2] > largest * body[0]
    return bool(
        is_flying_speed(wanted[0], wanted[1], commanded) and body[0] >= flown and not is_steep
    )


@func
def velocity_of(level: int, target: Quat4Like, state: State, gain: GainRow) -> Vec3:
    """Return the velocity to fly at for a setpoint of a VTOL, m/s, world."""
    position, _, velocity, _ = state
    goal = (target[0], target[1], target[2])
    if level == SetpointLevel.POSITION:
        return velocity_setpoint(position, goal, gain)
    if level == SetpointLevel.VELOCITY:
        return goal
    rate = 1.0 / (2.0 * gain.damping * gain.position_frequency)
    return (
        velocity[0] + rate * goal[0],
        velocity[1] + rate * goal[1],
        velocity[2] + rate * goal[2],
    )


@deferred(types.none)
@kernel
def run_outer_loops(
    level: int,
    target: Quat4Like,
    state: State,
    wind: Vec3Like,
    dt: float,
    gravity: float,
    memory: np.ndarray,
    row: np.record,
    pilot: AutopilotRow,
    gain: GainRow,
) -> None:
    """Write bank, pitch and thrusts for a setpoint down to ACCELERATION into memory.

    `wind` is the velocity of the air, m/s, world; see `fly_winged` for the other arguments.
    """
    first = memory.shape[0] - AUTOPILOT_MEMORY
    body = _body_velocity(state, wind)
    airspeed = math.sqrt(dot(body, body))
    if pilot.can_hover:
        wanted = velocity_of(level, target, state, gain)
        was = memory[first + WING_BORNE] > 0.0
        is_borne = flies_on_wings(wanted, body, was, pilot)
        memory[first + WING_BORNE] = 1.0 if is_borne else 0.0
        if not is_borne:
            memory[first + LAST_AIRSPEED] = 0.0
            yaw = target[3]
            fly_on_rotors(
                wanted, yaw, state, body, wind, dt, gravity, memory, first, row, pilot, gain
            )
            return
        # Lift rotors fade out
        memory[first + LIFT] = max(memory[first + LIFT] - dt * row.mass * gravity, 0.0)
        if level == SetpointLevel.POSITION:
            target, level = (wanted[0], wanted[1], wanted[2], target[3]), SetpointLevel.VELOCITY
    wanted = guide(level, target, state, wind, airspeed, dt, gravity, memory, first, pilot)
    fly_on_wings(wanted, state, wind, airspeed, dt, gravity, memory, first, row, pilot)


@func
def has_autopilot(autopilot: Autopilot | None, w: int, i: int) -> bool:
    """Check whether the autopilot flies drone i of world w; None in a swarm without wings."""
    if autopilot is None:
        return False
    return bool(autopilot.rows[w, i].is_winged > 0)


@func
def is_vtol(autopilot: Autopilot | None, w: int, i: int) -> bool:
    """Check whether drone i of world w is a VTOL that the autopilot flies."""
    if autopilot is None:
        return False
    return bool(autopilot.rows[w, i].can_hover > 0)


@func
def pause_loops(memory: np.ndarray) -> None:
    """Make the loops start again when they run next, as if after a reset.

    Args:
        memory: (M,) state of the controllers; updated.
    """
    first = memory.shape[0] - AUTOPILOT_MEMORY
    memory[first + COUNTDOWN] = 0.0
    memory[first + LAST_AIRSPEED] = 0.0
    memory[first + WING_BORNE] = 0.0


@func
def advance_loops(
    autopilot: Autopilot,
    level: int,
    target: Quat4Like,
    state: State,
    memory: np.ndarray,
    w: int,
    i: int,
    dt: float,
    gravity: float,
    row: np.record,
    gain: GainRow,
) -> bool:
    """Run the outer loops of one aircraft if they are due; they pause for attitudes and rates.

    See `fly_winged` for the arguments.

    Returns:
        Whether loops are due, among them the attitude loop of an aeroplane.
    """
    first = memory.shape[0] - AUTOPILOT_MEMORY
    # Half of a step early or late is nearer than a whole step late
    is_due = memory[first + COUNTDOWN] <= 0.5 * dt
    if is_due:
        memory[first + COUNTDOWN] += max(PERIOD, dt)
    memory[first + COUNTDOWN] -= dt
    if level > SetpointLevel.ACCELERATION:
        countdown = memory[first + COUNTDOWN]
        pause_loops(memory)
        if autopilot.rows[w, i].can_hover == 0:
            # The attitude loop of an aeroplane goes on
            memory[first + COUNTDOWN] = countdown
    elif is_due:
        wind, pilot = vec3(autopilot.wind, w, i), autopilot.rows[w, i]
        period = max(PERIOD, dt)
        run_outer_loops(level, target, state, wind, period, gravity, memory, row, pilot, gain)
    return bool(is_due)


@func
def fly_winged(
    autopilot: Autopilot | None,
    level: int,
    target: Quat4Like,
    state: State,
    memory: np.ndarray,
    w: int,
    i: int,
    dt: float,
    gravity: float,
    row: np.record,
    gain: GainRow,
    command: np.ndarray,
) -> bool:
    """Compute the commands of one aircraft with wings, and advance the state of its autopilot.

    Args:
        autopilot: The autopilot; None in a swarm without wings, and this function is removed then.
        level: `SetpointLevel` of the setpoint, above ROTOR.
        target: The setpoint's four numbers.
        state: State of the aircraft.
        memory: (M,) state of the controllers; the autopilot's comes last.
        w: Index of the world.
        i: Index of the drone.
        dt: Time since the last call, s.
        gravity: Gravitational acceleration, m/s^2.
        row: Row of the nominal `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R + S,) speed of each rotor, rad/s, and deflection of each control surface, rad,
            which are written.

    Returns:
        False for a multirotor, which another controller flies.
    """
    if autopilot is None:
        return False
    if not has_autopilot(autopilot, w, i):
        return False
    pilot, held = autopilot.rows[w, i], memory.shape[0] - AUTOPILOT_MEMORY + HELD
    is_due = advance_loops(autopilot, level, target, state, memory, w, i, dt, gravity, row, gain)
    if is_due or pilot.can_hover:
        wind = vec3(autopilot.wind, w, i)
        stabilise_one(level, target, state, wind, gravity, memory, row, pilot, gain, command)
    if pilot.can_hover == 0:
        for k in range(row.num_rotors + pilot.num_surfaces):
            if is_due:
                memory[held + k] = command[k]
            else:
                command[k] = memory[held + k]
    return True


@deferred(types.none)
@kernel
def stabilise_one(
    level: int,
    target: Quat4Like,
    state: State,
    wind: Vec3,
    gravity: float,
    memory: np.ndarray,
    row: np.record,
    pilot: AutopilotRow,
    gain: GainRow,
    command: np.ndarray,
) -> None:
    """Run `stabilise` for one aircraft; see `fly_winged` for the arguments."""
    # In the same order as in `steering._stabilise_lanes`
    first = memory.shape[0] - AUTOPILOT_MEMORY
    loops = (
        memory[first + BANK],
        memory[first + PITCH],
        memory[first + TURN_RATE],
        memory[first + LIFT],
        memory[first + FORWARD_SPEED],
        memory[first + WING_BORNE],
    )
    goal = attitude_goal(level, target)
    stabilise(level, goal, loops, state, wind, gravity, row, pilot, gain, command)


@func
def attitude_goal(level: int, target: Quat4Like) -> SixNumbers:
    """Return a setpoint as `stabilise` takes it; sines are computed only here.

    Args:
        level: `SetpointLevel` of the setpoint.
        target: The setpoint's four numbers.

    Returns:
        For an attitude, the tangent of the bank to the left, sine of the pitch up, yaw (rad),
        thrust (N), and the horizontal direction of the yaw; else the setpoint and zeros.
    """
    if level == SetpointLevel.ATTITUDE:
        # A left bank is a negative roll, a raised nose a negative pitch
        bank, pitch = -tan(_clip(target[0], -MAX_ROLL, MAX_ROLL)), -sin(target[1])
        ahead = nose(target[2])
        return bank, pitch, target[2], target[3], ahead[0], ahead[1]
    return target[0], target[1], target[2], target[3], 0.0, 0.0


@func
def _body_velocity(state: State, wind: Vec3Like) -> Vec3:
    """Return the velocity relative to the air in body axes, m/s."""
    ahead, left, top = axes(state[1])
    air = minus(state[2], wind)
    return dot(ahead, air), dot(left, air), dot(top, air)


@func
def stabilise(
    level: int,
    goal: SixNumbers,
    loops: SixNumbers,
    state: State,
    wind: Vec3,
    gravity: float,
    row: np.record,
    pilot: AutopilotRow,
    gain: GainRow,
    command: np.ndarray,
) -> None:
    """Run the attitude loop, and allocate its torque to rotors and control surfaces.

    Args:
        level: `SetpointLevel` of the setpoint, above ROTOR.
        goal: Result of `attitude_goal`.
        loops: Results of the outer loops: tangent of the bank, sine of the pitch, turn rate
            (rad/s), thrust of the lift rotors (N), speed of the forward rotors (rad/s), and 1 for a
            VTOL that flies on its wings. Unused but for the last one for attitudes and rates.
        state: State of the aircraft.
        wind: Velocity of the air, m/s, world.
        gravity: Gravitational acceleration, m/s^2.
        row: Row of the nominal `PARAMETERS`.
        pilot: Row of `AUTOPILOT`.
        gain: Row of `GAINS`.
        command: (R + S,) speed of each rotor, rad/s, and deflection of each control surface, rad,
            which are written.
    """
    _, quaternion, _, rates = state
    ahead, left, top = axes(quaternion)
    body = _body_velocity(state, wind)
    slow = max(math.sqrt(dot(body, body)), 0.5 * pilot.stall_speed)
    up = (ahead[2], left[2], top[2])
    bank, pitch, turn, lift, pushing, borne = loops
    if level > SetpointLevel.ACCELERATION:
        if pilot.can_hover:
            lift, pushing = goal[3], 0.0
        else:
            lift, pushing = 0.0, forward_rotor_speed(goal[3], max(body[0], 0.0), row, pilot)
    # An aeroplane, whose can_hover is 0, always flies on its wings
    is_borne = borne > pilot.can_hover - 1.0
    frequency = (
        where(is_borne, pilot.attitude_frequency[0], gain.attitude_frequency[0]),
        where(is_borne, pilot.attitude_frequency[1], gain.attitude_frequency[1]),
        where(is_borne, pilot.attitude_frequency[2], gain.attitude_frequency[2]),
    )

    load = 1.0
    wanted = (goal[0], goal[1], goal[2])
    if level != SetpointLevel.RATES:
        if level == SetpointLevel.ATTITUDE:
            bank, pitch = goal[0], goal[1]
            size = _length(ahead[0], ahead[1])
            turn = TURN_GAIN * (ahead[0] * goal[5] - ahead[1] * goal[4]) / size
        # Coordinated turn: g tan(bank) / V, and the nose into the flow
        level_part = max(up[2], 0.3)
        coordinated = _clip(-gravity * up[1] / (slow * level_part), -2.0, 2.0)
        turn = where(is_borne, coordinated, turn)
        load = where(is_borne, math.sqrt(1.0 + bank * bank), 1.0)
        wanted = attitude_rates(up, bank, pitch, turn, frequency, gain.damping)
        if is_any(is_borne):
            protected = protect_from_stall(
                wanted, body, up[2], slow, gravity, frequency, gain.damping, pilot
            )
            wanted = (
                where(is_borne, protected[0], wanted[0]),
                where(is_borne, protected[1], wanted[1]),
                where(is_borne, protected[2], wanted[2]),
            )
    torque = rates_to_torque(wanted, rates, pushing, frequency, row, pilot, gain)
    # Surfaces take over from lift rotors as their effect grows
    share = where(is_borne, 1.0, surface_share(body[0], pilot))
    has_lift = lift > 0.0
    if is_any(has_lift):
        rotor_share = 1.0 - share
        turned = (rotor_share * torque[0], rotor_share * torque[1], rotor_share * torque[2])
        mix(lift, turned, row, gain, command)
        for r in range(row.num_rotors):
            command[r] = where(has_lift, command[r], 0.0)
    else:
        for r in range(row.num_rotors):
            command[r] = 0.0
    for r in range(row.num_rotors):
        if pilot.forward[r] > 0.0:
            command[r] = pushing
    # Aerodynamic damping at the wanted rates is compensated
    damped = (
        torque[0] + pilot.rate_damping[0] * slow * wanted[0],
        torque[1] + pilot.rate_damping[1] * slow * wanted[1],
        torque[2] + pilot.rate_damping[2] * slow * wanted[2],
    )
    allocate_surfaces(damped, load, slow, share, row.num_rotors, pilot, command)


@func
def surface_share(ahead: float, pilot: AutopilotRow) -> float:
    """Return the fraction of the torque that surfaces provide on lift rotors, at an airspeed."""
    return wing_share(ahead, transition_speed(pilot))


@func
def rates_to_torque(
    wanted: Vec3,
    rates: Vec3,
    pushing: float,
    frequency: Vec3,
    row: np.record,
    pilot: AutopilotRow,
    gain: GainRow,
) -> Vec3:
    """Step from body rates to a torque, as `lee.torque_setpoint`.

    The torque compensates the reaction of the forward rotors.

    Args:
        wanted: Desired body rates, rad/s.
        rates: Body rates, rad/s.
        pushing: Speed of the forward rotors, rad/s.
        frequency: Frequencies of the attitude loop about x, y, z, rad/s.
        row: Row of the nominal `PARAMETERS`.
        pilot: Row of `AUTOPILOT`.
        gain: Row of `GAINS`.

    Returns:
        Torque, N m, body axes.
    """
    twice = 2.0 * gain.damping
    momentum = (row.inertia[0] * rates[0], row.inertia[1] * rates[1], row.inertia[2] * rates[2])
    carried = cross(rates, momentum)
    turns = 0.0
    for r in range(row.num_rotors):
        turns += pilot.forward[r] * row.rotor_turn[r]
    reaction = turns * row.torque_coefficient * (pushing * pushing)
    return (
        carried[0] + twice * frequency[0] * row.inertia[0] * (wanted[0] - rates[0]) - reaction,
        carried[1] + twice * frequency[1] * row.inertia[1] * (wanted[1] - rates[1]),
        carried[2] + twice * frequency[2] * row.inertia[2] * (wanted[2] - rates[2]),
    )


@func
def protect_from_stall(
    rates: Vec3,
    body: Vec3,
    up: float,
    airspeed: float,
    gravity: float,
    frequency: Vec3,
    damping: float,
    pilot: AutopilotRow,
) -> Vec3:
    """Limit the pitch rate so that the angle of attack stays below that of the stall.

    Args:
        rates: Desired body rates, rad/s.
        body: Velocity relative to the air, body axes, m/s.
        up: Vertical part of the body's z axis.
        airspeed: Airspeed, m/s.
        gravity: Gravitational acceleration, m/s^2.
        frequency: Frequencies of the attitude loop about x, y, z, rad/s.
        damping: Damping ratio of the attitude loop.
        pilot: Row of `AUTOPILOT`.

    Returns:
        Body rates, rad/s, with a yaw rate that turns the nose into the flow.
    """
    angle = _clip(-body[2] / max(body[0], 0.5 * airspeed), -1.0, 1.0)
    # The path turns by g (n - cos) / V, and the pitch may turn faster while the angle is small
    per_angle = airspeed * airspeed / pilot.alpha[1]
    load = (angle - pilot.alpha[0]) * per_angle
    # At a small angle the path may bend down: the angle grows, but no further than the largest one
    least = min((pilot.max_alpha - pilot.alpha[0]) * per_angle, up)
    rate = 0.5 * frequency[1] / damping
    fastest = rate * (pilot.max_alpha - angle) + gravity / airspeed * (max(load, least) - up)
    slip = 0.5 * frequency[2] / damping * body[1] / airspeed
    # Nose up is a negative rate about y
    return rates[0], max(rates[1], -fastest), rates[2] + slip
