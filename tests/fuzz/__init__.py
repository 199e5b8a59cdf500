"""Damaged files of every format that the package reads; see `__main__`."""
