"""Radio links, edge computing and ground users: models that are independent of the tasks."""
