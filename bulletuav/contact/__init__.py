"""Contacts, for all dynamics: what drones touch on their way, and how that pushes them back."""
