"""Identification: constants of an airframe from flight logs."""
