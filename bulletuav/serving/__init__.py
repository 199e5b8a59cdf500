"""Servers: the policy of their connections, and the log of what they refuse."""
