"""Adapters to training libraries and file formats; each needs the extra of its name."""
