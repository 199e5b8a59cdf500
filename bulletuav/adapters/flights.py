"""What exporters read of a recorded flight: its arrays, by the names that files give them."""

from collections.abc import Mapping

import numpy as np

Flight = Mapping[str, np.ndarray]
"""Arrays of a recording as `Recording.everything()` returns them"""
RESULTS = ("reward", "separation", "conflicts", "collision", "success")
"""Arrays (T, N) that each decision has, beside those of infos"""


def rows_flown(flight: Flight) -> list[int]:
    """Count the rows of states of each drone, from the start to the end of its last decision."""
    counts: list[int] = (flight["alive"][:-1].sum(axis=0) + 1).tolist()
    return counts


def results(flight: Flight) -> dict[str, np.ndarray]:
    """Return what each decision gave: arrays (T, N) of numbers by name, rewards first.

    Infos of several numbers a drone are left out.
    """
    shape = flight["reward"].shape
    names = [*RESULTS, *(name for name in flight if name.startswith("info/"))]
    return {
        name: flight[name].astype(np.float64)
        for name in names
        if flight[name].shape == shape and flight[name].dtype.kind in "biuf"
    }
