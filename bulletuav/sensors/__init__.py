"""Sensors of drones, one module per sensor."""

from bulletuav.sensors.base import (
    Image,
    Label,
    Moment,
    Sensor,
    SensorSetup,
    Uncertain,
    vector_labels,
)

__all__ = ["Image", "Label", "Moment", "Sensor", "SensorSetup", "Uncertain", "vector_labels"]
