"""Power consumption of flight, from the velocity through the air or from the torque of the rotors.

Level flight follows Zeng, Xu and Zhang. Climb and descent, which their model lacks, follow axial
momentum theory and Leishman's fit of the vortex-ring state. The power that vertical motion adds in
hover is added at every level speed (our choice).

A load changes the weight W in flight. Their blade power delta / 8 rho s A (Omega R)^3, induced
power (1 + k) W^(3/2) / (2 rho A)^(1/2), induced velocity (W / (2 rho A))^(1/2) and tip speed
Omega R follow from W, as the thrust of rotors of fixed pitch grows with the square of their speed
Omega. With n W instead of W the power at the shafts is therefore n^(3/2) times that at the velocity
V / n^(1/2).

References:
    Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless Communication with Rotary-Wing UAV,
    IEEE TWC 18(4), 2019.
    J. G. Leishman, Principles of Helicopter Aerodynamics (2006), chapter 2.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.lanes import is_any, where
from bulletuav.compiled.plain import record_type
from bulletuav.errors import finite
from bulletuav.geometry.rotation import Vec3Like, vec3
from bulletuav.vehicle.airframe import DENSITY, STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import ParameterRow

# Airframes do not contain these constants. They use those of Zeng, Xu and Zhang (our choice).
PROFILE_DRAG = 0.012
"""Profile drag coefficient of the blades."""
SOLIDITY = 0.05
"""Solidity: area of the blades divided by the area of the discs."""
INDUCED_EXCESS = 0.1
"""Induced power losses of real rotors, as a fraction of the ideal induced power."""
PARASITE_AREA_RATIO = 0.03
"""Flat-plate area of the fuselage divided by the area of the discs."""
MIN_LOAD = 1e-6
"""Minimum weight divided by that of the airframe"""


class RotaryWing(NamedTuple):
    """Constants of one drone's propulsion power.

    Attributes:
        blade: Profile power of the blades in hover, W.
        induced: Induced power in hover, W.
        tip_speed: Speed of the blade tips, m/s.
        induced_velocity: Induced velocity in hover, m/s.
        drag_ratio: Flat-plate area of the fuselage divided by the area of the blades.
        density: Density of the air, kg/m^3.
        solidity: Area of the blades divided by the area of the discs.
        disc_area: Area of the discs of all rotors, m^2.
        weight: Weight, N.
        efficiency: Power at the shafts divided by electrical power; 1 to neglect losses.
        electronics: Electrical power of everything except the motors, W.
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
    efficiency: float = 1.0
    electronics: float = 0.0


ROTARY_WING = record_type([(name, "f8") for name in RotaryWing._fields])
"""Type of the rows of `propulsion`; np.array of a list of `RotaryWing` with this dtype is (N,)."""


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
    """Compute the constants by the appendix of Zeng, Xu and Zhang (2019).

    Args:
        weight: Weight of the drone, N.
        radius: Radius of the rotors, m.
        disc_area: Area of the discs of all rotors, m^2.
        rotor_speed: Rotor speed in hover, rad/s.
        parasite_area: Flat-plate area of the fuselage, m^2.
        density: Density of the air, kg/m^3.
        solidity: Area of the blades divided by the area of the discs.
        profile_drag: Profile drag coefficient of the blades.
        induced_excess: Induced losses as a fraction of the ideal induced power.

    Returns:
        The constants.

    Raises:
        ValueError: If a number is not finite and greater than 0.
    """
    # Check all arguments by name.
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
"""The drone of 20 N of Zeng, Xu and Zhang, as published.

Its constants must not be mixed with those of `W100`.
"""
W100 = rotary_wing(
    weight=100.0, radius=0.5, disc_area=0.79, rotor_speed=400.0, parasite_area=0.01185
)
"""The drone of 100 N of the earlier preprint by Zeng, Xu and Zhang.

Its constants must not be mixed with those of `W20`.
"""


def airframe_wing(airframe: Airframe, gravity: float = STANDARD_GRAVITY) -> RotaryWing:
    """Compute the constants of an airframe at sea level.

    The formula is for helicopters; the blades of small rotors lose much more. Therefore the blade
    power is the power of the rotors' torque in hover minus the induced power, and the losses of
    motors and controllers are those of the airframe.

    Args:
        airframe: The airframe; its mass, propellers along z and hover speed are used.
        gravity: Gravity, m/s^2.

    Returns:
        The constants.
    """
    radius = airframe.propeller_radius
    area = len(airframe.lift_rotors) * math.pi * radius**2
    weight, speed = airframe.mass * gravity, airframe.hover_speed(gravity)
    wing = rotary_wing(
        weight=weight,
        radius=radius,
        disc_area=area,
        rotor_speed=speed,
        parasite_area=PARASITE_AREA_RATIO * area,
    )
    shafts = weight * airframe.torque_ratio * speed
    return wing._replace(
        blade=max(wing.blade, shafts - wing.induced),
        # The drag of aircraft that fly on wings is in their drag polar
        drag_ratio=0.0 if airframe.forward_rotors else wing.drag_ratio,
        efficiency=airframe.efficiency,
        electronics=airframe.electronics,
    )


@func
def level_power(speed: float, wing: RotaryWing) -> tuple[float, float, float]:
    """Compute the power of straight level flight by Zeng, Xu and Zhang (2019), eq. 12.

    Their induced term Pi (sqrt(1 + x^2) - x)^(1/2), with x = V^2 / (2 v0^2), loses precision at
    high speed by cancellation. The quotient here is equal and does not.

    Args:
        speed: Speed through the air, at least 0, m/s.
        wing: Constants of the drone.

    Returns:
        Blade, induced and parasite power, W.
    """
    tip = speed / wing.tip_speed
    ratio = speed / wing.induced_velocity
    x = 0.5 * (ratio * ratio)
    parasite_area = wing.drag_ratio * wing.solidity * wing.disc_area
    return (
        wing.blade * (1.0 + 3.0 * tip * tip),
        wing.induced / math.sqrt(math.sqrt(1.0 + x * x) + x),
        0.5 * parasite_area * wing.density * (speed * speed * speed),
    )


@func
def axial_inflow(x: float) -> float:
    """Return the inflow through the disc in vertical flight: climb rate plus induced velocity.

    Climb: momentum theory. Descent to -2: Leishman's fit of the vortex-ring state. Faster descent:
        the
    windmill-brake state of momentum theory. The two differ by 0.026 at the end of the fit, so the
    fit is continued to their intersection near -2.04 (our choice).

    Args:
        x: Climb rate divided by the induced velocity in hover; negative in descent.

    Returns:
        The inflow divided by the induced velocity in hover.
    """
    # Climb.
    inflow = 0.5 * x + math.sqrt(0.25 * x * x + 1.0)
    if is_any(x < 0.0):
        # Vortex-ring state: climb rate plus the fit of the induced velocity.
        ring = x + (1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x))))
        inflow = where(x < 0.0, ring, inflow)
        if is_any(x <= -2.0):
            # Windmill-brake state, from where it exceeds the fit.
            brake = max(ring, 0.5 * x - math.sqrt(abs(0.25 * x * x - 1.0)))
            inflow = where(x <= -2.0, brake, inflow)
    return inflow


@func
def vertical_power(climb: float, wing: RotaryWing) -> float:
    """Return the power that a climb adds to the power of hover: weight (Vc + v_i - v0).

    Args:
        climb: Climb rate Vc, m/s; negative in descent.
        wing: Constants of the drone.

    Returns:
        The power, W; mostly negative in descent.
    """
    return wing.weight * wing.induced_velocity * (axial_inflow(climb / wing.induced_velocity) - 1.0)


@func
def propulsion_power(velocity: Vec3Like, wing: RotaryWing, load: float = 1.0) -> float:
    """Return the electrical power at a velocity; also for lanes of velocities.

    It is the power of level flight plus that of the climb, with electrical losses. The power at the
    shafts is at least the blade power in hover: rotors also turn in descent, and no power is
    recovered (our choice).

    Args:
        velocity: (3,) velocity through the air, world axes, m/s.
        wing: Constants of the drone.
        load: Weight divided by that of the constants.

    Returns:
        The power, W.
    """
    # A drone without weight has no induced velocity to divide by
    load = max(load, MIN_LOAD)
    root = math.sqrt(load)
    level = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1]) / root
    blade, induced, parasite = level_power(level, wing)
    climb = vertical_power(velocity[2] / root, wing)
    shafts = load * root * max(blade + induced + parasite + climb, wing.blade)
    return shafts / wing.efficiency + wing.electronics


@allocating
def propulsion(velocity: np.ndarray, wings: np.ndarray) -> np.ndarray:
    """Compute `propulsion_power` of all drones.

    Args:
        velocity: (W, N, 3) velocities through the air, world axes, m/s.
        wings: (W, N) rows of `ROTARY_WING`.

    Returns:
        (W, N) power, W.
    """
    power = np.empty(wings.shape)
    for w in range(wings.shape[0]):
        for i in range(wings.shape[1]):
            power[w, i] = propulsion_power(vec3(velocity, w, i), wings[w, i])
    return power


def actuator_power(before: np.ndarray, after: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Compute the mean power of the rotors against their torque k_m w^2 over a decision.

    The mean is computed by the trapezoidal rule.

    Args:
        before: (W, N, R) rotor speeds at the start of the decision, rad/s.
        after: (W, N, R) rotor speeds at the end of the decision, rad/s.
        parameters: (W, N) rows of `parameters.PARAMETERS`.

    Returns:
        (W, N) power, W.
    """
    power = np.empty(before.shape[:2])
    fill_actuator_power(before, after, parameters, power)
    return power


@func
def rotor_power(before: np.ndarray, after: np.ndarray, row: ParameterRow) -> float:
    """Return the mean power of one drone's rotors between two rotor speeds (R,), rad/s, in W."""
    cubes = 0.0
    for r in range(before.shape[0]):
        begin, end = before[r], after[r]
        cubes += (begin * begin * begin + end * end * end) / 2.0
    return row.torque_coefficient * cubes


@kernel
def fill_actuator_power(
    before: np.ndarray, after: np.ndarray, parameters: np.ndarray, power: np.ndarray
) -> None:
    """Write the result of `actuator_power` to `power` (W, N)."""
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            power[w, i] = rotor_power(before[w, i], after[w, i], parameters[w, i])
