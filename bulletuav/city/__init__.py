"""Cities of convex pieces, generated or imported, with streets, queries, images and files.

Generated cities have the statistics of Recommendation ITU-R P.1410.
"""
