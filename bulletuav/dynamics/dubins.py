"""Kinematic motion of aircraft that cannot hover: the Dubins airplane.

The aircraft moves along its heading at an airspeed V, and climbs at a rate c. Its limits are those
of its `Envelope`:

- V from min_speed to max_speed;
- heading rate |psi'| <= g tan(max_bank) / V, the rate of a coordinated turn;
- c from -max_sink to max_climb, and at most P(V), the steady climb at full throttle;
- a common budget of energy for climb and acceleration, -max_sink <= c + V V' / g <= P(V), of which
  the climb takes what it needs. In `single_integrator` the acceleration is not limited.

Within these limits V, psi and c follow their commands as the velocity of a multirotor does: without
lag in `single_integrator`, with v' = (v_cmd - v) / tau in `point_mass` and `double_integrator`.
Commands are velocities over ground. In `point_mass` the wind carries the aircraft, whose limits
apply to its motion through the air, and the commanded airspeed is the commanded velocity minus the
wind; at the limits of airspeed, the course over ground is kept. Where wind does not act, airspeed
and ground speed are the same.

A commanded horizontal speed below min_speed commands a loiter: a turn to the left at min_speed and
half of the largest rate. A position setpoint commands a flight through the point, and then a loiter
around it, to the left, with the radius of such a turn at cruise speed; see
`bulletuav.control.waypoint`.

The nose points along the motion through the air, at the bank angle of a coordinated turn,
atan(V psi' / g). The yaw of setpoints has no effect, and body rates stay zero.

References:
    H. Chitsaz, S. LaValle, Time-optimal paths for a Dubins airplane, CDC 2007.
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012: first-order models of autopilots
    (chapter 9), the vector field of an orbit (section 10.2).
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, exp, sin
from bulletuav.compiled.kernel import func
from bulletuav.control.autopilot import AUTOPILOT_MEMORY, WAYPOINT_PHASE
from bulletuav.control.gains import NUM_CLIMBS, GainRow
from bulletuav.control.lee import nose
from bulletuav.control.setpoint import SetpointLevel, is_flying_speed
from bulletuav.control.waypoint import EXTENDING, HOMING, LOITERING, orbit_course, update_phase
from bulletuav.geometry.rotation import Quat4, Quat4Like, Vec3, from_euler, heading, plus

POINT_MASS, SINGLE_INTEGRATOR, DOUBLE_INTEGRATOR = range(3)
"""Kinds of kinematic dynamics, for compiled code."""
LOITER_FRACTION = 0.5
"""Turn rate of a loiter as a fraction of the largest one."""
_SMALLEST = 1e-9
"""Smallest number that is divided by: a range of airspeeds, m/s, or a length, m."""


@func
def loiter_radius(speed: float, gain: GainRow, gravity: float) -> float:
    """Return the radius of a loiter at a speed, V^2 / (f g tan(max_bank)), m."""
    return speed * speed / (LOITER_FRACTION * gravity * gain.max_bank)


@func
def excess_climb(speed: float, gain: GainRow) -> float:
    """Return the steady climb at full throttle P, interpolated between those stored, m/s.

    Args:
        speed: Airspeed, m/s, from min_speed to max_speed.
        gain: Row of `GAINS`.
    """
    place = (NUM_CLIMBS - 1) * (speed - gain.min_speed)
    place /= max(gain.max_speed - gain.min_speed, _SMALLEST)
    k = min(int(place), NUM_CLIMBS - 2)
    first: float = gain.excess_climb[k]
    rise: float = gain.excess_climb[k + 1] - first
    return first + (place - k) * rise


@func
def waypoint_velocity(
    phase: int, position: Vec3, velocity: Vec3, target: Vec3, gain: GainRow, gravity: float
) -> Vec3:
    """Return the velocity towards a target position, or around it, m/s.

    A loiter follows `orbit_course`. The height approaches that of the target as in
    `velocity_setpoint`.

    Args:
        phase: Phase of the flight, see `update_phase`.
        position: Position of the aircraft, m.
        velocity: Velocity of the aircraft, m/s.
        target: Target position, m.
        gain: Row of `GAINS`.
        gravity: Gravitational acceleration, m/s^2.
    """
    x, y = target[0] - position[0], target[1] - position[1]
    if phase == EXTENDING:
        x, y = velocity[0], velocity[1]
    elif phase == LOITERING:
        x, y = orbit_course(x, y, loiter_radius(gain.cruise_speed, gain, gravity))
    # A centre that has just been reached has no direction
    scale = gain.cruise_speed / max(math.sqrt(x * x + y * y), _SMALLEST)
    rate = gain.position_frequency / (2.0 * gain.damping)
    return scale * x, scale * y, rate * (target[2] - position[2])


@func
def _keep_course(target: Vec3, wanted: Vec3, wind: Vec3, gain: GainRow) -> Vec3:
    """Return a possible velocity through the air that keeps the commanded course over ground.

    Args:
        target: Commanded velocity over ground, m/s; not zero.
        wanted: Its velocity through the air, m/s, returned if its horizontal speed is possible.
        wind: Velocity of the air, m/s.
        gain: Row of `GAINS`.
    """
    speed = math.sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1])
    possible = min(max(speed, gain.min_speed), gain.max_speed)
    if possible == speed:
        return wanted
    # Wind triangle: the motion through the air balances the crosswind
    ground_speed = math.sqrt(target[0] * target[0] + target[1] * target[1])
    x, y = target[0] / ground_speed, target[1] / ground_speed
    across = x * wind[1] - y * wind[0]
    along = math.sqrt(max(possible * possible - across * across, 0.0))
    return along * x + across * y, along * y - across * x, wanted[2]


@func
def fly_forward(
    kind: int,
    level: int,
    setpoint: Quat4Like,
    state: tuple[Vec3, Quat4, Vec3],
    wind: Vec3,
    pull: Vec3,
    lag: float,
    gain: GainRow,
    gravity: float,
    dt: float,
    memory: np.ndarray,
) -> tuple[Vec3, Vec3, Quat4]:
    """Integrate the motion of an aircraft that cannot hover over dt.

    Positions are on the circle of a constant turn. External forces change the velocity before its
    limits apply, except in `single_integrator`.

    Args:
        kind: POINT_MASS, SINGLE_INTEGRATOR or DOUBLE_INTEGRATOR.
        level: `SetpointLevel` of the setpoint, up to ACCELERATION.
        setpoint: The setpoint's four numbers.
        state: Position, m, attitude, whose yaw is the heading of an aircraft at rest, and velocity,
            m/s.
        wind: Velocity of the air, m/s; acts in `point_mass` only.
        pull: Acceleration by external forces, m/s^2.
        lag: Time constant of the velocity, s.
        gain: Row of `GAINS`.
        gravity: Gravitational acceleration, m/s^2.
        dt: Duration, s.
        memory: (M,) state of the controllers; the phase of the flight to a position is updated.

    Returns:
        Velocity after dt, m/s, displacement, m, and attitude.
    """
    position, quaternion, velocity = state
    air = wind if kind == POINT_MASS else (0.0, 0.0, 0.0)
    before = plus(velocity, -1.0, air)
    if kind != SINGLE_INTEGRATOR:
        before = plus(before, dt, pull)
    speed = math.sqrt(before[0] * before[0] + before[1] * before[1])
    if speed > 0.0:
        ahead = (before[0] / speed, before[1] / speed, 0.0)
    else:
        ahead = nose(heading(quaternion))
    speed = min(max(speed, gain.min_speed), gain.max_speed)
    most_turn = gravity * gain.max_bank / speed * dt

    phase_index = memory.shape[0] - AUTOPILOT_MEMORY + WAYPOINT_PHASE
    if level != SetpointLevel.POSITION:
        memory[phase_index] = HOMING

    # Commanded changes of speed, heading and climb
    if level == SetpointLevel.ACCELERATION:
        faster = dt * (ahead[0] * setpoint[0] + ahead[1] * setpoint[1])
        turn = dt * (ahead[0] * setpoint[1] - ahead[1] * setpoint[0]) / speed
        steeper = dt * setpoint[2]
    else:
        target = (setpoint[0], setpoint[1], setpoint[2])
        if level == SetpointLevel.POSITION:
            most = gravity * gain.max_bank
            phase = update_phase(position, velocity, target, speed, most, dt, memory, phase_index)
            target = waypoint_velocity(phase, position, velocity, target, gain, gravity)
        wanted = plus(target, -1.0, air)
        share = 1.0
        if kind == POINT_MASS:
            share = 1.0 - exp(-dt / lag)
        elif kind == DOUBLE_INTEGRATOR:
            share = min(dt / lag, 1.0)
        if not is_flying_speed(target[0], target[1], gain.min_speed):
            faster, turn = gain.min_speed - speed, LOITER_FRACTION * most_turn
        else:
            if kind == POINT_MASS:
                wanted = _keep_course(target, wanted, air, gain)
            aside = ahead[0] * wanted[1] - ahead[1] * wanted[0]
            along = ahead[0] * wanted[0] + ahead[1] * wanted[1]
            faster = math.sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1]) - speed
            turn = share * atan2(aside, along)
        faster *= share
        steeper = share * (wanted[2] - before[2])

    # Limits; without a limit of acceleration, the climb is that at the new speed
    now = speed + faster if kind == SINGLE_INTEGRATOR else speed
    power = excess_climb(min(max(now, gain.min_speed), gain.max_speed), gain)
    climb = min(max(before[2] + steeper, -gain.max_sink), min(power, gain.max_climb))
    if kind != SINGLE_INTEGRATOR:
        thrust = gravity / speed * dt
        faster = min(max(faster, -thrust * (gain.max_sink + climb)), thrust * (power - climb))
    turn = min(max(turn, -most_turn), most_turn)
    # The top speed includes the climb
    fastest = math.sqrt(max(gain.max_speed * gain.max_speed - climb * climb, 0.0))
    speed = max(min(speed + faster, fastest), gain.min_speed)
    c, s = cos(turn), sin(turn)
    ahead = (c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1], 0.0)
    after = (speed * ahead[0], speed * ahead[1], climb)

    moved = (dt * after[0], dt * after[1], dt * after[2])
    if kind != SINGLE_INTEGRATOR:
        moved = plus((0.5 * moved[0], 0.5 * moved[1], 0.5 * moved[2]), 0.5 * dt, before)
        moved = plus(moved, dt, air)
    bank = atan2(speed * turn, gravity * dt)
    attitude = from_euler(-bank, -atan2(climb, speed), atan2(ahead[1], ahead[0]))
    return plus(after, 1.0, air), moved, attitude
