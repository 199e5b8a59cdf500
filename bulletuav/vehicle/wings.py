"""Forces of wings on one aircraft: lift, drag and moment of panels, and its propellers in the air.

A `Wing` has two panels, at the Gauss-Legendre points of its span. Strip theory is exact there for
moments that are linear or quadratic in the position, such as roll damping. A panel's lift is linear
in the angle of attack below the stall, and that of an inclined flat plate above it; a cubic blends
them. The flow along the span is neglected (independence principle).

Sines and cosines of the angle of attack are ratios of velocities, so no angle is computed. Most
products and sums are fused: fewer operations, and fewer roundings.

References:
    W. Khan, M. Nahon, Real-time modeling of agile fixed-wing UAV aerodynamics, ICUAS 2015: the
    forces beyond the stall (after Lindenburg), and the shift of the zero-lift angle by flaps.
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012: the blend of both laws.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from bulletuav.compiled.functions import atan2, cos, exp, fma, sin
from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import is_any, where
from bulletuav.compiled.plain import record_type
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, axes, cross, minus, plus
from bulletuav.vehicle.airframe import DENSITY, MAX_ROTORS, MAX_WINGS, Airframe, Wing
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.wrench import Surroundings

MAX_PANELS = 2 * MAX_WINGS
"""Maximum number of panels of an airframe: two for each wing."""
MAX_SURFACES = MAX_WINGS
"""Maximum number of control surfaces of an airframe."""
PANEL_POINT = 0.5 / math.sqrt(3.0)
"""Distance of a panel from the middle of its wing, as a fraction of the span (Gauss-Legendre)."""
FLAT_PLATE_DRAG = 1.98
"""Normal force coefficient of a long flat plate at right angles to the flow (Hoerner 1965)."""
FLAP_EFFICIENCY = 0.7
"""Viscous efficiency of control surfaces; in Khan and Nahon it falls from 0.8 at 10 degrees to 0.4
at 60, and is 0.7 at 23 degrees."""
STALL_SHIFT = 0.5
"""Fraction of a flap's shift of the zero-lift angle by which it shifts the stall angle (our choice:
a flap raises the maximum lift by half of what it adds at small angles)"""
STALL_WIDTH = math.radians(10.0)
"""Range of the angle of attack in which the flow separates, rad (our choice)."""
_SLOWEST = 1e-12
"""Added to squared speeds, so that a panel at rest has an angle of attack, m^2/s^2."""

WINGS = record_type(
    [
        ("num_panels", "i8"),
        ("num_surfaces", "i8"),
        ("panel_surface", "i8", MAX_PANELS),
        ("forward", "f8", MAX_ROTORS),
        ("rotor_z", "f8", MAX_ROTORS),
        ("thrust_slope", "f8"),
        ("jet_area", "f8"),
        ("chord_axis", "f8", (MAX_PANELS, 3)),
        ("normal", "f8", (MAX_PANELS, 3)),
        ("down_axis", "f8", (MAX_PANELS, 3)),
        ("chord_arm", "f8", (MAX_PANELS, 3)),
        ("normal_arm", "f8", (MAX_PANELS, 3)),
        ("moment_axis", "f8", (MAX_PANELS, 3)),
        ("half_density_area", "f8", MAX_PANELS),
        ("lift_slope", "f8", MAX_PANELS),
        ("zero_lift", "f8", MAX_PANELS),
        ("stall", "f8", MAX_PANELS),
        ("induced", "f8", MAX_PANELS),
        ("drag", "f8", MAX_PANELS),
        ("moment", "f8", MAX_PANELS),
        ("plate", "f8", MAX_PANELS),
        ("slipstream", "f8", MAX_PANELS),
        ("flap_lift", "f8", MAX_PANELS),
        ("flap_moment", "f8", MAX_PANELS),
        ("surface_low", "f8", MAX_SURFACES),
        ("surface_high", "f8", MAX_SURFACES),
        ("surface_rate", "f8", MAX_SURFACES),
    ]
)
"""Type of the rows; `WingRow` documents the fields."""


class WingRow(Protocol):
    """One row of `WINGS` as compiled functions see it, SI units, body axes FLU.

    Attributes:
        num_panels: Number of panels P; 0 for a multirotor. Arrays are padded with zeros.
        num_surfaces: Number of control surfaces.
        panel_surface: (MAX_PANELS,) index of the control surface on each panel, 0 for none.
        forward: (MAX_ROTORS,) 1 for a rotor with thrust along +x, 0 for one along +z.
        rotor_z: (MAX_ROTORS,) position of each rotor along z, m.
        thrust_slope: Fall of the thrust of forward rotors with airspeed, k_z / k_f, rad/m.
        jet_area: Disc area of all forward rotors, m^2; 0 without any.
        chord_axis: (MAX_PANELS, 3) unit vector along the chord, towards the leading edge.
        normal: (MAX_PANELS, 3) unit vector across the panel.
        down_axis: (MAX_PANELS, 3) velocity against the normal per velocity of the aircraft, in air
            that a wing ahead turns down.
        chord_arm: (MAX_PANELS, 3) moment of a unit force along the chord, m.
        normal_arm: (MAX_PANELS, 3) moment of a unit force along the normal, m.
        moment_axis: (MAX_PANELS, 3) moment of a unit pitching moment coefficient per force, m.
        half_density_area: (MAX_PANELS,) density / 2 times area, kg/m.
        lift_slope: (MAX_PANELS,) lift coefficient per angle of attack below the stall, 1/rad.
        zero_lift: (MAX_PANELS,) angle of attack without lift, rad.
        stall: (MAX_PANELS,) angle from the zero-lift angle at which the stall begins, rad.
        induced: (MAX_PANELS,) induced drag coefficient per squared lift coefficient.
        drag: (MAX_PANELS,) drag coefficient without lift.
        moment: (MAX_PANELS,) pitching moment coefficient about the quarter chord.
        plate: (MAX_PANELS,) reduction of the flat plate's normal force by the aspect ratio.
        slipstream: (MAX_PANELS,) fraction of the panel in the slipstream of the forward rotors.
        flap_lift: (MAX_PANELS,) change of the angle of attack per deflection.
        flap_moment: (MAX_PANELS,) change of the moment coefficient per deflection, 1/rad.
        surface_low: (MAX_SURFACES,) lowest deflection, rad.
        surface_high: (MAX_SURFACES,) highest deflection, rad.
        surface_rate: (MAX_SURFACES,) rate of the servo, rad/s.
    """

    num_panels: int
    num_surfaces: int
    panel_surface: np.ndarray
    forward: np.ndarray
    rotor_z: np.ndarray
    thrust_slope: float
    jet_area: float
    chord_axis: np.ndarray
    normal: np.ndarray
    down_axis: np.ndarray
    chord_arm: np.ndarray
    normal_arm: np.ndarray
    moment_axis: np.ndarray
    half_density_area: np.ndarray
    lift_slope: np.ndarray
    zero_lift: np.ndarray
    stall: np.ndarray
    induced: np.ndarray
    drag: np.ndarray
    moment: np.ndarray
    plate: np.ndarray
    slipstream: np.ndarray
    flap_lift: np.ndarray
    flap_moment: np.ndarray
    surface_low: np.ndarray
    surface_high: np.ndarray
    surface_rate: np.ndarray


def wing_rows(airframes: Sequence[Airframe]) -> np.ndarray | None:
    """Make the rows of wing constants that compiled functions read.

    Args:
        airframes: Airframe of each of N drones.

    Returns:
        (N,) rows of `WINGS`, or None if no airframe has wings: compiled functions without wings are
        then used.
    """
    if not any(airframe.wings for airframe in airframes):
        return None
    rows = np.zeros(len(airframes), dtype=WINGS)
    for row, airframe in zip(rows, airframes, strict=True):
        forward = list(airframe.forward_rotors)
        row["forward"][forward] = 1.0
        row["rotor_z"][: len(airframe.rotor_heights)] = airframe.rotor_heights
        row["thrust_slope"] = airframe.drag_z / airframe.thrust_coefficient
        row["jet_area"] = len(forward) * math.pi * airframe.propeller_radius**2
        row["num_panels"] = 2 * len(airframe.wings)
        angle = _zero_downwash(airframe.wings)
        for k, wing in enumerate(airframe.wings):
            for p, side in ((2 * k, -1.0), (2 * k + 1, 1.0)):
                _write_panel(row, p, side, wing, angle)
            if wing.surface is not None:
                number = row["num_surfaces"]
                row["panel_surface"][2 * k : 2 * k + 2] = number
                row["surface_low"][number] = wing.surface.low
                row["surface_high"][number] = wing.surface.high
                row["surface_rate"][number] = wing.surface.rate
                row["num_surfaces"] += 1
    return rows


class WingTable(NamedTuple):
    """Wings of W worlds of N drones.

    Attributes:
        rows: (A,) rows of `WINGS`, one for each kind of airframe.
        kind: (W, N) index of the row of each drone.
    """

    rows: np.ndarray
    kind: np.ndarray

    @classmethod
    def of(cls, airframes: Sequence[Airframe], num_worlds: int) -> "WingTable | None":
        """Make the table of the airframe of each of N drones; None if none has wings."""
        kinds = list({id(one): one for one in airframes}.values())
        rows = wing_rows(kinds)
        if rows is None:
            return None
        numbers = [next(k for k, kind in enumerate(kinds) if kind is one) for one in airframes]
        return cls(rows, np.tile(np.array(numbers), (num_worlds, 1)))


def _zero_downwash(wings: Sequence[Wing]) -> float:
    """Return the angle of attack of the largest wing, from its zero-lift angle, of a body at 0."""
    ahead = [wing for wing in wings if wing.downwash == 0.0]
    main = max(ahead, key=lambda wing: wing.span * wing.chord, default=None)
    return 0.0 if main is None else main.incidence - main.zero_lift


def _write_panel(row: np.record, p: int, side: float, wing: Wing, zero_downwash: float) -> None:
    """Write the constants of a panel, on the negative or positive side of its wing."""
    span: Vec3 = (0.0, cos(wing.dihedral), sin(wing.dihedral))
    up: Vec3 = (0.0, -span[2], span[1])
    # The incidence turns the leading edge up
    ahead: Vec3 = (cos(wing.incidence), 0.0, 0.0)
    chord_axis = plus(ahead, sin(wing.incidence), up)
    normal = plus((-sin(wing.incidence), 0.0, 0.0), cos(wing.incidence), up)
    point = plus(wing.position, side * PANEL_POINT * wing.span, span)
    row["chord_axis"][p] = chord_axis
    row["normal"][p] = normal
    row["chord_arm"][p] = cross(point, chord_axis)
    row["normal_arm"][p] = cross(point, normal)
    # A positive moment turns the leading edge up, which is negative about +y of a level wing
    row["moment_axis"][p] = [-wing.chord * one for one in cross(normal, chord_axis)]
    row["half_density_area"][p] = 0.25 * DENSITY * wing.span * wing.chord
    row["lift_slope"][p] = wing.lift_slope
    row["zero_lift"][p] = wing.zero_lift
    row["stall"][p] = wing.stall
    row["induced"][p] = 1.0 / (math.pi * wing.efficiency * wing.aspect_ratio)
    row["drag"][p] = wing.drag
    row["moment"][p] = wing.moment
    row["plate"][p] = 0.41 * (1.0 - exp(-17.0 / wing.aspect_ratio))
    # A wing ahead turns the flow down by a part of its angle of attack, zero_downwash - v_z / v_x.
    # The downwash is vertical, and so not felt by fins
    washed = wing.downwash * normal[2]
    row["down_axis"][p] = -normal[0] - washed * zero_downwash, -normal[1], washed - normal[2]
    row["slipstream"][p] = wing.slipstream
    if wing.surface is not None:
        lift, moment = flap_derivatives(wing.surface.chord_fraction)
        row["flap_lift"][p] = FLAP_EFFICIENCY * lift
        row["flap_moment"][p] = FLAP_EFFICIENCY * moment


def flap_derivatives(fraction: float) -> tuple[float, float]:
    """Compute the effect of a plain flap by thin airfoil theory.

    Args:
        fraction: Chord of the flap divided by that of the wing, from 0 to 1.

    Returns:
        Change of the angle of attack per deflection, and change of the moment coefficient about the
        quarter chord per deflection, 1/rad. A positive deflection moves the trailing edge down.

    References:
        H. Glauert, Theoretical relationships for an aerofoil with hinged flap, ARC R&M 1095 (1927).
    """
    # Cosine and sine of the hinge's angle on the circle over the chord
    cosine = 2.0 * fraction - 1.0
    sine = math.sqrt(1.0 - cosine * cosine)
    lift = 1.0 - (float(atan2(sine, cosine)) - sine) / math.pi
    return lift, -0.5 * sine * (1.0 - cosine)


@func
def deflection_after(deflection: float, command: float, k: int, dt: float, wing: WingRow) -> float:
    """Return the deflection of control surface k after a step, limited in rate and range, rad."""
    reach = wing.surface_rate[k] * dt
    moved = min(max(command, deflection - reach), deflection + reach)
    limited: float = min(max(moved, wing.surface_low[k]), wing.surface_high[k])
    return limited


@func
def _add_scaled(a: Vec3Like, scale: float, b: Vec3Like) -> Vec3:
    """Return a + scale b, by fused multiply-adds."""
    return fma(scale, b[0], a[0]), fma(scale, b[1], a[1]), fma(scale, b[2], a[2])


@func
def _add_dot(start: float, a: Vec3Like, b: Vec3Like) -> float:
    """Return start + a . b, by fused multiply-adds."""
    total: float = fma(a[0], b[0], fma(a[1], b[1], fma(a[2], b[2], start)))
    return total


@func
def _add_cross(start: Vec3Like, a: Vec3Like, b: Vec3Like) -> Vec3:
    """Return start + a x b, by fused multiply-adds."""
    return (
        fma(a[1], b[2], fma(-a[2], b[1], start[0])),
        fma(a[2], b[0], fma(-a[0], b[2], start[1])),
        fma(a[0], b[1], fma(-a[1], b[0], start[2])),
    )


@func
def attached_flow(
    sine: float, cosine: float, shift: float, moment: float, p: int, wing: WingRow
) -> tuple[float, float, float, float]:
    """Compute the lift, drag and moment coefficients of panel p in attached flow.

    Args:
        sine: Sine of the angle of attack.
        cosine: Cosine of the angle of attack; negative if the air comes from behind.
        shift: Change of the angle of attack by the control surface, rad.
        moment: Change of the moment coefficient by the control surface.
        p: Index of the panel.
        wing: Row of `WINGS`.

    Returns:
        The coefficients, of which the moment is about the quarter chord and positive if it raises
        the leading edge; and the angle beyond the start of the stall, rad, which is 1 if the air
        comes from behind. Above 0, the flow is separated, see `separated_flow`.
    """
    # The series of the arcsine is exact to 4e-4 rad up to 20 degrees
    angle = fma(sine, fma(sine * sine, 1.0 / 6.0, 1.0), -wing.zero_lift[p])
    lift = wing.lift_slope[p] * (angle + shift)
    drag = fma(wing.induced[p] * lift, lift, wing.drag[p])
    beyond = abs(fma(STALL_SHIFT, shift, angle)) - wing.stall[p]
    return lift, drag, wing.moment[p] + moment, where(cosine > 0.0, beyond, 1.0)


@func
def separated_flow(
    attached: tuple[float, float, float, float], sine: float, cosine: float, p: int, wing: WingRow
) -> tuple[float, float, float, float]:
    """Blend the coefficients of panel p from attached flow to separated flow.

    Separated flow is that of an inclined flat plate, with friction along the chord.

    Args:
        attached: Result of `attached_flow`.
        sine: Sine of the angle of attack.
        cosine: Cosine of the angle of attack.
        p: Index of the panel.
        wing: Row of `WINGS`.

    Returns:
        The coefficients, and the angle beyond the stall; unchanged where the flow is attached.
    """
    lift, drag, pitch, beyond = attached
    size = abs(sine)
    across = FLAT_PLATE_DRAG * sine * (1.0 / (0.56 + 0.44 * size) - wing.plate[p])
    along = 0.5 * wing.drag[p] * cosine
    plate_lift = across * cosine - along * sine
    plate_drag = across * sine + along * cosine
    # The centre of pressure moves from 0.325 to 0.675 of the chord, as the air turns from ahead to
    # behind. Khan and Nahon have 2 / pi times the angle in place of the sine
    turn = where(cosine > 0.0, 0.175, -0.175)
    plate_pitch = across * (turn * (1.0 - size) - 0.25)
    # Smooth step
    step = min(max(beyond * (1.0 / STALL_WIDTH), 0.0), 1.0)
    apart = step * step * (3.0 - 2.0 * step)
    is_apart = beyond > 0.0
    return (
        where(is_apart, lift + apart * (plate_lift - lift), lift),
        where(is_apart, drag + apart * (plate_drag - drag), drag),
        where(is_apart, pitch + apart * (plate_pitch - pitch), pitch),
        beyond,
    )


@func
def _air_at_panel(ahead: float, down: float) -> tuple[float, float, float]:
    """Return the squared airspeed of a panel, and sine and cosine of its angle of attack.

    Args:
        ahead: Velocity of the panel through the air along its chord, m/s.
        down: Velocity of the panel through the air against its normal, m/s.
    """
    square = fma(ahead, ahead, fma(down, down, _SLOWEST))
    slow = 1.0 / math.sqrt(square)
    return square, down * slow, ahead * slow


@func
def _panel_forces(
    air: tuple[float, float, float],
    coefficients: tuple[float, float, float, float],
    p: int,
    wing: WingRow,
) -> tuple[float, float, float]:
    """Return the forces on panel p along its chord and its normal, N, and its pitching moment.

    The moment is about the quarter chord per length of the chord, N. Arguments are the results of
    `_air_at_panel` and `attached_flow`.
    """
    square, sine, cosine = air
    lift, drag, pitch, _ = coefficients
    pressure = wing.half_density_area[p] * square
    # Lift is across the flow, drag along it
    forward = pressure * fma(lift, sine, -drag * cosine)
    upward = pressure * fma(lift, cosine, drag * sine)
    return forward, upward, pressure * pitch


@func
def add_wing(
    wrench: tuple[Vec3, Vec3],
    velocity: Vec3,
    rates: Vec3,
    thrust: float,
    deflection: np.ndarray,
    k: int,
    wing: WingRow,
) -> tuple[Vec3, Vec3]:
    """Add the force and moment of wing k: of its panels 2 k and 2 k + 1.

    Args:
        wrench: Force (N) and moment about the centre of mass (N m), body axes.
        velocity: Velocity of the centre of mass relative to the air, body axes, m/s.
        rates: Angular velocity, body axes, rad/s.
        thrust: Thrust of the forward rotors, N.
        deflection: (S,) deflections of the control surfaces, rad; at least one number.
        k: Index of the wing.
        wing: Row of `WINGS`.

    Returns:
        The sum of force and moment.
    """
    # Both panels have the same constants but for their arms
    p, q = 2 * k, 2 * k + 1
    jet = 0.0
    if wing.slipstream[p] > 0.0:
        # The fraction of the area in the jet has the mean dynamic pressure of all its parts
        jet = slipstream_velocity(wing.slipstream[p] * thrust, velocity[0], wing.jet_area)
    chord = (wing.chord_axis[p, 0], wing.chord_axis[p, 1], wing.chord_axis[p, 2])
    normal = (wing.normal[p, 0], wing.normal[p, 1], wing.normal[p, 2])
    descent = (wing.down_axis[p, 0], wing.down_axis[p, 1], wing.down_axis[p, 2])
    chord_arm = (wing.chord_arm[p, 0], wing.chord_arm[p, 1], wing.chord_arm[p, 2])
    normal_arm = (wing.normal_arm[p, 0], wing.normal_arm[p, 1], wing.normal_arm[p, 2])
    other_chord_arm = (wing.chord_arm[q, 0], wing.chord_arm[q, 1], wing.chord_arm[q, 2])
    other_normal_arm = (wing.normal_arm[q, 0], wing.normal_arm[q, 1], wing.normal_arm[q, 2])
    # Velocity through the air, along the chord and against the normal:
    # (w x r) . n = w . (r x n)
    ahead, down = _add_dot(jet, chord, velocity), _add_dot(0.0, descent, velocity)
    turned = deflection[wing.panel_surface[p]]
    shift, moment = wing.flap_lift[p] * turned, wing.flap_moment[p] * turned
    against = (-rates[0], -rates[1], -rates[2])
    air = _air_at_panel(_add_dot(ahead, chord_arm, rates), _add_dot(down, normal_arm, against))
    other_air = _air_at_panel(
        _add_dot(ahead, other_chord_arm, rates), _add_dot(down, other_normal_arm, against)
    )
    flow = attached_flow(air[1], air[2], shift, moment, p, wing)
    other_flow = attached_flow(other_air[1], other_air[2], shift, moment, q, wing)
    # In most flights, the flow is attached in all lanes. Without a branch between them, processors
    # compute both panels at the same time
    if is_any(max(flow[3], other_flow[3]) > 0.0):
        flow = separated_flow(flow, air[1], air[2], p, wing)
        other_flow = separated_flow(other_flow, other_air[1], other_air[2], q, wing)
    forward, upward, raised = _panel_forces(air, flow, p, wing)
    other_forward, other_upward, other_raised = _panel_forces(other_air, other_flow, q, wing)
    axis = (wing.moment_axis[p, 0], wing.moment_axis[p, 1], wing.moment_axis[p, 2])
    force, torque = wrench
    force = _add_scaled(force, forward + other_forward, chord)
    force = _add_scaled(force, upward + other_upward, normal)
    torque = _add_scaled(torque, raised + other_raised, axis)
    torque = _add_scaled(torque, forward, chord_arm)
    torque = _add_scaled(torque, upward, normal_arm)
    torque = _add_scaled(torque, other_forward, other_chord_arm)
    return force, _add_scaled(torque, other_upward, other_normal_arm)


@func
def propeller_wrench(
    velocity: Vec3, rates: Vec3, speed: np.ndarray, row: ParameterRow, wing: WingRow
) -> tuple[Vec3, Vec3, float]:
    """Compute the force and torque of rotors along the x and z axes, in air that moves past them.

    The thrust k_f w^2 - k_z w V falls linearly with the advance ratio: V is the velocity along the
    axis. For rotors along z, k_z is the drag of a rotor along its axis; for forward rotors, it is
    k_f times `thrust_slope`, which no effect switches off. Across the axis, the drag is k_xy w V.

    Args:
        velocity: Velocity of the centre of mass relative to the air, body axes, m/s.
        rates: Angular velocity, body axes, rad/s.
        speed: (R,) rotor speeds, rad/s.
        row: Constants of the drone.
        wing: Row of `WINGS`.

    Returns:
        Force (N) and torque about the centre of mass (N m), body axes, and the thrust of the
        forward rotors (N).
    """
    force: Vec3 = (0.0, 0.0, 0.0)
    torque: Vec3 = (0.0, 0.0, 0.0)
    # Sums of turn w and turn w^2 of the rotors along x and z, and the thrust along +x
    spin_x, spin_z, square_x, square_z, pushing = 0.0, 0.0, 0.0, 0.0, 0.0
    slope = row.thrust_coefficient * wing.thrust_slope
    for r in range(row.num_rotors):
        now = speed[r]
        turned = row.rotor_turn[r] * now
        point = (row.rotor_x[r], row.rotor_y[r], wing.rotor_z[r])
        v = _add_cross(velocity, rates, point)
        thrust = row.thrust_coefficient * (now * now)
        across = -row.drag_xy * now
        if wing.forward[r] > 0.0:
            pushed = (fma(-slope * now, v[0], thrust), across * v[1], across * v[2])
            pushing += pushed[0]
            spin_x += turned
            square_x = fma(turned, now, square_x)
        else:
            pushed = (across * v[0], across * v[1], fma(-row.drag_z * now, v[2], thrust))
            spin_z += turned
            square_z = fma(turned, now, square_z)
        force = plus(force, 1.0, pushed)
        torque = _add_cross(torque, point, pushed)
    # Gyroscopic torque of the angular momentum of the rotors, which spin opposite to the torque
    # that they exert on the body
    along_x, along_z = -row.rotor_inertia * spin_x, -row.rotor_inertia * spin_z
    turning = (
        fma(row.torque_coefficient, square_x, torque[0]),
        torque[1],
        fma(row.torque_coefficient, square_z, torque[2]),
    )
    return force, _add_cross(turning, (along_x, 0.0, along_z), rates), pushing


@func
def add_winding(
    around: Surroundings,
    begin: np.ndarray,
    end: np.ndarray,
    dt: float,
    row: ParameterRow,
    wing: WingRow,
) -> Surroundings:
    """Add the torque J dw/dt of accelerating rotors to the external torque of a substep.

    Args:
        around: External influences on the drone.
        begin: (R,) rotor speeds at the begin of the substep, rad/s.
        end: (R,) rotor speeds at its end, rad/s.
        dt: Duration of the substep, s.
        row: Constants of the drone.
        wing: Row of `WINGS`.

    Returns:
        The influences, with the mean torque of the substep.
    """
    if wing.num_panels == 0:  # `rotor_wrench` has this torque
        return around
    wind, surface, gravity, push, twist = around
    x, z = 0.0, 0.0
    for r in range(row.num_rotors):
        wound = row.rotor_inertia * row.rotor_turn[r] * (end[r] - begin[r]) * (1.0 / dt)
        if wing.forward[r] > 0.0:
            x += wound
        else:
            z += wound
    return wind, surface, gravity, push, (twist[0] + x, twist[1], twist[2] + z)


@func
def slipstream_velocity(thrust: float, airspeed: float, area: float) -> float:
    """Return the velocity that rotors add to the air far behind them, by momentum theory, m/s.

    Args:
        thrust: Their thrust T, N; negative thrust adds none.
        airspeed: Velocity V along their axis, m/s; negative is treated as 0.
        area: Area A of their discs, m^2; 0 for no rotors.

    Returns:
        sqrt(V^2 + 2 T / (density A)) - V.
    """
    ahead = max(airspeed, 0.0)
    # All drones of a block have the same area
    per_thrust = 2.0 / DENSITY / area if area > 0.0 else 0.0
    return math.sqrt(fma(ahead, ahead, per_thrust * max(thrust, 0.0))) - ahead


@func
def winged_wrench(
    quaternion: Quat4Like,
    velocity: Vec3Like,
    rates: Vec3,
    speed: np.ndarray,
    deflection: np.ndarray,
    around: Surroundings,
    row: ParameterRow,
    wing: WingRow,
) -> tuple[Vec3, Vec3]:
    """Compute force and torque on one aircraft with wings; it has no ground effect.

    Args:
        quaternion: Attitude, body to world.
        velocity: Velocity, world axes, m/s.
        rates: Angular velocity, body axes, rad/s.
        speed: (R,) rotor speeds, rad/s.
        deflection: (S,) deflections of the control surfaces, rad; at least one number.
        around: External influences on the drone.
        row: Constants of the drone.
        wing: Row of `WINGS`.

    Returns:
        The force, world axes, N, and the torque, body axes, N m. The torque contains damping and
        the gyroscopic torque of the rotors, but not that of the body.
    """
    wind, _, gravity, push, twist = around
    ahead, left, up = axes(quaternion)
    air = minus(velocity, wind)
    v = (_add_dot(0.0, ahead, air), _add_dot(0.0, left, air), _add_dot(0.0, up, air))
    force, torque, thrust = propeller_wrench(v, rates, speed, row, wing)
    for k in range(wing.num_panels // 2):
        force, torque = add_wing((force, torque), v, rates, thrust, deflection, k, wing)
    # Drag of the fuselage
    size = math.sqrt(_add_dot(0.0, v, v))
    flat, steep = -size * row.body_drag_xy, -size * row.body_drag_z
    body = (fma(flat, v[0], force[0]), fma(flat, v[1], force[1]), fma(steep, v[2], force[2]))
    x = _add_dot(push[0], body, (ahead[0], left[0], up[0]))
    y = _add_dot(push[1], body, (ahead[1], left[1], up[1]))
    z = _add_dot(push[2], body, (ahead[2], left[2], up[2]))
    return (x, y, fma(-row.mass, gravity, z)), plus(torque, 1.0, twist)
