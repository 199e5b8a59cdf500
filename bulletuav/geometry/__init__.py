"""Geometry of rotations, shapes, cities and rays: pure compiled functions."""
