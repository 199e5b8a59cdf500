"""Default constants of airframes without measurements, scaled from those of the Crazyflie.

Rotors of the same shape and disc loading are similar: lengths scale with the propeller's radius,
except the radius of the wake, which scales with the length of the arms. Ratios do not change.
"""

import math
from typing import NamedTuple

from bulletuav.vehicle.airframe import arm_length

GROUND_EFFECT_GAIN = 0.27
"""Relative increase of a rotor's thrust at a surface (fit, see docs/explanation/truth.md)."""
GROUND_EFFECT_REACH = 6.2
"""Height in propeller radii above which there is no ground effect (fit: 0.143 m, Crazyflie)."""
WAKE_SHARE = 0.32
"""Force of the wake on a drone just below, as a fraction of the thrust (fit, see
docs/explanation/truth.md)."""
WAKE_SPREAD = 0.1
"""Growth of the wake's width per distance below (fit)."""
WAKE_RADIUS = 1.0
"""Width of the wake at the rotors, in arms of the drone (fit)."""
AXIAL_DAMPING = 7.2
"""Loss of a rotor's thrust as it climbs, in k_f w / R (fit: damping of 3 1/s for the Crazyflie).

Blade-element theory without inflow, a s / (4 C_T), would give 12.
"""
BODY_DRAG = (0.075, 0.52)
"""Drag areas along and across the rotor plane, in areas of all rotor discs.

Our estimate, from the outlines of a Crazyflie: 5 and 35 cm^2.
"""
EFFICIENCY = 0.6
"""Power at the shafts divided by electrical power (our estimate)."""


class Scaled(NamedTuple):
    """Scaled constants.

    Attributes:
        ground_effect: Height above which there is none, m; and gain, see `GROUND_EFFECT_GAIN`.
        wake: Radius at the rotors, m; fraction of the thrust, see `WAKE_SHARE`; and growth of the
            width per distance below.
        damping: Damping of rotation about x, y and z, 1/s.
        body_drag: Drag areas along and across the rotor plane, m^2.
        power: Efficiency, and power of the electronics, W.
    """

    ground_effect: tuple[float, float]
    wake: tuple[float, float, float]
    damping: tuple[float, float, float]
    body_drag: tuple[float, float]
    power: tuple[float, float]


def without_rotor_effects(scaled: Scaled, propeller_radius: float) -> Scaled:
    """Return the scaled constants of an airframe with wings.

    Its panels and the rotors' drag along their axes damp its rotation, so there is no further
    damping. Ground effect and wake are models of a multirotor, and are off.

    Args:
        scaled: Constants of a multirotor with the same rotors.
        propeller_radius: R, m.
    """
    return scaled._replace(
        ground_effect=(scaled.ground_effect[0], 0.0),
        wake=(propeller_radius, 0.0, WAKE_SPREAD),
        damping=(0.0, 0.0, 0.0),
    )


def scaled_constants(
    inertia: tuple[float, float, float],
    rotors: tuple[tuple[float, float, int], ...],
    thrust_coefficient: float,
    drag_xy: float,
    propeller_radius: float,
    hover_speed: float,
) -> Scaled:
    """Scale the Crazyflie's constants to another airframe.

    A rotor that moves along its axis gains or loses thrust, which damps roll and pitch. Yaw is
    damped by the rotors' drag only, so the scaling gives less yaw damping than was measured on a
    Crazyflie.

    Args:
        inertia: Principal moments of inertia, kg m^2.
        rotors: Position x, y (m) and direction of rotation of each rotor.
        thrust_coefficient: k_f, N s^2.
        drag_xy: Drag of a rotor across its axis, N / (m/s rad/s).
        propeller_radius: R, m.
        hover_speed: Rotor speed w in hover, rad/s.

    Returns:
        The constants.

    References:
        G. J. Leishman, Principles of Helicopter Aerodynamics (2006), chapter 3.
    """
    axial = AXIAL_DAMPING * thrust_coefficient * hover_speed / propeller_radius
    aside = sum(y * y for _, y, _ in rotors)
    along = sum(x * x for x, _, _ in rotors)
    disc_area = len(rotors) * math.pi * (propeller_radius * propeller_radius)
    return Scaled(
        ground_effect=(GROUND_EFFECT_REACH * propeller_radius, GROUND_EFFECT_GAIN),
        wake=(WAKE_RADIUS * arm_length(rotors), WAKE_SHARE, WAKE_SPREAD),
        damping=(
            axial * aside / inertia[0],
            axial * along / inertia[1],
            drag_xy * hover_speed * (along + aside) / inertia[2],
        ),
        body_drag=(BODY_DRAG[0] * disc_area, BODY_DRAG[1] * disc_area),
        power=(EFFICIENCY, 0.0),
    )
