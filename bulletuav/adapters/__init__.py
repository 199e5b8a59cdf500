"""Adapters to trainers and formats of others; importing one needs the extra of its name."""
