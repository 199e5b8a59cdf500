"""Policies that know the whole state and show that a level of a task can be done."""
