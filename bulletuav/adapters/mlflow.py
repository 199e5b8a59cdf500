"""Logging of training runs to MLflow: settings, and curves of updates and evaluations.

The server is set by `MLFLOW_TRACKING_URI`, such as http://localhost:5000.
"""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from bulletuav.errors import missing_extra
from bulletuav.files import replace_file
from bulletuav.policies.run import RunConfig

try:
    from mlflow import MlflowClient
    from mlflow.entities import Metric, Param, RunTag
    from mlflow.exceptions import MlflowException
except ImportError:
    raise missing_extra("logging a training to MLflow", "mlflow") from None

EXPERIMENT = "bulletuav"
"""Name of the MLflow experiment of all runs"""
RUN_ID = "mlflow.txt"
"""File in the folder of a training that stores the id of its MLflow run"""


@contextlib.contextmanager
def open_mlflow_run(
    name: str, config: RunConfig, conditions: Mapping[str, str], folder: Path
) -> Iterator[Callable[[Mapping[str, float], int], None]]:
    """Create a run in MLflow, or resume that of an interrupted training.

    At the end of the context its status is finished, killed by an interrupt, or failed.

    Args:
        name: Name of the run.
        config: Settings, logged as parameters of the run.
        conditions: Conditions of the training and its evaluations, logged as tags.
        folder: Folder of the training.

    Yields:
        Function that logs the finite of some numbers as metrics, at a number of steps.

    Raises:
        RuntimeError: If MLflow cannot be reached, or rejects the run.
    """
    try:
        client = MlflowClient()
        run = _resume_run(client, folder / RUN_ID) or _create_run(
            client, name, config, conditions, folder / RUN_ID
        )
    except MlflowException as error:
        raise RuntimeError(
            f"MLflow rejects the run: {error.message}; see MLFLOW_TRACKING_URI"
        ) from None

    def log(values: Mapping[str, float], steps: int) -> None:
        now = int(1000 * time.time())
        metrics = [
            Metric(name, float(value), now, steps)
            for name, value in values.items()
            if math.isfinite(value)
        ]
        client.log_batch(run, metrics=metrics)

    status = "KILLED"
    try:
        yield log
        status = "FINISHED"
    except Exception:
        status = "FAILED"
        raise
    finally:
        client.set_terminated(run, status)


def _resume_run(client: MlflowClient, file: Path) -> str | None:
    """Resume the run whose id the file stores; return None if there is no file."""
    if not file.exists():
        return None
    run = file.read_text(encoding="utf-8").strip()
    client.update_run(run, status="RUNNING")
    return run


def _create_run(
    client: MlflowClient, name: str, config: RunConfig, conditions: Mapping[str, str], file: Path
) -> str:
    """Create a run with the settings of the training, and store its id in the file."""
    known = client.get_experiment_by_name(EXPERIMENT)
    experiment = known.experiment_id if known else client.create_experiment(EXPERIMENT)
    run: str = client.create_run(experiment, run_name=name).info.run_id
    client.log_batch(
        run,
        params=[Param(key, str(value)) for key, value in config.plain().items()],
        tags=[RunTag(key, value) for key, value in conditions.items()],
    )
    replace_file(file, run + "\n")
    return run
