"""Radio, edge computing and the users on the ground: pure models, which know no task."""
