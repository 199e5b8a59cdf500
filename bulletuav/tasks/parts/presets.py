"""Presets shared by several tasks: sizes and rates of other projects' environments."""

import math
from typing import Any

UAVCONFLICT: dict[str, Any] = {
    "num_drones": 8,
    "d_safe": 5.0,
    "goal_radius": 2.0,
    "max_speed": 20.0,
    "decision_hz": 10,
    "horizon": 500,
    "action": "velocity_increment",
    "observation": ("position", "velocity", "goal", "identity", "all_neighbours"),
    "at_goal": "hold",
    "boundary": "soft",
    "conflict_ends": "world",
    "randomization": {},
    "weights": {
        "progress": 10.0,
        "goal": 50.0,
        "conflict": -200.0,
        "warning": -5.0,
        "collision": 0.0,
        "out_of_bounds": 0.0,
        "energy": -0.01,
        "speed_keeping": 0.5,
        "time": 0.0,
    },
}
"""Sizes, observation and reward constants of UAVConflictGym.

docs/explanation/conflict.md lists the differences of the tasks from it, and the reasons.
"""

URBANMARL: dict[str, Any] = {
    "dynamics": "single_integrator",
    "num_drones": 3,
    "decision_hz": 1,
    "horizon": 100,
    "city": "urban",
    "area": 500.0,
    "ceiling": 200.0,
    "height": (20.0, 150.0),
    "max_speed": 20.0,
    "max_climb": 12.0,
}
"""Sizes and rates shared by all scenarios of UrbanMARL 0.3.1.

docs/explanation/radio_and_edge.md lists the differences of the tasks from them, and the reasons.
"""
_UNPAID = ("progress", "conflict", "warning", "energy", "time", "out_of_bounds")
_FLIGHT = {**dict.fromkeys(_UNPAID, 0.0), "goal": 5.0}
_USERS: dict[str, Any] = {**URBANMARL, "num_users": 50, "boundary": "hard", "contact_ends": "world"}
_MEC: dict[str, Any] = {**_USERS, "n_nlos": 3.5, "queue": "erlang", "assignment": "dtlcm"}
_WAYPOINT: dict[str, Any] = {**URBANMARL, "observation": ("position", "battery", "goal_offset")}
_OWN_SHARE = {"served": 0.0, "sight": 1.0}

URBANMARL_DEFAULT: dict[str, Any] = {
    **_WAYPOINT,
    "weights": {"progress": 1.0, "goal": 5.0, "conflict": 0.0, "collision": -1.0, "time": 0.0},
}
URBANMARL_NAVIGATION: dict[str, Any] = {
    **_WAYPOINT,
    "goal_radius": 5.0,
    "boundary": "hard",
    "contact_ends": "world",
    "weights": {**_FLIGHT, "progress": 1 / 20.0, "collision": -1.0},  # of max_speed for 1 s
}
URBANMARL_LIDAR_NAVIGATION: dict[str, Any] = {
    **URBANMARL_NAVIGATION,
    "height": (20.0, 120.0),
    "at_goal": "respawn",
    "num_beams": 8,
    "max_range": 60.0,
    "lidar_frame": "world",
    "proximity_range": 15.0,
    "observation": ("goal_offset", "velocity", "battery", "lidar"),
    "normalise": True,
    "weights": {
        **_FLIGHT,
        "collision": -5.0,
        "proximity": -0.25,  # UrbanMARL uses fractions of the range: 15 m are 0.25 of 60 m
        "distance": -1 / math.dist((0.0, 0.0, 0.0), (500.0, 500.0, 200.0)),
    },
}
URBANMARL_LOS: dict[str, Any] = {
    **_USERS,
    "min_contribution": 0.0,
    "observation": ("position", "battery"),
    "weights": {**_OWN_SHARE, "conflict": 0.0, "collision": -1.0, "out_of_bounds": 0.0},
}
URBANMARL_COVERAGE: dict[str, Any] = {
    **URBANMARL,
    "observation": ("position", "battery"),
    "weights": {
        "covered": 0.0,
        "sight": 1.0,
        "close": -5.0,
        "conflict": 0.0,
        "collision": -1.0,
        "out_of_bounds": 0.0,
    },
}
URBANMARL_MOBILE_USERS: dict[str, Any] = {
    **_USERS,
    "min_contribution": 0.0,
    "mobility": "manhattan",
    "weights": {**_OWN_SHARE, "conflict": 0.0, "service_time": 0.0, "dwell_time": 0.5},
}
URBANMARL_MEC: dict[str, Any] = {
    **_MEC,
    "arrival_rate": 0.1,
    "weights": {"conflict": 0.0, "service_time": 0.0, "dwell_time": 0.3},
}
URBANMARL_MEC_ADVANCED: dict[str, Any] = {
    **_MEC,
    "num_users": 10,
    "height": (20.0, 120.0),
    "bandwidth": 10e6,
    "weights": {"conflict": 0.0, "service_time": 0.0, "dwell_time": 0.5},
}
