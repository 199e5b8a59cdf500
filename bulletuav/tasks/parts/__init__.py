"""Parts of tasks: cities, obstacles, users, tracks, formations, with the options of each."""
