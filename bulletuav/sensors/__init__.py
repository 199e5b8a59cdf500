"""What drones measure."""
