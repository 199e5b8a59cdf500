"""Setpoint levels, controllers, and the actions that they carry out."""
