"""Training in chapters, each from a checkpoint to the next, so that an interrupted run goes on to the same weights."""

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.sb3 import BaseCallback, DroneVecEnv, single_thread
from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.metrics import METRICS
from bulletuav.envs.curriculum import Curriculum
from bulletuav.errors import missing
from bulletuav.policies.run import RunConfig
from bulletuav.training import checkpoint
from bulletuav.training.models import make_model
from bulletuav.training.store import Row, Store, opened

EVALUATION_SEED = 1_000_000
"""Of the first episode of every evaluation on the way: others than those of training, and than tables begin with"""
Progress = Callable[[int], None]


def train(config: RunConfig, out: Path, progress: Progress = lambda steps: None) -> list[Row]:
    """Train as the configuration says and keep everything in the folder `out`; returns the learning curve, see `Store`.

    A chapter ends with an evaluation and a checkpoint; the next begins with new episodes and random numbers that follow
    from the seed and the chapter alone. So a call with the same configuration goes on from the last checkpoint to the
    weights of a run that was never interrupted. `progress` is told the steps done so far. Raises ValueError for what cannot
    be, and for a folder of another run.
    """
    single_thread()
    with opened(out, config) as store:
        if not store.finished:
            _train(config, store, progress)
        progress(config.steps)
        return store.rows


def _train(config: RunConfig, store: Store, progress: Progress) -> None:
    from stable_baselines3.common.logger import configure

    if importlib.util.find_spec("tensorboard") is None:
        raise missing("training, which tells TensorBoard of its curves,", "sb3")
    curriculum = Curriculum(len(config.stages), **config.curriculum)
    env = DroneVecEnv(
        config.task,
        config.worlds,
        config.stages,
        curriculum,
        config.shared_reward,
        **config.options,
    )
    try:
        model = _model(config, env, store)
        model.set_logger(configure(str(store.folder / "tensorboard"), ["tensorboard"]))
        chapters = _Chapters(config, env, store, progress)
        model.learn(
            config.steps - model.num_timesteps,
            callback=chapters,
            log_interval=None,
            reset_num_timesteps=False,
        )
        chapters.end()
    finally:
        env.close()


def _model(config: RunConfig, env: DroneVecEnv, store: Store) -> Any:
    """New, or as it was at the last checkpoint."""
    model = make_model(config, env)
    if not store.rows:
        return model
    checkpoint.restore(model, store.last)
    env.curriculum.restore(store.curriculum)
    env.decisions = int(store.rows[-1]["decisions"])
    return model


class _Chapters(BaseCallback):
    """Begins and ends chapters between two rollouts, and sums up the episodes of each."""

    def __init__(self, config: RunConfig, env: DroneVecEnv, store: Store, progress: Progress):
        super().__init__()
        self._config, self._env, self._store, self._progress = config, env, store, progress
        self._episodes: list[dict[str, float]] = []
        self._open = False
        self._start = time.perf_counter()

    def _on_rollout_start(self) -> None:
        if not self._store.rows:
            self.end()  # what a policy does before it learns begins the curve
        steps, rows = self.model.num_timesteps, self._store.rows
        if steps > rows[-1][
            "steps"
        ] and steps * self._config.evaluations >= self._config.steps * len(rows):
            self.end()
        if not self._open:
            self._begin()

    def _begin(self) -> None:
        """New episodes, and random numbers that know nothing of the past."""
        model: Any = self.model
        seed = (
            np.random.SeedSequence([self._config.seed, len(self._store.rows)]).generate_state(1)[0]
            >> 1
        )
        model.set_random_seed(int(seed))
        model._last_obs = model.env.reset()  # of the wrapper that SB3 puts around pictures, too
        if model.use_sde:  # SB3 drew its noise just before
            getattr(model, "actor", model.policy).reset_noise(self._env.num_envs)
        model._last_episode_starts = np.ones(self._env.num_envs, dtype=bool)
        self._open, self._start = True, time.perf_counter()

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._episodes.append(info["episode"] | {"success": info["is_success"]})
        self._progress(self.num_timesteps)
        return True

    def end(self) -> None:
        """Keep the model, evaluate it, and tell the curve."""
        model: Any = self.model
        seconds = time.perf_counter() - self._start if self._open else 0.0
        config, folder = self._config, self._store.next
        checkpoint.save(model, folder)
        found = evaluate(
            config.task, folder, config.episodes, EVALUATION_SEED, **config.evaluated
        ).estimates()
        row = {
            "steps": model.num_timesteps,
            "decisions": self._env.decisions,
            "stage": self._env.curriculum.stage,
            "seconds": seconds,
            **{f"train/{name}": self._mean(key) for name, key in TOLD.items()},
            **{name: found[name].mean for name in METRICS},
        }
        self._store.add(row, self._env.curriculum.state())
        for name, value in row.items():
            model.logger.record(name if "/" in name else f"evaluation/{name}", value)
        model.logger.dump(model.num_timesteps)
        self._episodes, self._open = [], False

    def _mean(self, key: str) -> float:
        return (
            float(np.mean([episode[key] for episode in self._episodes]))
            if self._episodes
            else np.nan
        )


TOLD = {
    "return": "r",
    "decisions": "l",
    "success": "success",
    "conflicts": "conflicts",
    "collision": "collision",
}
"""Of the episodes of a chapter: columns of the curve, and their keys in infos"""
