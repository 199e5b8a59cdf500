"""Compilation of hot loops to machine code, and programs of compiled calls."""
