"""BenchMARL tasks: one for each task of bulletuav, with options from code or Hydra.

    task = DroneTask.CROSSING.get_task({"num_drones": 4, "dynamics": "point_mass"})
    Experiment(task, MappoConfig.get_from_yaml(), ...).run()

The command line is that of BenchMARL. All tasks are registered, without a YAML file for each:

    python -m bulletuav.adapters.benchmarl algorithm=mappo task=bulletuav/crossing task.num_drones=4
"""

import importlib
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.options import EnvOptions
from bulletuav.errors import find_choice, install, missing_extra
from bulletuav.tasks import find_task, list_tasks

NAME = "bulletuav"
"""Name of the environment in BenchMARL, the prefix of its task names"""
TENSOR_ENV_OPTIONS = ("group_map", "return_state", "infos")
"""Options of `DroneTensorEnv` that are not options of the environment"""
FULL_ERROR = "HYDRA_FULL_ERROR"
"""Environment variable that makes Hydra print full tracebacks"""
TASK_DEFAULT = "default"
"""Value in Hydra's configuration that stands for the default of the task"""
SUCCESS = "success"
"""Info that is logged for each drone"""


def require_version() -> None:
    """Check that the installed version of TorchRL is compatible with BenchMARL.

    Raises:
        ImportError: If TorchRL is missing, or is version 0.12 or later.
    """
    try:
        found = version("torchrl")
    except PackageNotFoundError:
        raise missing_extra("training with BenchMARL", "benchmarl") from None
    if tuple(map(int, found.split(".")[:2])) >= (0, 12):
        raise ImportError(
            f"BenchMARL needs torchrl below 0.12, and {found} is installed: the extras 'torchrl' "
            f"and 'benchmarl' exclude each other, make a virtual environment for it and "
            f"{install('benchmarl')}"
        )


require_version()
try:
    import torch
    from benchmarl.algorithms import algorithm_config_registry
    from benchmarl.environments import Task, TaskClass, task_config_registry
    from benchmarl.run import hydra_experiment
    from hydra.core.config_store import ConfigStore
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException
    from torchrl.data import Composite

    from bulletuav.adapters.torchrl import PROCESSES, DroneTensorEnv
except ImportError:
    raise missing_extra("training with BenchMARL", "benchmarl") from None


class DroneTaskClass(TaskClass):  # type: ignore[misc]  # has no types
    """`benchmarl.environments.TaskClass` of one bulletuav task with its options.

    Options are those of `bulletuav.parallel_env`, the option `workers` of `batch_env`, and the
    options `group_map`, `return_state` (default True) and `infos` of `DroneTensorEnv`. Algorithms
    for discrete actions use `action="discrete"` unless an action is given.
    """

    def __init__(self, name: str, config: dict[str, Any] | None) -> None:
        """Check the options.

        Args:
            name: Name of the task in upper or lower case, or `module:Name`.
            config: Options by name; None for the defaults.

        Raises:
            ValueError: If an option is invalid.
        """
        super().__init__(name, config)
        self._source = {task.upper(): task for task in list_tasks()}.get(name.upper(), name)
        own = (*PROCESSES, *TENSOR_ENV_OPTIONS)
        spec = EnvSpec(
            self._source, 1, {key: value for key, value in self.config.items() if key not in own}
        )
        if spec.observer.images:
            raise ValueError(
                f"observation has images {list(spec.observer.images)}: networks of BenchMARL "
                f"take vectors from this adapter, leave images out or train with TorchRL itself"
            )
        self._horizon = spec.options.horizon
        self._is_discrete = spec.action.choices is not None

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], DroneTensorEnv]:
        """Return a function that makes the environment of `num_envs` worlds; see BenchMARL."""
        options = {"return_state": True, "infos": (SUCCESS,), **self.config}
        if seed is not None:
            options["seed"] = seed
        if not continuous_actions:
            options.setdefault("action", "discrete")
        source = self._source
        return lambda: DroneTensorEnv(source, num_envs, device=device, **options)

    def supports_continuous_actions(self) -> bool:
        """Return True if actions are continuous."""
        return not self._is_discrete

    def supports_discrete_actions(self) -> bool:
        """Return True if actions are discrete, or no action is given and so may be discrete."""
        return self._is_discrete or "action" not in self.config

    def max_steps(self, env: Any) -> int:
        """Return the maximum number of decisions of an episode."""
        return self._horizon

    def has_render(self, env: Any) -> bool:
        """Return True if the environment renders images."""
        return bool(self.config.get("render_mode") == "rgb_array")

    def group_map(self, env: Any) -> dict[str, list[str]]:
        """Return the names of the agents of each group."""
        groups: dict[str, list[str]] = env.group_map
        return groups

    def observation_spec(self, env: Any) -> Any:
        """Return the spec of the observations."""
        return self._select_specs(env, "observation")

    def info_spec(self, env: Any) -> Any:
        """Return the spec of the infos, or None without infos."""
        return self._select_specs(env, "info") if self.config.get("infos", (SUCCESS,)) else None

    def state_spec(self, env: Any) -> Any:
        """Return the spec of the global state, or None without it."""
        if not self.config.get("return_state", True):
            return None
        spec = env.full_observation_spec_unbatched
        return Composite({"state": spec["state"].clone()}, device=spec.device)

    def action_spec(self, env: Any) -> Any:
        """Return the spec of the actions."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: Any) -> Any:
        """Return the spec of the masks of actions, or None without the option `action_masks`."""
        return self._select_specs(env, "action_mask") if self.config.get("action_masks") else None

    def _select_specs(self, env: Any, name: str) -> Any:
        """Select one entry of each group from the observation spec."""
        spec = env.full_observation_spec_unbatched
        parts = {
            group: Composite({name: spec[group, name].clone()}, shape=spec[group].shape)
            for group in self.group_map(env)
        }
        return Composite(parts, device=spec.device)

    @staticmethod
    def env_name() -> str:
        """Return the name of the environment, which all tasks share."""
        return NAME

    @staticmethod
    def log_info(batch: Any) -> dict[str, float]:
        """Return the success rate of the drones whose episodes ended in a batch, by group."""
        rates = {}
        for key in batch["next"].keys(include_nested=True):
            if key[1:] == ("info", SUCCESS):
                group = key[0]
                # The last decision of a drone: it flies before the step and not after it
                last = batch[group, "mask"] & ~batch["next", group, "mask"]
                if last.any():
                    reached = batch["next", group, "info", SUCCESS][last]
                    rates[f"collection/{group}/info/drone_success"] = float(reached.mean())
        return rates

    @staticmethod
    def render_callback(experiment: Any, env: Any, data: Any) -> torch.Tensor:
        """Render an image of the first world."""
        return torch.from_numpy(env.base_env.render().copy())


class _DroneTask(Task):  # type: ignore[misc]  # has no types
    """Enum of tasks that need no YAML file."""

    @staticmethod
    def associated_class() -> type[DroneTaskClass]:
        return DroneTaskClass

    def get_task(self, config: dict[str, Any] | None = None) -> DroneTaskClass:
        """Return the task with the given options, and the defaults of the task for the others."""
        given = {key: value for key, value in (config or {}).items() if value != TASK_DEFAULT}
        return DroneTaskClass(self.name, given)


DroneTask = _DroneTask("DroneTask", {name.upper(): None for name in list_tasks()}, module=__name__)
"""Enum with a member for each task of `bulletuav.list_tasks()`, in upper case"""


def option_names(task: str) -> list[str]:
    """Return the names of all options of a task."""
    config = find_task(task).Config
    listed = [
        *PROCESSES,
        *TENSOR_ENV_OPTIONS,
        *(one.name for kind in (EnvOptions, config) for one in fields(kind)),
    ]
    return list(dict.fromkeys(listed))


def register_benchmarl() -> None:
    """Register the tasks with BenchMARL and Hydra; repeated calls have no further effect."""
    store = ConfigStore.instance()
    for task in DroneTask:
        name = task.name.lower()
        task_config_registry[f"{NAME}/{name}"] = task
        node = dict.fromkeys(option_names(name), TASK_DEFAULT)
        store.store(group=f"task/{NAME}", name=name, node=node)


register_benchmarl()


def check_arguments(arguments: Sequence[str]) -> None:
    """Check the names of tasks, algorithms and options before Hydra parses the overrides.

    Args:
        arguments: Overrides of Hydra; a sweep has several names, separated by commas.

    Raises:
        ValueError: If a task, algorithm or option is unknown. The message suggests the closest
            matches.
    """
    values = dict(one.lstrip("+").partition("=")[::2] for one in arguments)
    known = {"task": task_config_registry, "algorithm": algorithm_config_registry}
    for what, table in known.items():
        for name in values[what].split(",") if what in values else ():
            find_choice(what, name, table)
    tasks = [name.partition("/") for name in values.get("task", "").split(",")]
    if all(folder == NAME for folder, _, _ in tasks):
        options = {option: None for _, _, name in tasks for option in option_names(name)}
        for key in values:
            if key.startswith("task."):
                find_choice("option", key.split(".")[1], options)


def run_benchmarl(arguments: Sequence[str] | None = None) -> None:
    """Run the command line of BenchMARL.

    Args:
        arguments: Overrides of Hydra such as "task=bulletuav/crossing"; those of the command line
            if None.

    Raises:
        SystemExit: If a task or algorithm is unknown or an option is invalid, with one line. If
            HYDRA_FULL_ERROR is set, the original error is raised instead.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    in_full = FULL_ERROR in os.environ
    # Otherwise Hydra itself exits, after many lines
    os.environ[FULL_ERROR] = "1"
    try:
        check_arguments(given)
        sys.argv[1:] = given
        # The task itself checks its options
        warnings.filterwarnings("ignore", "TaskConfig python dataclass not found")
        hydra_experiment()
    except (ValueError, HydraException, OmegaConfBaseException) as error:
        if in_full:
            raise
        raise SystemExit(f"bulletuav: {str(error).splitlines()[0]}") from None


if __name__ == "__main__":
    # Import by name, so that objects that BenchMARL pickles can be loaded elsewhere
    importlib.import_module("bulletuav.adapters.benchmarl").run_benchmarl()
