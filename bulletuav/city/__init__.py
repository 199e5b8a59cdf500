"""Cities of convex pieces: generated from ITU-R P.1410 statistics, or imported; their streets, queries and files."""
