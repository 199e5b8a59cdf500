"""Logging of training runs to Weights & Biases: settings, and curves of updates and evaluations.

`WANDB_MODE=offline` writes the run to the folder of the training, without a network or an account;
`wandb sync` uploads it. The other variables of the library apply, too, such as `WANDB_PROJECT`.
"""

import contextlib
import math
import os
import secrets
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from bulletuav.errors import missing_extra
from bulletuav.files import replace_file
from bulletuav.policies.run import RunConfig

try:
    import wandb
except ImportError:
    raise missing_extra("logging a training to Weights & Biases", "wandb") from None

PROJECT = "bulletuav"
"""Name of the project of all runs, if `WANDB_PROJECT` names no other"""
RUN_ID = "wandb.txt"
"""File in the folder of a training that stores the id of its run"""


@contextlib.contextmanager
def open_wandb_run(
    name: str, config: RunConfig, conditions: Mapping[str, str], folder: Path
) -> Iterator[Callable[[Mapping[str, float], int], None]]:
    """Create a run, or resume that of an interrupted training.

    A run that ends by an exception is marked as failed.

    Args:
        name: Name of the run.
        config: Settings, stored as those of the run.
        conditions: Conditions of the training and its evaluations, stored with the settings.
        folder: Folder of the training, which gets a subfolder `wandb`.

    Yields:
        Function that logs the finite of some numbers, at a number of steps.

    Raises:
        RuntimeError: If the run cannot be created, for example without an account.
    """
    file = folder / RUN_ID
    if not file.exists():
        replace_file(file, secrets.token_hex(4) + "\n")
    try:
        run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", PROJECT),
            name=name,
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
