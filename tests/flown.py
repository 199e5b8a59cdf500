"""Flights of the simulator, written as logs with the noise of real ones."""

from bulletuav.identification.example import COLUMNS, HZ, fly, noisy, write

__all__ = ["COLUMNS", "HZ", "fly", "noisy", "write"]
