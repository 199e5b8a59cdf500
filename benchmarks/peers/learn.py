"""Run of a learner under comparison: stable-baselines3's PPO, with one line of results.

The last argument of the process says how it learns; see `learn`. Of the simulator it knows only a
`VecEnv`, and the class that resets.
"""

from serve import ANSWERS  # first: it takes care of what others print

# isort: split

import json
import sys
import time
from collections.abc import Callable

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv


class Stopwatch:
    """Counter of the CPU-seconds that a method takes, of all objects of its class."""

    def __init__(self, owner: type, method: str):
        self.seconds = 0.0
        function = getattr(owner, method)

        def timed(*args, **kwargs):
            begin = time.process_time()
            result = function(*args, **kwargs)
            self.seconds += time.process_time() - begin
            return result

        setattr(owner, method, timed)


class Episodes(BaseCallback):
    """Counter of the episodes that end."""

    count = 0

    def _on_step(self) -> bool:
        self.count += int(self.locals["dones"].sum())
        return True


def learn(make: Callable[[int], VecEnv], simulator: type) -> None:
    """Measure a learner that begins, and print its results as JSON.

    It is asked for by JSON with "environments", "frames", "seed" and options of PPO. It answers
    with "frames", "episodes", and in seconds "wall", "cpu", "environment" and "resets". A frame is
    one transition; there may be more than asked for, as rollouts are not cut. The environment's
    time includes that of its resets. The first rollout and update, which compile, do not count.

    Args:
        make: Function that makes so many environments.
        simulator: Class whose method `reset` is a reset of the environment.
    """
    options = json.loads(sys.argv[-1])
    env = make(options.pop("environments"))
    frames = options.pop("frames")
    episodes = Episodes()
    steps = Stopwatch(type(env), "step_wait")
    resets = Stopwatch(simulator, "reset")
    torch.set_num_threads(1)
    model = PPO("MlpPolicy", env, device="cpu", **options)
    # Compile, then begin to count.
    model.learn(env.num_envs * model.n_steps)
    steps.seconds = resets.seconds = 0.0
    before = model.num_timesteps
    clock = time.perf_counter()
    cpu = time.process_time()
    model.learn(frames, callback=episodes, reset_num_timesteps=False)
    answer = {
        "wall": time.perf_counter() - clock,
        "cpu": time.process_time() - cpu,
        "environment": steps.seconds,
        "resets": resets.seconds,
        "frames": model.num_timesteps - before,
        "episodes": episodes.count,
    }
    print(json.dumps(answer), file=ANSWERS, flush=True)
