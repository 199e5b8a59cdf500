"""Families of tasks: what airspace, urban, users' and edge computing tasks have in common."""
