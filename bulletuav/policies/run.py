"""Settings of a training run, and the file `run.yaml` that reproduces it.

The folder of a run holds this file and `policy.safetensors`, the policy that came out of it.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bulletuav.envs.curriculum import Curriculum, check_stages
from bulletuav.envs.env_spec import MAX_WORLDS
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.errors import as_int, choose, shown, unknown
from bulletuav.parsing import read_yaml
from bulletuav.tasks import find_task
from bulletuav.version import CONSTANTS

CONFIG = "run.yaml"
"""File with the settings of a run, in its folder"""
VERSION = 1
"""Version of that file: another number means other names or meanings of settings"""
MODULE_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""A name by which a module is imported: `module:Name`"""
POLICY = "policy.safetensors"
"""File with the policy of a run or of a checkpoint, in its folder"""
CHECKPOINTS = "checkpoints"
"""Folder of the checkpoints in that of a run"""
ALGORITHMS = ("ppo", "sac", "td3", "dqn", "a2c", "ddpg")
"""Algorithms of stable-baselines3 that train policies"""
INTERFACE = (
    "action",
    "decision_hz",
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
    "camera_size",
    "camera_hz",
)
"""Options that say what a policy sees and does; they hold wherever it flies"""
SCENE = ("num_drones", "airframe", "difficulty", "preset")
"""Options, beside `INTERFACE`, that evaluations during training take over from it"""
LIMITS = {
    "seed": (0, None),
    "steps": (1, 10**12),
    "worlds": (1, MAX_WORLDS),
    "evaluations": (1, 10**6),
    "episodes": (1, 10**6),
    "constants": (1, None),
}
"""Least and greatest value of each setting that is a whole number; None: no bound"""
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
    "a2c": {"n_steps": 16, "learning_rate": 7e-4, "gamma": 0.99},
    "sac": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4},
    "td3": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "ddpg": {**_REPLAY, "learning_rate": 1e-3, "gradient_steps": 4, "action_noise": 0.2},
    "dqn": {**_REPLAY, "learning_rate": 5e-4, "gradient_steps": 4, "target_update_interval": 5_000},
}
"""Settings of each algorithm that work with some hundred slots; those of a run override them"""
SHIPPED = Path(__file__).parents[1] / "trained"
"""Folder of the runs that come with the package, one for each task"""


@dataclass(frozen=True)
class RunConfig:
    """The settings that decide a training run.

    Attributes:
        task: Name of the task that is learned.
        algo: One of `ALGORITHMS`.
        seed: Seed of weights, worlds and everything drawn.
        steps: Decisions of all slots together; an empty slot counts, too, see
            `bulletuav.adapters.sb3`.
        worlds: How many worlds are flown at once.
        options: Options of the environment in training; those of `INTERFACE` hold also where
            the policy flies.
        stages: Further options of each stage of a curriculum, easiest first; one stage for none.
        curriculum: Arguments `up`, `down` and `window` of `bulletuav.envs.curriculum.Curriculum`.
        shared_reward: Whether each drone is rewarded with the mean of all of its world.
        model: Arguments of the algorithm, see `bulletuav.training.models.make_model`.
        evaluations: How many times the policy is evaluated and kept during training.
        episodes: Episodes of each evaluation.
        evaluation: Options of the environment in these, beside `INTERFACE` and `SCENE`.
        constants: Number of the package's forces, airframes and rewards that it learned with.
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
    model: Mapping[str, Any] = field(default_factory=dict)
    evaluations: int = 20
    episodes: int = 20
    evaluation: Mapping[str, Any] = field(default_factory=dict)
    constants: int = CONSTANTS

    def __post_init__(self) -> None:
        """Check all settings but those of the algorithm, which its own model checks.

        Raises:
            ValueError: A setting, or an option of an environment, is impossible.
        """
        task = find_task(self.task)
        choose("algorithm", self.algo, dict.fromkeys(ALGORITHMS))
        for name, (least, most) in LIMITS.items():
            as_int(name, getattr(self, name), least, most)
        for name in ("options", "curriculum", "model", "evaluation"):
            value = getattr(self, name)
            if not isinstance(value, Mapping):
                raise ValueError(f"{name} is {shown(value)}: names with values are needed")
        if not isinstance(self.shared_reward, bool):
            raise ValueError(
                f"shared_reward is {shown(self.shared_reward)}: true or false is needed"
            )
        # Making the curriculum and the options of all environments checks them.
        check_stages(self.stages)
        for name in self.curriculum:
            choose("setting of curriculum:", name, dict.fromkeys(("up", "down", "window")))
        Curriculum(len(self.stages), **self.curriculum)
        for stage in self.stages:
            resolve_options(task, {**self.options, **stage})
        resolve_options(task, self.evaluated)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "RunConfig":
        """Make the settings from names and values, where 2e6 may stand for 2000000.

        Args:
            values: Settings by name; those left out have their defaults.

        Raises:
            ValueError: A name is unknown (the nearest are told), a value is impossible, or there
                is no task.
        """
        fields = dataclasses.fields(cls)
        known = [one.name for one in fields]
        for name in values:
            if name not in known:
                raise unknown("setting of a run:", name, known)
        if "task" not in values:
            raise ValueError("a run without a task: say which")
        # Files say 2e6 where a whole number is meant.
        counts = {one.name for one in fields if one.type is int}
        given = {
            name: whole_number(value) if name in counts else value for name, value in values.items()
        }
        return cls(**given)

    @classmethod
    def read(cls, path: Path, trust: bool = False) -> "RunConfig":
        """Read the settings from a YAML file.

        Args:
            path: A file as `text` writes it, or one by hand: `version`, `task`, and any other.
            trust: Whether modules that it names as `module:Name` may be imported.

        Raises:
            ValueError: The file is of another kind or version, or holds an impossible setting.
            FileNotFoundError: There is no such file.
        """
        settings = read_settings(path, "run.yaml of a run", trust)
        # Whatever is wrong with them is told with the file's name.
        try:
            return cls.of(settings)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def plain(self) -> dict[str, Any]:
        """Give the version of the file and all settings, made of lists, dicts, texts and numbers.

        Returns:
            What a file holds, by name, in its order.
        """
        settings = {name: plain_value(value) for name, value in dataclasses.asdict(self).items()}
        return {"version": VERSION, **settings}

    def text(self, *names: str) -> str:
        """Write the settings as YAML, which `read` takes back.

        Args:
            names: Those to write beside the version and the task; all if none is named. Other
                trainers write those that they used.
        """
        plain = self.plain()
        kept = {"version", "task", *(names or plain)}
        return write_settings({name: value for name, value in plain.items() if name in kept})

    @property
    def settings(self) -> dict[str, Any]:
        """The algorithm's settings: those of `DEFAULTS`, changed as `model` says."""
        return {**DEFAULTS[self.algo], "features": "symlog", **self.model}

    @property
    def interface(self) -> dict[str, Any]:
        """The options of `INTERFACE` that the policy needs wherever it flies.

        They are those that the training gives, and those that a preset or so changes.
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

    @property
    def action(self) -> str:
        """The action that the policy gives."""
        return self._resolved.action

    @property
    def evaluated(self) -> dict[str, Any]:
        """The options of evaluations during training."""
        scene = {name: value for name, value in self._given.items() if name in SCENE}
        return {**scene, **self.interface, **self.evaluation}

    @property
    def _given(self) -> dict[str, Any]:
        """The options of the last stage, as they were given."""
        return {**self.options, **self.stages[-1]}

    @property
    def _resolved(self) -> EnvOptions:
        """All options of the last stage."""
        return resolve_options(find_task(self.task), self._given).options


def read_settings(
    path: Path,
    what: str,
    trust: bool = False,
) -> dict[str, Any]:
    """Read names and values from a YAML file that tells the version of its form.

    Args:
        path: The file.
        what: What is needed, for the message, such as "run.yaml of a run".
        trust: Whether it may name modules as `module:Name`.

    Returns:
        Its values by name, without the version.

    Raises:
        ValueError: The file is of another kind or version, or names a module.
        FileNotFoundError: There is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}: the {what}, or one like it, is needed")
    values = read_yaml(path)
    if not isinstance(values, Mapping):
        raise ValueError(
            f"{path} holds {shown(values)}: names with values are needed, such as task: crossing"
        )
    _require_version(path, values)
    if not trust:
        _refuse_modules(path, values)
    return {name: value for name, value in values.items() if name != "version"}


def write_settings(values: Mapping[str, Any]) -> str:
    """Write plain values as YAML, which `read_settings` takes back."""
    text: str = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=110)
    return text


def shipped_tasks() -> list[str]:
    """List the tasks for which there is a trained policy in the package."""
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{CONFIG}"))


def shipped(task: str) -> Path:
    """Find the folder of the package's run for a task.

    Args:
        task: Name of the task.

    Raises:
        ValueError: There is none for that task; those that have one are told.
    """
    if task not in shipped_tasks():
        raise ValueError(
            f"no policy for task {task!r} comes with the package: "
            f"there are some for {', '.join(shipped_tasks())}"
        )
    return SHIPPED / task


def whole_number(value: Any) -> Any:
    """Give 2000000 for 2e6, and anything that is no whole number as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _require_version(path: Path, values: Mapping[str, Any]) -> None:
    """Raise ValueError unless a file says that it is of this version."""
    version = values.get("version")
    if type(version) is int and version == VERSION:  # True is no version, though it equals 1
        return
    found = f"version: {shown(version)}" if "version" in values else "no version"
    raise ValueError(
        f"{path} has {found}, and version: {VERSION} is needed: "
        f"train anew, or use the version of bulletuav that made it"
    )


def plain_value(value: Any) -> Any:
    """Make a value of lists, dicts, texts and numbers alone."""
    if isinstance(value, Mapping):
        return {name: plain_value(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Path):
        return str(value)
    return [plain_value(one) for one in value] if isinstance(value, list | tuple) else value


def _refuse_modules(path: Path, value: Any) -> None:
    """Refuse a file that names a module to import: importing it runs its code.

    Raises:
        ValueError: It does; the name and the remedy are told.
    """
    if isinstance(value, Mapping):
        for one in value.values():
            _refuse_modules(path, one)
    elif isinstance(value, list):
        for one in value:
            _refuse_modules(path, one)
    elif isinstance(value, str) and MODULE_NAME.fullmatch(value):
        raise ValueError(
            f"{path} names {shown(value)}, whose module would be imported: if you know who made "
            f"it, say so by --trust (in Python trust=True)"
        )
