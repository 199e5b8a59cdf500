"""Geometry of rotations, convex shapes, cities and rays, as compiled functions without state."""
