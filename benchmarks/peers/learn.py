"""How a learner under comparison answers: one run of stable-baselines3's PPO, one line told.

The last argument says how it learns; see `learn`. Of the simulator it knows nothing but a `VecEnv`, and who resets.
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
    """Counts the CPU-seconds that a method takes, of all objects of its class."""

    def __init__(self, owner: type, method: str):
        self.seconds, function = 0.0, getattr(owner, method)

        def timed(*args, **kwargs):
            begin = time.process_time()
            result = function(*args, **kwargs)
            self.seconds += time.process_time() - begin
            return result

        setattr(owner, method, timed)


class Episodes(BaseCallback):
    """Counts those that end."""

    count = 0

    def _on_step(self) -> bool:
        self.count += int(self.locals["dones"].sum())
        return True


def learn(make: Callable[[int], VecEnv], simulator: type) -> None:
    """Tell of a learner that begins: {"frames", "episodes", "wall", "cpu", "environment", "resets"}, the last four seconds.

    Asked for {"environments", "frames", "seed", and options of PPO}. The first rollout and update, which compile, are not
    counted. A frame is one transition; there may be more than asked for, as rollouts are not cut. The environment's time
    includes that of its resets, which are those of class `simulator`.
    """
    options = json.loads(sys.argv[-1])
    env, frames, episodes = make(options.pop("environments")), options.pop("frames"), Episodes()
    steps, resets = Stopwatch(type(env), "step_wait"), Stopwatch(simulator, "reset")
    torch.set_num_threads(1)
    model = PPO("MlpPolicy", env, device="cpu", **options)
    model.learn(env.num_envs * model.n_steps)
    steps.seconds = resets.seconds = 0.0
    before, clock, cpu = model.num_timesteps, time.perf_counter(), time.process_time()
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
