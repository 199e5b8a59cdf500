"""Vector and quaternion algebra of one drone, as compiled functions.

Quaternions are (x, y, z, w) and rotate body axes (FLU: x forward, y left, z up) into world axes
(ENU: x east, y north, z up). Arguments are arrays or tuples. Results are tuples, so that nothing is
allocated.

References:
    J. Diebel, Representing Attitude (2006). The exponential map is exact.
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import func

Vec3 = tuple[float, float, float]
"""Vector (x, y, z), as compiled functions return it."""
Quat4 = tuple[float, float, float, float]
"""Quaternion (x, y, z, w), as compiled functions return it."""
Vec3Like = Vec3 | np.ndarray
"""Vector argument of compiled functions: a tuple of three numbers or an array (3,)."""
Quat4Like = Quat4 | np.ndarray
"""Quaternion argument of compiled functions: a tuple of four numbers or an array (4,)."""


@func
def vec3(array: np.ndarray, w: int, i: int) -> Vec3:
    """Return array[w, i] (3,) as a tuple, which is faster than a view."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2]


@func
def quat4(array: np.ndarray, w: int, i: int) -> Quat4:
    """Return array[w, i] (4,) as a tuple, which is faster than a view."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2], array[w, i, 3]


@func
def point(array: np.ndarray, m: int) -> Vec3:
    """Return array[m] (3,) as a tuple, which is faster than a view."""
    return array[m, 0], array[m, 1], array[m, 2]


@func
def minus(a: Vec3Like, b: Vec3Like) -> Vec3:
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@func
def plus(a: Vec3Like, scale: float, b: Vec3Like) -> Vec3:
    """Return the scaled sum a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@func
def cross(a: Vec3Like, b: Vec3Like) -> Vec3:
    """Return the cross product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@func
def dot(a: Vec3Like, b: Vec3Like) -> float:
    """Return the dot product of two vectors of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@func
def normalise_quaternion(q: Quat4Like) -> Quat4:
    """Return the unit quaternion q / |q|."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@func
def axes(q: Quat4Like) -> tuple[Vec3, Vec3, Vec3]:
    """Return the columns of the rotation matrix R: the body's x, y and z axes in the world."""
    # Rotation matrix of a unit quaternion, scalar last
    x = q[0]
    y = q[1]
    z = q[2]
    w = q[3]
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@func
def to_world(q: Quat4Like, v: Vec3Like) -> Vec3:
    """Rotate a vector from body axes into world axes: R v."""
    # Sum of the columns of R, weighted by the components of the vector
    bx, by, bz = axes(q)
    return (
        bx[0] * v[0] + by[0] * v[1] + bz[0] * v[2],
        bx[1] * v[0] + by[1] * v[1] + bz[1] * v[2],
        bx[2] * v[0] + by[2] * v[1] + bz[2] * v[2],
    )


@func
def to_body(q: Quat4Like, v: Vec3Like) -> Vec3:
    """Rotate a vector from world axes into body axes: R^T v."""
    bx, by, bz = axes(q)
    return dot(bx, v), dot(by, v), dot(bz, v)


@func
def product(p: Quat4Like, q: Quat4Like) -> Quat4:
    """Return the quaternion product p q: the rotation by q, followed by the rotation by p."""
    # Hamilton's product, scalar last
    return (
        p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
        p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
        p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )


@func
def exp_map(v: Vec3Like) -> Quat4:
    """Return the quaternion of a rotation vector: by |v| radians about v (exponential map)."""
    angle = math.sqrt(dot(v, v))
    # For small angles sin(angle / 2) / angle is 1/2 in double precision; avoids 0 / 0.
    scale = sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    return scale * v[0], scale * v[1], scale * v[2], cos(0.5 * angle)


@func
def log_map(q: Quat4Like) -> Vec3:
    """Return the rotation vector (at most pi long) of a unit quaternion; inverse of `exp_map`."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    # q and -q are the same rotation
    side = 1.0 if q[3] >= 0.0 else -1.0
    scale = 2.0 * atan2(length, side * q[3]) / length if length > 1e-12 else 2.0
    return side * scale * q[0], side * scale * q[1], side * scale * q[2]


@func
def from_euler(roll: float, pitch: float, yaw: float) -> Quat4:
    """Return the quaternion of Euler angles in the aerospace order (yaw, pitch, roll).

    Args:
        roll: Third rotation, about the rotated x axis, rad.
        pitch: Second rotation, about the rotated y axis, rad.
        yaw: First rotation, about the z axis, rad.

    Returns:
        The quaternion, body to world.
    """
    # Product of the three rotations, written in half angles
    cr = cos(0.5 * roll)
    sr = sin(0.5 * roll)
    cp = cos(0.5 * pitch)
    sp = sin(0.5 * pitch)
    cy = cos(0.5 * yaw)
    sy = sin(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@func
def heading(quaternion: Quat4Like) -> float:
    """Return the yaw angle of an attitude, rad."""
    x, y, z, w = quaternion
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
