"""Distances of convex shapes by other means than GJK and EPA, in numpy, of M poses at a time.

Shapes are `Shape`; a turn is an array (M, 3, 3) of rotation matrices and an offset is (M, 3), the
position of b less that of a. Polytopes are compared feature by feature.
"""

import itertools

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE


def corners_of(shape):
    if shape.kind == BOX:
        return np.array(list(itertools.product((-1.0, 1), repeat=3))) * shape.half
    return np.array(shape.corners)


def world(turn, points):
    """Points (V, 3) in world axes (M, V, 3)."""
    return np.einsum("mij,vj->mvi", turn, points)


def local(turn, vectors):
    """World vectors (M, 3) in body axes."""
    return np.einsum("mji,mj->mi", turn, vectors)


def reach(shape, turn, d):
    """How far a shape reaches along directions (M, 3), m."""
    d = local(turn, d)
    if shape.kind == SPHERE:
        return shape.half[0] * np.linalg.norm(d, axis=1)
    if shape.kind == CYLINDER:
        return shape.half[0] * np.hypot(d[:, 0], d[:, 1]) + shape.half[2] * np.abs(d[:, 2])
    return (d @ corners_of(shape).T).max(axis=1)


def separation(a, turn_a, b, turn_b, offset, n):
    """Distance of the shapes' planes across a unit normal: no more than their signed distance."""
    along = np.einsum("mi,mi->m", offset, n)
    return -reach(a, turn_a, -n) - reach(b, turn_b, n) - along


def outside(shape, turn, points):
    """How far points (M, 3) are outside of a shape, at least, m; negative inside."""
    p = local(turn, points)
    if shape.kind == SPHERE:
        return np.linalg.norm(p, axis=1) - shape.half[0]
    if shape.kind == BOX:
        return (np.abs(p) - shape.half).max(axis=1)
    if shape.kind == CYLINDER:
        across = np.hypot(p[:, 0], p[:, 1]) - shape.half[0]
        return np.maximum(across, np.abs(p[:, 2]) - shape.half[2])
    planes = ConvexHull(corners_of(shape)).equations
    return (p @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def from_centre(shape, turn, centre, radius):
    """Signed distance of a sphere, at centre (M, 3) from the shape's position, in closed form."""
    p = local(turn, centre)
    if shape.kind == SPHERE:
        return np.linalg.norm(p, axis=1) - shape.half[0] - radius
    if shape.kind == BOX:
        over = np.abs(p) - shape.half
    elif shape.kind == CYLINDER:
        across = np.hypot(p[:, 0], p[:, 1]) - shape.half[0]
        over = np.stack([across, np.abs(p[:, 2]) - shape.half[2]], axis=1)
    else:
        apart = point_triangles(p, corners_of(shape)).min(axis=1)
        inner = outside(shape, turn, centre)
        return np.where(inner > 0, apart, inner) - radius
    apart = np.linalg.norm(np.maximum(over, 0), axis=1)
    return np.where(over.max(axis=1) > 0, apart, over.max(axis=1)) - radius


def point_triangles(p, corners):
    """Distance of points (M, 3) from each triangle of the hull of corners (M, T)."""
    faces = corners[ConvexHull(corners).simplices]
    return _point_triangle(p[:, None], *(faces[None, :, k] for k in range(3)))


def _square(v):
    return np.einsum("...i,...i->...", v, v)


def _dot(a, b):
    return np.einsum("...i,...i->...", a, b)


def _point_segment(p, q, r):
    way = r - q
    share = np.clip(_dot(p - q, way) / _square(way), 0, 1)
    return np.sqrt(_square(p - q - share[..., None] * way))


def _point_plane(p, q, r, s):
    """Distance of a point from a triangle's plane where it is over the triangle, else inf."""
    normal = np.cross(r - q, s - q)
    normal = normal / np.sqrt(_square(normal))[..., None]
    inside = np.ones(np.broadcast_shapes(p.shape, q.shape)[:-1], dtype=bool)
    for one, two in ((q, r), (r, s), (s, q)):
        inside &= _dot(np.cross(two - one, p - one), normal) >= 0
    return np.where(inside, np.abs(_dot(p - q, normal)), np.inf)


def _point_triangle(p, q, r, s):
    sides = [_point_segment(p, *side) for side in ((q, r), (r, s), (s, q))]
    return np.minimum(np.minimum.reduce(sides), _point_plane(p, q, r, s))


def _segments(p, q, r, s):
    """Distance of the segments pq and rs where it is between inner points, else inf."""
    one, two, start = q - p, s - r, p - r
    aa, bb, ab = _square(one), _square(two), _dot(one, two)
    a0, b0 = _dot(one, start), _dot(two, start)
    with np.errstate(all="ignore"):
        x = (ab * b0 - a0 * bb) / (aa * bb - ab * ab)
        y = (ab * x + b0) / bb
    inside = (x >= 0) & (x <= 1) & (y >= 0) & (y <= 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    way = start + x[..., None] * one - y[..., None] * two
    return np.where(inside, np.sqrt(_square(way)), np.inf)


def _features(shape):
    """Corners (V, 3), triangles (T, 3), edges (E, 2) and face normals (F, 3) of a polytope."""
    corners = corners_of(shape)
    hull = ConvexHull(corners)
    triangles = hull.simplices
    edges = {tuple(sorted(e)) for t in triangles.tolist() for e in itertools.combinations(t, 2)}
    normals = np.unique(hull.equations[:, :3].round(15), axis=0)
    return corners, triangles, np.array(sorted(edges)), normals


def polytopes(a, turn_a, b, turn_b, offset):
    """Signed distance (M,) of two boxes or hulls: all features against all."""
    (va, ta, ea, na), (vb, tb, eb, nb) = _features(a), _features(b)
    pa, pb = world(turn_a, va), world(turn_b, vb) + offset[:, None]
    apart = np.full(len(offset), np.inf)
    for corners, faces, tri in ((pa, pb, tb), (pb, pa, ta)):
        for t in tri:
            q, r, s = (faces[:, k, None] for k in t)
            apart = np.minimum(apart, _point_triangle(corners, q, r, s).min(axis=1))
    for e in ea:
        p, q = pa[:, e[0], None], pa[:, e[1], None]
        apart = np.minimum(apart, _segments(p, q, pb[:, eb[:, 0]], pb[:, eb[:, 1]]).min(axis=1))
    # The axes of the separating-axis theorem, both ways
    one = pa[:, ea[:, 1]] - pa[:, ea[:, 0]]
    two = pb[:, eb[:, 1]] - pb[:, eb[:, 0]]
    best = np.full(len(offset), -np.inf)

    def look(n):
        nonlocal best
        low = np.minimum(_along(pa, n).min(axis=1) - _along(pb, n).max(axis=1), np.inf)
        high = _along(pb, n).min(axis=1) - _along(pa, n).max(axis=1)
        best = np.maximum(best, np.maximum(low, high))

    for n in na:
        look(turn_a @ n)
    for n in nb:
        look(turn_b @ n)
    for e, f in itertools.product(range(len(ea)), range(len(eb))):
        n = np.cross(one[:, e], two[:, f])
        size = np.sqrt(_square(n))
        scale = np.sqrt(_square(one[:, e]) * _square(two[:, f]))
        fine = size > 1e-7 * scale
        n = np.where(fine[:, None], n / np.where(fine, size, 1)[:, None], turn_a @ na[0])
        look(n)
    return np.where(best > 0, apart, best)


def _along(points, n):
    return np.einsum("mvi,mi->mv", points, n)


def deepest(a, turn_a, b, turn_b, offset, count=4000):
    """Signed distance of two shapes that overlap (turns (3, 3)): the best of many normals."""
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    n = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], 1)
    # Axes that a smooth search would miss
    n = np.concatenate([n, turn_a.T, -turn_a.T, turn_b.T, -turn_b.T])

    def separations(n):
        many = len(n)
        turns = (np.broadcast_to(turn, (many, 3, 3)) for turn in (turn_a, turn_b))
        one, two = turns
        return separation(a, one, b, two, np.broadcast_to(offset, (many, 3)), n)

    value = separations(n)
    best = value.max()
    for start in n[np.argsort(-value)[:4]]:

        def depth(x):
            return -separations((x / np.linalg.norm(x))[None])[0]

        options = {"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000}
        simplex = np.stack([start, *(start + 0.02 * np.eye(3))])
        found = minimize(
            depth, start, method="Nelder-Mead", options={**options, "initial_simplex": simplex}
        )
        best = max(best, -found.fun)
    return best
