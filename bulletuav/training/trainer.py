"""Training in segments between checkpoints, so that an interrupted run can be resumed.

A resumed run ends with the same weights as an uninterrupted run.
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
from bulletuav.errors import missing_extra
from bulletuav.policies.run import RunConfig
from bulletuav.training import checkpoint
from bulletuav.training.models import make_model
from bulletuav.training.store import (
    EVALUATION_SEED,
    RECENT,
    Row,
    Store,
    evaluation_conditions,
    open_store,
    training_conditions,
)
from bulletuav.training.wall_time import WallTime

MLFLOW = "bulletuav.adapters.mlflow"
"""Module that logs to MLflow; it needs the extra `mlflow`"""
MAX_UPDATES = 1000
"""Maximum number of points that a run logs to TensorBoard and `updates.csv`"""
Progress = Callable[[int], None]
"""Callback with the number of finished steps"""
Note = Callable[[str], None]
"""Callback with a text about the training"""
CURVE_COLUMNS = {
    "return": "r",
    "decisions": "l",
    "success": "success",
    "conflicts": "conflicts",
    "collision": "collision",
}
"""Columns of the curve about the episodes of a segment, and their keys in infos"""


def train(
    config: RunConfig,
    out: Path,
    progress: Progress = lambda steps: None,
    note: Note = lambda text: None,
    mlflow: bool = False,
) -> list[Row]:
    """Train a policy, and store everything in a folder.

    Each segment ends with an evaluation and a checkpoint. The next segment starts with new episodes
    and random numbers that depend only on the seed and the index of the segment. Therefore a call
    with the same configuration resumes from the last checkpoint, and ends with the weights of an
    uninterrupted run.

    Args:
        config: Settings of the run.
        out: The folder.
        progress: Called with the number of finished steps.
        note: Called with a text of return, success and speed when episodes end.
        mlflow: If True, also log to MLflow; see `bulletuav.adapters.mlflow`.

    Returns:
        The learning curve, see `Store`.

    Raises:
        ValueError: If the configuration is invalid, or the folder has another run.
        ImportError: If the extra `sb3`, or `mlflow`, is not installed.
        RuntimeError: If MLflow cannot be reached.
    """
    single_thread()
    with open_store(out, config) as store:
        if not store.finished:
            _train(config, store, progress, note, mlflow)
        progress(config.steps)
        return store.rows


def _train(config: RunConfig, store: Store, progress: Progress, note: Note, mlflow: bool) -> None:
    """Train until all steps are done."""
    # Check before worlds are created: stable-baselines3 imports it much later
    if importlib.util.find_spec("tensorboard") is None:
        raise missing_extra("training, which logs to TensorBoard,", "sb3")
    with ExitStack() as exit_stack:
        logger = _logger(config, store.folder, mlflow, exit_stack)
        env = DroneVecEnv(
            config.task,
            config.worlds,
            config.stages,
            Curriculum(len(config.stages), **config.curriculum),
            config.shared_reward,
            config.staggered,
            **config.options,
        )
        exit_stack.callback(env.close)
        # If the store has rows, the model resumes from the last checkpoint
        model = _model(config, env, store)
        model.set_logger(logger)
        # Conditions of the following curves
        logger.record("rollout/conditions", training_conditions(config))
        logger.record("evaluation/conditions", str(evaluation_conditions(config)))
        logger.dump(model.num_timesteps)
        # The callback evaluates and saves at the end of segments
        segments = _Segments(config, env, store, progress, note)
        # Only the remaining steps
        model.learn(
            config.steps - model.num_timesteps,
            callback=segments,
            log_interval=None,
            reset_num_timesteps=False,
        )
        segments.end()


def _logger(config: RunConfig, folder: Path, mlflow: bool, exit_stack: ExitStack) -> Any:
    """Make the logger of stable-baselines3; `exit_stack` closes its outputs."""
    from stable_baselines3.common.logger import configure

    logger = configure(str(folder / "tensorboard"), ["tensorboard"])
    exit_stack.callback(logger.close)
    if mlflow:
        adapter = importlib.import_module(MLFLOW)
        run = exit_stack.enter_context(adapter.MlflowWriter(config, folder))
        logger.output_formats.append(run)
    return logger


def _model(config: RunConfig, env: DroneVecEnv, store: Store) -> Any:
    """Create a model, and restore the last checkpoint if there is one."""
    model = make_model(config, env)
    if not store.rows:
        return model
    checkpoint.restore_checkpoint(model, store.last)
    env.curriculum.restore(store.curriculum)
    env.decisions = int(store.rows[-1]["decisions"])
    return model


class _Segments(BaseCallback):
    """Callback that starts and ends segments between rollouts, and collects their episodes."""

    def __init__(
        self, config: RunConfig, env: DroneVecEnv, store: Store, progress: Progress, note: Note
    ) -> None:
        super().__init__()
        self._config = config
        self._env = env
        self._store = store
        self._progress = progress
        self._note = note
        # Episodes of the segment, how many of them are logged, and its rows of updates
        self._episodes: list[dict[str, float]] = []
        self._counted = 0
        self._updates: list[Row] = []
        self._wall = WallTime()
        self._is_open = False

    def _on_rollout_start(self) -> None:
        """End the segment if it is due, and start a segment if none is open."""
        self._wall.part = "simulation"
        if self._is_open:
            self._log_update()
        # The curve starts with the untrained policy
        if not self._store.rows:
            self.end()
        steps = self.model.num_timesteps
        rows = self._store.rows
        # Segment k ends at the first rollout after the fraction k / evaluations of the steps
        is_due = steps * self._config.evaluations >= self._config.steps * len(rows)
        if steps > rows[-1]["steps"] and is_due:
            self.end()
        if not self._is_open:
            self._begin()

    def _begin(self) -> None:
        """Start a segment: new episodes, and random numbers independent of earlier segments."""
        model: Any = self.model
        segment = np.random.SeedSequence([self._config.seed, len(self._store.rows)])
        # 31 bits: the seed must be positive as a signed integer
        seed = segment.generate_state(1)[0] >> 1
        model.set_random_seed(int(seed))
        # model.env includes the wrapper that SB3 adds for images
        model._last_obs = model.env.reset()
        # SB3 sampled its noise just before this callback
        if model.use_sde:
            getattr(model, "actor", model.policy).reset_noise(self._env.num_envs)
        model._last_episode_starts = np.ones(self._env.num_envs, dtype=bool)
        self._is_open = True
        self._wall.part = "simulation"

    def _on_rollout_end(self) -> None:
        """Count the following wall time as update."""
        self._wall.part = "update"

    def _log_update(self) -> None:
        """Log the statistics since the last entry to TensorBoard and `updates.csv`, if due."""
        steps = self.num_timesteps
        rows = self._updates or self._store.updates
        since = steps - (rows[-1]["steps"] if rows else 0)
        if since * MAX_UPDATES < self._config.steps:
            return
        fresh = self._episodes[self._counted :]
        self._counted = len(self._episodes)
        found = {f"rollout/{name}": _mean(fresh, key) for name, key in CURVE_COLUMNS.items()}
        # The logger already has the numbers of the algorithm, such as losses
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
        """Record and report the finished episodes; return True to continue training."""
        before = len(self._episodes)
        for info in self.locals["infos"]:
            if "episode" in info:
                self._episodes.append(info["episode"] | {"success": info["is_success"]})
        if len(self._episodes) > before:
            self._note(self._describe_progress())
        self._progress(self.num_timesteps)
        return True

    def _describe_progress(self) -> str:
        """Return a text with return, success and speed of the training."""
        recent = self._episodes[-RECENT:]
        seconds = sum(self._wall.seconds().values())
        done = self.num_timesteps - self._store.rows[-1]["steps"]
        return (
            f"training return {_mean(recent, 'r'):.4g}, training success "
            f"{_mean(recent, 'success'):.2f} at {self._env.aviary.options.difficulty}, "
            f"{done / max(seconds, 1e-9):,.0f} steps/s"
        )

    def end(self) -> None:
        """End the segment: save the model, evaluate it, and add a row to the curve."""
        model: Any = self.model
        config = self._config
        if self._is_open:
            self._log_update()
        # Count the following wall time as evaluation
        self._wall.part = "evaluation"
        folder = self._store.next
        checkpoint.save_checkpoint(model, folder)
        # Evaluate the checkpoint as users would
        evaluation = evaluate(
            config.task,
            folder,
            config.episodes,
            EVALUATION_SEED,
            # The modules that its settings name are already imported by this run
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
            **{f"train/{name}": _mean(self._episodes, key) for name, key in CURVE_COLUMNS.items()},
            **{name: found[name].mean for name in METRICS},
        }
        # Once the segment is stored, an interrupt can only lose its row in TensorBoard
        self._store.add(row, self._updates, self._env.curriculum.state())
        for name, value in row.items():
            model.logger.record(name if "/" in name else f"evaluation/{name}", value)
        model.logger.dump(model.num_timesteps)
        # Reset for the next segment
        self._episodes, self._counted, self._updates = [], 0, []
        self._wall = WallTime()
        self._is_open = False


def _mean(episodes: list[dict[str, float]], key: str) -> float:
    """Return the mean of a number over episodes; NaN if there are none."""
    return float(np.mean([episode[key] for episode in episodes])) if episodes else np.nan
