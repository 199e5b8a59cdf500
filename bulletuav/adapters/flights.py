"""What exporters read of a recorded flight: its arrays, by the names that files give them."""

from collections.abc import Mapping

import numpy as np

Flight = Mapping[str, np.ndarray]
"""Arrays of a recording as `Recording.everything()` returns them"""
RESULTS = ("reward", "separation", "conflicts", "collision", "success")
"""Arrays (T, N) that each decision has, beside those of infos"""
LATEST = 2**31
"""s, from which on stamps of ROS have no room for a time"""


def check(flight: Flight) -> None:
    """Check the arrays that exporters read.

    Raises:
        ValueError: One is damaged; it is named, with the shape that it needs.
    """
    # The shape of the positions tells how long the flight was and how many flew
    if flight["position"].ndim != 3:
        raise ValueError("'position' of the recording is damaged: numbers (T+1, N, 3) are needed")
    states, time = flight["position"].shape[:2], flight["time"]
    rows, drones = states
    # A row for each time: states; one fewer: results of the decisions between
    needed: dict[str, tuple[int, ...]] = {
        "time": (rows,),
        "alive": states,
        "quaternion": (*states, 4),
    }
    needed |= dict.fromkeys(("position", "velocity", "rates"), (*states, 3))
    needed |= dict.fromkeys(RESULTS, (rows - 1, drones))
    # Goals and IMU are not in all recordings
    if flight["goal"].shape != (rows, 0, 3):
        needed["goal"] = (*states, 3)
    if "reading/imu" in flight:
        needed["reading/imu"] = (*states, 6)
    for name, shape in needed.items():
        if flight[name].shape != shape or flight[name].dtype.kind not in "biuf":
            raise ValueError(f"{name!r} of the recording is damaged: numbers {shape} are needed")
    # Stamps of ROS have 32 bits for the seconds
    if not ((time >= 0) & (time < LATEST)).all():
        raise ValueError(f"'time' of the recording is damaged: 0 to {LATEST} s are needed")


def rows_flown(flight: Flight) -> list[int]:
    """Count the rows of states of each drone, from the start to the end of its last decision."""
    # A drone flies from the start on without a gap.
    flown = flight["alive"][:-1].astype(bool).sum(axis=0)
    counts: list[int] = (flown + 1).tolist()
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
