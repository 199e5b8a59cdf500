"""Textbook formulas of aeroplanes: drag polar, stability derivatives and modes.

They are written from R. Nelson, Flight Stability and Automatic Control (1998), chapters 2 to 4, and
B. Etkin and L. Reid, Dynamics of Flight (1996), chapters 2, 4 and 6, and use nothing of
`vehicle.wings`. They hold in a glide with stopped rotors, at small angles.
"""

import math
from types import SimpleNamespace

import numpy as np

G, DENSITY = 9.80665, 1.225


def wings_of(airframe):
    """The main wing, which comes as two halves, and the tailplane."""
    return airframe.wings[0], next(one for one in airframe.wings if one.name == "tailplane")


def reference(airframe):
    """Area S, span b, chord c, and the areas of the tailplane and all fins."""
    wing, tail = wings_of(airframe)
    fins = sum(one.span * one.chord for one in airframe.wings if one.dihedral > 1.0)
    return SimpleNamespace(
        area=2 * wing.span * wing.chord,
        span=2 * wing.span,
        chord=wing.chord,
        tail_area=tail.span * tail.chord,
        fin_area=fins,
    )


def lift_slope(airframe):
    """Lift slope of wing, tailplane behind its downwash, and fuselage, by the wing's area."""
    wing, tail = wings_of(airframe)
    at = reference(airframe)
    behind = tail.lift_slope * (1 - tail.downwash) * at.tail_area / at.area
    return wing.lift_slope + behind + airframe.body_drag[1] / at.area


def drag_polar(airframe, lift):
    """Drag coefficient: parasite drag of all parts, and the induced drag of the wing."""
    wing, tail = wings_of(airframe)
    at = reference(airframe)
    parasite = (
        wing.drag + (tail.drag * (at.tail_area + at.fin_area) + airframe.body_drag[0]) / at.area
    )
    return parasite + lift**2 / (math.pi * wing.efficiency * wing.aspect_ratio)


def level_lift(airframe, airspeed, load=1.0):
    """Lift coefficient at which lift is a multiple of the weight."""
    pressure = 0.5 * DENSITY * airspeed**2
    return load * airframe.mass * G / (pressure * reference(airframe).area)


def derivatives(airframe, airspeed):
    """Dimensional longitudinal derivatives, stability axes, z down (Nelson, chapter 3)."""
    wing, tail = wings_of(airframe)
    at = reference(airframe)
    lift = level_lift(airframe, airspeed)
    slope = lift_slope(airframe)
    drag = drag_polar(airframe, lift)
    drag_slope = 2 * lift * slope / (math.pi * wing.efficiency * wing.aspect_ratio)
    # Arms from the centre of mass to the quarter chords, positive behind it
    arm, ahead, above = -tail.position[0], wing.position[0], wing.position[2]
    volume = at.tail_area * arm / (at.area * at.chord)
    # The wing's lift leans forward as the angle of attack grows, above the centre of mass
    lean = lift - 2 * lift * wing.lift_slope / (math.pi * wing.efficiency * wing.aspect_ratio)
    pitch = (
        wing.lift_slope * ahead / at.chord
        - volume * tail.lift_slope * (1 - tail.downwash)
        - above / at.chord * lean
    )
    pitch_rate = -2 * volume * tail.lift_slope * arm / at.chord
    pitch_rate -= 2 * wing.lift_slope * (ahead / at.chord) ** 2
    lift_rate = 2 * volume * tail.lift_slope - 2 * wing.lift_slope * ahead / at.chord
    force = 0.5 * DENSITY * airspeed**2 * at.area / airframe.mass
    moment = 0.5 * DENSITY * airspeed**2 * at.area * at.chord / airframe.inertia[1]
    half = at.chord / (2 * airspeed)
    return SimpleNamespace(
        x_u=-2 * drag * force / airspeed,
        x_w=(lift - drag_slope) * force / airspeed,
        z_u=-2 * lift * force / airspeed,
        z_w=-(slope + drag) * force / airspeed,
        z_q=-lift_rate * half * force,
        m_w=pitch * moment / airspeed,
        m_q=pitch_rate * half * moment,
        static_margin=-pitch / slope,
    )


def longitudinal_matrix(airframe, airspeed, climb):
    """Matrix of the linear model of u, w, q and theta (Nelson, equation 4.51)."""
    d = derivatives(airframe, airspeed)
    return np.array(
        [
            (d.x_u, d.x_w, 0.0, -G * math.cos(climb)),
            (d.z_u, d.z_w, airspeed + d.z_q, -G * math.sin(climb)),
            (0.0, d.m_w, d.m_q, 0.0),
            (0.0, 0.0, 1.0, 0.0),
        ]
    )


def modes(matrix):
    """Natural frequency (rad/s) and damping ratio of the slow and the fast oscillation."""
    values = sorted(np.linalg.eigvals(matrix), key=abs)
    return [(abs(one), -one.real / abs(one)) for one in (values[0], values[-1])]


def short_period(airframe, airspeed):
    """Frequency (rad/s) and damping ratio by Nelson's approximation (chapter 4)."""
    d = derivatives(airframe, airspeed)
    frequency = math.sqrt(d.z_w * d.m_q - airspeed * d.m_w)
    return frequency, -(d.z_w + d.m_q) / (2 * frequency)


def roll_damping(airframe, airspeed):
    """Rate of decay of a roll rate, 1/s, by strip theory: Clp = -(a + C_D) / 6 of each wing."""
    pressure = 0.5 * DENSITY * airspeed**2
    halves = [one for one in airframe.wings if "wing" in one.name]
    wing, tail = wings_of(airframe)
    total = 0.0
    for slope, drag, span, chord in (
        (wing.lift_slope, wing.drag, 2 * halves[0].span, wing.chord),
        (tail.lift_slope, tail.drag, tail.span, tail.chord),
    ):
        total += pressure * span * chord * span * (slope + drag) / 6 * span / (2 * airspeed)
    return total / airframe.inertia[0]
