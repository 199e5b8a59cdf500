"""Meshes of buildings for tests, closed and turning left seen from outside."""

import numpy as np

ELL = [(0, 0), (30, 0), (30, 10), (10, 10), (10, 30), (0, 30)]  # 500 m^2, its hull 700


def prism(outline, height):
    """Points and faces, of as many corners as they have, of an upright prism."""
    count = len(outline)
    points = [(x, y, z) for z in (0, height) for x, y in outline]
    walls = [(k, (k + 1) % count, count + (k + 1) % count, count + k) for k in range(count)]
    floor, roof = range(count - 1, -1, -1), range(count, 2 * count)
    return np.array(points, dtype=float), [*walls, tuple(floor), tuple(roof)]


def podium():
    """A tower of 12 m x 12 m x 22 m on a podium of 40 m x 40 m x 8 m: 15,968 m^3."""
    low = [(0, 0), (40, 0), (40, 40), (0, 40)]
    high = [(10, 10), (22, 10), (22, 22), (10, 22)]
    levels = ((low, 0), (low, 8), (high, 8), (high, 30))
    points = [(x, y, z) for outline, z in levels for x, y in outline]
    faces = [(3, 2, 1, 0), (12, 13, 14, 15)]
    for first in (0, 4, 8):
        for k in range(4):
            after = (k + 1) % 4
            faces.append((first + k, first + after, first + 4 + after, first + 4 + k))
    return np.array(points, dtype=float), faces


def written(*objects):
    """An OBJ file of named objects: names, points and faces."""
    lines, first = [], 1
    for name, points, faces in objects:
        lines.append(f"o {name}")
        lines += [f"v {x} {y} {z}" for x, y, z in points.tolist()]
        lines += ["f " + " ".join(str(first + k) for k in face) for face in faces]
        first += len(points)
    return "\n".join(lines) + "\n"


OPEN_BOX = """v 0 1e-300 0
v 10 0 0
v 10 10 0
v 0 10 0
v 0 0 8
v 10 0 -1
v 10 10 8
v 0 10 8
f 1 2 3 4
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
"""A box whose lower corner goes through its floor: CoACD 1.0.14 dies with SIGSEGV"""
