"""Servers: limits of their connections, and the log of rejected calls and clients."""
