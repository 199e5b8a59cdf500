"""Train CleanRL's PPO for PettingZoo's Atari games in the parallel environment.

    git clone https://github.com/vwxyzjn/cleanrl
    CLEANRL=cleanrl/cleanrl/ppo_pettingzoo_ma_atari.py python tests/clients/cleanrl_client.py

The script is a single file to be edited. `EDITS` replaces what makes the game, the network for its
pictures, and calls of `gym`, which Gymnasium has replaced; the algorithm stays.
"""

import difflib
import os
import re
import runpy
import sys
import tempfile
from pathlib import Path

import numpy as np
import supersuit
from library import OPTIONS, report

import bulletuav

DRONES = OPTIONS["num_drones"]
WORLDS = 4
STEPS = 8192
"""Decisions of drones"""
ARGUMENTS = f"--num-envs {WORLDS * DRONES} --total-timesteps {STEPS} --cuda false"
MADE = """\
    env = bulletuav.parallel_env("crossing", **OPTIONS, action="discrete")
    env = ss.black_death_v3(env)
"""
NETWORK = """\
        width = envs.single_observation_space.shape[0]
        self.network = nn.Sequential(layer_init(nn.Linear(width, 512)), nn.Tanh())
"""
STEP = (
    r"next_obs, reward, terminated, truncated, info = \1\n            done = terminated | truncated"
)
EDITS = {
    r"^import gym\n": "import gymnasium as gym\nimport bulletuav\nfrom library import OPTIONS\n",
    r"^    env = importlib.*?(?=^    env = ss.pettingzoo_env)": MADE,
    r"args.num_envs // 2, (.*?)\"gym\"": rf'args.num_envs // {DRONES}, \1"gymnasium"',
    # The vector is no vector environment of Gymnasium
    r"^    envs = gym.wrappers.RecordEpisode.*?\n": "",
    r"^        self.network = .*?(?=^        self.actor)": NETWORK,
    r"^        x = x.clone.*?255.0\n": "",
    r"x.permute\(.*?\)\)": "x",
    r"envs.reset\(\)": "envs.reset()[0]",
    r"next_obs, reward, done, info = (.*?)$": STEP,
    # Infos of Gymnasium are another structure
    r"^            for idx, item.*?(?=^        # bootstrap)": "",
}
"""Replacements of regular expressions in CleanRL's file"""


def edit(text):
    """Return the script with drones.

    Raises:
        ValueError: If the file has not what an edit replaces.
    """
    for pattern, new in EDITS.items():
        text, count = re.subn(pattern, new, text, flags=re.MULTILINE | re.DOTALL)
        if not count:
            raise ValueError(f"nothing in CleanRL's file is like {pattern!r}: take another version")
    return text


def collect():
    """Return a function that flies a decision by SuperSuit's vector environment."""
    env = bulletuav.parallel_env("crossing", **OPTIONS, action="discrete")
    env = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(env))
    envs = supersuit.concat_vec_envs_v1(env, WORLDS, num_cpus=0, base_class="gymnasium")
    envs.reset()
    space = envs.action_space
    actions = np.random.default_rng(0).integers(space.n, size=WORLDS * DRONES)
    return lambda: envs.step(actions)


def main():
    """Train by the edited script, and report."""
    if "CLEANRL" not in os.environ:
        raise SystemExit("set CLEANRL to the path of CleanRL's ppo_pettingzoo_ma_atari.py")
    path = Path(os.environ["CLEANRL"])
    before = path.read_text()
    after = edit(before)
    lines = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    written, left_out = (sum(line.startswith(sign) for line in lines) for sign in "+-")

    def train():
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / path.name
            script.write_text(after)
            os.chdir(folder)  # the script writes into "runs"
            sys.argv = [script.name, *ARGUMENTS.split()]
            found = runpy.run_path(str(script), run_name="__main__")
            os.chdir(path.anchor)
        assert found["global_step"] == STEPS
        assert found["optimizer"].state
        return STEPS

    how = f"`{path.name}`, {WORLDS} worlds; {left_out} lines of it left out"
    report(["supersuit", "torch"], how, written, WORLDS, collect, train)


if __name__ == "__main__":
    main()
