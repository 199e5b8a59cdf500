"""Tutorials of others, unmodified, with drones where they fly games.

    python tests/clients/tutorial_client.py cleanrl_advanced.py --env-id crossing-v2 --cuda false

PettingZoo's names of the games lead to `crossing` here, so that the tutorials make drones. Those of
CleanRL look through the drones' cameras; those of tianshou take turns.
See `docs/howto/trainers/others.md`.
"""

import runpy
import sys
import warnings
from functools import partial

import pettingzoo
import supersuit

import bulletuav

OPTIONS = {
    "num_drones": 2,
    "dynamics": "point_mass",
    "action": "discrete",
    "difficulty": "easy",
}


def cameras(max_cycles=100, stay=False, **_):
    """Drones that see what their cameras see; with `stay` those that leave stay, and see black."""
    env = bulletuav.parallel_env(
        "crossing", **OPTIONS, horizon=max_cycles, observation=("rgb",), camera_size=(84, 84)
    )
    env = supersuit.observation_lambda_v0(
        env, lambda seen, _: seen["rgb"], lambda space: space["rgb"]
    )
    return supersuit.black_death_v3(env) if stay else env


def turns(**_):
    """Drones that take turns."""
    return bulletuav.aec_env("crossing", **OPTIONS, horizon=50)


def main():
    """Lead the names of games to drones, and run the script that the first argument names."""
    # PettingZoo tells that its own games are replaced.
    warnings.simplefilter("ignore")
    pettingzoo.register("parallel", "atari/crossing-v2", partial(cameras, stay=True))
    pettingzoo.register("parallel", "butterfly/pistonball-v6", cameras)
    for game in ("classic/tictactoe-v3", "classic/rps-v2"):
        pettingzoo.register("aec", game, turns)
    sys.argv = sys.argv[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
