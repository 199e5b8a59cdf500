"""Training in chapters, from checkpoint to checkpoint, so that an interrupted run can go on.

It goes on to the weights of a run that was never interrupted.
"""

import importlib.util
from collections.abc import Callable
from contextlib import ExitStack
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
from bulletuav.training.store import (
    EVALUATION_SEED,
    RECENT,
    Row,
    Store,
    evaluation_conditions,
    opened,
    training_conditions,
)
from bulletuav.training.wall_time import WallTime

MLFLOW = "bulletuav.adapters.mlflow"
"""Module that tells MLflow; it needs an extra of its own"""
MOST_UPDATES = 1000
"""Most points that a run tells TensorBoard and `updates.csv`"""
Progress = Callable[[int], None]
"""Is told the steps done so far"""
Told = Callable[[str], None]
"""Is told in words how the training goes"""
TOLD = {
    "return": "r",
    "decisions": "l",
    "success": "success",
    "conflicts": "conflicts",
    "collision": "collision",
}
"""Columns of the curve on the episodes of a chapter, and their keys in infos"""


def train(
    config: RunConfig,
    out: Path,
    progress: Progress = lambda steps: None,
    told: Told = lambda text: None,
    mlflow: bool = False,
) -> list[Row]:
    """Train a policy and keep everything in a folder.

    A chapter ends with an evaluation and a checkpoint. The next begins with new episodes and random
    numbers that follow from the seed and the chapter alone. So a call with the same configuration
    goes on from the last checkpoint to the weights of a run that was never interrupted.

    Args:
        config: What is trained, and how.
        out: The folder.
        progress: Told the steps done so far.
        told: Told return, success and speed in words, whenever they are new.
        mlflow: Whether MLflow is told, too; see `bulletuav.adapters.mlflow`.

    Returns:
        The learning curve, see `Store`.

    Raises:
        ValueError: The configuration is none that can be, or the folder holds another run.
        ImportError: The extra `sb3`, or `mlflow`, is missing.
        RuntimeError: MLflow cannot be reached.
    """
    single_thread()
    with opened(out, config) as store:
        if not store.finished:
            _train(config, store, progress, told, mlflow)
        progress(config.steps)
        return store.rows


def _train(config: RunConfig, store: Store, progress: Progress, told: Told, mlflow: bool) -> None:
    """Train until all steps are done."""
    # Told before worlds are made, rather than by an import far below
    if importlib.util.find_spec("tensorboard") is None:
        raise missing("training, which tells TensorBoard of its curves,", "sb3")
    with ExitStack() as open_things:
        logger = _logger(config, store.folder, mlflow, open_things)
        env = DroneVecEnv(
            config.task,
            config.worlds,
            config.stages,
            Curriculum(len(config.stages), **config.curriculum),
            config.shared_reward,
            **config.options,
        )
        open_things.callback(env.close)
        # With rows in the store, the model goes on from its last checkpoint
        model = _model(config, env, store)
        model.set_logger(logger)
        # What the curves that follow are of
        logger.record("rollout/conditions", training_conditions(config))
        logger.record("evaluation/conditions", str(evaluation_conditions(config)))
        logger.dump(model.num_timesteps)
        # Chapters evaluate and save between the steps
        chapters = _Chapters(config, env, store, progress, told)
        # Steps that an earlier call did are not done again
        model.learn(
            config.steps - model.num_timesteps,
            callback=chapters,
            log_interval=None,
            reset_num_timesteps=False,
        )
        chapters.end()


def _logger(config: RunConfig, folder: Path, mlflow: bool, open_things: ExitStack) -> Any:
    """Make the logger of stable-baselines3; what it writes to is closed with `open_things`."""
    from stable_baselines3.common.logger import configure

    logger = configure(str(folder / "tensorboard"), ["tensorboard"])
    open_things.callback(logger.close)
    if mlflow:
        adapter = importlib.import_module(MLFLOW)
        run = open_things.enter_context(adapter.MlflowWriter(config, folder))
        logger.output_formats.append(run)
    return logger


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
        self, config: RunConfig, env: DroneVecEnv, store: Store, progress: Progress, told: Told
    ) -> None:
        super().__init__()
        self._config = config
        self._env = env
        self._store = store
        self._progress = progress
        self._told = told
        # Episodes of the chapter, how many an update has told, and its rows.
        self._episodes: list[dict[str, float]] = []
        self._counted = 0
        self._updates: list[Row] = []
        self._wall = WallTime()
        self._is_open = False

    def _on_rollout_start(self) -> None:
        """End the chapter where it is long enough, and begin one where none is open."""
        self._wall.part = "simulation"
        if self._is_open:
            self._tell_update()
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
        self._wall.part = "simulation"

    def _on_rollout_end(self) -> None:
        """Note that the networks learn from here on."""
        self._wall.part = "update"

    def _tell_update(self) -> None:
        """Tell TensorBoard and the table of updates what they have not heard, if it is due."""
        steps = self.num_timesteps
        rows = self._updates or self._store.updates
        since = steps - (rows[-1]["steps"] if rows else 0)
        if since * MOST_UPDATES < self._config.steps:
            return
        fresh = self._episodes[self._counted :]
        self._counted = len(self._episodes)
        found = {f"rollout/{name}": _mean(fresh, key) for name, key in TOLD.items()}
        # The algorithm's own numbers, such as losses, are in its logger by now.
        logger = self.model.logger
        found |= {
            name: float(value)
            for name, value in logger.name_to_value.items()
            if isinstance(value, int | float | np.number)
        }
        self._updates.append({"steps": float(steps), **found})
        for name, value in found.items():
            logger.record(name, value)
        logger.dump(steps)

    def _on_step(self) -> bool:
        """Note the episodes that ended, and tell of them; True lets SB3 go on."""
        before = len(self._episodes)
        for info in self.locals["infos"]:
            if info:
                self._episodes.append(info["episode"] | {"success": info["is_success"]})
        if len(self._episodes) > before:
            self._told(self._words())
        self._progress(self.num_timesteps)
        return True

    def _words(self) -> str:
        """Say how the training goes."""
        recent = self._episodes[-RECENT:]
        seconds = sum(self._wall.seconds().values())
        done = self.num_timesteps - self._store.rows[-1]["steps"]
        return (
            f"training return {_mean(recent, 'r'):.4g}, training success "
            f"{_mean(recent, 'success'):.2f} at {self._env.aviary.options.difficulty}, "
            f"{done / max(seconds, 1e-9):,.0f} steps/s"
        )

    def end(self) -> None:
        """Keep the model, evaluate it, and add a row to the curve."""
        model: Any = self.model
        config = self._config
        if self._is_open:
            self._tell_update()
        # Time from here on counts as evaluation
        self._wall.part = "evaluation"
        folder = self._store.next
        checkpoint.save(model, folder)
        # The checkpoint is flown as users would fly it
        evaluation = evaluate(
            config.task,
            folder,
            config.episodes,
            EVALUATION_SEED,
            # The modules that its settings name are those of this run: they are imported already
            trust=True,
            **config.evaluated,
        )
        found = evaluation.estimates()
        wall = self._wall.seconds()
        row = {
            "steps": model.num_timesteps,
            "decisions": self._env.decisions,
            "stage": self._env.curriculum.stage,
            "seconds": sum(wall.values()),
            **wall,
            **{f"train/{name}": _mean(self._episodes, key) for name, key in TOLD.items()},
            **{name: found[name].mean for name in METRICS},
        }
        # From here on the chapter is kept; TensorBoard's copy of the curve may lack its last row.
        self._store.add(row, self._updates, self._env.curriculum.state())
        for name, value in row.items():
            model.logger.record(name if "/" in name else f"evaluation/{name}", value)
        model.logger.dump(model.num_timesteps)
        # The next chapter begins with nothing
        self._episodes, self._counted, self._updates = [], 0, []
        self._wall = WallTime()
        self._is_open = False


def _mean(episodes: list[dict[str, float]], key: str) -> float:
    """Average a number over episodes; NaN where there are none."""
    return float(np.mean([episode[key] for episode in episodes])) if episodes else np.nan
