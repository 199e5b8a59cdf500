"""Experiment trackers, to which trainings of all algorithms can log."""

import contextlib
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path

from bulletuav.errors import find_choice
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import evaluation_conditions, training_conditions

Log = Callable[[Mapping[str, float], int], None]
"""Callback with numbers by name, such as "evaluation/return", and the number of finished steps"""
TRACKERS = {
    "mlflow": ("bulletuav.adapters.mlflow", "open_mlflow_run"),
    "wandb": ("bulletuav.adapters.wandb", "open_wandb_run"),
}
"""Module and function of each tracker, which needs the extra of the same name"""


def open_tracker(
    name: str | None, config: RunConfig, folder: Path
) -> contextlib.AbstractContextManager[Log]:
    """Open the run of a training in a tracker, and close it at the end of the context.

    A training that is resumed continues its run.

    Args:
        name: One of `TRACKERS`; None for no tracker.
        config: Settings of the training, which the tracker stores.
        folder: Folder of the training, in which the tracker stores the id of its run.

    Raises:
        ValueError: If there is no such tracker.
        ImportError: If the extra of the tracker is not installed.
        RuntimeError: If the tracker cannot be reached, or rejects the run.
    """
    if name is None:
        return contextlib.nullcontext(lambda values, steps: None)
    module, function = find_choice("tracker", name, TRACKERS)
    open_run = getattr(importlib.import_module(module), function)
    conditions = {
        "rollout/conditions": str(training_conditions(config)),
        "evaluation/conditions": str(evaluation_conditions(config)),
    }
    run_name = f"{config.task}-{config.algo}-{config.seed}"
    opened: contextlib.AbstractContextManager[Log] = open_run(run_name, config, conditions, folder)
    return opened
