"""Setpoint levels, controllers and the actions that they fly."""
