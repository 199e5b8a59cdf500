"""Cities of convex pieces: generated or imported; their streets, queries, pictures and files.

Generated cities have the statistics of Recommendation ITU-R P.1410.
"""
