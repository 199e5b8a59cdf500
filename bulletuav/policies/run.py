"""The folder of a training run: `run.yaml`, which reproduces it, and `policy.safetensors`, what came out of it."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bulletuav.envs.curriculum import Curriculum, check_stages
from bulletuav.envs.env_spec import MOST_WORLDS
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve import resolve
from bulletuav.errors import as_int, choose, unknown
from bulletuav.tasks import find_task

CONFIG, POLICY = "run.yaml", "policy.safetensors"
CHECKPOINTS = "checkpoints"
ALGORITHMS = ("ppo", "sac", "td3", "dqn", "a2c", "ddpg")
INTERFACE = (
    "action",
    "decision_hz",
    "max_speed",
    "observation",
    "num_neighbours",
    "normalise",
    "num_beams",
    "max_range",
    "lidar_elevations",
    "lidar_frame",
    "camera_size",
    "camera_hz",
)
"""Options that say what a policy sees and does: where it flies they are as in its training"""
SCENE = ("num_drones", "airframe", "difficulty", "preset")
"""Options that evaluations on the way take over from the training, beside those of `INTERFACE`"""
LIMITS = {
    "seed": (0, None),
    "steps": (1, 10**12),
    "worlds": (1, MOST_WORLDS),
    "evaluations": (1, 10**6),
    "episodes": (1, 10**6),
}
"""Least and most of whole numbers of a run"""
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
"""Settings that work with some hundred slots; those of a run go before them"""
SHIPPED = Path(__file__).parents[1] / "trained"


@dataclass(frozen=True)
class RunConfig:
    """What decides a training run.

    task, seed   what is learned, and the seed of weights, worlds and everything drawn
    algo         one of `ALGORITHMS`
    steps        decisions of all slots together; an empty slot counts, too, see `bulletuav.adapters.sb3`
    worlds       that are flown at once
    options      of the environment in training; those of `INTERFACE` also where the policy flies
    stages       further options of each stage of a curriculum, easiest first; one for none
    curriculum   `up`, `down` and `window` of `bulletuav.envs.curriculum.Curriculum`
    shared_reward  whether each drone is rewarded with the mean of all of its world
    model        arguments of the algorithm, see `bulletuav.training.models.make_model`
    evaluations  how many times the policy is evaluated and kept on the way
    episodes     of each
    evaluation   options of the environment in these, beside those of `INTERFACE` and `SCENE`
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

    def __post_init__(self):
        """Raise ValueError for what cannot be, options of environments among it; settings of models are theirs to check."""
        task = find_task(self.task)
        choose("algorithm", self.algo, dict.fromkeys(ALGORITHMS))
        for name, (least, most) in LIMITS.items():
            as_int(name, getattr(self, name), least, most)
        for name in ("options", "curriculum", "model", "evaluation"):
            if not isinstance(getattr(self, name), Mapping):
                raise ValueError(f"{name} is {getattr(self, name)!r}: names with values are needed")
        if not isinstance(self.shared_reward, bool):
            raise ValueError(f"shared_reward is {self.shared_reward!r}: true or false is needed")
        stages = self.stages
        check_stages(stages)
        for name in self.curriculum:
            choose("setting of curriculum:", name, dict.fromkeys(("up", "down", "window")))
        Curriculum(len(stages), **self.curriculum)
        for stage in stages:
            resolve(task, {**self.options, **stage})
        resolve(task, self.evaluated)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "RunConfig":
        """From names and values. Raises ValueError for unknown names, with the nearest, or a missing task."""
        known = [one.name for one in dataclasses.fields(cls)]
        for name in values:
            if name not in known:
                raise unknown("setting of a run:", name, known)
        if "task" not in values:
            raise ValueError("a run without a task: say which")
        counts = {field.name for field in dataclasses.fields(cls) if field.type is int}
        return cls(
            **{
                name: whole_number(value) if name in counts else value
                for name, value in values.items()
            }
        )

    @classmethod
    def read(cls, path: Path) -> "RunConfig":
        """From a YAML file. Raises ValueError where it holds something else, FileNotFoundError where there is none."""
        try:
            values = yaml.load(path.read_text(), _Loader)
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is no YAML file: {error}") from None
        except (FileNotFoundError, IsADirectoryError):
            raise FileNotFoundError(
                f"no file {path}: the run.yaml of a run, or one like it, is needed"
            ) from None
        if not isinstance(values, Mapping):
            raise ValueError(
                f"{path} holds {values!r}: names with values are needed, such as task: crossing"
            )
        try:
            return cls.of(values)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def plain(self) -> dict[str, Any]:
        """Of lists, dicts, texts and numbers alone."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}

    def text(self) -> str:
        """As YAML, which `read` takes back."""
        return yaml.safe_dump(self.plain(), sort_keys=False, default_flow_style=None, width=110)

    @property
    def settings(self) -> dict[str, Any]:
        """The algorithm's settings: those that work with some hundred slots, changed as `model` says."""
        return {**DEFAULTS[self.algo], "features": "symlog", **self.model}

    @property
    def _given(self) -> dict[str, Any]:
        return {**self.options, **self.stages[-1]}

    @property
    def _resolved(self) -> EnvOptions:
        return resolve(find_task(self.task), self._given)[0]

    @property
    def interface(self) -> dict[str, Any]:
        """The options that hold wherever the policy flies: those of `INTERFACE`, also where a preset or so gives them."""
        given, own, usual = self._given, self._resolved, resolve(find_task(self.task), {})[0]
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
        """The options of evaluations on the way."""
        scene = {name: value for name, value in self._given.items() if name in SCENE}
        return {**scene, **self.interface, **self.evaluation}


def shipped_tasks() -> list[str]:
    """Tasks for which there is a trained policy in the package."""
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{CONFIG}"))


def shipped(task: str) -> Path:
    """The folder of the package's run for a task. Raises ValueError where there is none."""
    if task not in shipped_tasks():
        raise ValueError(
            f"no policy for task {task!r} comes with the package: there are some for {', '.join(shipped_tasks())}"
        )
    return SHIPPED / task


def whole_number(value: Any) -> Any:
    """2000000 for 2e6; anything that is no whole number as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Path):
        return str(value)
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


class _Loader(yaml.SafeLoader):
    """Makes nothing but plain values, and takes 1e-3 for a number, which YAML 1.1 takes for a text."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases, of which a short file can make a value that fills the memory."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias, such as *name, and values are to be written out")
        return super().compose_node(parent, index)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)
