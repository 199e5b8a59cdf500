"""Evaluation, metrics, recordings and speed."""
