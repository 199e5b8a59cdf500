"""Measures of conflict between drones.

Separation within a decision, closest approach, time to conflict, and its probability.
"""
