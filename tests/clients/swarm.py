"""Flight of all clients.

Episodes are short and goals near, so drones leave early, and ends are mixed.
"""

import bulletuav

HORIZON = 6
DRONES = 4
OPTIONS = {
    "num_drones": DRONES,
    "dynamics": "point_mass",
    "difficulty": "easy",
    "horizon": HORIZON,
    "half_length": 20.0,
    "lane_spacing": 10.0,
    "goal_radius": 37.0,
    "start_speed": (0.0, 10.0),
    "seed": 0,
}


def make_env():
    """Make the environment.

    About every third episode ends with a step that terminates some drones and truncates the others.
    """
    return bulletuav.parallel_env("crossing", **OPTIONS)
