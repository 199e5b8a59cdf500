"""Swarms of many drones in places that are hard for spatial grids."""

PLACES = ("random", "flat", "clustered", "collinear", "coincident", "distant")


def place_points(rng, kind, count):
    """Return the positions (count, 3) of a swarm, m."""
    side = count ** (1 / 3)
    points = rng.uniform(-side, side, (count, 3))
    if kind == "flat":
        points[:, :2] *= count ** (1 / 6)
        points[:, 2] = 1.5
    elif kind == "clustered":
        points = 100.0 * rng.uniform(-1, 1, (5, 3))[rng.integers(5, size=count)] + 0.05 * points
    elif kind == "collinear":
        points[:, 1:] = (3.0, -2.0)
    elif kind == "coincident":
        points = points[rng.integers(max(count // 4, 1), size=count)]
    elif kind == "distant":
        points[0], points[-1] = (1e6, -3e5, 2.0), (-1e3, 0.0, 40.0)
    return points
