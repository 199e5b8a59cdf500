"""Access to the arrays of a recorded flight, as exporters need them."""

from collections.abc import Mapping

import numpy as np

FlightArrays = Mapping[str, np.ndarray]
"""Arrays of a recording by name, as `Recording.everything()` returns them"""
RESULTS = ("reward", "separation", "conflicts", "collision", "success")
"""Names of the arrays (T, N) of results of each decision, besides the infos"""
MAX_STAMP = 2**31
"""Limit of ROS time stamps, s"""


def check_flight(flight: FlightArrays) -> None:
    """Check shapes and types of the arrays that exporters read.

    Raises:
        ValueError: If an array is damaged. The message contains its name and the needed shape.
    """
    # The shape of the positions determines the numbers of times and drones
    if flight["position"].ndim != 3:
        raise ValueError("'position' of the recording is damaged: numbers (T+1, N, 3) are needed")
    states, time = flight["position"].shape[:2], flight["time"]
    rows, drones = states
    # States have one row more than the results of the decisions between them
    needed: dict[str, tuple[int, ...]] = {
        "time": (rows,),
        "alive": states,
        "quaternion": (*states, 4),
    }
    needed |= dict.fromkeys(("position", "velocity", "rates"), (*states, 3))
    needed |= dict.fromkeys(RESULTS, (rows - 1, drones))
    # Not all recordings have goals and IMU readings
    if flight["goal"].shape != (rows, 0, 3):
        needed["goal"] = (*states, 3)
    if "reading/imu" in flight:
        needed["reading/imu"] = (*states, 6)
    for name, shape in needed.items():
        if flight[name].shape != shape or flight[name].dtype.kind not in "biuf":
            raise ValueError(f"{name!r} of the recording is damaged: numbers {shape} are needed")
    # ROS time stamps have 32 bits for the seconds
    if not ((time >= 0) & (time < MAX_STAMP)).all():
        raise ValueError(f"'time' of the recording is damaged: 0 to {MAX_STAMP} s are needed")


def count_flown_rows(flight: FlightArrays) -> list[int]:
    """Return the number of state rows of each drone, up to the end of its last decision."""
    # The flight of a drone is one interval from the start
    flown = flight["alive"][:-1].astype(bool).sum(axis=0)
    counts: list[int] = (flown + 1).tolist()
    return counts


def decision_results(flight: FlightArrays) -> dict[str, np.ndarray]:
    """Return the results of each decision, arrays (T, N) by name, rewards first.

    Infos with several numbers for each drone are left out.
    """
    shape = flight["reward"].shape
    names = [*RESULTS, *(name for name in flight if name.startswith("info/"))]
    return {
        name: flight[name].astype(np.float64)
        for name in names
        if flight[name].shape == shape and flight[name].dtype.kind in "biuf"
    }
