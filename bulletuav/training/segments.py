"""Segments of a training run, for any learner: their episodes, evaluations and checkpoints.

Each segment starts with new episodes and random numbers that depend only on the seed of the run and
the index of the segment, and ends with a checkpoint. A run that is resumed from a checkpoint
therefore ends with the weights of an uninterrupted run.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bulletuav.adapters.slots import DroneSlots, Info
from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.metrics import METRICS
from bulletuav.envs.curriculum import Curriculum
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import EVALUATION_SEED, RECENT, Row, Store
from bulletuav.training.trackers import Log
from bulletuav.training.wall_time import WallTime

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


class Learner(Protocol):
    """Learner whose run is divided into segments."""

    @property
    def num_steps(self) -> int:
        """Number of finished steps of all slots."""

    def begin_segment(self, seed: int) -> None:
        """Reset the environment, and seed all random numbers."""

    def save(self, folder: Path) -> None:
        """Write a checkpoint."""

    def statistics(self) -> dict[str, float]:
        """Return the statistics of the last update by name, such as losses."""


class OwnLearner(Learner, Protocol):
    """Learner whose loop is `learn_in_segments`."""

    def restore(self, folder: Path) -> None:
        """Restore a checkpoint."""

    def collect(self, report: Callable[[list[Info]], None]) -> None:
        """Collect a rollout; `report` is called with the infos of the slots of each decision."""

    def update(self) -> None:
        """Update the policy on the rollout."""


def make_slots(config: RunConfig, kind: type[DroneSlots]) -> Any:
    """Make the training environment of a run.

    Args:
        config: Settings of the run.
        kind: Class of the environment.
    """
    return kind(
        config.task,
        config.worlds,
        config.stages,
        Curriculum(len(config.stages), **config.curriculum),
        config.shared_reward,
        config.staggered,
        **config.options,
    )


class Segments:
    """The segments of a run, which start and end between rollouts."""

    def __init__(
        self,
        config: RunConfig,
        env: DroneSlots,
        store: Store,
        learner: Learner,
        progress: Progress,
        note: Note,
        log: Log,
    ) -> None:
        """Start with no open segment; the environment continues where the store ends.

        Args:
            config: Settings of the run.
            env: The training environment.
            store: Storage of the run.
            learner: The learner.
            progress: Called with the number of finished steps.
            note: Called with a text when episodes end.
            log: Called with the statistics of updates, and with the rows of the curve.
        """
        self._config = config
        self._env = env
        self._store = store
        self._learner = learner
        self._progress = progress
        self._note = note
        self._log = log
        # Episodes of the segment, how many of them are logged, and its rows of updates
        self._episodes: list[dict[str, float]] = []
        self._counted = 0
        self._updates: list[Row] = []
        self._wall = WallTime()
        self._is_open = False
        if store.rows:
            env.curriculum.restore(store.curriculum)
            env.decisions = int(store.rows[-1]["decisions"])

    def start_rollout(self) -> None:
        """End the segment if it is due, and start a segment if none is open."""
        self._wall.part = "simulation"
        if self._is_open:
            self._log_update()
        # The curve starts with the untrained policy
        if not self._store.rows:
            self.end()
        steps = self._learner.num_steps
        rows = self._store.rows
        # Segment k ends at the first rollout after the fraction k / evaluations of the steps
        is_due = steps * self._config.evaluations >= self._config.steps * len(rows)
        if steps > rows[-1]["steps"] and is_due:
            self.end()
        if not self._is_open:
            self._begin()

    def _begin(self) -> None:
        """Start a segment: new episodes, and random numbers independent of earlier segments."""
        segment = np.random.SeedSequence([self._config.seed, len(self._store.rows)])
        # 31 bits: the seed must be positive as a signed integer
        self._learner.begin_segment(int(segment.generate_state(1)[0] >> 1))
        self._is_open = True
        self._wall.part = "simulation"

    def end_rollout(self) -> None:
        """Count the following wall time as update."""
        self._wall.part = "update"

    def _log_update(self) -> None:
        """Log the statistics since the last entry, also to `updates.csv`, if due."""
        steps = self._learner.num_steps
        rows = self._updates or self._store.updates
        since = steps - (rows[-1]["steps"] if rows else 0)
        if since * MAX_UPDATES < self._config.steps:
            return
        fresh = self._episodes[self._counted :]
        self._counted = len(self._episodes)
        found = {f"rollout/{name}": _mean(fresh, key) for name, key in CURVE_COLUMNS.items()}
        found |= self._learner.statistics()
        self._updates.append({"steps": float(steps), **found})
        self._log(found, steps)

    def add_infos(self, infos: Sequence[dict[str, Any]]) -> None:
        """Record and report the episodes that ended in a decision.

        Args:
            infos: Infos of the slots.
        """
        before = len(self._episodes)
        for info in infos:
            if "episode" in info:
                self._episodes.append(info["episode"] | {"success": info["is_success"]})
        if len(self._episodes) > before:
            self._note(self._describe_progress())
        self._progress(self._learner.num_steps)

    def _describe_progress(self) -> str:
        """Return a text with return, success and speed of the training."""
        recent = self._episodes[-RECENT:]
        seconds = sum(self._wall.seconds().values())
        done = self._learner.num_steps - self._store.rows[-1]["steps"]
        return (
            f"training return {_mean(recent, 'r'):.4g}, training success "
            f"{_mean(recent, 'success'):.2f} at {self._env.aviary.options.difficulty}, "
            f"{done / max(seconds, 1e-9):,.0f} steps/s"
        )

    def end(self) -> None:
        """End the segment: save a checkpoint, evaluate it, and add a row to the curve."""
        config = self._config
        if self._is_open:
            self._log_update()
        # Count the following wall time as evaluation
        self._wall.part = "evaluation"
        folder = self._store.next
        self._learner.save(folder)
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
            "steps": self._learner.num_steps,
            "decisions": self._env.decisions,
            "stage": self._env.curriculum.stage,
            "seconds": sum(wall.values()),
            **wall,
            **{f"train/{name}": _mean(self._episodes, key) for name, key in CURVE_COLUMNS.items()},
            **{name: found[name].mean for name in METRICS},
        }
        # Once the segment is stored, an interrupt can only lose its row elsewhere
        self._store.add(row, self._updates, self._env.curriculum.state())
        named = {name if "/" in name else f"evaluation/{name}": row[name] for name in row}
        self._log(named, self._learner.num_steps)
        # Reset for the next segment
        self._episodes, self._counted, self._updates = [], 0, []
        self._wall = WallTime()
        self._is_open = False


def _mean(episodes: list[dict[str, float]], key: str) -> float:
    """Return the mean of a number over episodes; NaN if there are none."""
    return float(np.mean([episode[key] for episode in episodes])) if episodes else np.nan


def learn_in_segments(
    config: RunConfig,
    env: DroneSlots,
    learner: OwnLearner,
    store: Store,
    progress: Progress,
    note: Note,
    log: Log,
) -> None:
    """Train until all steps are done.

    Args:
        config: Settings of the run.
        env: The training environment.
        learner: The learner.
        store: Storage of the run; if it has rows, the last checkpoint is restored.
        progress: Called with the number of finished steps.
        note: Called with a text when episodes end.
        log: Called with the statistics of updates, and with the rows of the curve.

    Raises:
        ValueError: If the checkpoint is damaged.
    """
    if store.rows:
        learner.restore(store.last)
    segments = Segments(config, env, store, learner, progress, note, log)
    while learner.num_steps < config.steps:
        segments.start_rollout()
        learner.collect(segments.add_infos)
        segments.end_rollout()
        learner.update()
    segments.end()
