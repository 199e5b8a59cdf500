"""Logging of training runs to Weights & Biases: settings, and curves of updates and evaluations.

`WANDB_MODE=offline` writes the run to the folder of the training, without a network or an account;
`wandb sync` uploads it. The other variables of the library apply, too, such as `WANDB_PROJECT`.
"""

import contextlib
import math
import os
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path

from bulletuav.errors import missing_extra
from bulletuav.files import replace_file
from bulletuav.policies.run import RunConfig
from bulletuav.training.store import evaluation_conditions, training_conditions
from bulletuav.training.trackers import Log, run_name

try:
    import wandb
except ImportError:
    raise missing_extra("logging a training to Weights & Biases", "wandb") from None

PROJECT = "bulletuav"
"""Name of the project of all runs, if `WANDB_PROJECT` names no other"""
RUN_ID = "wandb.txt"
"""File in the folder of a training that stores the id of its run"""


@contextlib.contextmanager
def open_run(config: RunConfig, folder: Path) -> Iterator[Log]:
    """Create a run, or resume that of an interrupted training.

    A run that ends by an exception is marked as failed.

    Args:
        config: Settings, stored as those of the run.
        folder: Folder of the training, which gets a subfolder `wandb`.

    Yields:
        Function that logs finite numbers.

    Raises:
        RuntimeError: If the run cannot be created, for example without an account.
    """
    file = folder / RUN_ID
    if not file.exists():
        replace_file(file, secrets.token_hex(4) + "\n")
    conditions = {
        "rollout/conditions": str(training_conditions(config)),
        "evaluation/conditions": str(evaluation_conditions(config)),
    }
    try:
        run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            name=run_name(config),
            id=file.read_text(encoding="utf-8").strip(),
            resume="allow",
            dir=folder,
            config={**config.plain(), **conditions},
        )
    except wandb.errors.Error as error:
        raise RuntimeError(
            f"Weights & Biases rejects the run: {error}; log in by `wandb login`, or set "
            f"WANDB_MODE=offline"
        ) from None

    def log(values: Mapping[str, float], steps: int) -> None:
        finite = {name: float(value) for name, value in values.items() if math.isfinite(value)}
        run.log(finite, step=steps)

    with run:
        yield log
