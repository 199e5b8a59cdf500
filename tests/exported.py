"""A flight of made-up numbers, for tests of exporters."""

import json

import numpy as np

DRONES, DECISIONS = 3, 7
ROWS = (8, 5, 8)
"""Rows of states of each drone: the second leaves early"""
PARTS = [
    {"kind": kind, "half": [0.3, 0.2, 0.1], "corners": [], "colour": [1, 0.5, 0, 1]}
    | {"position": [0.1 * kind, 0, 0], "quaternion": [0, 0, 0, 1]}
    for kind in (0, 1, 2)
]
TETRAHEDRON = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
OBSTACLE = {"kind": 3, "half": [1, 1, 1], "corners": TETRAHEDRON, "colour": [0, 0, 1, 1]}


def made_flight():
    """Arrays of a recording by the names of files, with numbers of all sizes."""
    rng = np.random.default_rng(5)
    rows, shape = DECISIONS + 1, (DECISIONS, DRONES)
    states = (rows, DRONES)

    def numbers(*shape):
        return rng.normal(size=shape) * 10.0 ** rng.integers(-12, 4, size=shape)

    quaternion = rng.normal(size=(*states, 4))
    separation = np.abs(numbers(*shape))
    separation[0, 0] = np.inf
    position = numbers(*states, 3)
    position[0, 0] = -0.0, 5e-324, 1 / 3
    return {
        "time": np.arange(rows) / 48,
        "position": position,
        "quaternion": quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True),
        "velocity": rng.normal(size=(*states, 3)),
        "rates": rng.normal(size=(*states, 3)),
        "alive": np.arange(rows)[:, None] < np.array(ROWS) - 1,
        "reward": numbers(*shape),
        "separation": separation,
        "conflicts": rng.integers(0, 3, size=shape),
        "collision": rng.random(shape) < 0.5,
        "success": rng.random(shape) < 0.5,
        "goal": numbers(*states, 3),
        "obstacle": numbers(rows, 1, 3),
        "building": np.array([[[0, 0, 0], [2, 3, 4]], [[5, 5, 0], [6, 6, 1]]], dtype=float),
        "info/reward/progress": numbers(*shape),
        "info/odd name": numbers(*shape),
        "info/odd_name": numbers(*shape),
        "info/2nd": numbers(*shape),
        "info/several": numbers(*shape, 2),
        "info/text": np.full(shape, "text"),
        "reading/imu": numbers(*states, 6),
        "scene/about": np.array(
            json.dumps(
                {
                    "airframes": [{"parts": PARTS}],
                    "airframe_of": [0] * DRONES,
                    "obstacles": [OBSTACLE],
                }
            )
        ),
        "scene/obstacle_quaternion": np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1, 1)),
        "scene/hull": np.array(TETRAHEDRON, dtype=float) + [5, 5, 0],
        "scene/hull_size": np.array([4]),
    }
