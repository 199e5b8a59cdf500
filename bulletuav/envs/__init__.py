"""The batched core, and the environment classes of each API around it."""
