"""Measures of conflict between drones: separation, closest approach, time to conflict, probability."""
