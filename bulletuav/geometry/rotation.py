"""Vectors and rotations of one drone as compiled functions.

Quaternions are (x, y, z, w) and turn body axes (FLU: x forward, y left, z up) into world axes
(ENU: x east, y north, z up). Vectors and quaternions come as arrays or tuples and leave as tuples,
so nothing is allocated.

Formulas: J. Diebel, Representing Attitude (2006); the exponential map is exact.
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import func

Vec3 = tuple[float, float, float]
"""Vector (x, y, z) that compiled functions return."""
Quat4 = tuple[float, float, float, float]
"""Quaternion (x, y, z, w) that compiled functions return."""
Vec3Like = Vec3 | np.ndarray
"""Vector that compiled functions take: a tuple of three numbers or an array (3,)."""
Quat4Like = Quat4 | np.ndarray
"""Quaternion that compiled functions take: a tuple of four numbers or an array (4,)."""


@func
def vec3(array: np.ndarray, w: int, i: int) -> Vec3:
    """Return array[w, i] (3,) as a tuple: unlike a view it costs nothing."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2]


@func
def quat4(array: np.ndarray, w: int, i: int) -> Quat4:
    """Return array[w, i] (4,) as a tuple: unlike a view it costs nothing."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2], array[w, i, 3]


@func
def point(array: np.ndarray, m: int) -> Vec3:
    """Return array[m] (3,) as a tuple: unlike a view it costs nothing."""
    return array[m, 0], array[m, 1], array[m, 2]


@func
def minus(a: Vec3Like, b: Vec3Like) -> Vec3:
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@func
def plus(a: Vec3Like, scale: float, b: Vec3Like) -> Vec3:
    """Return a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@func
def cross(a: Vec3Like, b: Vec3Like) -> Vec3:
    """Return the vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@func
def dot(a: Vec3Like, b: Vec3Like) -> float:
    """Return the scalar product of two vectors of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@func
def normalise_quaternion(q: Quat4Like) -> Quat4:
    """Return the unit quaternion q / |q|."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@func
def axes(q: Quat4Like) -> tuple[Vec3, Vec3, Vec3]:
    """Return the body's x, y and z axes in the world: the columns of the rotation matrix R."""
    # Scalar last; the textbook matrix of a unit quaternion
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
    """Turn a vector from body axes into world axes: R v."""
    # Columns of R, weighted by the vector's numbers
    bx, by, bz = axes(q)
    return (
        bx[0] * v[0] + by[0] * v[1] + bz[0] * v[2],
        bx[1] * v[0] + by[1] * v[1] + bz[1] * v[2],
        bx[2] * v[0] + by[2] * v[1] + bz[2] * v[2],
    )


@func
def to_body(q: Quat4Like, v: Vec3Like) -> Vec3:
    """Turn a vector from world axes into body axes: R^T v."""
    bx, by, bz = axes(q)
    return dot(bx, v), dot(by, v), dot(bz, v)


@func
def product(p: Quat4Like, q: Quat4Like) -> Quat4:
    """Return the quaternion of the rotation by q and then by p: the product p q."""
    # Hamilton's product, scalar last
    return (
        p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
        p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
        p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )


@func
def exp_map(v: Vec3Like) -> Quat4:
    """Return the quaternion of the rotation by |v| radians about v (the exponential map)."""
    angle = math.sqrt(dot(v, v))
    # Below the limit sin(angle / 2) / angle is 1/2 to the last digit, and 0 / 0 is avoided.
    scale = sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    return scale * v[0], scale * v[1], scale * v[2], cos(0.5 * angle)


@func
def from_euler(roll: float, pitch: float, yaw: float) -> Quat4:
    """Return the quaternion of Euler angles in the aerospace order.

    Args:
        roll: Last turn, about the moved x axis, rad.
        pitch: Second turn, about the moved y axis, rad.
        yaw: First turn, about the z axis, rad.

    Returns:
        The quaternion, body to world.
    """
    # Product of the three turns by half angles: yaw, then pitch, then roll
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
    """Return the yaw of an attitude, rad."""
    x, y, z, w = quaternion
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
