"""Training in chapters, from checkpoint to checkpoint, so that an interrupted run can go on.

It goes on to the weights of a run that was never interrupted.
"""

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
"""Seed of the first episode of evaluations on the way: no seed of training or of tables"""
Progress = Callable[[int], None]
"""Is told the steps done so far"""
TOLD = {
    "return": "r",
    "decisions": "l",
    "success": "success",
    "conflicts": "conflicts",
    "collision": "collision",
}
"""Columns of the curve on the episodes of a chapter, and their keys in infos"""


def train(config: RunConfig, out: Path, progress: Progress = lambda steps: None) -> list[Row]:
    """Train a policy and keep everything in a folder.

    A chapter ends with an evaluation and a checkpoint. The next begins with new episodes and random
    numbers that follow from the seed and the chapter alone. So a call with the same configuration
    goes on from the last checkpoint to the weights of a run that was never interrupted.

    Args:
        config: What is trained, and how.
        out: The folder.
        progress: Told the steps done so far.

    Returns:
        The learning curve, see `Store`.

    Raises:
        ValueError: The configuration is none that can be, or the folder holds another run.
        ImportError: The extra `sb3` is missing.
    """
    single_thread()
    with opened(out, config) as store:
        if not store.finished:
            _train(config, store, progress)
        progress(config.steps)
        return store.rows


def _train(config: RunConfig, store: Store, progress: Progress) -> None:
    """Train until all steps are done."""
    from stable_baselines3.common.logger import configure

    if importlib.util.find_spec("tensorboard") is None:
        raise missing("training, which tells TensorBoard of its curves,", "sb3")
    env = DroneVecEnv(
        config.task,
        config.worlds,
        config.stages,
        Curriculum(len(config.stages), **config.curriculum),
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
    """Make a new model, or one that stands where the last checkpoint does."""
    model = make_model(config, env)
    if not store.rows:
        return model
    checkpoint.restore(model, store.last)
    env.curriculum.restore(store.curriculum)
    env.decisions = int(store.rows[-1]["decisions"])
    return model


class _Chapters(BaseCallback):
    """Begins and ends chapters between two rollouts, and sums up the episodes of each."""

    def __init__(
        self,
        config: RunConfig,
        env: DroneVecEnv,
        store: Store,
        progress: Progress,
    ) -> None:
        super().__init__()
        self._config = config
        self._env = env
        self._store = store
        self._progress = progress
        self._episodes: list[dict[str, float]] = []
        self._is_open = False
        self._start = time.perf_counter()

    def _on_rollout_start(self) -> None:
        """End the chapter where it is long enough, and begin one where none is open."""
        # What a policy does before it learns begins the curve.
        if not self._store.rows:
            self.end()
        steps = self.model.num_timesteps
        rows = self._store.rows
        # Chapter k ends at the first rollout from the share k / evaluations of the steps on.
        is_due = steps * self._config.evaluations >= self._config.steps * len(rows)
        if steps > rows[-1]["steps"] and is_due:
            self.end()
        if not self._is_open:
            self._begin()

    def _begin(self) -> None:
        """Begin new episodes, with random numbers that know nothing of the past."""
        model: Any = self.model
        chapter = np.random.SeedSequence([self._config.seed, len(self._store.rows)])
        # A seed of 31 bits is positive wherever it goes.
        seed = chapter.generate_state(1)[0] >> 1
        model.set_random_seed(int(seed))
        # The model's own environment is the wrapper that SB3 puts around pictures, too.
        model._last_obs = model.env.reset()
        # SB3 drew its noise just before.
        if model.use_sde:
            getattr(model, "actor", model.policy).reset_noise(self._env.num_envs)
        model._last_episode_starts = np.ones(self._env.num_envs, dtype=bool)
        self._is_open = True
        self._start = time.perf_counter()

    def _on_step(self) -> bool:
        """Note the episodes that ended; True lets SB3 go on."""
        for info in self.locals["infos"]:
            if info:
                self._episodes.append(info["episode"] | {"success": info["is_success"]})
        self._progress(self.num_timesteps)
        return True

    def end(self) -> None:
        """Keep the model, evaluate it, and add a row to the curve."""
        model: Any = self.model
        config = self._config
        seconds = time.perf_counter() - self._start if self._is_open else 0.0
        folder = self._store.next
        checkpoint.save(model, folder)
        evaluation = evaluate(
            config.task,
            folder,
            config.episodes,
            EVALUATION_SEED,
            **config.evaluated,
        )
        found = evaluation.estimates()
        row = {
            "steps": model.num_timesteps,
            "decisions": self._env.decisions,
            "stage": self._env.curriculum.stage,
            "seconds": seconds,
            **{f"train/{name}": self._mean(key) for name, key in TOLD.items()},
            **{name: found[name].mean for name in METRICS},
        }
        # From here on the chapter is kept; TensorBoard's copy of the curve may lack its last row.
        self._store.add(row, self._env.curriculum.state())
        for name, value in row.items():
            model.logger.record(name if "/" in name else f"evaluation/{name}", value)
        model.logger.dump(model.num_timesteps)
        self._episodes = []
        self._is_open = False

    def _mean(self, key: str) -> float:
        """Average a number over the episodes of the chapter; NaN where there are none."""
        if not self._episodes:
            return np.nan
        return float(np.mean([episode[key] for episode in self._episodes]))
