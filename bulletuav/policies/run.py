"""Configuration of a training run, and the file `run.yaml` that reproduces the run.

The folder of a run contains this file and `policy.safetensors`, the trained policy.
"""

import dataclasses
import functools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bulletuav.control.actions import ActionNames, action_names
from bulletuav.envs.curriculum import Curriculum, check_stages
from bulletuav.envs.env_spec import MAX_WORLDS
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.errors import as_int, find_choice, shown, unknown
from bulletuav.parsing import read_yaml
from bulletuav.tasks import find_task
from bulletuav.version import CONSTANTS

CONFIG = "run.yaml"
"""File name of the run configuration"""
VERSION = 1
"""Version of the file format; it changes with the names or meanings of settings"""
MODULE_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""Name by which a module is imported: `module:Name`"""
POLICY = "policy.safetensors"
"""File name of the policy of a run or of a checkpoint"""
CURVE = "curve.csv"
"""File of the learning curve"""
CHECKPOINTS = "checkpoints"
"""Name of the checkpoint folder of a run"""
FAST = "fast_ppo"
"""PPO of `bulletuav.training.fast`, without PyTorch"""
FOUNDATION = "foundation"
"""Imitation of many teachers by one recurrent policy, see `bulletuav.training.foundation`"""
COMPILED = (FAST, FOUNDATION)
"""Training algorithms without PyTorch"""
SB3_ALGORITHMS = ("ppo", "sac", "td3", "dqn", "a2c", "ddpg")
"""Training algorithms of stable-baselines3"""
ALGORITHMS = (*SB3_ALGORITHMS, *COMPILED)
"""All training algorithms"""
MASKABLE = ("ppo", FAST)
"""Algorithms that learn with masks of actions; "ppo" as MaskablePPO of sb3-contrib"""
INTERFACE = (
    "action",
    "decision_hz",
    "decision_every",
    "max_speed",
    "max_climb",
    "observation",
    "sensors",
    "num_neighbours",
    "normalise",
    "num_beams",
    "max_range",
    "lidar_elevations",
    "lidar_frame",
    "camera",
    "camera_size",
    "camera_hz",
    "camera_range",
    "camera_depth",
    "camera_mounts",
    "camera_format",
    "frame_stack",
)
"""Options that determine observations and actions of a policy; fixed wherever it flies"""
OBSERVED = (
    "observation",
    "normalise",
    "num_beams",
    "max_range",
    "lidar_elevations",
    "lidar_frame",
)
"""Options of `INTERFACE` that change what the numbers of an observation mean"""
RANGED = {
    "num_beams": ("lidar",),
    "max_range": ("lidar", "room"),
    "lidar_elevations": ("lidar",),
    "lidar_frame": ("lidar",),
}
"""Observation blocks that some of these options change"""
SCENE = ("num_drones", "airframe", "difficulty", "preset")
"""Options, besides `INTERFACE`, that evaluations inherit from training"""
LIMITS = {
    "seed": (0, None),
    "steps": (1, 10**12),
    "worlds": (1, MAX_WORLDS),
    "evaluations": (1, 10**6),
    "episodes": (1, 10**6),
    "constants": (1, None),
}
"""Minimum and maximum of each integer setting; None: unbounded"""
_REPLAY = {
    "learning_starts": 10_000,
    "batch_size": 1024,
    "buffer_size": 300_000,
    "train_freq": 1,
    "gamma": 0.99,
}
DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 64,
        "batch_size": 2048,
        "n_epochs": 5,
        "learning_rate": [1e-3, 1e-5],
        "gamma": 0.99,
        "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.0},
    },
    FAST: {
        "n_steps": 32,
        "batch_size": 1024,
        "n_epochs": 4,
        "learning_rate": [2e-3, 1e-5],
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "clip_range": 0.2,
        "ent_coef": 0.0,
        "vf_coef": 0.5,
        "max_grad_norm": 0.5,
        "critic": "own",
        "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.0},
    },
    FOUNDATION: {
        "airframes": 64,
        "hidden_size": 20,
        "buffer_size": 2048,
        "batch_size": 64,
        "gradient_steps": 16,
        "learning_rate": [5e-3, 1e-5],
        "max_grad_norm": 1.0,
    },
    "a2c": {"n_steps": 16, "learning_rate": 7e-4, "gamma": 0.99},
    "sac": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4},
    "td3": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "ddpg": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "dqn": {**_REPLAY, "learning_rate": 5e-4, "gradient_steps": 4, "target_update_interval": 5_000},
}
"""Default settings of each algorithm, tuned for some hundred slots; a run overrides them"""
SHIPPED = Path(__file__).parents[1] / "trained"
"""Folder of the runs in the package, one for each task"""


@dataclass(frozen=True)
class RunConfig:
    """Configuration of a training run.

    Attributes:
        task: Name of the task.
        algo: One of `ALGORITHMS`.
        seed: Seed of weights, worlds and all random numbers.
        steps: Total number of decisions of all slots, including empty slots, see
            `bulletuav.adapters.sb3`.
        worlds: Number of parallel worlds.
        options: Options of the training environment; those of `INTERFACE` apply wherever the policy
            flies.
        stages: Additional options of each curriculum stage, easiest first; one stage for no
            curriculum.
        curriculum: Arguments `up`, `down` and `window` of `bulletuav.envs.curriculum.Curriculum`.
        shared_reward: Whether each drone gets the mean reward of its world.
        staggered: Whether the first episodes of the worlds are cut at different times, so that
            rollouts shorter than an episode have all phases of it.
        model: Arguments of the algorithm, see `bulletuav.training.models.make_model`.
        evaluations: Number of evaluations and checkpoints during training.
        episodes: Number of episodes of each evaluation.
        evaluation: Options of evaluation environments, besides `INTERFACE` and `SCENE`.
        constants: Version number of the package's forces, airframes and rewards in training.
    """

    task: str
    algo: str = "ppo"
    seed: int = 0
    steps: int = 1_000_000
    worlds: int = 32
    options: Mapping[str, Any] = field(default_factory=dict)
    stages: Sequence[Mapping[str, Any]] = ({},)
    curriculum: Mapping[str, Any] = field(default_factory=dict)
    shared_reward: bool = False
    staggered: bool = False
    model: Mapping[str, Any] = field(default_factory=dict)
    evaluations: int = 20
    episodes: int = 20
    evaluation: Mapping[str, Any] = field(default_factory=dict)
    constants: int = CONSTANTS

    def __post_init__(self) -> None:
        """Validate all settings except those of the algorithm, which the algorithm validates.

        Raises:
            ValueError: If a setting, or an option of an environment, is invalid.
        """
        task = find_task(self.task)
        find_choice("algorithm", self.algo, dict.fromkeys(ALGORITHMS))
        for name, (low, high) in LIMITS.items():
            as_int(name, getattr(self, name), low, high)
        for name in ("options", "curriculum", "model", "evaluation"):
            value = getattr(self, name)
            if not isinstance(value, Mapping):
                raise ValueError(f"{name} is {shown(value)}: names with values are needed")
        for name in ("shared_reward", "staggered"):
            if not isinstance(value := getattr(self, name), bool):
                raise ValueError(f"{name} is {shown(value)}: true or false is needed")
        # Constructing the curriculum and the options validates them.
        check_stages(self.stages)
        for name in self.curriculum:
            find_choice("setting of curriculum:", name, dict.fromkeys(("up", "down", "window")))
        Curriculum(len(self.stages), **self.curriculum)
        for stage in self.stages:
            resolve_options(task, {**self.options, **stage})
            if "action_masks" in stage:
                raise ValueError(
                    "stages: action_masks is the same in all stages: set it in options instead"
                )
        if self.action_masks and self.algo not in MASKABLE:
            raise ValueError(
                f"action_masks is True, and algorithm {self.algo!r} ignores masks: choose "
                f"{' or '.join(map(repr, MASKABLE))}, or leave action_masks out"
            )
        resolve_options(task, self.evaluated)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "RunConfig":
        """Create a configuration from settings by name; 2e6 is accepted for 2000000.

        Args:
            values: Settings by name; missing ones have their defaults.

        Raises:
            ValueError: If a name is unknown (the message suggests similar names), a value is
                invalid, or the task is missing.
        """
        fields = dataclasses.fields(cls)
        known = [one.name for one in fields]
        for name in values:
            if name not in known:
                raise unknown("setting of a run:", name, known)
        if "task" not in values:
            raise ValueError("a run needs a task: set task")
        # YAML reads 2e6 as a float.
        counts = {one.name for one in fields if one.type is int}
        given = {
            name: whole_number(value) if name in counts else value for name, value in values.items()
        }
        return cls(**given)

    @classmethod
    def read(cls, path: Path, trust: bool = False, known: Collection[Any] = ()) -> "RunConfig":
        """Read a configuration from a YAML file.

        Args:
            path: A file written by `text`, or by hand: `version`, `task`, and any other settings.
            trust: Whether modules that the file names as `module:Name` may be imported.
            known: Names whose modules may be imported in any case.

        Raises:
            ValueError: If the file is of another kind or version, or contains an invalid setting.
            FileNotFoundError: If there is no such file.
        """
        settings = read_settings(path, "run.yaml of a run", trust, known)
        # Add the name of the file to all errors.
        try:
            return cls.of(settings)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def plain(self) -> dict[str, Any]:
        """Return the file version and all settings as lists, dicts, strings and numbers.

        Returns:
            Contents of the file by name, in the order of the file.
        """
        settings = {name: plain_value(value) for name, value in dataclasses.asdict(self).items()}
        return {"version": VERSION, **settings}

    def text(self, *names: str) -> str:
        """Format the settings as YAML, which `read` accepts.

        Args:
            names: Settings to include besides version and task; all if empty. Other trainers
                include the settings that they used.
        """
        plain = self.plain()
        kept = {"version", "task", *(names or plain)}
        return write_settings({name: value for name, value in plain.items() if name in kept})

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the algorithm: `DEFAULTS`, overridden by `model`."""
        settings = {**DEFAULTS[self.algo], "features": "symlog", **self.model}
        if self.action_masks and "policy_kwargs" not in self.model:
            # Policies of MaskablePPO have no standard deviation
            layers = dict(settings["policy_kwargs"])
            layers.pop("log_std_init")
            settings["policy_kwargs"] = layers
        return settings

    @property
    def interface(self) -> dict[str, Any]:
        """Options of `INTERFACE` that the policy requires wherever it flies.

        These are the options that training sets, and those that a preset changes.
        """
        given = self._given
        own = self._resolved
        usual = resolve_options(find_task(self.task), {}).options
        values = {name: getattr(own, name) for name in INTERFACE}
        return {
            name: value
            for name, value in values.items()
            if name in given or value != getattr(usual, name)
        }

    def require_observed(self, task: str, options: EnvOptions) -> None:
        """Check that an environment has the observations of the training.

        Networks for numbers of other observations would return actions without sense. The number of
        neighbours may differ, as far as the network accepts it.

        Args:
            task: Name of the task to fly.
            options: Options of the environment.

        Raises:
            ValueError: If an option of `OBSERVED` differs; the message names the remedy.
        """
        own, named = self._resolved, self.interface
        blocks = own.observation or find_task(self.task).observation
        is_listed = not isinstance(blocks, Mapping) and all(isinstance(one, str) for one in blocks)
        for name in OBSERVED:
            if is_listed and name in RANGED and not set(RANGED[name]) & set(blocks):
                continue
            # Another task has defaults of its own, and fits if the network does
            if task != self.task and name not in named:
                continue
            given, learned = getattr(options, name), getattr(own, name)
            # The same block of a user's module may be named or be an object
            if given != learned and not (_has_module(given) or _has_module(learned)):
                raise ValueError(
                    f"{name} is {shown(plain_value(given))}, and it was trained for task "
                    f"{self.task!r} with {shown(plain_value(learned))} and "
                    f"{' or '.join(map(str, action_names(self.action)))} actions: leave {name} "
                    f"out, or train another policy, by bulletuav train {task} "
                    f"--set {name}=VALUE"
                )

    @property
    def action(self) -> ActionNames:
        """Action type of the policy; or of each drone, or by team."""
        return self._resolved.action

    @property
    def action_masks(self) -> bool:
        """Whether the policy is trained, and flies, with masks of discrete actions."""
        return self._resolved.action_masks

    @property
    def evaluated(self) -> dict[str, Any]:
        """Options of the evaluations during training."""
        scene = {name: value for name, value in self._given.items() if name in SCENE}
        return {**scene, **self.interface, **self.evaluation}

    @property
    def _given(self) -> dict[str, Any]:
        """Options of the last stage as given."""
        return {**self.options, **self.stages[-1]}

    @functools.cached_property
    def _resolved(self) -> EnvOptions:
        """All options of the last stage, with defaults."""
        return resolve_options(find_task(self.task), self._given).options


def read_settings(
    path: Path, what: str, trust: bool = False, known: Collection[Any] = ()
) -> dict[str, Any]:
    """Read settings from a YAML file with a format version.

    Args:
        path: The file.
        what: Description of the required file, for the message, such as "run.yaml of a run".
        trust: Whether the file may name modules as `module:Name`.
        known: Names that it may name in any case, as the user named them, too.

    Returns:
        Settings by name, without the version.

    Raises:
        ValueError: If the file is of another kind or version, or names a module.
        FileNotFoundError: If there is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}: the {what}, or a similar file, is needed")
    values = read_yaml(path)
    if not isinstance(values, Mapping):
        raise ValueError(
            f"{path} contains {shown(values)}: names with values are needed, such as task: crossing"
        )
    _require_version(path, values)
    if not trust:
        _forbid_modules(path, values, known)
    return {name: value for name, value in values.items() if name != "version"}


def write_settings(values: Mapping[str, Any]) -> str:
    """Format plain values as YAML, which `read_settings` accepts."""
    text: str = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=110)
    return text


def shipped_tasks() -> list[str]:
    """List the tasks with a trained policy in the package."""
    folders = (path.parent.name for path in SHIPPED.glob(f"*/{CONFIG}"))
    return sorted(name for name in folders if name != FOUNDATION)


def shipped(task: str) -> Path:
    """Return the folder of the package's training run for a task.

    Args:
        task: Name of the task.

    Raises:
        ValueError: If there is no run for the task; the message lists the tasks that have one, and
            the command that trains one.
    """
    if task not in shipped_tasks():
        raise ValueError(
            f"the package has no policy for task {task!r}, only for {', '.join(shipped_tasks())}: "
            f"train one by bulletuav train {task}, and fly its folder"
        )
    return SHIPPED / task


def whole_number(value: Any) -> Any:
    """Convert a float with an integer value to int; return other values unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _require_version(path: Path, values: Mapping[str, Any]) -> None:
    """Raise ValueError unless the file has the supported version."""
    version = values.get("version")
    if type(version) is int and version == VERSION:  # excludes True, which equals 1
        return
    found = f"version: {shown(version)}" if "version" in values else "no version"
    raise ValueError(
        f"{path} has {found}, and version: {VERSION} is needed: "
        f"train again, or use the version of bulletuav that wrote the file"
    )


def _has_module(value: Any) -> bool:
    """Return True if blocks of an observation are objects, or names of a user's module."""
    if isinstance(value, Mapping):
        return any(_has_module(one) for one in value.values())
    return isinstance(value, tuple) and any(
        not isinstance(one, str | float) or ":" in str(one) for one in value
    )


def plain_value(value: Any) -> Any:
    """Convert a value to lists, dicts, strings and numbers."""
    if isinstance(value, Mapping):
        return {name: plain_value(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Path):
        return str(value)
    return [plain_value(one) for one in value] if isinstance(value, list | tuple) else value


def _forbid_modules(path: Path, value: Any, known: Collection[Any]) -> None:
    """Check that a file names no module beside known ones, as importing a module runs its code.

    Raises:
        ValueError: If the file names a module; the message includes the name and the remedy.
    """
    if isinstance(value, Mapping):
        for one in value.values():
            _forbid_modules(path, one, known)
    elif isinstance(value, list):
        for one in value:
            _forbid_modules(path, one, known)
    elif isinstance(value, str) and MODULE_NAME.fullmatch(value) and value not in known:
        raise ValueError(
            f"{path} names {shown(value)}, whose module would be imported: if you trust its "
            f"author, set --trust (in Python trust=True)"
        )
