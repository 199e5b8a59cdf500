"""Training by stable-baselines3."""

import importlib.util
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.sb3 import BaseCallback, DroneVecEnv, single_thread
from bulletuav.errors import missing_extra
from bulletuav.policies.run import RunConfig
from bulletuav.training import checkpoint
from bulletuav.training.models import make_model
from bulletuav.training.segments import Note, Progress, Segments, make_slots
from bulletuav.training.store import Store, evaluation_conditions, training_conditions
from bulletuav.training.trackers import Log


def learn_by_sb3(config: RunConfig, store: Store, progress: Progress, note: Note, log: Log) -> None:
    """Train until all steps are done.

    Args:
        config: Settings of the run.
        store: Storage of the run; if it has rows, the last checkpoint is restored.
        progress: Called with the number of finished steps.
        note: Called with a text when episodes end.
        log: Called with the values that are logged to TensorBoard.

    Raises:
        ValueError: If a setting is invalid.
        ImportError: If an extra is not installed.
    """
    single_thread()
    # Check before worlds are created: stable-baselines3 imports it much later
    if importlib.util.find_spec("tensorboard") is None:
        raise missing_extra("training, which logs to TensorBoard,", "sb3")
    from stable_baselines3.common.logger import configure

    with ExitStack() as exit_stack:
        logger = configure(str(store.folder / "tensorboard"), ["tensorboard"])
        exit_stack.callback(logger.close)
        env = make_slots(config, DroneVecEnv)
        exit_stack.callback(env.close)
        model = make_model(config, env)
        if store.rows:
            checkpoint.restore_checkpoint(model, store.last)
        model.set_logger(logger)
        # Conditions of the following curves
        logger.record("rollout/conditions", training_conditions(config))
        logger.record("evaluation/conditions", str(evaluation_conditions(config)))
        logger.dump(model.num_timesteps)
        # The callback evaluates and saves at the end of segments
        callback = _Learner(model, env)

        def log_to_both(values: Mapping[str, float], steps: int) -> None:
            for name, value in values.items():
                logger.record(name, value)
            logger.dump(steps)
            log(values, steps)

        segments = callback.segments = Segments(
            config, env, store, callback, progress, note, log_to_both
        )
        # Only the remaining steps
        model.learn(
            config.steps - model.num_timesteps,
            callback=callback,
            log_interval=None,
            reset_num_timesteps=False,
        )
        segments.end()


class _Learner(BaseCallback):
    """Callback that connects a model to its segments; see `bulletuav.training.segments.Learner`."""

    segments: Segments

    def __init__(self, model: Any, env: DroneVecEnv) -> None:
        super().__init__()
        self.model = model
        self._env = env

    @property
    def num_steps(self) -> int:
        """Number of finished steps of all slots."""
        return int(self.model.num_timesteps)

    def _on_rollout_start(self) -> None:
        self.segments.start_rollout()

    def _on_rollout_end(self) -> None:
        self.segments.end_rollout()

    def _on_step(self) -> bool:
        """Record the finished episodes; return True to continue training."""
        self.segments.add_infos(self.locals["infos"])
        return True

    def begin_segment(self, seed: int) -> None:
        """Reset the environment, and seed all random numbers."""
        model: Any = self.model
        model.set_random_seed(seed)
        # model.env includes the wrapper that SB3 adds for images
        model._last_obs = model.env.reset()
        # SB3 sampled its noise just before this callback
        if model.use_sde:
            getattr(model, "actor", model.policy).reset_noise(self._env.num_envs)
        model._last_episode_starts = np.ones(self._env.num_envs, dtype=bool)

    def save(self, folder: Path) -> None:
        """Write a checkpoint."""
        checkpoint.save_checkpoint(self.model, folder)

    def statistics(self) -> dict[str, float]:
        """Return the numbers that the logger has of the algorithm, such as losses."""
        return {
            name: float(value)
            for name, value in self.model.logger.name_to_value.items()
            if isinstance(value, int | float | np.number)
        }
