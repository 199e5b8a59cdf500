"""Obstacles: bodies that drones can collide with and rays can hit."""

from dataclasses import dataclass

import numpy as np

from bulletuav.errors import as_sequence, find_choice, finite, points_of, shown
from bulletuav.geometry.convex import bounding_radius, make_hull_shape
from bulletuav.geometry.shapes import BOX, CYLINDER, HULL, SPHERE, Shape

NUM_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "hull": 0}
"""Kinds of obstacles, and the number of values in their size."""
MAX_SIZE = 4096.0
"""Maximum edge length or radius of an obstacle, m."""
MIN_BAR_RATIO = 2.5
"""Minimum ratio of length to width of a box that counts as a bar"""
MAX_CORNERS = 256
"""Maximum number of corners of a hull."""
MAX_FRICTION = 10.0
"""Maximum coefficient of friction."""
DEFAULT_FRICTION = 0.5
"""Default coefficient of friction."""

Corners = tuple[tuple[float, float, float], ...]
"""Corners of a hull, m."""


@dataclass(frozen=True)
class Obstacle:
    """A static or moving body in a world, with which drones can collide.

    Attributes:
        kind: "box", "sphere", "cylinder" or "hull".
        size: Three edge lengths of a box, the radius of a sphere, or the radius and height of a
            cylinder (its axis is z), m; empty for a hull.
        colour: Red, green, blue and opacity, from 0 to 1.
        corners: For a hull: points (V, 3) whose convex hull it is, relative to its origin, m.
        friction: Coefficient of friction, from 0 to 10.
        restitution: Coefficient of restitution, from 0 to 1.

    Raises:
        ValueError: If the kind is unknown, a number is out of bounds, or a hull has no volume or
            too many corners.
    """

    kind: str
    size: tuple[float, ...] = ()
    colour: tuple[float, float, float, float] = (0.55, 0.57, 0.62, 1.0)
    corners: Corners = ()
    friction: float = DEFAULT_FRICTION
    restitution: float = 0.0

    def __post_init__(self) -> None:
        find_choice("kind of obstacle", self.kind, NUM_SIZES)
        size = as_sequence("size of an obstacle", self.size, NUM_SIZES[self.kind])
        if min((finite("size of an obstacle", one, most=MAX_SIZE) for one in size), default=1) <= 0:
            raise ValueError(
                f"size of an obstacle is {shown(self.size)}: metres above 0 are needed"
            )
        for component in as_sequence("colour", self.colour, 4):
            finite("colour of an obstacle", component, 0, 1)
        finite("friction of an obstacle", self.friction, 0, MAX_FRICTION)
        finite("restitution of an obstacle", self.restitution, 0, 1)
        self._check_corners()

    def _check_corners(self) -> None:
        """Store the corners of a hull as tuples; raise ValueError for corners of other kinds."""
        if self.kind != "hull":
            if len(self.corners):
                raise ValueError(f"an obstacle of kind {self.kind!r} has no corners: use 'hull'")
            return
        corners = hull_from_points("corners of an obstacle", self.corners).corners
        object.__setattr__(self, "corners", corners)

    @property
    def shape(self) -> Shape:
        """Collision shape relative to the obstacle's position."""
        if self.kind == "box":
            width, depth, height = self.size
            return Shape(BOX, (width / 2, depth / 2, height / 2))
        if self.kind == "sphere":
            return Shape(SPHERE, (self.size[0],) * 3)
        if self.kind == "cylinder":
            radius, height = self.size
            return Shape(CYLINDER, (radius, radius, height / 2))
        across, deep, high = np.abs(np.array(self.corners)).max(axis=0).tolist()
        return Shape(HULL, (across, deep, high), self.corners)

    @property
    def long_axis(self) -> tuple[float, float, float]:
        """Vector from the centre of a bar to its end, m; zeros for all other obstacles."""
        across, along = sorted(self.size)[-2:] if self.kind == "box" else (1.0, 1.0)
        if along < MIN_BAR_RATIO * across:
            return 0.0, 0.0, 0.0
        x, y, z = (0.5 * edge if edge == along else 0.0 for edge in self.size)
        return x, y, z

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere about the obstacle's position, m."""
        return bounding_radius(self.shape)


def hull_from_points(name: str, points: object) -> Shape:
    """Make the convex hull of points that a user passed.

    Args:
        name: Name of the points in error messages.
        points: (V, 3) m.

    Returns:
        The hull.

    Raises:
        ValueError: If the points are not finite, lie too far out, span no volume, or have too many
            corners.
    """
    corners = points_of(name, points)
    if np.abs(corners).max(initial=0.0) > MAX_SIZE:
        raise ValueError(f"{name}: a point is farther out than {MAX_SIZE:g} m")
    try:
        shape = make_hull_shape(corners)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(shape.corners) > MAX_CORNERS:
        raise ValueError(
            f"{name}: the hull has {len(shape.corners)} corners, "
            f"at most {MAX_CORNERS} are supported: simplify it"
        )
    return shape
