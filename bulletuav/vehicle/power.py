"""Power that rotors need, W: from the velocity through the air, or from the torque of the simulated rotors.

Level flight: Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless Communication with Rotary-Wing UAV, IEEE TWC 18(4),
2019. Climb and descent, which are not in it: axial momentum theory and the vortex-ring fit of J. G. Leishman, Principles of
Helicopter Aerodynamics (2006), chapter 2. What the vertical motion adds in hover is added at every level speed (our choice).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.errors import finite
from bulletuav.geometry.rotation import vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe

DENSITY = 1.225  # kg/m^3, standard atmosphere at sea level
PROFILE_DRAG = 0.012
SOLIDITY = 0.05
INDUCED_EXCESS = 0.1  # share of the ideal induced power that real rotors lose on top of it
PARASITE_SHARE = 0.03  # flat-plate area of the fuselage, in disc areas
"""What Zeng, Xu and Zhang take; airframes do not tell theirs, so they get the same (our choice)"""


class RotaryWing(NamedTuple):
    """Constants of one drone's propulsion power.

    blade             profile power of the blades in hover, W
    induced           induced power in hover, W
    tip_speed         of the blades, m/s
    induced_velocity  of the air through the discs in hover, m/s
    drag_ratio        flat-plate area of the fuselage over the area of the blades
    density           of the air, kg/m^3
    solidity          area of the blades over that of the discs
    disc_area         of all rotors, m^2
    weight            N
    """

    blade: float
    induced: float
    tip_speed: float
    induced_velocity: float
    drag_ratio: float
    density: float
    solidity: float
    disc_area: float
    weight: float


ROTARY_WING = np.dtype([(name, "f8") for name in RotaryWing._fields])
"""Rows for `propulsion`: np.array of a list of `RotaryWing` with this dtype is (N,)"""


def rotary_wing(
    weight: float,
    radius: float,
    disc_area: float,
    rotor_speed: float,
    parasite_area: float,
    density: float = DENSITY,
    solidity: float = SOLIDITY,
    profile_drag: float = PROFILE_DRAG,
    induced_excess: float = INDUCED_EXCESS,
) -> RotaryWing:
    """Constants by the appendix of Zeng, Xu and Zhang (2019).

    weight (N), radius of the rotors (m), area of all their discs (m^2), rotor speed in hover (rad/s), flat-plate area of the
    fuselage (m^2), density of the air (kg/m^3). Raises ValueError unless all numbers are finite and above 0.
    """
    for name, value in locals().copy().items():
        if not finite(name, value) > 0:
            raise ValueError(f"{name} is {value!r}: a number above 0 is needed")
    tip_speed = rotor_speed * radius
    induced_velocity = math.sqrt(weight / (2 * density * disc_area))
    return RotaryWing(
        blade=profile_drag / 8 * density * solidity * disc_area * tip_speed**3,
        induced=(1 + induced_excess) * weight * induced_velocity,
        tip_speed=tip_speed,
        induced_velocity=induced_velocity,
        drag_ratio=parasite_area / (solidity * disc_area),
        density=density,
        solidity=solidity,
        disc_area=disc_area,
        weight=weight,
    )


W20 = rotary_wing(weight=20.0, radius=0.4, disc_area=0.503, rotor_speed=300.0, parasite_area=0.0151)
W100 = rotary_wing(
    weight=100.0, radius=0.5, disc_area=0.79, rotor_speed=400.0, parasite_area=0.01185
)
"""The drones of 20 N (published) and of 100 N (earlier preprint) of Zeng, Xu and Zhang; their constants must not be mixed"""


def airframe_wing(airframe: Airframe, gravity: float = STANDARD_GRAVITY) -> RotaryWing:
    """Constants of an airframe at sea level: of its mass, propellers and hover speed under `gravity`, m/s^2."""
    radius = airframe.propeller_radius
    area = len(airframe.rotors) * math.pi * radius**2
    return rotary_wing(
        airframe.mass * gravity, radius, area, airframe.hover_speed(gravity), PARASITE_SHARE * area
    )


@func
def level_power(speed, wing):
    """Blade, induced and parasite power (W) of straight level flight at `speed` m/s, at least 0.

    Zeng, Xu and Zhang (2019), eq. 12. The induced term is there Pi (sqrt(1 + x^2) - x)^(1/2) with x = V^2 / (2 v0^2), a
    difference that cancels at high speed; the quotient here equals it and does not.
    """
    tip, x = speed / wing.tip_speed, 0.5 * (speed / wing.induced_velocity) ** 2
    parasite_area = wing.drag_ratio * wing.solidity * wing.disc_area
    return (
        wing.blade * (1.0 + 3.0 * tip * tip),
        wing.induced / math.sqrt(math.sqrt(1.0 + x * x) + x),
        0.5 * parasite_area * wing.density * speed**3,
    )


@func
def axial_inflow(x):
    """Air through the disc in vertical flight, climb rate `x` plus induced velocity, all in induced velocities of hover.

    Climb: momentum theory. Descent to -2: Leishman's fit of the vortex ring. Faster: the windmill brake of momentum theory;
    it misses the end of the fit by 0.026, so the fit goes on until they meet, near -2.04 (our choice).
    """
    if x >= 0.0:
        return 0.5 * x + math.sqrt(0.25 * x * x + 1.0)
    ring = x + (1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x))))
    if x > -2.0:
        return ring
    return max(ring, 0.5 * x - math.sqrt(0.25 * x * x - 1.0))


@func
def vertical_power(climb, wing):
    """What climbing at `climb` m/s adds to the power of hover, W; mostly negative in descent: weight (Vc + v_i - v0)."""
    return wing.weight * wing.induced_velocity * (axial_inflow(climb / wing.induced_velocity) - 1.0)


@func
def propulsion_power(velocity, wing):
    """Power (W) at `velocity` (3,) m/s through the air, ENU: level flight and climb, at least the blades' in hover.

    Rotors turn in descent too: none of the power that the air gives back is stored (our choice).
    """
    blade, induced, parasite = level_power(math.hypot(velocity[0], velocity[1]), wing)
    return max(blade + induced + parasite + vertical_power(velocity[2], wing), wing.blade)


@kernel
def propulsion(velocity, wings):
    """`propulsion_power` (W, N), W, at velocities (W, N, 3) m/s, by `wings` (W, N) of `ROTARY_WING`."""
    power = np.empty(wings.shape)
    for w in range(wings.shape[0]):
        for i in range(wings.shape[1]):
            power[w, i] = propulsion_power(vec3(velocity, w, i), wings[w, i])
    return power


def actuator_power(before: np.ndarray, after: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Mean power (W, N), W, of the rotors against their torque k_m w^2 over a decision, by the trapezium rule.

    Rotor speeds `before` and `after` it (W, N, R) rad/s; `parameters` rows (W, N) of `airframe.PARAMETERS`.
    """
    return parameters["torque_coefficient"] * ((before**3 + after**3) / 2).sum(axis=-1)
