"""Where drones wait that are not in the airspace."""

import numpy as np

PARKING_HEIGHT = 2000.0
"""Height of parked drones, m; obstacles that are not placed wait as deep below the ground"""
PARKING_PITCH = 10.0
"""Distance of parked drones, m"""
PARKING_COLUMNS = 100
"""Parked drones in a row"""


def parking_places(offset: np.ndarray, num_drones: int) -> np.ndarray:
    """Give each drone of each world a place (W, N, 3), m, for tiles at `offset` (W, 3)."""
    grid = [
        (
            PARKING_PITCH * (i % PARKING_COLUMNS),
            PARKING_PITCH * (i // PARKING_COLUMNS),
            PARKING_HEIGHT,
        )
        for i in range(num_drones)
    ]
    places: np.ndarray = offset[:, None] + grid
    return places
