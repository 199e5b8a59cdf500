"""Training in segments between checkpoints, so that an interrupted run can be resumed.

A resumed run ends with the same weights as an uninterrupted run.
"""

import importlib
from pathlib import Path

from bulletuav.policies.run import FAST, FOUNDATION, RunConfig
from bulletuav.training.fast.settings import check_fast_settings
from bulletuav.training.foundation.settings import check_foundation_settings
from bulletuav.training.segments import Note, Progress
from bulletuav.training.store import Row, open_store
from bulletuav.training.trackers import open_tracker

FAST_LEARNER = "bulletuav.training.fast.learner"
"""Module of the algorithm `FAST`"""
FOUNDATION_LEARNER = "bulletuav.training.foundation.learner"
"""Module of the algorithm `FOUNDATION`"""
MODELS = "bulletuav.training.models"
"""Module that checks the settings of all other algorithms"""
SB3_LEARNER = "bulletuav.training.sb3_learner"
"""Module of all other algorithms; imported lazily, as it needs the extra `sb3`"""


def train(
    config: RunConfig,
    out: Path,
    progress: Progress = lambda steps: None,
    note: Note = lambda text: None,
    tracker: str | None = None,
) -> list[Row]:
    """Train a policy, and store everything in a folder.

    Each segment ends with an evaluation and a checkpoint, see `bulletuav.training.segments`. A call
    with the same configuration resumes from the last checkpoint, and ends with the weights of an
    uninterrupted run.

    Args:
        config: Settings of the run.
        out: The folder.
        progress: Called with the number of finished steps.
        note: Called with a text of return, success and speed when episodes end.
        tracker: Name of an experiment tracker to which the training also logs, one of
            `bulletuav.training.trackers.TRACKERS`.

    Returns:
        The learning curve, see `Store`.

    Raises:
        ValueError: If the configuration is invalid, or the folder has another run.
        ImportError: If the extra `sb3`, or that of the tracker, is not installed.
        RuntimeError: If the tracker cannot be reached.
    """
    if config.algo == FAST:
        learn = importlib.import_module(FAST_LEARNER).learn_fast
    elif config.algo == FOUNDATION:
        learn = importlib.import_module(FOUNDATION_LEARNER).learn_foundation
    else:
        learn = importlib.import_module(SB3_LEARNER).learn_by_sb3
    opened = open_tracker(tracker, config, out)
    with open_store(out, config) as store:
        if not store.finished:
            with opened as log:
                learn(config, store, progress, note, log)
        progress(config.steps)
        return store.rows


def check_algorithm(config: RunConfig) -> None:
    """Check the settings of the algorithm of a run, without creating a model.

    Raises:
        ValueError: If the algorithm has no such setting. The message suggests the closest names.
        ImportError: If the extra `sb3` is not installed, and the algorithm needs it.
    """
    if config.algo == FAST:
        check_fast_settings(config)
    elif config.algo == FOUNDATION:
        check_foundation_settings(config)
    else:
        importlib.import_module(MODELS).check_settings(config)
