"""Flights of the simulator, written as logs with the noise of real ones."""

from bulletuav.identification.example import (
    COLUMNS,
    HZ,
    add_sensor_noise,
    fly_example,
    write_example_log,
)

__all__ = ["COLUMNS", "HZ", "add_sensor_noise", "fly_example", "write_example_log"]
