"""Training runs that are stored in a folder and resume reproducibly, bit for bit."""
