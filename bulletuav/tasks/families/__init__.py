"""What several tasks have in common: airspace, city, users, edge computing."""
