"""The folder of a training run: `run.yaml`, which reproduces it, and `model.zip`, what came out of it."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bulletuav.errors import pick, unknown, whole
from bulletuav.tasks import find_task

CONFIG, MODEL = "run.yaml", "model.zip"
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
SHIPPED = Path(__file__).parents[1] / "trained"


@dataclass(frozen=True)
class RunConfig:
    """What decides a training run.

    task, seed   what is learned, and the seed of weights, worlds and everything drawn
    algo         one of `ALGORITHMS`
    steps        decisions of all slots together; an empty slot counts, too, see `bulletuav.adapters.sb3`
    worlds       that are flown at once
    options      of the environment in training; those of `INTERFACE` also where the policy flies
    levels       further options of each level of a curriculum, easiest first; one for none
    curriculum   `up`, `down` and `window` of `bulletuav.envs.curriculum.Curriculum`
    shared_reward  whether each drone is rewarded with the mean of all of its world
    model        arguments of the algorithm, see `bulletuav.training.models.make_model`
    evaluations  how many times the policy is evaluated and kept on the way
    episodes     of each
    evaluation   options of the environment in these, beside those of `INTERFACE`
    """

    task: str
    algo: str = "ppo"
    seed: int = 0
    steps: int = 1_000_000
    worlds: int = 32
    options: Mapping[str, Any] = field(default_factory=dict)
    levels: Sequence[Mapping[str, Any]] = ({},)
    curriculum: Mapping[str, Any] = field(default_factory=dict)
    shared_reward: bool = False
    model: Mapping[str, Any] = field(default_factory=dict)
    evaluations: int = 20
    episodes: int = 20
    evaluation: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        """Raise ValueError for what cannot be; options are checked where environments are made."""
        find_task(self.task)
        pick("algorithm", self.algo, dict.fromkeys(ALGORITHMS))
        for name, least in (("seed", 0), ("steps", 1), ("worlds", 1), ("evaluations", 1), ("episodes", 1)):
            whole(name, getattr(self, name), least)
        for name in ("options", "curriculum", "model", "evaluation"):
            if not isinstance(getattr(self, name), Mapping):
                raise ValueError(f"{name} is {getattr(self, name)!r}: names with values are needed")
        if not isinstance(self.shared_reward, bool):
            raise ValueError(f"shared_reward is {self.shared_reward!r}: true or false is needed")
        if isinstance(self.levels, Mapping | str) or not all(isinstance(level, Mapping) for level in self.levels):
            raise ValueError(f"levels is {self.levels!r}: a list of names with values is needed")

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "RunConfig":
        """From names and values. Raises ValueError for unknown names, with the nearest, or a missing task."""
        known = [one.name for one in dataclasses.fields(cls)]
        for name in values:
            if name not in known:
                raise unknown("setting of a run:", name, known)
        if "task" not in values:
            raise ValueError("a run without a task: say which")
        numbers = {name: _whole(values[name]) for name in ("steps", "seed") if name in values}
        return cls(**{**values, **numbers})

    @classmethod
    def read(cls, path: Path) -> "RunConfig":
        """From a YAML file. Raises ValueError where it holds something else, FileNotFoundError where there is none."""
        yaml = _yaml()
        try:
            values = yaml.safe_load(path.read_text())
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is no YAML file: {error}") from None
        except FileNotFoundError:
            raise FileNotFoundError(f"no file {path}: the run.yaml of a run, or one like it, is needed") from None
        if not isinstance(values, Mapping):
            raise ValueError(f"{path} holds {values!r}: names with values are needed, such as task: crossing")
        try:
            return cls.of(values)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def text(self) -> str:
        """As YAML, which `read` takes back."""
        plain = {name: _plain(value) for name, value in dataclasses.asdict(self).items()}
        return _yaml().safe_dump(plain, sort_keys=False, default_flow_style=None, width=110)

    @property
    def interface(self) -> dict[str, Any]:
        """The options that hold wherever the policy flies."""
        options = {**self.options, **self.levels[-1]}
        return {name: options[name] for name in INTERFACE if name in options}


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


def _plain(value: Any) -> Any:
    """The same of lists and dicts alone."""
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _whole(value: Any) -> Any:
    """2000000 for 2e6, which YAML takes for a text; anything else as it is."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return value
    return int(number) if number.is_integer() else value


def _yaml() -> Any:
    try:
        import yaml
    except ImportError:
        raise ImportError("runs are told in YAML, which needs the extra 'sb3': pip install 'bulletuav[sb3]'") from None
    return yaml
