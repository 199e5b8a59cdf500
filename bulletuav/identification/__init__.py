"""System identification: fit the constants of an airframe to flight logs."""
