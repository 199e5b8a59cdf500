"""Batched simulation core, and environment classes for Gymnasium, PettingZoo and batches."""
