"""Evaluation and recording of episodes: metrics, datasets, and files of results."""
