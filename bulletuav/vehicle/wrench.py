"""The one wrench per drone and substep that every six-degree-of-freedom dynamics shares."""

from bulletuav.geometry.rotation import axes
from bulletuav.kernel import func
from bulletuav.vehicle.aerodynamics import ground_effect, rotor_drag


@func
def wrench(quaternion, velocity, altitude, rotors, air, downwash, row):
    """Force (N, world) and torque (N m, body) on one drone.

    rotors: what `rotor_wrench` tells; air: (wind (3,) m/s, surface height below m, gravity m/s^2); downwash: N, from the
    other drones.
    """
    wind, surface, gravity = air
    thrust, torque, total_speed = rotors
    up = axes(quaternion)[2]
    thrust *= 1.0 + ground_effect(altitude - surface, up[2], row)
    against = (velocity[0] - wind[0], velocity[1] - wind[1], velocity[2] - wind[2])
    drag = rotor_drag(quaternion, against, total_speed, row)
    force = (
        thrust * up[0] + drag[0],
        thrust * up[1] + drag[1],
        thrust * up[2] + drag[2] - downwash - row.mass * gravity,
    )
    return force, torque


@func
def body_acceleration(rates, torque, row):
    """Euler's equation, J^-1 (M - w x J w), rad/s^2 in body axes."""
    jx, jy, jz = row.inertia[0], row.inertia[1], row.inertia[2]
    return (
        (torque[0] - (jz - jy) * rates[1] * rates[2])
        * (1.0 / jx),  # divisions that several calls for one drone share
        (torque[1] - (jx - jz) * rates[2] * rates[0]) * (1.0 / jy),
        (torque[2] - (jy - jx) * rates[0] * rates[1]) * (1.0 / jz),
    )
