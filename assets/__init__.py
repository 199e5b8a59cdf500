"""Data files of bulletuav: `urdf/`, one airframe a file."""
