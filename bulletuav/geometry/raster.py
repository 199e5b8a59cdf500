"""Rasteriser of pinhole cameras: pictures equal to those by casting a ray through each pixel.

A pixel's ray has the points eye + t direction, m. Its direction is FAR (forward + x left + y up),
so that t is the fraction of the depth FAR. For a plane, 1/t is linear in x and y. A ray from
outside a convex solid enters it through the front plane with the least 1/t, if it lies in the
half-spaces of the planes through the eye and the edges of the silhouette, between a front and a
back face. Each row of pixels is therefore a span of columns, in which 1/t is the minimum of linear
functions, without any division or clipping. The buffer of 1/t keeps the maximum.

Blocks of buildings are drawn front to back, and skipped if they are out of view, or behind the
smallest 1/t in each tile of pixels they cover. Rays are cast only in the rectangles of pixels of
round shapes, and if the eye is inside a solid.

The solids, what rays hit, and hits from inside are those of `bulletuav.geometry.raycast`. Of
surfaces at the same depth, that with the lower id is shown.

References:
    J. Olano and T. Greer, Triangle scan conversion using 2D homogeneous coordinates (1997).
    N. Greene, M. Kass and G. Miller, Hierarchical z-buffer visibility (1993): the tiles.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.raycast import Poses, intersect_shape
from bulletuav.geometry.rotation import (
    Quat4Like,
    Vec3,
    Vec3Like,
    axes,
    dot,
    minus,
    plus,
    point,
    quat4,
    to_body,
    to_world,
    vec3,
)
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import BOX, HULL, SPHERE, intersect_box
from bulletuav.geometry.view import FAR
from bulletuav.geometry.view_blocks import GROUND_FACE, SKY_FACE, Faces, ViewBlocks

TILE = 8
"""Side of a tile, pixels"""
SLACK = 1e-6
"""Margin of rectangles of pixels, against rounding, pixels"""
EDGE_SLACK = 1e-9
"""Distance from an edge within which pixels belong to a solid, pixels"""
NEAREST = 1e-3
"""Depth of a corner below which a solid may cover the whole picture, m"""
MAX_FLOW = 1000.0
"""Maximum of the flow along each axis, pixels"""
CHECKER_SIDE = 5.0
"""Side of the squares of the ground in colour pictures, m"""
CHECKER_CONTRAST = 24.0
"""Difference of the colours of these squares near the camera, from 0 to 255"""
CHECKER_REACH = 40.0
"""Depth at which half of this difference is left, m"""

View = tuple[Vec3, Vec3, Vec3, Vec3]
"""Eye of a camera, m, and its axes: forward, left and up."""
Rectangle = tuple[int, int, int, int]
"""First row, last row, first column and last column of pixels; empty if a first is above a last."""

BoxAxis = tuple[float, float, float, float, float, float]
"""Components along one axis: eye, low and high corner of a box, forward, left and up."""
Counts = tuple[int, int]
"""Number of front planes and of silhouette edges of a solid."""


class PixelRays(NamedTuple):
    """Directions of the rays through the pixels of a picture: forward + x left + y up.

    Attributes:
        x: (width,) x of each column.
        y: (height,) y of each row.
    """

    x: np.ndarray
    y: np.ndarray


class Canvas(NamedTuple):
    """Memory for drawing one picture at a time; see `make_canvas`.

    Attributes:
        inverse: (height, width) 1/t of the nearest surface; 1 for the sky.
        face: (height, width) its id, see `view_blocks.Faces`; (0, 0) if ids are not needed.
        tile_minimum: Minimum of `inverse` in each tile.
        is_stale: Whether pixels of a tile have changed since.
        key: Squared distances of sorted blocks, m^2.
        order: Sorted blocks.
        piece_key: Squared distances of sorted pieces, m^2.
        piece_order: Sorted pieces.
        above: Height of the eye above each plane of a hull, m.
        plane: (P, 3) 1/t on each front plane: constant, and coefficients of x and y.
        plane_face: (P,) ids of these faces.
        edge: (E, 3) silhouette edges: the side on which the span lies (1: right of it, -1: left,
            0: everywhere if the rest is at least 0), constant, and coefficient of the row.
        row: (width,) 1/t of a solid in one row.
        row_face: (width,) ids of the faces in this row.
    """

    inverse: np.ndarray
    face: np.ndarray
    tile_minimum: np.ndarray
    is_stale: np.ndarray
    key: np.ndarray
    order: np.ndarray
    piece_key: np.ndarray
    piece_order: np.ndarray
    above: np.ndarray
    plane: np.ndarray
    plane_face: np.ndarray
    edge: np.ndarray
    row: np.ndarray
    row_face: np.ndarray


class Cameras(NamedTuple):
    """C cameras.

    Attributes:
        world: (C,) world of each camera.
        drone: (C,) drone which each camera does not show, as it carries it; -1 for none.
        eye: (C, 3) positions, m.
        quaternion: (C, 4) attitudes: the camera looks along x, with y left and z up.
        tangent: (C,) tangents of half of the vertical fields of view.
        slot: (C,) index of each camera's pictures in `Images`.
    """

    world: np.ndarray
    drone: np.ndarray
    eye: np.ndarray
    quaternion: np.ndarray
    tangent: np.ndarray
    slot: np.ndarray


class Paint(NamedTuple):
    """Colours of pictures in W worlds, or in all of them alike (W = 1).

    Attributes:
        colour: (W, F, 3) uint8, red, green and blue of each face; those of the ground are at least
            CHECKER_CONTRAST.
        windows: (W, 4) windows of buildings: distance from one to the next along a wall and up, m,
            fraction of these distances that they take, and their brightness relative to the wall,
            from -255 to 255; 0 for none.
    """

    colour: np.ndarray
    windows: np.ndarray


class Earlier(NamedTuple):
    """Poses of cameras, drones and bodies at an earlier time, from which flow is measured.

    Attributes:
        eye: (C, 3) positions of the cameras, m.
        quaternion: (C, 4) their attitudes.
        drones: Positions (W, N, 3), m, and attitudes (W, N, 4) of the drones.
        bodies: Positions (W, R, 3), m, and attitudes (W, R, 4) of the bodies.
    """

    eye: np.ndarray
    quaternion: np.ndarray
    drones: tuple[np.ndarray, np.ndarray]
    bodies: tuple[np.ndarray, np.ndarray]


class Images(NamedTuple):
    """Pictures to be drawn; those with no rows are not.

    Attributes:
        depth: (P, height, width) float32, distance along the view axis, m; FAR for the sky.
        labels: (P, height, width) uint8: SKY, LAND, BUILDING, OBSTACLE or DRONE.
        colours: (P, height, width, 3) uint8, red, green, blue.
        normals: (P, height, width, 3) float32, outward unit normals of the surfaces in the axes of
            the camera (x along the view axis, y left, z up); zero for the sky. From within a box or
            hull, they are those of one of its faces.
        flow: (P, height, width, 2) float32, motion of the shown points of surfaces since an earlier
            time, to the right and down, pixels, up to MAX_FLOW; zero for points that were behind
            the camera. The sky is infinitely far away.
    """

    depth: np.ndarray
    labels: np.ndarray
    colours: np.ndarray
    normals: np.ndarray = np.zeros((0, 1, 1, 3), dtype=np.float32)
    flow: np.ndarray = np.zeros((0, 1, 1, 2), dtype=np.float32)


def make_pixel_rays(width: int, height: int, tangent: float = 1.0) -> PixelRays:
    """Return the rays of a picture, through the upper left corners of its pixels.

    The centre of projection is in column width / 2 and row height / 2 - 1.

    Args:
        width: Number of columns.
        height: Number of rows.
        tangent: Tangent of half of the vertical field of view.

    Returns:
        The rays.
    """
    rays = PixelRays(np.empty(width), np.empty(height))
    _set_rays(rays, tangent)
    return rays


def make_canvas(
    rays: PixelRays, table: ShapeTable, faces: Faces, blocks: ViewBlocks, has_faces: bool
) -> Canvas:
    """Allocate the memory for drawing pictures.

    Args:
        rays: Rays of the pictures.
        table: Shapes of the worlds.
        faces: Their faces.
        blocks: Blocks of the city layouts.
        has_faces: Whether ids of faces are needed, for all images but depths.

    Returns:
        The memory.
    """
    width, height = len(rays.x), len(rays.y)
    tiles = (-(-height // TILE), -(-width // TILE))
    num_blocks = int(np.diff(blocks.first).max(initial=0))
    num_pieces = int(np.diff(blocks.piece_first).max(initial=0))
    num_faces = max(6, int(np.diff(table.face_range).max(initial=0)))
    num_edges = max(12, int(np.diff(faces.edge_range).max(initial=0)))
    return Canvas(
        inverse=np.empty((height, width)),
        face=np.empty((height, width) if has_faces else (0, 0), dtype=np.int32),
        tile_minimum=np.empty(tiles),
        is_stale=np.empty(tiles, dtype=np.bool_),
        key=np.empty(num_blocks),
        order=np.empty(num_blocks, dtype=np.int64),
        piece_key=np.empty(num_pieces),
        piece_order=np.empty(num_pieces, dtype=np.int64),
        above=np.empty(num_faces),
        plane=np.empty((num_faces, 3)),
        plane_face=np.empty(num_faces, dtype=np.int32),
        edge=np.empty((num_edges, 3)),
        row=np.empty(width),
        row_face=np.empty(width, dtype=np.int32),
    )


@kernel
def _set_rays(rays: PixelRays, tangent: float) -> None:
    """Write the rays of a camera; see `make_pixel_rays`."""
    width = rays.x.shape[0]
    height = rays.y.shape[0]
    for u in range(width):
        rays.x[u] = tangent * width / height * (1 - 2 * u / width)
    for v in range(height):
        rays.y[v] = tangent * (1 - 2 * (v + 1) / height)


@func
def _is_hidden(canvas: Canvas, rectangle: Rectangle, bound: float) -> bool:
    """Return True if every pixel of a rectangle shows a surface with 1/t above a bound."""
    first_row, last_row, first_column, last_column = rectangle
    height, width = canvas.inverse.shape
    for i in range(first_row // TILE, last_row // TILE + 1):
        for j in range(first_column // TILE, last_column // TILE + 1):
            # The old minimum is a lower bound, as 1/t only grows
            if canvas.tile_minimum[i, j] > bound:
                continue
            if not canvas.is_stale[i, j]:
                return False
            smallest = np.inf
            for v in range(TILE * i, min(TILE * i + TILE, height)):
                for u in range(TILE * j, min(TILE * j + TILE, width)):
                    smallest = min(smallest, canvas.inverse[v, u])
            canvas.tile_minimum[i, j] = smallest
            canvas.is_stale[i, j] = False
            if smallest <= bound:
                return False
    return True


@func
def _mark_stale(canvas: Canvas, rectangle: Rectangle) -> None:
    """Note that the pixels of a rectangle have changed."""
    first_row, last_row, first_column, last_column = rectangle
    for i in range(first_row // TILE, last_row // TILE + 1):
        for j in range(first_column // TILE, last_column // TILE + 1):
            canvas.is_stale[i, j] = True


@func
def _is_inside(place: Vec3, low: Vec3, high: Vec3) -> bool:
    """Return True if a point is in a box or on its surface."""
    for k in range(3):
        if not low[k] <= place[k] <= high[k]:
            return False
    return True


@func
def _largest_dot(normal: Vec3, low: Vec3, high: Vec3) -> float:
    """Return the largest dot product of a vector with a point of a box."""
    return (
        max(normal[0] * low[0], normal[0] * high[0])
        + max(normal[1] * low[1], normal[1] * high[1])
        + max(normal[2] * low[2], normal[2] * high[2])
    )


@func
def _sum(a: float, u: Vec3, b: float, v: Vec3) -> Vec3:
    """Return the vector a u + b v."""
    return a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2]


@func
def _is_in_view(rays: PixelRays, view: View, low: Vec3, high: Vec3) -> bool:
    """Return True if a box may be in view; its corners are relative to the eye."""
    _, forward, left, up = view
    # Written so that an eye that is not finite sees nothing
    if not _largest_dot(forward, low, high) > 0.0:
        return False
    nearest = -_largest_dot(_sum(-1.0, forward, 0.0, forward), low, high)
    if not nearest < FAR:
        return False
    # The box is out of view if it is beyond one of the four sides.
    x = rays.x[0]
    y = -rays.y[rays.y.shape[0] - 1]
    return (
        _largest_dot(_sum(x, forward, 1.0, left), low, high) >= 0.0
        and _largest_dot(_sum(x, forward, -1.0, left), low, high) >= 0.0
        and _largest_dot(_sum(y, forward, 1.0, up), low, high) >= 0.0
        and _largest_dot(_sum(y, forward, -1.0, up), low, high) >= 0.0
    )


@kernel
def _cover_box(view: View, rays: PixelRays, low: Vec3, high: Vec3) -> tuple[Rectangle, float]:
    """Return the rectangle of pixels that may show a box, and an upper bound of 1/t.

    Args:
        view: Eye and axes of the camera, in the axes of the box.
        rays: Rays of the picture.
        low: Corner of minimum coordinates, m.
        high: Corner of maximum coordinates, m.

    Returns:
        The rectangle, empty if the box is out of view, and the bound.
    """
    eye, forward, left, up = view
    width = rays.x.shape[0]
    height = rays.y.shape[0]
    nothing = (0, -1, 0, -1)
    everything = (0, height - 1, 0, width - 1)
    # From its surface, even rays that point away from the box hit it
    if _is_inside(eye, low, high):
        return everything, np.inf
    low = minus(low, eye)
    high = minus(high, eye)
    if not _is_in_view(rays, view, low, high):
        return nothing, 0.0
    nearest = -_largest_dot(_sum(-1.0, forward, 0.0, forward), low, high)
    if nearest <= NEAREST:
        return everything, np.inf
    # Project the corners
    right_x = np.inf
    left_x = -np.inf
    low_y = np.inf
    high_y = -np.inf
    for corner in range(8):
        x = high[0] if corner & 1 else low[0]
        y = high[1] if corner & 2 else low[1]
        z = high[2] if corner & 4 else low[2]
        inverse = 1.0 / (forward[0] * x + forward[1] * y + forward[2] * z)
        across = (left[0] * x + left[1] * y + left[2] * z) * inverse
        rise = (up[0] * x + up[1] * y + up[2] * z) * inverse
        right_x = min(right_x, across)
        left_x = max(left_x, across)
        low_y = min(low_y, rise)
        high_y = max(high_y, rise)
    # Columns and rows from x and y: the inverse of `make_pixel_rays`
    half_x = rays.x[0]
    half_y = -rays.y[height - 1]
    first_u = max(0.5 * width * (1.0 - left_x / half_x) - SLACK, 0.0)
    last_u = min(0.5 * width * (1.0 - right_x / half_x) + SLACK, width - 1.0)
    first_v = max(0.5 * height * (1.0 - high_y / half_y) - 1.0 - SLACK, 0.0)
    last_v = min(0.5 * height * (1.0 - low_y / half_y) - 1.0 + SLACK, height - 1.0)
    if not (first_u <= last_u and first_v <= last_v):
        return nothing, 0.0
    rectangle = (
        math.ceil(first_v),
        math.floor(last_v),
        math.ceil(first_u),
        math.floor(last_u),
    )
    # Rounding of the planes' 1/t must not exceed the bound
    return rectangle, FAR / nearest * (1.0 + 1e-9)


@func
def _is_empty(rectangle: Rectangle) -> bool:
    """Return True if a rectangle has no pixels."""
    return rectangle[0] > rectangle[1] or rectangle[2] > rectangle[3]


@func
def _add_edge(canvas: Canvas, rays: PixelRays, number: int, a: float, b: float, c: float) -> int:
    """Add the silhouette edge whose inner side is a + b x + c y >= 0; return the new number."""
    # x and y are linear in the column u and the row v
    height = rays.y.shape[0]
    step_x = -2.0 * rays.x[0] / rays.x.shape[0]
    step_y = 2.0 * rays.y[height - 1] / height
    first = a + b * rays.x[0] + c * rays.y[0]
    slope = b * step_x
    rise = c * step_y
    # Rays through an edge, but for rounding, meet the solid: no gap is left between two solids
    if slope != 0.0:
        side = 1.0 if slope > 0.0 else -1.0
        canvas.edge[number, 0] = side
        canvas.edge[number, 1] = -first / slope - side * EDGE_SLACK
        canvas.edge[number, 2] = -rise / slope
    else:
        scale = 1.0 / abs(rise) if rise != 0.0 else 1.0
        canvas.edge[number, 0] = 0.0
        canvas.edge[number, 1] = first * scale + EDGE_SLACK
        canvas.edge[number, 2] = rise * scale
    return number + 1


@func
def _find_span(canvas: Canvas, edges: int, v: int, first: int, last: int) -> tuple[int, int]:
    """Return the first and last column of a solid in row v, between two columns."""
    low = float(first)
    high = float(last)
    for e in range(edges):
        place = canvas.edge[e, 1] + canvas.edge[e, 2] * v
        if canvas.edge[e, 0] > 0.0:
            low = max(low, place)
        elif canvas.edge[e, 0] < 0.0:
            high = min(high, place)
        elif place < 0.0:
            return 0, -1
    if not low <= high:
        return 0, -1
    return math.ceil(low), math.floor(high)


@func
def _fill_one(
    canvas: Canvas, x: np.ndarray, v: int, first: int, last: int, a: float, b: float, face: int
) -> None:
    """Draw one plane, 1/t = a + b x, in a span of row v."""
    inverse = canvas.inverse
    if canvas.face.size == 0:
        for u in range(first, last + 1):
            z = a + b * x[u]
            inverse[v, u] = z if z > inverse[v, u] else inverse[v, u]
        return
    faces = canvas.face
    f = np.int32(face)
    for u in range(first, last + 1):
        z = a + b * x[u]
        old = inverse[v, u]
        is_shown = (z > old) | ((z == old) & (f < faces[v, u]))
        faces[v, u] = f if is_shown else faces[v, u]
        inverse[v, u] = z if is_shown else old


@func
def _fill_two(
    canvas: Canvas,
    x: np.ndarray,
    v: int,
    first: int,
    last: int,
    one: tuple[float, float, int],
    two: tuple[float, float, int],
) -> None:
    """Draw the smaller 1/t of two planes in a span of row v."""
    a, b, face = one
    a2, b2, face2 = two
    inverse = canvas.inverse
    if canvas.face.size == 0:
        for u in range(first, last + 1):
            z = a + b * x[u]
            z2 = a2 + b2 * x[u]
            z = z2 if z2 < z else z
            inverse[v, u] = z if z > inverse[v, u] else inverse[v, u]
        return
    faces = canvas.face
    f1 = np.int32(face)
    f2 = np.int32(face2)
    for u in range(first, last + 1):
        z = a + b * x[u]
        z2 = a2 + b2 * x[u]
        f = f2 if z2 < z else f1
        z = z2 if z2 < z else z
        old = inverse[v, u]
        is_shown = (z > old) | ((z == old) & (f < faces[v, u]))
        faces[v, u] = f if is_shown else faces[v, u]
        inverse[v, u] = z if is_shown else old


@func
def _fill_many(
    canvas: Canvas, x: np.ndarray, v: int, first: int, last: int, planes: int, y: float
) -> None:
    """Draw the smallest 1/t of several planes in a span of row v."""
    inverse = canvas.inverse
    row = canvas.row
    has_faces = canvas.face.size > 0
    for m in range(planes):
        a = canvas.plane[m, 0] + canvas.plane[m, 2] * y
        b = canvas.plane[m, 1]
        face = canvas.plane_face[m]
        if m == 0:
            for u in range(first, last + 1):
                row[u] = a + b * x[u]
                canvas.row_face[u] = face
        elif has_faces:
            for u in range(first, last + 1):
                z = a + b * x[u]
                canvas.row_face[u] = face if z < row[u] else canvas.row_face[u]
                row[u] = z if z < row[u] else row[u]
        else:
            for u in range(first, last + 1):
                z = a + b * x[u]
                row[u] = z if z < row[u] else row[u]
    if not has_faces:
        for u in range(first, last + 1):
            inverse[v, u] = row[u] if row[u] > inverse[v, u] else inverse[v, u]
        return
    faces = canvas.face
    for u in range(first, last + 1):
        old = inverse[v, u]
        z = row[u]
        f = canvas.row_face[u]
        is_shown = (z > old) | ((z == old) & (f < faces[v, u]))
        faces[v, u] = f if is_shown else faces[v, u]
        inverse[v, u] = z if is_shown else old


@kernel
def _fill_spans(
    canvas: Canvas, rays: PixelRays, rectangle: Rectangle, planes: int, edges: int
) -> None:
    """Draw a solid from its front planes and silhouette edges in `canvas`."""
    first_row, last_row, first_column, last_column = rectangle
    plane = canvas.plane
    for v in range(first_row, last_row + 1):
        first, last = _find_span(canvas, edges, v, first_column, last_column)
        if first > last:
            continue
        y = rays.y[v]
        a = plane[0, 0] + plane[0, 2] * y
        if planes == 1:
            _fill_one(canvas, rays.x, v, first, last, a, plane[0, 1], canvas.plane_face[0])
        elif planes == 2:
            one = (a, plane[0, 1], canvas.plane_face[0])
            two = (plane[1, 0] + plane[1, 2] * y, plane[1, 1], canvas.plane_face[1])
            _fill_two(canvas, rays.x, v, first, last, one, two)
        else:
            _fill_many(canvas, rays.x, v, first, last, planes, y)


@func
def _show(canvas: Canvas, v: int, u: int, enters: float, leaves: float, face: int) -> None:
    """Draw a ray's hit from outside, or where the ray leaves if it starts inside."""
    if enters > leaves or leaves < 0.0:
        return
    fraction = enters if enters >= 0.0 else leaves
    z = 1.0 / fraction if fraction > 0.0 else np.inf
    old = canvas.inverse[v, u]
    if z > old:
        canvas.inverse[v, u] = z
        if canvas.face.size:
            canvas.face[v, u] = face
    elif z == old and canvas.face.size:
        canvas.face[v, u] = min(face, canvas.face[v, u])


@func
def _ray(rays: PixelRays, view: View, v: int, u: int) -> Vec3:
    """Return the vector from the eye to the point at depth FAR of a pixel's ray, m."""
    _, forward, left, up = view
    x = rays.x[u]
    y = rays.y[v]
    return (
        FAR * (forward[0] + x * left[0] + y * up[0]),
        FAR * (forward[1] + x * left[1] + y * up[1]),
        FAR * (forward[2] + x * left[2] + y * up[2]),
    )


@kernel
def _cast_at_box(
    canvas: Canvas,
    rays: PixelRays,
    rectangle: Rectangle,
    view: View,
    low: Vec3,
    high: Vec3,
    face: int,
) -> None:
    """Draw a box by casting the rays of a rectangle of pixels; see `_draw_box`."""
    for v in range(rectangle[0], rectangle[1] + 1):
        for u in range(rectangle[2], rectangle[3] + 1):
            enters, leaves = intersect_box(view[0], _ray(rays, view, v, u), low, high)
            _show(canvas, v, u, enters, leaves, face)


@kernel
def _cast_at_shape(
    canvas: Canvas,
    rays: PixelRays,
    rectangle: Rectangle,
    view: View,
    table: ShapeTable,
    s: int,
    face: int,
    is_drone: bool,
) -> None:
    """Draw a shape by casting the rays of a rectangle of pixels; see `_draw_shape`."""
    for v in range(rectangle[0], rectangle[1] + 1):
        for u in range(rectangle[2], rectangle[3] + 1):
            enters, leaves = intersect_shape(table, s, view[0], _ray(rays, view, v, u))
            # Drones are hit from outside only
            if enters >= 0.0 or not is_drone:
                _show(canvas, v, u, enters, leaves, face)


@func
def _add_box_face(
    canvas: Canvas, rays: PixelRays, face: int, j: BoxAxis, k: BoxAxis, m: BoxAxis, counts: Counts
) -> Counts:
    """Add the front plane of a box along axis j, if there is one, and its silhouette edges."""
    planes, edges = counts
    eye, low, high, forward, left, up = j
    # Between both planes of the axis, or in one of them, the eye sees neither.
    is_below = eye < low
    if not (is_below or eye > high):
        return planes, edges
    sign = 1.0 if is_below else -1.0
    distance = low - eye if is_below else eye - high
    scale = FAR * sign / distance
    canvas.plane[planes, 0] = forward * scale
    canvas.plane[planes, 1] = left * scale
    canvas.plane[planes, 2] = up * scale
    canvas.plane_face[planes] = face if is_below else face + 1
    for other in range(2):
        eye, low, high, forward2, left2, up2 = k if other == 0 else m
        for end in range(2):
            to_back = high - eye if end else eye - low
            if to_back < 0.0:
                continue
            # The ray meets the front plane before the back plane. Both sides are multiplied by the
            # distances, so that an eye in a back plane needs no division by zero.
            mine = sign * to_back
            its = distance if end else -distance
            edges = _add_edge(
                canvas,
                rays,
                edges,
                forward * mine - forward2 * its,
                left * mine - left2 * its,
                up * mine - up2 * its,
            )
    return planes + 1, edges


@func
def _box_axis(view: View, low: Vec3, high: Vec3, k: int) -> BoxAxis:
    """Return the components of a camera and a box along axis k."""
    return view[0][k], low[k], high[k], view[1][k], view[2][k], view[3][k]


@kernel
def _draw_box(
    canvas: Canvas,
    rays: PixelRays,
    rectangle: Rectangle,
    view: View,
    low: Vec3,
    high: Vec3,
    face: int,
) -> None:
    """Draw a box whose faces have the ids from `face`, to a camera in the axes of the box."""
    x = _box_axis(view, low, high, 0)
    y = _box_axis(view, low, high, 1)
    z = _box_axis(view, low, high, 2)
    counts = _add_box_face(canvas, rays, face, x, y, z, (0, 0))
    counts = _add_box_face(canvas, rays, face + 2, y, x, z, counts)
    counts = _add_box_face(canvas, rays, face + 4, z, x, y, counts)
    if counts[0] == 0:
        _cast_at_box(canvas, rays, rectangle, view, low, high, face)
    else:
        _fill_spans(canvas, rays, rectangle, counts[0], counts[1])


@kernel
def _draw_hull(
    canvas: Canvas,
    rays: PixelRays,
    rectangle: Rectangle,
    view: View,
    table: ShapeTable,
    faces: Faces,
    s: int,
    is_drone: bool,
) -> None:
    """Draw a hull to a camera in the axes of the hull."""
    eye, forward, left, up = view
    normal = table.face_planes
    first = table.face_range[s, 0]
    planes = 0
    for f in range(first, table.face_range[s, 1]):
        # In the order of the ray caster's sum
        above = -normal[f, 3]
        for k in range(3):
            above += normal[f, k] * eye[k]
        canvas.above[f - first] = above
        if above > 0.0:
            scale = -FAR / above
            n = point(normal, f)
            canvas.plane[planes, 0] = dot(n, forward) * scale
            canvas.plane[planes, 1] = dot(n, left) * scale
            canvas.plane[planes, 2] = dot(n, up) * scale
            canvas.plane_face[planes] = faces.first[s] + f - first
            planes += 1
    if planes == 0 or faces.edge_range[s, 0] == faces.edge_range[s, 1]:
        _cast_at_shape(canvas, rays, rectangle, view, table, s, faces.first[s], is_drone)
        return
    edges = 0
    for e in range(faces.edge_range[s, 0], faces.edge_range[s, 1]):
        front = faces.edges[e, 0]
        back = faces.edges[e, 1]
        if canvas.above[front - first] <= 0.0:
            front, back = back, front
        of_front = canvas.above[front - first]
        of_back = canvas.above[back - first]
        if of_front > 0.0 >= of_back:
            # As for boxes, without a division: the eye may be in the plane of the back face
            n = point(normal, front)
            m = point(normal, back)
            edges = _add_edge(
                canvas,
                rays,
                edges,
                of_back * dot(n, forward) - of_front * dot(m, forward),
                of_back * dot(n, left) - of_front * dot(m, left),
                of_back * dot(n, up) - of_front * dot(m, up),
            )
    _fill_spans(canvas, rays, rectangle, planes, edges)


@kernel
def _draw_posed_shape(
    canvas: Canvas,
    rays: PixelRays,
    view: View,
    table: ShapeTable,
    faces: Faces,
    s: int,
    place: Vec3Like,
    quaternion: Quat4Like,
    is_drone: bool,
) -> None:
    """Draw a shape at a pose, if it is in view and not hidden."""
    # Most shapes are behind the camera or far away
    here = minus(view[0], place)
    depth = -dot(here, view[1])
    if not -table.radius[s] < depth < FAR + table.radius[s]:
        return
    body_view = (
        to_body(quaternion, here),
        to_body(quaternion, view[1]),
        to_body(quaternion, view[2]),
        to_body(quaternion, view[3]),
    )
    centre = point(table.centre, s)
    half = point(table.half, s)
    low = minus(centre, half)
    high = (centre[0] + half[0], centre[1] + half[1], centre[2] + half[2])
    rectangle, bound = _cover_box(body_view, rays, low, high)
    if _is_empty(rectangle) or _is_hidden(canvas, rectangle, bound):
        return
    kind = table.kind[s]
    face = faces.first[s]
    if kind == HULL:
        _draw_hull(canvas, rays, rectangle, body_view, table, faces, s, is_drone)
    elif kind != BOX or (is_drone and _is_inside(body_view[0], low, high)):
        _cast_at_shape(canvas, rays, rectangle, body_view, table, s, face, is_drone)
    else:
        _draw_box(canvas, rays, rectangle, body_view, low, high, face)
    _mark_stale(canvas, rectangle)


@kernel
def _draw_ground(canvas: Canvas, rays: PixelRays, view: View) -> None:
    """Start a picture with the ground and the sky."""
    eye, forward, left, up = view
    has_faces = canvas.face.size > 0
    inverse = canvas.inverse
    # The ground stops rays from both sides, and at their start if the eye is in it. Products are in
    # the order of those of boxes, so that faces at z = 0 are at the same depth.
    is_off_ground = eye[2] != 0.0
    scale = -FAR / eye[2] if is_off_ground else 1.0
    b = left[2] * scale
    for v in range(rays.y.shape[0]):
        a = forward[2] * scale + up[2] * scale * rays.y[v]
        if not is_off_ground:
            for u in range(rays.x.shape[0]):
                inverse[v, u] = np.inf if a + b * rays.x[u] != 0.0 else 1.0
        else:
            for u in range(rays.x.shape[0]):
                z = a + b * rays.x[u]
                inverse[v, u] = z if z > 1.0 else 1.0
        if has_faces:
            for u in range(rays.x.shape[0]):
                canvas.face[v, u] = GROUND_FACE if inverse[v, u] > 1.0 else SKY_FACE
    for i in range(canvas.is_stale.shape[0]):
        for j in range(canvas.is_stale.shape[1]):
            canvas.tile_minimum[i, j] = 0.0
            canvas.is_stale[i, j] = True


@func
def _squared_distance(place: Vec3, low: np.ndarray, high: np.ndarray, p: int) -> float:
    """Return the squared distance of a point from box p, m^2; 0 inside."""
    square = 0.0
    for k in range(3):
        aside = max(low[p, k] - place[k], 0.0, place[k] - high[p, k])
        square += aside * aside
    return square


@func
def _insert(key: np.ndarray, order: np.ndarray, count: int, new_key: float, new: int) -> None:
    """Insert an element into the first `count` ones, which are sorted by their keys."""
    slot = count
    while slot > 0 and key[slot - 1] > new_key:
        key[slot] = key[slot - 1]
        order[slot] = order[slot - 1]
        slot -= 1
    key[slot] = new_key
    order[slot] = new


@kernel
def _draw_city(
    canvas: Canvas,
    rays: PixelRays,
    view: View,
    layout: int,
    low: np.ndarray,
    high: np.ndarray,
    piece_place: np.ndarray,
    first_piece: int,
    table: ShapeTable,
    faces: Faces,
    blocks: ViewBlocks,
) -> None:
    """Draw the pieces of a layout, nearest blocks first, and nearest pieces of a block first."""
    eye = view[0]
    count = 0
    for k in range(blocks.first[layout], blocks.first[layout + 1]):
        distance = _squared_distance(eye, blocks.low, blocks.high, k)
        here = minus(point(blocks.low, k), eye)
        there = minus(point(blocks.high, k), eye)
        if distance == 0.0 or _is_in_view(rays, view, here, there):
            _insert(canvas.key, canvas.order, count, distance, k)
            count += 1
    for n in range(count):
        k = canvas.order[n]
        rectangle, bound = _cover_box(view, rays, point(blocks.low, k), point(blocks.high, k))
        if _is_empty(rectangle) or _is_hidden(canvas, rectangle, bound):
            continue
        start = blocks.piece_first[k]
        pieces = blocks.piece_first[k + 1] - start
        for m in range(pieces):
            p = blocks.piece[start + m]
            distance = _squared_distance(eye, low, high, p)
            _insert(canvas.piece_key, canvas.piece_order, m, distance, p)
        for m in range(pieces):
            p = canvas.piece_order[m]
            rectangle, bound = _cover_box(view, rays, point(low, p), point(high, p))
            if _is_empty(rectangle) or _is_hidden(canvas, rectangle, bound):
                continue
            s = first_piece + p
            if table.kind[s] == HULL:
                shifted = (minus(eye, point(piece_place, p)), view[1], view[2], view[3])
                _draw_hull(canvas, rays, rectangle, shifted, table, faces, s, False)
            else:
                face = faces.first[s]
                _draw_box(canvas, rays, rectangle, view, point(low, p), point(high, p), face)
            _mark_stale(canvas, rectangle)


@kernel
def _write_depth(canvas: Canvas, depth: np.ndarray, c: int) -> None:
    """Write the depths of a picture, m."""
    for v in range(depth.shape[1]):
        for u in range(depth.shape[2]):
            depth[c, v, u] = FAR / canvas.inverse[v, u]


@kernel
def _write_labels(canvas: Canvas, label: np.ndarray, labels: np.ndarray, c: int) -> None:
    """Write the labels (P, height, width) of picture c: that of each face."""
    for v in range(labels.shape[1]):
        for u in range(labels.shape[2]):
            labels[c, v, u] = label[canvas.face[v, u]]


@kernel
def _write_colours(
    canvas: Canvas, rays: PixelRays, view: View, colour: np.ndarray, colours: np.ndarray, c: int
) -> None:
    """Write the colours of a picture: that of each face, and a checkered ground that fades."""
    eye, forward, left, up = view
    scale = 1.0 / CHECKER_SIDE
    for v in range(colours.shape[1]):
        y = rays.y[v]
        ahead = (forward[0] + y * up[0], forward[1] + y * up[1])
        for u in range(colours.shape[2]):
            face = canvas.face[v, u]
            darker = 0
            if face == GROUND_FACE:
                depth = FAR / canvas.inverse[v, u]
                column = math.floor(scale * (eye[0] + depth * (ahead[0] + rays.x[u] * left[0])))
                row = math.floor(scale * (eye[1] + depth * (ahead[1] + rays.x[u] * left[1])))
                if (column + row) & 1:
                    darker = int(CHECKER_CONTRAST * CHECKER_REACH / (CHECKER_REACH + depth))
            for k in range(3):
                colours[c, v, u, k] = colour[face, k] - darker


@func
def _fraction(x: float) -> float:
    """Return the fractional part of x, from 0 to 1."""
    return x - math.floor(x)


@kernel
def _write_windows(
    canvas: Canvas,
    rays: PixelRays,
    view: View,
    faces: Faces,
    first_building: int,
    windows: np.ndarray,
    colours: np.ndarray,
    c: int,
) -> None:
    """Write the windows of buildings over the colours of a picture.

    Args:
        canvas: The picture.
        rays: Rays of the picture.
        view: Eye and axes of the camera.
        faces: Faces of the shapes.
        first_building: First id of the faces of the city's pieces.
        windows: (4,) see `Paint.windows`.
        colours: (P, height, width, 3); written.
        c: Index of the picture.
    """
    eye = view[0]
    for v in range(colours.shape[1]):
        for u in range(colours.shape[2]):
            face = canvas.face[v, u]
            n = point(faces.normal, face)
            # Roofs have no windows
            if face < first_building or abs(n[2]) > 0.5:
                continue
            place = plus(eye, 1.0 / canvas.inverse[v, u], _ray(rays, view, v, u))
            # Coordinates on the wall: along a horizontal tangent, and up
            along = _fraction((n[0] * place[1] - n[1] * place[0]) / windows[0])
            rise = _fraction(place[2] / windows[1])
            if along < windows[2] and rise < windows[2]:
                for k in range(3):
                    lit = float(colours[c, v, u, k]) + windows[3]
                    colours[c, v, u, k] = int(min(max(lit, 0.0), 255.0))


@func
def _round_normal(kind: int, half: Vec3, place: Vec3) -> Vec3:
    """Return the outward normal of a sphere or cylinder at a point of its surface, in its axes."""
    radius = math.sqrt(place[0] * place[0] + place[1] * place[1])
    height = 0.0
    if kind == SPHERE:
        height = place[2]
        radius = math.sqrt(dot(place, place))
    elif abs(place[2]) - half[2] > radius - half[0]:
        return 0.0, 0.0, 1.0 if place[2] > 0.0 else -1.0
    scale = 1.0 / radius if radius > 0.0 else 0.0
    return place[0] * scale, place[1] * scale, height * scale


@kernel
def _write_normals(
    canvas: Canvas,
    rays: PixelRays,
    view: View,
    table: ShapeTable,
    faces: Faces,
    first_body: int,
    first_piece: int,
    drones: tuple[np.ndarray, np.ndarray],
    bodies: tuple[np.ndarray, np.ndarray],
    w: int,
    normals: np.ndarray,
    c: int,
) -> None:
    """Write the normals of a picture.

    Args:
        canvas: The picture.
        rays: Rays of the picture.
        view: Eye and axes of the camera.
        table: The shapes.
        faces: Their faces.
        first_body: First shape of the bodies, which follow those of drones.
        first_piece: First shape of the city's pieces.
        drones: Positions (W, N, 3), m, and attitudes (W, N, 4) of the drones.
        bodies: Positions and attitudes of the bodies.
        w: The world.
        normals: (P, height, width, 3); written.
        c: Index of the picture.
    """
    eye, forward, left, up = view
    for v in range(normals.shape[1]):
        # Neighbours in a row often show the same flat face
        last = -1
        x = 0.0
        y = 0.0
        z = 0.0
        for u in range(normals.shape[2]):
            face = canvas.face[v, u]
            if face != last:
                last = face
                n = point(faces.normal, face)
                s = faces.shape[face]
                if 0 <= s < first_piece:
                    place, quaternion = drones if s < first_body else bodies
                    r = s if s < first_body else s - first_body
                    attitude = quat4(quaternion, w, r)
                    if table.kind[s] != BOX and table.kind[s] != HULL:
                        last = -1
                        ray = _ray(rays, view, v, u)
                        here = minus(plus(eye, 1.0 / canvas.inverse[v, u], ray), vec3(place, w, r))
                        local = to_body(attitude, here)
                        n = _round_normal(table.kind[s], point(table.half, s), local)
                    n = to_world(attitude, n)
                x = dot(forward, n)
                y = dot(left, n)
                z = dot(up, n)
            normals[c, v, u, 0] = x
            normals[c, v, u, 1] = y
            normals[c, v, u, 2] = z


@kernel
def _write_flow(
    canvas: Canvas,
    rays: PixelRays,
    view: View,
    view0: View,
    faces: Faces,
    first_body: int,
    first_piece: int,
    now: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    earlier: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    w: int,
    flow: np.ndarray,
    c: int,
) -> None:
    """Write the flow of a picture.

    Args:
        canvas: The picture.
        rays: Rays of the picture.
        view: Eye and axes of the camera.
        view0: The same at the earlier time.
        faces: Faces of the shapes.
        first_body: First shape of the bodies, which follow those of drones.
        first_piece: First shape of the city's pieces.
        now: Poses of drones and of bodies, see `Earlier`.
        earlier: The same at the earlier time.
        w: The world.
        flow: (P, height, width, 2); written.
        c: Index of the picture.
    """
    eye0, forward0, left0, up0 = view0
    height, width = flow.shape[1:3]
    half_x = rays.x[0]
    half_y = -rays.y[height - 1]
    for v in range(height):
        for u in range(width):
            face = canvas.face[v, u]
            here = _ray(rays, view, v, u)
            if face != SKY_FACE:
                place = plus(view[0], 1.0 / canvas.inverse[v, u], here)
                s = faces.shape[face]
                if 0 <= s < first_piece:
                    k = 0 if s < first_body else 1
                    r = s - k * first_body
                    local = to_body(quat4(now[k][1], w, r), minus(place, vec3(now[k][0], w, r)))
                    turned = to_world(quat4(earlier[k][1], w, r), local)
                    place = plus(vec3(earlier[k][0], w, r), 1.0, turned)
                here = minus(place, eye0)
            ahead = dot(forward0, here)
            across = 0.0
            down = 0.0
            if ahead > 0.0:
                # The inverse of `make_pixel_rays`
                x = dot(left0, here) / ahead
                y = dot(up0, here) / ahead
                across = u - 0.5 * width * (1.0 - x / half_x)
                down = v - (0.5 * height * (1.0 - y / half_y) - 1.0)
            flow[c, v, u, 0] = min(max(across, -MAX_FLOW), MAX_FLOW)
            flow[c, v, u, 1] = min(max(down, -MAX_FLOW), MAX_FLOW)


@func
def _camera_view(eye: np.ndarray, quaternion: np.ndarray, c: int) -> View:
    """Return the eye and the axes of camera c."""
    turn = (quaternion[c, 0], quaternion[c, 1], quaternion[c, 2], quaternion[c, 3])
    forward, left, up = axes(turn)
    return point(eye, c), forward, left, up


@kernel
def draw_pictures(
    cameras: Cameras,
    rays: PixelRays,
    scenery: Scenery,
    blocks: ViewBlocks,
    faces: Faces,
    paint: Paint,
    swarm: Poses,
    mask: np.ndarray,
    canvas: Canvas,
    images: Images,
    earlier: Earlier,
) -> None:
    """Draw the pictures of cameras.

    Args:
        cameras: Cameras in any of the W worlds.
        rays: Memory for the rays of a picture.
        scenery: Shapes and poses in each world.
        blocks: Blocks of its city layouts.
        faces: Faces of its shapes.
        paint: Colours.
        swarm: State of the drones.
        mask: (W, N) bool, drones that are shown.
        canvas: Memory for drawing.
        images: Pictures; written.
        earlier: Poses from which flow is measured; not read without flow.
    """
    # Read the fields of the scenery once: nested tuples are slow in loops
    layouts = scenery.city_grid.layout
    low = scenery.city_grid.low
    high = scenery.city_grid.high
    table = scenery.table
    for c in range(cameras.world.shape[0]):
        w = cameras.world[c]
        _set_rays(rays, cameras.tangent[c])
        view = _camera_view(cameras.eye, cameras.quaternion, c)
        _draw_ground(canvas, rays, view)
        if layouts[w] != NO_LAYOUT:
            _draw_city(
                canvas,
                rays,
                view,
                layouts[w],
                low,
                high,
                scenery.piece_place,
                scenery.first_piece,
                table,
                faces,
                blocks,
            )
        for r in range(scenery.place.shape[1]):
            place = vec3(scenery.place, w, r)
            quaternion = quat4(scenery.quaternion, w, r)
            s = scenery.first_body + r
            _draw_posed_shape(canvas, rays, view, table, faces, s, place, quaternion, False)
        for i in range(mask.shape[1]):
            if mask[w, i] and i != cameras.drone[c]:
                place = vec3(swarm.position, w, i)
                quaternion = quat4(swarm.quaternion, w, i)
                _draw_posed_shape(canvas, rays, view, table, faces, i, place, quaternion, True)
        if images.depth.shape[0] > 0:
            _write_depth(canvas, images.depth, cameras.slot[c])
        if images.labels.shape[0] > 0:
            _write_labels(canvas, faces.labels, images.labels, cameras.slot[c])
        if images.colours.shape[0] > 0:
            k = w if paint.colour.shape[0] > 1 else 0
            _write_colours(canvas, rays, view, paint.colour[k], images.colours, cameras.slot[c])
            if paint.windows[k, 3] != 0.0:
                _write_windows(
                    canvas,
                    rays,
                    view,
                    faces,
                    faces.first[scenery.first_piece],
                    paint.windows[k],
                    images.colours,
                    cameras.slot[c],
                )
        if images.normals.shape[0] > 0:
            _write_normals(
                canvas,
                rays,
                view,
                table,
                faces,
                scenery.first_body,
                scenery.first_piece,
                (swarm.position, swarm.quaternion),
                (scenery.place, scenery.quaternion),
                w,
                images.normals,
                cameras.slot[c],
            )
        if images.flow.shape[0] > 0:
            _write_flow(
                canvas,
                rays,
                view,
                _camera_view(earlier.eye, earlier.quaternion, c),
                faces,
                scenery.first_body,
                scenery.first_piece,
                ((swarm.position, swarm.quaternion), (scenery.place, scenery.quaternion)),
                (earlier.drones, earlier.bodies),
                w,
                images.flow,
                cameras.slot[c],
            )
