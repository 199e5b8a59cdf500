"""Presets that several tasks share: sizes and rates of other projects' environments."""

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
    },
}
"""Sizes, observation and reward constants of UAVConflictGym.

docs/conflict.md lists where the tasks differ from it, and why.
"""

URBANMARL: dict[str, Any] = {
    "dynamics": "single_integrator",
    "num_drones": 3,
    "num_users": 50,
    "decision_hz": 1,
    "horizon": 100,
    "city": "urban",
    "area": 500.0,
    "ceiling": 200.0,
    "height": (20.0, 150.0),
    "max_speed": 20.0,
    "boundary": "hard",
    "contact_ends": "world",
}
"""Sizes and rates of UrbanMARL 0.3.1, which tasks over users share (docs/service.md)."""
