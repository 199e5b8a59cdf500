"""Dynamics by name, one file a level: how drones move under setpoints, and what they touch."""
