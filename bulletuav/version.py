"""The one place that says which version this is, and which constants it flies with."""

__version__ = "0.9.0"
CONSTANTS = 2
"""Number of the forces, airframes and rewards: another one means that policies learned in others"""
