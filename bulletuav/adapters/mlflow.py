"""Logging of training runs to MLflow: settings, and curves of updates and evaluations.

The server is set by `MLFLOW_TRACKING_URI`, such as http://localhost:5000.
"""

import math
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bulletuav.errors import missing_extra
from bulletuav.files import replace_file
from bulletuav.policies.run import RunConfig

try:
    from mlflow import MlflowClient
    from mlflow.entities import Metric, Param
    from mlflow.exceptions import MlflowException
    from stable_baselines3.common.logger import KVWriter
except ImportError:
    raise missing_extra("logging a training to MLflow", "mlflow") from None

EXPERIMENT = "bulletuav"
"""Name of the MLflow experiment of all runs"""
RUN_ID = "mlflow.txt"
"""File in the folder of a run that stores its MLflow run id"""


class MlflowWriter(KVWriter):
    """Output format of the stable-baselines3 logger that writes to an MLflow run.

    It is a context manager, which sets the final status of the run.
    """

    def __init__(self, config: RunConfig, folder: Path) -> None:
        """Create a run in MLflow, or resume the run of an interrupted training.

        Args:
            config: Settings, logged as parameters of the run.
            folder: Folder of the training.

        Raises:
            RuntimeError: If MLflow cannot be reached, or rejects the run.
        """
        try:
            self._client = MlflowClient()
            self._run = self._resume_run(folder / RUN_ID) or self._create_run(
                config, folder / RUN_ID
            )
        except MlflowException as error:
            raise RuntimeError(
                f"MLflow rejects the run: {error.message}; see MLFLOW_TRACKING_URI"
            ) from None

    def _resume_run(self, file: Path) -> str | None:
        """Resume the run whose id the file stores; return None if there is no file."""
        if not file.exists():
            return None
        run = file.read_text(encoding="utf-8").strip()
        self._client.update_run(run, status="RUNNING")
        return run

    def _create_run(self, config: RunConfig, file: Path) -> str:
        """Create a run, and store its id in the file."""
        known = self._client.get_experiment_by_name(EXPERIMENT)
        place = known.experiment_id if known else self._client.create_experiment(EXPERIMENT)
        name = f"{config.task}-{config.algo}-{config.seed}"
        run: str = self._client.create_run(place, run_name=name).info.run_id
        params = [Param(key, str(value)) for key, value in config.plain().items()]
        self._client.log_batch(run, params=params)
        replace_file(file, run + "\n")
        return run

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        """Log the finite numbers of a step as metrics, and texts as tags."""
        now = int(1000 * time.time())
        texts = {key: value for key, value in key_values.items() if isinstance(value, str)}
        numbers = {key: float(key_values[key]) for key in key_values.keys() - texts.keys()}
        for key, text in texts.items():
            self._client.set_tag(self._run, key, text)
        metrics = [
            Metric(key, value, now, step) for key, value in numbers.items() if math.isfinite(value)
        ]
        self._client.log_batch(self._run, metrics=metrics)

    def close(self) -> None:
        """Do nothing: `__exit__` ends the run."""

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """Set the final status of the run: finished, killed by an interrupt, or failed."""
        status = "FINISHED" if kind is None else "FAILED"
        if kind is not None and not issubclass(kind, Exception):
            status = "KILLED"
        self._client.set_terminated(self._run, status)
