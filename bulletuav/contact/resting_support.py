"""Resting support: the forces under which a drone on one surface stays at rest.

A rigid body on a flat surface stays at rest if the line of action of its load meets the surface
within its base, and if friction can hold the tangential load (Coulomb). Both are tested with a
safety factor of two (`SAFE_FRACTION`), so that the distribution of the load over the contact points
does not matter.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import where
from bulletuav.compiled.plain import record_type
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld, get_surface_coefficients
from bulletuav.contact.motion import interpolate_pose, read_vec3, write_vec3
from bulletuav.geometry.contact_points import contact_points
from bulletuav.geometry.gjk import gjk_distance
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus, point, quat4, vec3
from bulletuav.vehicle.swarm import Swarm

SAFE_FRACTION = 0.5
"""Fraction of the load limit of a support that counts as safe"""
MAX_BASE_DISTANCE = 1e-3
"""Distance from the surface up to which a point belongs to the base, m"""
MIN_BASE_POINTS = 3
"""Minimum number of contact points of a base"""
NUM_DIRECTIONS = 16
"""Number of directions in which the base is measured"""

SUPPORT = record_type([("normal", "f8", 3), ("height", "f8"), ("span", "f8"), ("friction", "f8")])
"""The surface that a drone rests on.

Attributes:
    normal: Unit vector out of the surface.
    height: Height of the centre of mass above the surface, m.
    span: Radius of the largest circle about the projected centre of mass within the base, m; 0 if
        there is none, or if the drone rests on several surfaces.
    friction: Coefficient of friction.
"""


@kernel
def measure_support(
    support: np.record,
    space: ContactWorkspace,
    world: ContactWorld,
    swarm: Swarm,
    i: int,
    other: int,
) -> None:
    """Measure how a drone rests on a static shape.

    Args:
        support: Row of `SUPPORT`, written.
        space: Arrays to work on.
        world: The world.
        swarm: State of all drones.
        i: Index of the drone.
        other: Index of the shape that it rests on.
    """
    scenery = world.scenery
    table = scenery.table
    support.span = 0.0
    if other < scenery.first_body:
        return
    place, turned = interpolate_pose(scenery, space.motions, world.w, other, 0.0, world.dt)
    turn = axes(turned)
    own = axes(quat4(swarm.quaternion, world.w, i))
    offset = minus(place, vec3(swarm.position, world.w, i))
    nowhere = (0.0, 0.0, 0.0)
    _, normal, on_a, on_b = gjk_distance(table, i, own, other, turn, offset, nowhere, space.scratch)
    found = contact_points(
        table,
        i,
        own,
        other,
        turn,
        offset,
        normal,
        on_a,
        on_b,
        MAX_BASE_DISTANCE,
        space.found,
        space.scratch,
    )
    if found < MIN_BASE_POINTS:
        return
    write_vec3(support.normal, normal)
    support.height = -dot(normal, point(space.found, 0))
    rough, _ = get_surface_coefficients(world, i)
    rough_other, _ = get_surface_coefficients(world, other)
    support.friction = math.sqrt(rough * rough_other)
    support.span = max(0.0, _compute_inner_radius(space.found, found, normal))


@func
def _compute_inner_radius(points: np.ndarray, num_points: int, normal: Vec3) -> float:
    """Return the smallest extent of points (M, 3) from the origin over tangential directions, m."""
    first = cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.8 else (0.0, 1.0, 0.0))
    scale = 1.0 / math.sqrt(dot(first, first))
    first = (scale * first[0], scale * first[1], scale * first[2])
    second = cross(normal, first)
    least = np.inf
    for k in range(NUM_DIRECTIONS):
        angle = 2.0 * math.pi * k / NUM_DIRECTIONS
        east = cos(angle)
        north = sin(angle)
        most = -np.inf
        for m in range(num_points):
            place = point(points, m)
            most = max(most, east * dot(place, first) + north * dot(place, second))
        least = min(least, most)
    return least


@func
def compute_support_force(
    support: np.record, mass: float, acceleration: Vec3, torque: Vec3
) -> tuple[float, bool]:
    """Compute the normal force of a drone on its support, N, and whether the drone stays at rest.

    Args:
        support: Row of `SUPPORT`, of one drone or of lanes.
        mass: Mass of the drone, kg.
        acceleration: Acceleration by forces without contacts, m/s^2.
        torque: Torque without contacts, world axes, N m.
    """
    normal = read_vec3(support.normal)
    pressed = -mass * dot(acceleration, normal)
    force = (mass * acceleration[0], mass * acceleration[1], mass * acceleration[2])
    along = plus(force, pressed, normal)
    about = dot(torque, normal)
    # Moment about the foot of the centre of mass: gives the centre of pressure
    tipping = plus(plus(torque, -about, normal), support.height, cross(normal, along))
    max_tipping = SAFE_FRACTION * support.span * pressed
    base = where(support.span > 0.0, support.span, 1.0)
    pull = math.sqrt(dot(along, along)) + abs(about) / base
    # Without branches, which lanes do not have; no pull is below a negative limit
    limit = where(
        dot(tipping, tipping) > max_tipping * max_tipping,
        -1.0,
        SAFE_FRACTION * support.friction * pressed,
    )
    limit = where(pressed <= 0.0, -1.0, limit)
    is_safe = pull <= where(support.span <= 0.0, -1.0, limit)
    pressed = where(pressed <= 0.0, 0.0, pressed)
    return where(support.span <= 0.0, 0.0, pressed), is_safe


@func
def can_carry_load(
    support: np.record,
    row: np.record,
    acceleration: Vec3,
    torque: Vec3,
    load: np.ndarray,
    dt: float,
) -> bool:
    """Check whether a resting drone stays at rest under the drones on it.

    On several surfaces it does if the tangential load is below the friction limit of its own load.

    Args:
        support: Row of `SUPPORT`.
        row: Row of `PARAMETERS` of the drone.
        acceleration: Acceleration by forces without contacts, m/s^2.
        torque: Torque without contacts, world axes, N m.
        load: (2, 3) impulse (N s) and angular impulse (N m s) of the other drones in a substep.
        dt: Length of the substep, s.
    """
    total = plus(acceleration, 1.0 / (row.mass * dt), point(load, 0))
    if support.span > 0.0:
        _, is_safe = compute_support_force(
            support, row.mass, total, plus(torque, 1.0 / dt, point(load, 1))
        )
        return is_safe
    weight = dot(acceleration, acceleration)
    down = dot(total, acceleration)
    across = dot(total, total) * weight - down * down
    held: bool = down > 0.0 and across <= (row.friction * down) ** 2
    return held
