"""Refinement of the contact normal between edges, corners and rims to machine precision.

GJK finds a distance to machine precision. The direction of a distance of 0.1 mm between two rims
has an error of about 1e-4, since the distance hardly depends on it. Here Newton's method solves for
the direction between the closest points of two features.
"""

import math

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.minkowski import Mat3, rotate_to_body, shape_margin, support_point
from bulletuav.geometry.rotation import Vec3, cross, dot, minus, plus
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE

FEATURE_TOLERANCE = 1e-5
"""Distance from an edge or rim within which a closest point counts as lying on it, m"""
MAX_ITERATIONS = 8
"""Maximum number of Newton iterations"""
CONVERGED_STEP = 1e-13
"""Change of the direction at which Newton's method has converged"""
MAX_CORRECTION = 1e-3
"""Maximum change of the direction in a Newton step; larger steps are no correction. Also the sine
below which edges count as parallel, and a rim as seen along its axis
"""
BOUND_TOLERANCE = 1e-12
"""Tolerance by which the separation along the refined direction may be smaller, m"""
ORIGIN = (0.0, 0.0, 0.0)

Feature = tuple[bool, Vec3, Vec3, float]
"""Whether it is no face, direction of its edge or zeros, axis of a rim or face, radius of a rim."""


@func
def _classify_feature(table: ShapeTable, s: int, rotation: Mat3, place: Vec3) -> Feature:
    """Return the feature of a shape on which a point, relative to its position, lies."""
    kind = table.kind[s]
    # A sphere is a point with a margin: no edge and no rim
    if kind == SPHERE:
        return True, ORIGIN, ORIGIN, 0.0
    # From here on in the shape's own axes
    local = rotate_to_body(rotation, place)
    if kind == CYLINDER:
        # Side and end together are the rim; the side alone has lines along the axis
        radius = table.half[s, 0]
        on_side = math.sqrt(local[0] * local[0] + local[1] * local[1]) > radius - FEATURE_TOLERANCE
        on_end = abs(local[2]) > table.half[s, 2] - FEATURE_TOLERANCE
        return on_side, ORIGIN if on_end else rotation[2], rotation[2], radius
    if kind == BOX:
        # On two faces it is an edge along the third axis, on three a corner
        inner = ORIGIN
        outer = ORIGIN
        found = 0
        for k in range(3):
            axis = rotation[0] if k == 0 else (rotation[1] if k == 1 else rotation[2])
            if abs(local[k] - table.centre[s, k]) > table.half[s, k] - FEATURE_TOLERANCE:
                found += 1
                outer = axis
            else:
                inner = axis
        return found >= 2, inner if found == 2 else ORIGIN, outer, 0.0
    # Features of hulls are not classified: the normal of `gjk_distance` stays
    return False, ORIGIN, ORIGIN, 0.0


@func
def orthogonal_part(edge: Vec3, v: Vec3) -> Vec3:
    """Return the part of v that is orthogonal to a unit vector; v itself if that vector is zero."""
    return plus(v, -dot(v, edge), edge)


@func
def _rim_point_derivative(feature: Feature, d: Vec3, moved: Vec3) -> Vec3:
    """Return the change of the support point of a rim along d when d changes by `moved`."""
    _, _, axis, radius = feature
    if radius == 0.0:
        return ORIGIN
    # The farthest point of the rim lies outwards, across the axis
    outward = orthogonal_part(axis, d)
    size = math.sqrt(dot(outward, outward))
    radial = (outward[0] / size, outward[1] / size, outward[2] / size)
    # Only the part of the change about the axis moves it
    along = orthogonal_part(radial, orthogonal_part(axis, moved))
    return plus(ORIGIN, radius / size, along)


@func
def _is_rim_degenerate(feature: Feature, d: Vec3) -> bool:
    """Return True if a rim has no unique support point along d, close to its axis."""
    outward = orthogonal_part(feature[2], d)
    return feature[3] > 0.0 and dot(outward, outward) < MAX_CORRECTION * MAX_CORRECTION


@func
def support_pair(
    table: ShapeTable, a: int, rotation_a: Mat3, b: int, rotation_b: Mat3, offset: Vec3, d: Vec3
) -> tuple[Vec3, Vec3, Vec3]:
    """Return the support points of a along -d and of b along d, and the vector between them.

    The vector is from the point on b to the point on a. Spheres are represented by their centres.
    """
    on_a = support_point(table, a, rotation_a, (-d[0], -d[1], -d[2]))
    on_b = support_point(table, b, rotation_b, d)
    return on_a, on_b, minus(minus(on_a, on_b), offset)


@func
def _separation_along(
    table: ShapeTable, a: int, rotation_a: Mat3, b: int, rotation_b: Mat3, offset: Vec3, d: Vec3
) -> tuple[float, Vec3]:
    """Return the separation of two shapes along a direction and the support points' offset, m."""
    _, _, separation = support_pair(table, a, rotation_a, b, rotation_b, offset, d)
    return dot(separation, d) - shape_margin(table, a) - shape_margin(table, b), separation


@func
def closest_line_parameters(
    one: Vec3, two: Vec3, square: float, separation: Vec3
) -> tuple[float, float]:
    """Return the distances along two skew lines to the points where the lines are closest, m.

    Args:
        one: Direction of the first line, a unit vector.
        two: Direction of the second line, a unit vector.
        square: Squared length of their cross product.
        separation: Vector from the point on the second line to the point on the first, m.

    Returns:
        Distance to move along the first line, and along the second.
    """
    slant = dot(one, two)
    far = (slant * dot(separation, two) - dot(separation, one)) / square
    return far, dot(separation, two) + slant * far


@func
def _refine_edge_pair(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    one: Vec3,
    two: Vec3,
    before: float,
    given: tuple[Vec3, Vec3, Vec3],
) -> tuple[Vec3, Vec3, Vec3]:
    """Return the direction across two edges, and the closest points on the edges."""
    # Nearly parallel edges do not determine a normal
    d = cross(one, two)
    square = dot(d, d)
    if square < MAX_CORRECTION * MAX_CORRECTION:
        return given
    # From b to a, as before
    scale = 1.0 / math.sqrt(square)
    if dot(d, given[0]) < 0.0:
        scale = -scale
    d = (scale * d[0], scale * d[1], scale * d[2])
    # Another pair of features may be nearer than these edges
    after, separation = _separation_along(table, a, rotation_a, b, rotation_b, offset, d)
    if not after >= before - BOUND_TOLERANCE:
        return given
    # Move along both edges to the closest points of their lines
    far_a, far_b = closest_line_parameters(one, two, square, separation)
    on_a = plus(support_point(table, a, rotation_a, (-d[0], -d[1], -d[2])), far_a, one)
    return d, on_a, plus(support_point(table, b, rotation_b, d), far_b, two)


@func
def newton_step(
    one: Feature,
    two: Feature,
    edge: Vec3,
    d: Vec3,
    found: Vec3,
    size: float,
    first: Vec3,
    second: Vec3,
) -> tuple[float, float]:
    """Compute the Newton step of the direction between two features.

    Args:
        one: Feature of the first shape.
        two: Feature of the second shape.
        edge: Direction of an edge to which the direction stays orthogonal, or zeros.
        d: Current direction.
        found: Direction between the support points along d.
        size: Distance of these points, m.
        first: Unit vector orthogonal to d.
        second: Unit vector orthogonal to both.

    Returns:
        Components of the step along the first and the second vector; NaN if the step is
        undetermined.
    """
    # Derivative of the direction between the support points with respect to d
    turned_first = direction_derivative(one, two, edge, d, first, size)
    turned_second = direction_derivative(one, two, edge, d, second, size)
    m11 = 1.0 - dot(turned_first, first)
    m21 = -dot(turned_first, second)
    m12 = -dot(turned_second, first)
    m22 = 1.0 - dot(turned_second, second)
    # Solve (1 - turning) step = found - d
    error = minus(found, d)
    r1 = dot(error, first)
    r2 = dot(error, second)
    scale = 1.0 / (m11 * m22 - m12 * m21)
    return scale * (m22 * r1 - m12 * r2), scale * (m11 * r2 - m21 * r1)


@kernel
def refine_normal(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    normal: Vec3,
    on_a: Vec3,
    on_b: Vec3,
) -> tuple[Vec3, Vec3, Vec3]:
    """Refine the contact normal of two shapes and their closest points to machine precision.

    Args:
        table: The shapes.
        a: Index of the first shape.
        rotation_a: Axes of the first shape.
        b: Index of the second shape, which is no half-space.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, world axes, m.
        normal: Unit normal from b to a, as returned by `gjk_distance`; returned unchanged between
            faces.
        on_a: Closest point on a, relative to its position, world axes, m.
        on_b: Closest point on b, relative to its position, world axes, m.

    Returns:
        The unit normal, and the closest points on a and b.
    """
    # Returned if the refinement fails
    given = (normal, on_a, on_b)
    one = _classify_feature(table, a, rotation_a, on_a)
    two = _classify_feature(table, b, rotation_b, on_b)
    # Two faces: the direction is exact already
    if not (one[0] or two[0]):
        return given
    # Separation along the given normal, which must not decrease
    before, _ = _separation_along(table, a, rotation_a, b, rotation_b, offset, normal)
    if one[0] != two[0]:
        # A corner, edge or rim on a face: across the face
        axis = two[2] if one[0] else one[2]
        sign = 1.0 if dot(axis, normal) > 0.0 else -1.0
        d = plus(ORIGIN, sign, axis)
        after, _ = _separation_along(table, a, rotation_a, b, rotation_b, offset, d)
        # An edge may lie on the face all along: no single point of it is nearest
        edge = one[1] if one[0] else two[1]
        if dot(edge, edge) > 0.0 or not after >= before - BOUND_TOLERANCE:
            return given
        # The point is exact; the other is its foot on the face
        if one[0]:
            on_a = plus(
                support_point(table, a, rotation_a, plus(ORIGIN, -1.0, d)),
                -shape_margin(table, a),
                d,
            )
            return d, on_a, plus(minus(on_a, offset), -after, d)
        on_b = plus(support_point(table, b, rotation_b, d), shape_margin(table, b), d)
        return d, plus(plus(on_b, 1.0, offset), after, d), on_b
    # Two edges that cross
    if dot(one[1], one[1]) > 0.0 and dot(two[1], two[1]) > 0.0:
        return _refine_edge_pair(
            table, a, rotation_a, b, rotation_b, offset, one[1], two[1], before, given
        )
    # Corners are exact, and rims seen along their axis are as good as faces
    round_one = one[3] > 0.0 or two[3] > 0.0
    if not round_one or _is_rim_degenerate(one, normal) or _is_rim_degenerate(two, normal):
        return given
    # A rim: Newton's method on the direction, orthogonal to an edge if there is one
    edge = one[1] if dot(one[1], one[1]) > 0.0 else two[1]
    d = normal
    for _ in range(MAX_ITERATIONS):
        # The vector between the support points along d must be parallel to d
        _, separation = _separation_along(table, a, rotation_a, b, rotation_b, offset, d)
        separation = orthogonal_part(edge, separation)
        size = math.sqrt(dot(separation, separation))
        if size == 0.0:
            return given
        # If the shapes overlap, the vector points backwards
        found = (separation[0] / size, separation[1] / size, separation[2] / size)
        if dot(found, d) < 0.0:
            found = (-found[0], -found[1], -found[2])
            size = -size
        # Basis of the tangent plane at d, in which a step has two components
        first = cross(d, (1.0, 0.0, 0.0) if abs(d[0]) < 0.7 else (0.0, 1.0, 0.0))
        scale = 1.0 / math.sqrt(dot(first, first))
        first = (scale * first[0], scale * first[1], scale * first[2])
        second = cross(d, first)
        step_first, step_second = newton_step(one, two, edge, d, found, size, first, second)
        # A step that is too long, or NaN, comes from degenerate rims
        step = math.sqrt(step_first * step_first + step_second * step_second)
        if not step < MAX_CORRECTION:
            return given
        # Normalise
        d = plus(plus(d, step_first, first), step_second, second)
        scale = 1.0 / math.sqrt(dot(d, d))
        d = (scale * d[0], scale * d[1], scale * d[2])
        if step < CONVERGED_STEP:
            break
    # The separation must not decrease
    after, _ = _separation_along(table, a, rotation_a, b, rotation_b, offset, d)
    if not after >= before - BOUND_TOLERANCE:
        return given
    on_a = plus(
        support_point(table, a, rotation_a, (-d[0], -d[1], -d[2])), -shape_margin(table, a), d
    )
    on_b = plus(support_point(table, b, rotation_b, d), shape_margin(table, b), d)
    # Along an edge, the point opposite the point on the other shape
    ahead = dot(minus(on_b, on_a), edge) + dot(offset, edge)
    if dot(one[1], one[1]) > 0.0:
        on_a = plus(on_a, ahead, edge)
    else:
        on_b = plus(on_b, -ahead, edge)
    return d, on_a, on_b


@func
def direction_derivative(
    one: Feature, two: Feature, edge: Vec3, d: Vec3, moved: Vec3, size: float
) -> Vec3:
    """Return the change of the direction between two features when d changes by `moved`."""
    back = (-d[0], -d[1], -d[2])
    against = (-moved[0], -moved[1], -moved[2])
    separation = minus(
        _rim_point_derivative(one, back, against), _rim_point_derivative(two, d, moved)
    )
    return plus(ORIGIN, 1.0 / size, orthogonal_part(edge, separation))
