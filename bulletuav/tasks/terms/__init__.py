"""Ingredients that tasks share."""
