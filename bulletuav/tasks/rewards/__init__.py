"""Reward terms, one file a family."""
