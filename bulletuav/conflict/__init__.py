"""Measures of conflict between drones.

Separation within a decision, closest point of approach, time to conflict, and conflict probability.
"""
