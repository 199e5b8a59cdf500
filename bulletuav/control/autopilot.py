"""Constants and memory of the autopilot of aircraft with wings, as rows for the compiled loops.

All constants are computed from the airframe: its limits of steady flight, its trim at two speeds,
and the torque of its control surfaces. `bulletuav.control.fixed_wing` documents the controller.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from bulletuav.compiled.functions import tan
from bulletuav.compiled.plain import record_type
from bulletuav.control.gains import FASTEST_ATTITUDE, exact_pseudo_inverse
from bulletuav.vehicle.airframe import MAX_ROTORS, STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.envelope import find_envelope, find_trim
from bulletuav.vehicle.wing_power import STALL_MARGIN, trim_thrust
from bulletuav.vehicle.wings import MAX_SURFACES, wing_rows

AUTOPILOT_MEMORY = 33
"""Size of the autopilot's state, which follows that of the observers of multirotors in memory; the
names below number its entries"""
THRUST_INTEGRAL = 0
PITCH_INTEGRAL = 1
LAST_AIRSPEED = 2
BANK = 3
PITCH = 4
FORWARD_SPEED = 5
COUNTDOWN = 6
LIFT = 7
TURN_RATE = 8
WING_BORNE = 9
PUSH = 10
CLIMB = 13
HELD = 14
WAYPOINT_PHASE = 30

LOITER_BANK = 0.5
"""Turn rate of a loiter relative to the largest turn rate"""
L1_DAMPING = 0.75
"""Damping ratio of the L1 guidance: default of NAVL1_DAMPING of ArduPilot"""
COURSE_RATIO = 3.0
"""Frequency of the roll loop relative to the rate at which course errors decay"""

AUTOPILOT = record_type(
    [
        ("is_winged", "i8"),
        ("can_hover", "i8"),
        ("num_surfaces", "i8"),
        ("num_forward", "i8"),
        ("thrust_slope", "f8"),
        ("forward", "f8", MAX_ROTORS),
        ("stall_speed", "f8"),
        ("min_speed", "f8"),
        ("cruise_speed", "f8"),
        ("max_speed", "f8"),
        ("max_bank", "f8"),
        ("max_climb", "f8"),
        ("max_sink", "f8"),
        ("alpha", "f8", 2),
        ("max_alpha", "f8"),
        ("drag", "f8", 2),
        ("course_rate", "f8"),
        ("loiter_radius", "f8"),
        ("attitude_frequency", "f8", 3),
        ("rate_damping", "f8", 3),
        ("trim", "f8", (MAX_SURFACES, 2)),
        ("mixer", "f8", (MAX_SURFACES, 3)),
        ("surface_low", "f8", MAX_SURFACES),
        ("surface_high", "f8", MAX_SURFACES),
    ]
)
"""NumPy type of the rows; `AutopilotRow` documents the fields"""


class AutopilotRow(Protocol):
    """One row of `AUTOPILOT`, as typed for compiled functions; SI units, body axes FLU.

    Quantities of level flight at airspeed V with load factor n are a pair (a, b) of
    a + b n / V^2, through the values at the minimum speed and the cruise speed. The lift is linear
    in the angle of attack below the stall, which makes this exact but for drag.

    Attributes:
        is_winged: 1 for an aircraft that flies on wings with forward rotors; 0 for a multirotor,
            and all other fields are 0 then.
        can_hover: 1 for a VTOL that hovers on its lift rotors.
        num_surfaces: Number of control surfaces.
        num_forward: Number of forward rotors.
        thrust_slope: Fall of their thrust with airspeed, k_z / k_f, rad/m.
        forward: (MAX_ROTORS,) 1 for a forward rotor, else 0.
        stall_speed: Stall speed in level flight, m/s.
        min_speed: Minimum commanded airspeed, m/s.
        cruise_speed: Airspeed towards positions, m/s.
        max_speed: Maximum commanded airspeed, m/s.
        max_bank: Tangent of the largest bank.
        max_climb: Maximum climb rate, m/s.
        max_sink: Maximum sink rate, m/s.
        alpha: Angle of attack, rad.
        max_alpha: Largest commanded angle of attack, rad.
        drag: Drag a V^2 + b n^2 / V^2, N: parasitic and induced.
        course_rate: Rate at which a small course error decays, 1/s.
        loiter_radius: Radius of the circle around a target position, m.
        attitude_frequency: (3,) frequencies of the attitude loop about x, y, z, rad/s.
        rate_damping: (3,) damping torque per angular velocity and airspeed, N s^2.
        trim: (MAX_SURFACES, 2) deflection, rad.
        mixer: (MAX_SURFACES, 3) deflection times V^2 per torque about x, y, z.
        surface_low: (MAX_SURFACES,) lowest deflection, rad.
        surface_high: (MAX_SURFACES,) highest deflection, rad.
    """

    is_winged: int
    can_hover: int
    num_surfaces: int
    num_forward: int
    thrust_slope: float
    forward: np.ndarray
    stall_speed: float
    min_speed: float
    cruise_speed: float
    max_speed: float
    max_bank: float
    max_climb: float
    max_sink: float
    alpha: np.ndarray
    max_alpha: float
    drag: np.ndarray
    course_rate: float
    loiter_radius: float
    attitude_frequency: np.ndarray
    rate_damping: np.ndarray
    trim: np.ndarray
    mixer: np.ndarray
    surface_low: np.ndarray
    surface_high: np.ndarray


class Autopilot(NamedTuple):
    """The autopilot of W worlds of N drones, of which some have wings.

    Attributes:
        rows: (W, N) rows of `AUTOPILOT`.
        wind: (W, N, 3) velocity of the air at each drone, m/s, world: the airspeed sensors of an
            autopilot, a Pitot tube with vanes, measure without error.
    """

    rows: np.ndarray
    wind: np.ndarray


def autopilot_rows(airframes: Sequence[Airframe], max_speed: float) -> np.ndarray | None:
    """Compute the constants of the autopilot of drones.

    Args:
        airframes: Airframe of each of N drones.
        max_speed: Highest speed towards a target position, m/s.

    Returns:
        (N,) rows of `AUTOPILOT`, or None if no airframe flies on wings.
    """
    wings = wing_rows(airframes)
    if wings is None:
        return None
    rows = np.zeros(len(airframes), dtype=AUTOPILOT)
    for row, wing, airframe in zip(rows, wings, airframes, strict=True):
        if airframe.wings and airframe.forward_rotors:
            _write_row(row, wing, airframe, max_speed)
    return rows if rows["is_winged"].any() else None


def _write_row(row: np.record, wing: np.record, airframe: Airframe, max_speed: float) -> None:
    """Write the constants of one aircraft with wings and forward rotors."""
    envelope = find_envelope(airframe)
    num_surfaces = int(wing["num_surfaces"])
    row["is_winged"] = 1
    row["can_hover"] = airframe.can_hover
    row["num_surfaces"] = num_surfaces
    row["num_forward"] = len(airframe.forward_rotors)
    row["thrust_slope"] = airframe.drag_z / airframe.thrust_coefficient
    row["forward"] = wing["forward"]
    for name in ("stall_speed", "min_speed", "max_speed", "max_climb", "max_sink"):
        row[name] = getattr(envelope, name)
    row["cruise_speed"] = max(min(envelope.cruise_speed, max_speed), envelope.min_speed)
    row["max_bank"] = tan(envelope.max_bank)
    row["surface_low"] = wing["surface_low"]
    row["surface_high"] = wing["surface_high"]

    # Trims at two speeds, and the lines through them
    slow = envelope.min_speed
    fast = min(max(envelope.cruise_speed, 1.2 * slow), envelope.max_speed)
    one, other = find_trim(airframe, slow), find_trim(airframe, fast)
    row["alpha"] = _line(slow, one.alpha, fast, other.alpha)
    limit = STALL_MARGIN * envelope.stall_speed
    row["max_alpha"] = row["alpha"][0] + row["alpha"][1] / limit**2
    thrusts = [trim_thrust(airframe, trim) for trim in (one, other)]
    # D / V^2 = a + b / V^4
    parasitic, induced = _line(slow**2, thrusts[0] / slow**2, fast**2, thrusts[1] / fast**2)
    row["drag"] = parasitic, induced

    torque = _surface_torque(row, wing)
    _write_loops(row, wing, torque, airframe)
    # The part of the trim about the pitch axis: the autopilot compensates the propellers' torque
    for k in range(num_surfaces):
        share = row["mixer"][k, 1] * torque[1]
        deflections = (sum(share * trim.deflection) for trim in (one, other))
        row["trim"][k] = _line(slow, next(deflections), fast, next(deflections))
    row["course_rate"] = row["attitude_frequency"][0] / COURSE_RATIO
    turn = LOITER_BANK * row["max_bank"] * STANDARD_GRAVITY
    row["loiter_radius"] = row["cruise_speed"] ** 2 / turn


def _line(slow: float, one: float, fast: float, other: float) -> tuple[float, float]:
    """Return a and b of a + b / V^2 with given values at two speeds."""
    slope = (one - other) / (1 / slow**2 - 1 / fast**2)
    return one - slope / slow**2, slope


def _surface_torque(row: np.record, wing: np.record) -> np.ndarray:
    """Return the torque of each control surface, (3, S), and write the damping of the rates.

    They are derivatives of `wings.add_wing` for small angles: the torque per deflection and
    V^2, and per angular velocity and V.
    """
    torque = np.zeros((3, int(row["num_surfaces"])))
    for p in range(int(wing["num_panels"])):
        area, arm = wing["half_density_area"][p], wing["normal_arm"][p]
        lift = area * wing["lift_slope"][p] * arm
        row["rate_damping"] += lift * arm
        # Panels without a surface have the first, and neither lift nor moment of it
        moment = area * wing["flap_moment"][p] * wing["moment_axis"][p]
        torque[:, wing["panel_surface"][p]] += wing["flap_lift"][p] * lift + moment
    return torque


def _write_loops(row: np.record, wing: np.record, torque: np.ndarray, airframe: Airframe) -> None:
    """Write the frequencies of the attitude loops, and the allocation to the control surfaces."""
    num_surfaces = int(row["num_surfaces"])
    inertia = np.array(airframe.inertia)
    reach = np.minimum(-wing["surface_low"], wing["surface_high"])[:num_surfaces]
    # Angular acceleration at the lowest speed, and the time that servos take for half of the range
    strongest = (np.abs(torque) * reach).sum(axis=1) * row["min_speed"] ** 2 / inertia
    time = (0.5 * reach / wing["surface_rate"][:num_surfaces]).max()
    fastest = min(FASTEST_ATTITUDE, 0.5 / time)
    row["attitude_frequency"] = [min(fastest, math.sqrt(one)) for one in strongest]
    # A damped pseudo-inverse A^T (A A^T + 1)^-1: axes with an authority far below 1 rad/s^2 have no
    # part in it
    square = row["cruise_speed"] ** 2
    scaled = np.concatenate([torque * (square / inertia[:, None]), np.eye(3)], axis=1)
    row["mixer"][:num_surfaces] = exact_pseudo_inverse(scaled)[:num_surfaces] * (square / inertia)
