"""Difficulties shared by several tasks: randomization, numbers of drones, and cities."""

from typing import Any

UNCERTAINTY: dict[str, dict[str, Any]] = {
    "easy": {},
    "medium": {"randomization": {"gps_noise": (0.5, 1.5)}},
    "hard": {
        "randomization": {"gps_noise": (0.5, 3.0), "gps_walk": (0.0, 0.1), "wind": (-3.0, 3.0)}
    },
    "extreme": {
        "turbulence": "light",
        "randomization": {
            "mass": (0.8, 1.2),
            "thrust": (0.9, 1.1),
            "drag": (1 / 3, 5 / 3),
            "motor_lag": (0.5, 2.0),
            "battery": (0.0, 0.1),
            "gps_noise": (0.5, 5.0),
            "gps_walk": (0.0, 0.1),
            "gps_dropout": (0.0, 0.1),
            "wind": (-3.0, 3.0),
            "radio_delay": (0.005, 0.1),
            "radio_loss": (0.0, 0.3),
            "radio_range": (100.0, 200.0),
        },
    },
}
"""Randomization by difficulty.

Units are those of `bulletuav.envs.randomization.Randomization`.
"""

AIRSPACE_DIFFICULTIES: dict[str, dict[str, Any]] = {
    "easy": {"num_drones": 4, **UNCERTAINTY["easy"]},
    "medium": UNCERTAINTY["medium"],
    "hard": {"num_drones": 20, "num_obstacles": 6, "num_moving": 3, **UNCERTAINTY["hard"]},
    "extreme": {"num_drones": 100, "num_obstacles": 12, "num_moving": 6, **UNCERTAINTY["extreme"]},
}
"""Difficulties of flights through free airspace: drones, obstacles and randomization."""

URBAN_DIFFICULTIES: dict[str, dict[str, Any]] = {
    "easy": UNCERTAINTY["easy"],
    "medium": {"num_drones": 5, "irregularity": 0.5, **UNCERTAINTY["medium"]},
    "hard": {"num_drones": 8, "city": "dense", "irregularity": 0.5, **UNCERTAINTY["hard"]},
    "extreme": {
        "num_drones": 16,
        "city": "high_rise",
        "irregularity": 1.0,
        **UNCERTAINTY["extreme"],
    },
}
"""Difficulties of tasks in cities: the city, the number of drones, and randomization."""


SERVICE_DRONES = {"medium": 4, "hard": 5, "extreme": 6}
"""Number of drones that serve a city: so few that only some places serve most of it"""


def service_difficulties(**wanted: float) -> dict[str, dict[str, Any]]:
    """Return the difficulties of tasks of service over cities.

    Args:
        **wanted: Required service of each difficulty but "easy", whose options are the defaults.
    """
    own = {
        name: {**URBAN_DIFFICULTIES[name], "num_drones": count, "wanted": wanted[name]}
        for name, count in SERVICE_DRONES.items()
    }
    return {"easy": URBAN_DIFFICULTIES["easy"], **own}
