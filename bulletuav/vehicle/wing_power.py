"""Power of aircraft with wings whose rotors are not simulated, from the drag polar.

The drag at the airspeed V with the lift L is D = a V^2 + b (L / V)^2. Both constants follow from
the steady level flights of the airframe at its minimum and its maximum speed, so the drag contains
that of the slipstream and the trimmed elevator. The force along the path is thrust minus drag, the
force across it is lift: climbs, turns and accelerations cost what they cost in flight. The speed of
the forward rotors follows from their thrust k_f w^2 - k_z w V, and their power is k_m w^3, as in
`wings.propeller_wrench`; the propulsive efficiency D V / (k_m w^3) is not a constant.

Lift rotors of an aircraft that can hover carry what the wings do not, by `power.propulsion_power`.
The autopilot has the nose level below half of the transition speed, and pitches up from there to
the angle of attack at which the wings carry the aircraft at the transition speed.

References:
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012, chapter 4: drag polar.
    J. D. Anderson, Aircraft Performance and Design, McGraw-Hill 1999, chapter 5: power required.
"""

import math
from typing import NamedTuple

from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import where
from bulletuav.compiled.plain import record_type
from bulletuav.geometry.rotation import Vec3Like
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.envelope import Trim, find_envelope, find_trim
from bulletuav.vehicle.power import RotaryWing, propulsion_power

STALL_MARGIN = 1.1
"""Minimum airspeed relative to the stall speed at the load factor of a turn, and transition speed
of an aircraft that can hover (our choice)."""
FIRST_LIFT = 0.5
"""Airspeed relative to the transition speed from which wings and surfaces take over from lift
rotors (our choice)."""
_STILL = 1e-6
"""Squared airspeed below which the wings carry nothing, m^2/s^2."""


class WingPower(NamedTuple):
    """Constants of the power of one aircraft with wings.

    Attributes:
        num_rotors: Number of forward rotors; 0 for a multirotor, which may have fins.
        parasite: Drag without lift per squared airspeed a, kg/m.
        induced: Induced drag b of a lift of 1 N at 1 m/s, m^2/(N s^2).
        max_lift: Maximum lift per squared airspeed, kg/m; of an aircraft that can hover, the lift
            that carries it at the transition speed.
        flat_lift: Lift with the nose level per squared airspeed, kg/m.
        transition_speed: Airspeed from which wings alone carry an aircraft that can hover, m/s.
        thrust_coefficient: Thrust of a rotor per squared speed k_f, N s^2.
        drag: Loss of thrust per rotor speed and airspeed k_z, N s^2/m.
        torque_coefficient: Torque of a rotor per squared speed k_m, N m s^2.
        max_rotor_speed: Maximum rotor speed, rad/s.
        efficiency: Power at the shafts divided by electrical power.
        electronics: Electrical power of everything except the motors, W.
        hovers: 1 for an aircraft that can hover, else 0.
    """

    num_rotors: float
    parasite: float
    induced: float
    max_lift: float
    flat_lift: float
    transition_speed: float
    thrust_coefficient: float
    drag: float
    torque_coefficient: float
    max_rotor_speed: float
    efficiency: float
    electronics: float
    hovers: float


WING_POWER = record_type([(name, "f8") for name in WingPower._fields])
"""Type of rows of `WingPower`."""
NO_WINGS = WingPower(*(0.0 for _ in WingPower._fields))
"""Row of a multirotor."""


def wing_power(airframe: Airframe) -> WingPower:
    """Compute the constants of an airframe at sea level.

    Args:
        airframe: The airframe.

    Returns:
        The constants; `NO_WINGS` for an airframe without forward rotors.

    Raises:
        ValueError: If the airframe has forward rotors and cannot fly level.
    """
    if not airframe.forward_rotors:
        return NO_WINGS
    limits = find_envelope(airframe)
    weight = airframe.mass * STANDARD_GRAVITY
    slow, fast = limits.min_speed, limits.max_speed
    # D = a V^2 + b (W / V)^2 at both speeds, where the thrust of level flight is the drag
    trims = [find_trim(airframe, v) for v in (slow, fast)]
    at_slow, at_fast = (trim_thrust(airframe, trim) for trim in trims)
    squares, lift = (slow * slow, fast * fast), weight * weight
    slowest = limits.stall_speed * (STALL_MARGIN if airframe.can_hover else 1.0)
    # Angle of attack: alpha = alpha_0 + s / V^2 at both speeds, and the lift is W V^2 (alpha -
    # alpha_0) / s
    alpha = [trim.alpha for trim in trims]
    slope = (alpha[0] - alpha[1]) / (1.0 / squares[0] - 1.0 / squares[1])
    zero_lift = alpha[1] - slope / squares[1]
    induced = (at_slow * squares[1] - at_fast * squares[0]) / (
        lift * (squares[1] / squares[0] - squares[0] / squares[1])
    )
    parasite = (at_fast - induced * lift / squares[1]) / squares[1]
    return WingPower(
        num_rotors=len(airframe.forward_rotors),
        parasite=float(parasite),
        induced=float(induced),
        max_lift=weight / (slowest * slowest),
        flat_lift=max(-zero_lift / slope * weight, 0.0),
        transition_speed=STALL_MARGIN * limits.stall_speed,
        thrust_coefficient=airframe.thrust_coefficient,
        drag=airframe.drag_z,
        torque_coefficient=airframe.thrust_coefficient * airframe.torque_ratio,
        max_rotor_speed=airframe.max_rotor_speed,
        efficiency=airframe.efficiency,
        electronics=airframe.electronics,
        hovers=float(airframe.can_hover),
    )


def trim_thrust(airframe: Airframe, trim: Trim) -> float:
    """Return the thrust of the forward rotors in a steady flight, k_f w^2 - k_z V w each, N."""
    used = [trim.speed[k] for k in airframe.forward_rotors]
    factor = airframe.thrust_coefficient
    return sum(factor * one * one - airframe.drag_z * one * trim.airspeed for one in used)


@func
def propeller_speed(thrust: float, loss: float, factor: float) -> float:
    """Return the speed w of a forward rotor at a thrust k_f w^2 - k_z w V, rad/s.

    Args:
        thrust: Thrust, N; the rotor stands still if it is not above 0.
        loss: Loss of thrust per speed k_z V, N s.
        factor: Thrust per squared speed k_f, N s^2; 1 for thrust and loss divided by it.
    """
    squared = loss * loss + 4.0 * factor * max(thrust, 0.0)
    speed: float = where(thrust > 0.0, (loss + math.sqrt(squared)) / (2.0 * factor), 0.0)
    return speed


@func
def forward_power(thrust: float, airspeed: float, wing: WingPower) -> float:
    """Return the power at the shafts of the forward rotors, W.

    Args:
        thrust: Thrust of all, N; they stand still if it is not above 0, and none exceeds that of
            the maximum rotor speed.
        airspeed: Velocity along their axes, at least 0, m/s.
        wing: Constants of the aircraft.
    """
    each, loss = thrust / wing.num_rotors, wing.drag * airspeed
    speed = min(propeller_speed(each, loss, wing.thrust_coefficient), wing.max_rotor_speed)
    return wing.num_rotors * wing.torque_coefficient * (speed * speed * speed)


@func
def wing_share(ahead: float, transition_speed: float) -> float:
    """Return how far wings and surfaces have taken over from lift rotors, from 0 to 1.

    Args:
        ahead: Airspeed along the nose, m/s.
        transition_speed: Airspeed from which they have, m/s.
    """
    share = (ahead / transition_speed - FIRST_LIFT) / (1.0 - FIRST_LIFT)
    return min(max(share, 0.0), 1.0)


@func
def winged_power(velocity: Vec3Like, force: Vec3Like, wing: WingPower, rotary: RotaryWing) -> float:
    """Return the electrical power of an aircraft with wings, W.

    Args:
        velocity: (3,) velocity through the air, world axes, m/s.
        force: (3,) force of air and rotors, world axes, N: mass times the sum of acceleration and
            the upwards gravity.
        wing: Constants of the aircraft.
        rotary: Constants of its lift rotors; unused if it cannot hover.
    """
    level = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    whole = level + velocity[2] * velocity[2]
    # A vertical climb is flight on lift rotors, if there are any
    square = level if wing.hovers > 0.0 else whole
    total = force[0] * force[0] + force[1] * force[1] + force[2] * force[2]
    forward, carried = 0.0, 0.0
    if square > _STILL:
        speed = math.sqrt(whole)
        work = force[0] * velocity[0] + force[1] * velocity[1] + force[2] * velocity[2]
        along = work / speed
        needed = math.sqrt(max(total - along * along, 0.0))
        most = wing.max_lift
        if wing.hovers > 0.0:
            share = wing_share(math.sqrt(square), wing.transition_speed)
            most = wing.flat_lift + share * (most - wing.flat_lift)
        lift = min(needed, most * square)
        carried = lift / needed if needed > 0.0 else 1.0
        drag = wing.parasite * square + wing.induced * (lift * lift / square)
        # Lift rotors do their part of the work along the path
        pushed = along if wing.hovers == 0.0 else carried * along
        forward = forward_power(drag + pushed, speed, wing)
    power = forward / wing.efficiency
    if wing.hovers > 0.0:
        load = (1.0 - carried) * math.sqrt(total) / rotary.weight
        # Simulated rotors have no translational lift
        return power + propulsion_power((0.0, 0.0, velocity[2]), rotary, load)
    return power + wing.electronics
