"""What the preset "urbanmarl" of several tasks has in common: sizes and rates of UrbanMARL 0.3.1 (docs/service.md)."""

from typing import Any

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
