"""Servers through which programs for other drone APIs fly the drones of an airspace."""
