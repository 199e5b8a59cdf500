"""Contact detection and rigid-body contact response for all dynamics."""
