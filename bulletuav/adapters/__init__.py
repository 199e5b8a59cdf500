"""Adapters to trainers, one file each; importing one needs the extra of its name."""
