"""Contact constraints: Jacobians, effective masses and impulses of contact points.

Each contact point constrains the relative velocity of its two surfaces: along the normal they must
not approach faster than allowed, and along the tangents friction stays within Coulomb's disc
(E. Catto, Iterative dynamics with temporal coherence, 2005). An impulse acts on both bodies at the
same point, so that momentum and angular momentum are conserved.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import read_quaternion, read_vec3, write_vec3
from bulletuav.geometry.rotation import Vec3, Vec3Like, axes, cross, dot, minus, plus, point

CONTACT_POINT = record_type(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("pair", "i8"),
        ("normal", "f8", 3),
        ("tangent", "f8", (2, 3)),
        ("arm_a", "f8", 3),
        ("arm_b", "f8", 3),
        ("jacobian_a", "f8", (3, 3)),
        ("jacobian_b", "f8", (3, 3)),
        ("angular_response_a", "f8", (3, 3)),
        ("angular_response_b", "f8", (3, 3)),
        ("obstacle_velocity", "f8", 3),
        ("friction", "f8"),
        ("restitution", "f8"),
        ("distance", "f8"),
        ("normal_velocity", "f8"),
        ("relative_velocity", "f8", 3),
        ("normal_mass", "f8"),
        ("tangent_mass", "f8", 4),
        ("coupling", "f8", 2),
        ("block_mass", "f8", (3, 3)),
        ("target_velocity", "f8"),
        ("rolling_axis", "f8", (3, 3)),
        ("rolling_response_a", "f8", (3, 3)),
        ("rolling_response_b", "f8", (3, 3)),
        ("rolling_mass", "f8", 3),
        ("rolling_limit", "f8", 3),
        ("rolling_impulse", "f8", 3),
        ("total_rolling_impulse", "f8", 3),
        ("is_sliding", "?"),
        ("tipping_damping", "f8"),
        ("impulse", "f8", 3),
        ("impulse_change", "f8", 3),
        ("search_direction", "f8", 3),
        ("total_impulse", "f8", 3),
        ("saved_impulse", "f8", 3),
    ]
)
"""A contact point with its constraint.

Attributes:
    a: Index of the drone that `normal` points to.
    b: Index of the other drone, or -1 for a static body.
    pair: Index of the pair.
    normal: Unit vector from b to a.
    tangent: Two unit vectors perpendicular to the normal and to each other.
    arm_a: From the centre of mass of a to the point, m.
    arm_b: From the centre of mass of b to the point, m.
    jacobian_a: Angular Jacobian of a, arm x axis for the normal and the tangents, m.
    jacobian_b: Angular Jacobian of b, m.
    angular_response_a: Change of the angular velocity of a by unit impulses along the axes, rad/s.
    angular_response_b: Change of the angular velocity of b, rad/s.
    obstacle_velocity: Velocity of a static body, m/s.
    friction: Coefficient of friction.
    restitution: Coefficient of restitution.
    distance: Signed distance of the surfaces along the normal, m.
    normal_velocity: Relative velocity along the normal before the impact, m/s.
    relative_velocity: Velocity of a relative to b at the point, m/s; zeros if speculative.
    normal_mass: Effective mass along the normal, kg.
    tangent_mass: Effective mass matrix of the tangents (symmetric 2 x 2: 11, 12, 22), and its
        smallest eigenvalue, kg.
    coupling: Velocities along the normal by unit impulses along the tangents, 1/kg.
    block_mass: Effective mass matrix of all three axes (3 x 3), kg.
    target_velocity: Smallest velocity along the normal that the solver accepts, m/s.
    rolling_axis: Unit vectors about which rotation is resisted: z of a, z of b, and the normal.
    rolling_response_a: Change of the angular velocity of a by unit angular impulses about these
        axes, rad/s.
    rolling_response_b: Change of the angular velocity of b, rad/s.
    rolling_mass: Effective moments of inertia about these axes, kg m^2.
    rolling_limit: Maximum angular impulses about these axes per normal impulse, m.
    rolling_impulse: Angular impulses about these axes in this pass, N m s.
    total_rolling_impulse: Sum of them over all passes since `save_velocities`, N m s.
    is_sliding: Whether the friction limit was reached in the last iteration.
    tipping_damping: Angular impulse that damps tipping, per normal impulse and spin, m s.
    impulse: Impulses along the normal and the tangents in this pass, N s.
    impulse_change: Change of the impulses in the last iteration, N s.
    search_direction: Decaying sum of the changes over iterations, N s.
    total_impulse: Sum of the impulses over all passes, N s.
    saved_impulse: Sum over all passes before `save_velocities`, N s.
"""


BodyVelocities = tuple[Vec3, Vec3, Vec3, Vec3]
"""Velocity and angular velocity of a, and of b, m/s and rad/s"""


@func
def _tangents(normal: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors perpendicular to a unit vector and to each other."""
    x, y, z = normal
    if abs(x) > abs(z):
        scale = 1.0 / math.sqrt(x * x + y * y)
        one = (-y * scale, x * scale, 0.0)
    else:
        scale = 1.0 / math.sqrt(y * y + z * z)
        one = (0.0, -z * scale, y * scale)
    return one, cross(normal, one)


@func
def apply_inverse_inertia(motion: np.record, v: Vec3Like) -> Vec3:
    """Return the change of angular velocity (rad/s) by an angular impulse (N m s), world axes."""
    inverse_inertia = motion.inverse_inertia
    return (
        inverse_inertia[0, 0] * v[0] + inverse_inertia[0, 1] * v[1] + inverse_inertia[0, 2] * v[2],
        inverse_inertia[1, 0] * v[0] + inverse_inertia[1, 1] * v[1] + inverse_inertia[1, 2] * v[2],
        inverse_inertia[2, 0] * v[0] + inverse_inertia[2, 1] * v[1] + inverse_inertia[2, 2] * v[2],
    )


@func
def set_inverse_mass(motion: np.record, row: np.record) -> None:
    """Compute the inverse mass, and the inverse inertia in world axes, at the present attitude."""
    motion.inverse_mass = 1.0 / row.mass
    bx, by, bz = axes(read_quaternion(motion))
    inertia = row.inertia
    for k in range(3):
        for m in range(3):
            total = bx[k] * bx[m] / inertia[0]
            total += by[k] * by[m] / inertia[1]
            total += bz[k] * bz[m] / inertia[2]
            motion.inverse_inertia[k, m] = total


@func
def _set_jacobian(
    motion: np.record,
    arm: Vec3,
    normal: Vec3,
    row: np.record,
    jacobians: np.ndarray,
    responses: np.ndarray,
) -> None:
    """Compute the angular Jacobian of a contact point, and its product with the inverse inertia."""
    for k in range(3):
        axis = normal if k == 0 else read_vec3(row.tangent[k - 1])
        jacobian = cross(arm, axis)
        write_vec3(jacobians[k], jacobian)
        write_vec3(responses[k], apply_inverse_inertia(motion, jacobian))


@func
def _compute_inverse_mass(row: np.record, one: int, two: int, inverse_mass: float) -> float:
    """Return the velocity along axis `one` of a point by a unit impulse along axis `two`, 1/kg."""
    total = inverse_mass if one == two else 0.0
    total += dot(row.jacobian_a[one], row.angular_response_a[two])
    if row.b >= 0:
        total += dot(row.jacobian_b[one], row.angular_response_b[two])
    return total


@func
def _set_block_mass(
    row: np.record, k00: float, k01: float, k02: float, k11: float, k12: float, k22: float
) -> None:
    """Invert the symmetric 3 x 3 inverse mass matrix of a point (Cramer's rule)."""
    first = (k00, k01, k02)
    second = (k01, k11, k12)
    third = (k02, k12, k22)
    scale = 1.0 / dot(first, cross(second, third))
    write_vec3(row.block_mass[0], plus((0.0, 0.0, 0.0), scale, cross(second, third)))
    write_vec3(row.block_mass[1], plus((0.0, 0.0, 0.0), scale, cross(third, first)))
    write_vec3(row.block_mass[2], plus((0.0, 0.0, 0.0), scale, cross(first, second)))


@kernel
def prepare_constraint(row: np.record, motions: np.ndarray) -> None:
    """Compute the tangents, Jacobians and effective masses of a contact point; reset its impulses.

    `a`, `b`, `normal` and the arms must be set. The inverse masses of the bodies must be set.
    """
    normal = read_vec3(row.normal)
    one, two = _tangents(normal)
    write_vec3(row.tangent[0], one)
    write_vec3(row.tangent[1], two)
    for k in range(3):
        row.total_impulse[k] = 0.0
        row.saved_impulse[k] = 0.0
        row.impulse[k] = 0.0
        row.rolling_impulse[k] = 0.0
        row.total_rolling_impulse[k] = 0.0
    inverse_mass = motions[row.a].inverse_mass
    _set_jacobian(
        motions[row.a], read_vec3(row.arm_a), normal, row, row.jacobian_a, row.angular_response_a
    )
    if row.b >= 0:
        inverse_mass += motions[row.b].inverse_mass
        _set_jacobian(
            motions[row.b],
            read_vec3(row.arm_b),
            normal,
            row,
            row.jacobian_b,
            row.angular_response_b,
        )
    k11 = _compute_inverse_mass(row, 1, 1, inverse_mass)
    k12 = _compute_inverse_mass(row, 1, 2, inverse_mass)
    k22 = _compute_inverse_mass(row, 2, 2, inverse_mass)
    k00 = _compute_inverse_mass(row, 0, 0, inverse_mass)
    k01 = _compute_inverse_mass(row, 0, 1, inverse_mass)
    k02 = _compute_inverse_mass(row, 0, 2, inverse_mass)
    _set_block_mass(row, k00, k01, k02, k11, k12, k22)
    row.coupling[0], row.coupling[1] = k01, k02
    row.normal_mass = 1.0 / k00
    scale = 1.0 / (k11 * k22 - k12 * k12)
    row.tangent_mass[0] = k22 * scale
    row.tangent_mass[1] = -k12 * scale
    row.tangent_mass[2] = k11 * scale
    spread = math.sqrt((k11 - k22) ** 2 + 4.0 * k12 * k12)
    row.tangent_mass[3] = 2.0 / (k11 + k22 + spread)


@func
def compute_surface_velocity(motion: np.record, arm: Vec3) -> Vec3:
    """Return the velocity of a drone's surface at a point `arm` from its centre of mass, m/s."""
    turning = cross(read_vec3(motion.spin), arm)
    return plus(read_vec3(motion.velocity), 1.0, turning)


@func
def compute_relative_velocity(row: np.record, motions: np.ndarray) -> Vec3:
    """Return the velocity of surface a relative to surface b at a contact point, m/s."""
    other = read_vec3(row.obstacle_velocity)
    if row.b >= 0:
        other = compute_surface_velocity(motions[row.b], read_vec3(row.arm_b))
    return minus(compute_surface_velocity(motions[row.a], read_vec3(row.arm_a)), other)


@func
def read_velocities(row: np.record, motions: np.ndarray) -> BodyVelocities:
    """Return the velocities of both bodies of a point; a static body has `obstacle_velocity`."""
    a = motions[row.a]
    if row.b < 0:
        return (
            read_vec3(a.velocity),
            read_vec3(a.spin),
            read_vec3(row.obstacle_velocity),
            (0.0, 0.0, 0.0),
        )
    b = motions[row.b]
    return read_vec3(a.velocity), read_vec3(a.spin), read_vec3(b.velocity), read_vec3(b.spin)


@func
def write_velocities(row: np.record, motions: np.ndarray, velocities: BodyVelocities) -> None:
    """Write the velocities of the bodies of a point."""
    write_vec3(motions[row.a].velocity, velocities[0])
    write_vec3(motions[row.a].spin, velocities[1])
    if row.b >= 0:
        write_vec3(motions[row.b].velocity, velocities[2])
        write_vec3(motions[row.b].spin, velocities[3])


@func
def compute_axis_velocity(row: np.record, velocities: BodyVelocities, k: int, axis: Vec3) -> float:
    """Return the velocity of surface a relative to surface b along axis k of a point, m/s."""
    speed = (
        dot(velocities[0], axis)
        + dot(velocities[1], point(row.jacobian_a, k))
        - dot(velocities[2], axis)
    )
    if row.b >= 0:
        speed -= dot(velocities[3], point(row.jacobian_b, k))
    return speed


@func
def apply_axis_impulse(
    row: np.record,
    motions: np.ndarray,
    velocities: BodyVelocities,
    k: int,
    axis: Vec3,
    impulse: float,
) -> BodyVelocities:
    """Return the velocities of both bodies after an impulse along axis k of a point, N s."""
    velocity_a, spin_a, velocity_b, spin_b = velocities
    velocity_a = plus(velocity_a, impulse * motions[row.a].inverse_mass, axis)
    spin_a = plus(spin_a, impulse, point(row.angular_response_a, k))
    if row.b >= 0:
        velocity_b = plus(velocity_b, -impulse * motions[row.b].inverse_mass, axis)
        spin_b = plus(spin_b, -impulse, point(row.angular_response_b, k))
    return velocity_a, spin_a, velocity_b, spin_b
