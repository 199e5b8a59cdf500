"""Random quadrotors, with the constants of small to large ones."""

import dataclasses
import math

import numpy as np

from bulletuav.compiled.functions import cos, exp, log, sin
from bulletuav.geometry.shapes import CYLINDER, Shape
from bulletuav.policies.rotor_axes import TURNS
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe, hover_speed
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.scaling import scaled_constants

# The ranges contain the quadrotors in assets/urdf and those of gym-pybullet-drones, which have no
# motor lag and large or small torque ratios
MASS = (0.025, 2.4)
"""Mass, kg"""
ARM = (0.09, 0.24)
"""Distance of a rotor from the centre, divided by the cube root of the mass in kg, m"""
THRUST_TO_WEIGHT = (1.4, 5.0)
"""Maximum thrust divided by the weight"""
INERTIA = (0.2, 0.4)
"""Moment of inertia about x, divided by the mass and the square of the arm"""
INERTIA_Y, INERTIA_Z = (0.9, 1.2), (1.0, 1.9)
"""Moments of inertia about y and z, divided by the one about x"""
HALF_ANGLE = (33.0, 62.0)
"""Angle between the nose and the front rotors, degrees"""
REAR = (0.9, 1.1)
"""Distance between the rear rotors, divided by that between the front rotors"""
TORQUE_RATIO = (0.02, 0.7)
"""Torque of a rotor divided by its thrust and the arm"""
LAG = (0.0, 0.08)
"""Time constant of a rotor that speeds up, s"""
LAG_DOWN = (1.0, 2.0)
"""Time constant of a rotor that slows down, divided by that of one that speeds up"""
PROPELLER = (0.38, 0.65)
"""Radius of the propellers divided by the arm"""
TIP_SPEED = (50.0, 220.0)
"""Maximum speed of the tips of the propellers, m/s"""
DRAG_XY, DRAG_Z = (0.0, 0.7), (0.0, 0.7)
"""Drag of all rotors in hover, divided by mass and speed, across and along the axis, 1/s"""
DRAG_HEIGHT = (0.0, 0.75)
"""Height at which this drag acts, divided by the arm"""
ROTOR_SPIN = (0.0, 5.0)
"""Change of the yaw rate when a rotor reaches its maximum speed, rad/s"""
MAX_SPEED = 10.0
"""Maximum commanded speed, m/s; without meaning for rotor commands"""


def draw_airframe(rng: np.random.Generator) -> Airframe:
    """Draw a quadrotor with rotors in the order and directions of `rotor_axes`.

    Sizes are drawn relative to mass and arm, so that the drawn constants fit each other. Damping,
    drag of the body and wake follow from them, see `scaled_constants`. Mass, arm, torque ratio and
    tip speed are uniform in their logarithms, all other numbers uniform.

    Args:
        rng: Random generator.

    Returns:
        The airframe.
    """
    mass = _draw_logarithmic(rng, MASS)
    arm = _draw_logarithmic(rng, ARM) * float(exp(log(mass) / 3))
    inertia_x = rng.uniform(*INERTIA) * mass * arm * arm
    inertia = (
        inertia_x,
        inertia_x * rng.uniform(*INERTIA_Y),
        inertia_x * rng.uniform(*INERTIA_Z),
    )
    half_angle = math.radians(rng.uniform(*HALF_ANGLE))
    x, y, rear = arm * float(cos(half_angle)), arm * float(sin(half_angle)), rng.uniform(*REAR)
    places = ((x, -y), (-x, -y * rear), (-x, y * rear), (x, y))
    rotors = tuple((*place, turn) for place, turn in zip(places, TURNS, strict=True))
    radius = arm * rng.uniform(*PROPELLER)
    max_rotor_speed = _draw_logarithmic(rng, TIP_SPEED) / radius
    weight = mass * STANDARD_GRAVITY
    thrust = rng.uniform(*THRUST_TO_WEIGHT) * weight / (4 * max_rotor_speed * max_rotor_speed)
    hover = hover_speed(weight, 4, thrust)
    drag_xy, drag_z = (rng.uniform(*bounds) * mass / (4 * hover) for bounds in (DRAG_XY, DRAG_Z))
    lag = rng.uniform(*LAG)
    scaled = scaled_constants(inertia, rotors, thrust, drag_xy, radius, hover)
    outer = arm + 0.5 * radius
    return dataclasses.replace(
        load_airframe("cf2x"),
        name="drawn",
        mass=mass,
        inertia=inertia,
        rotors=rotors,
        thrust_coefficient=thrust,
        torque_ratio=arm * _draw_logarithmic(rng, TORQUE_RATIO),
        max_rotor_speed=max_rotor_speed,
        lag_up=lag,
        lag_down=lag * rng.uniform(*LAG_DOWN),
        drag_xy=drag_xy,
        drag_z=drag_z,
        drag_height=arm * rng.uniform(*DRAG_HEIGHT),
        propeller_radius=radius,
        rotor_inertia=rng.uniform(*ROTOR_SPIN) * inertia[2] / max_rotor_speed,
        damping=scaled.damping,
        body_drag=scaled.body_drag,
        ground_effect_reach=scaled.ground_effect[0],
        ground_effect_gain=scaled.ground_effect[1],
        wake_radius=scaled.wake[0],
        wake_share=scaled.wake[1],
        wake_spread=scaled.wake[2],
        max_speed=MAX_SPEED,
        shape=Shape(CYLINDER, (outer, outer, 0.2 * arm)),
        pack=None,
        pwm=None,
    )


def _draw_logarithmic(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Draw a number whose logarithm is uniform."""
    low, high = (float(log(bound)) for bound in bounds)
    return float(exp(rng.uniform(low, high)))
