"""The batched core and its faces."""
