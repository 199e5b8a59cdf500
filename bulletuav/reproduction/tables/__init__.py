"""Published tables: one file each, with the constant `REPRODUCTION`."""
