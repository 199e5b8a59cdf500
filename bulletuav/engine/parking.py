"""Parking positions of drones that are not in the airspace."""

import numpy as np

PARKING_HEIGHT = 2000.0
"""Height of parked drones, and depth of unplaced obstacles below the ground, m"""
PARKING_PITCH = 10.0
"""Spacing of parked drones, m"""
PARKING_COLUMNS = 100
"""Number of parked drones in a row"""


def parking_places(offset: np.ndarray, num_drones: int) -> np.ndarray:
    """Return the parking position (W, N, 3) of each drone, m, for tiles at `offset` (W, 3)."""
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
