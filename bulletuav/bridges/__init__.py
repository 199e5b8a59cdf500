"""Servers through which programs of others fly the drones of an airspace."""
