"""Policies made for single tasks that try to be paid without doing the work."""
