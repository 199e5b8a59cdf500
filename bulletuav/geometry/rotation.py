"""Rotations of one drone as compiled functions: quaternions (x, y, z, w) turn body FLU axes into world ENU axes.

Vectors and quaternions come as arrays or tuples and leave as tuples, so nothing is allocated.
Formulas: J. Diebel, Representing Attitude (2006); the exponential map is exact.
"""

import math

import numpy as np

from bulletuav.kernel import func

Vec3 = tuple[float, float, float]
Quat4 = tuple[float, float, float, float]
Vec3Like = Vec3 | np.ndarray
Quat4Like = Quat4 | np.ndarray
"""What compiled functions take: a tuple of numbers, or an array (3,) or (4,)"""


@func
def vec3(array, w, i):
    """array[w, i] (3,) as a tuple: unlike a view it costs nothing."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2]


@func
def quat4(array, w, i):
    """array[w, i] (4,) as a tuple."""
    return array[w, i, 0], array[w, i, 1], array[w, i, 2], array[w, i, 3]


@func
def cross(a, b):
    """Vector product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@func
def dot(a, b):
    """Scalar product of two vectors of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@func
def normalised(q):
    """The unit quaternion q / |q|."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


@func
def axes(q):
    """The body's x, y and z axes in the world: the columns of the rotation matrix."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


@func
def to_world(q, v):
    """R v: a body vector in world axes."""
    bx, by, bz = axes(q)
    return (
        bx[0] * v[0] + by[0] * v[1] + bz[0] * v[2],
        bx[1] * v[0] + by[1] * v[1] + bz[1] * v[2],
        bx[2] * v[0] + by[2] * v[1] + bz[2] * v[2],
    )


@func
def to_body(q, v):
    """R^T v: a world vector in body axes."""
    bx, by, bz = axes(q)
    return dot(bx, v), dot(by, v), dot(bz, v)


@func
def exponential(v):
    """Quaternion of the rotation by |v| radians about v."""
    angle = math.sqrt(dot(v, v))
    scale = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    return scale * v[0], scale * v[1], scale * v[2], math.cos(0.5 * angle)


@func
def from_euler(roll, pitch, yaw):
    """Quaternion of yaw, then pitch, then roll about the moving z, y, x axes (the aerospace order)."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
