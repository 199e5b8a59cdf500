"""Observation blocks, one file a family."""
