"""Baseline policies, and those that were trained."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import choose, shown
from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.coverage import Centroid, Hotspot, KMeans, Oracle
from bulletuav.policies.orca import Orca
from bulletuav.policies.planner import Planner
from bulletuav.policies.potential import PotentialField
from bulletuav.policies.random import RandomActions
from bulletuav.policies.run import ALGORITHMS, CHECKPOINTS, CONFIG, POLICY, RunConfig, shipped
from bulletuav.policies.straight import StraightLine
from bulletuav.policies.trained import TRUST, Sb3Model, SharedPolicy, Trained
from bulletuav.tasks import TaskSource, find_task

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy
    for policy in (
        StraightLine,
        PotentialField,
        Orca,
        Planner,
        RandomActions,
        Centroid,
        Hotspot,
        KMeans,
        Oracle,
    )
}
PolicySource = str | Path | type[Policy]
NEEDED = ("name", "actions", "reads_swarm")
"""Attributes that every policy class has"""
SHIPPED_NAMES = ("trained", "untrained")
OLD_MODEL = "model.zip"


class PolicySpec(NamedTuple):
    """A policy to be: its name, the actions that it can give (none named: any), what it reads, and how to make it.

    `model`: its file, where it is a trained one; `options`: those that environments need for it to see and do what it
    learned with.
    """

    name: str
    actions: tuple[str, ...]
    reads_swarm: bool
    make: Callable[[Aviary], Policy]
    model: Path | None = None
    options: Mapping[str, Any] = MappingProxyType({})

    def __call__(self, aviary: Aviary) -> Policy:
        """The policy, to fly that aviary. Raises ValueError where its action is not one that the policy can give."""
        check_action(self.name, self.actions, aviary.options.action)
        return self.make(aviary)


def find_policy(
    source: PolicySource, task: TaskSource | None = None, trust: bool = False
) -> PolicySpec:
    """Find a policy.

    Args:
        source: A name; a class; the folder of a training run, or one of its checkpoints (RUN/checkpoints/003); or
            "ppo:model.zip" (also sac, td3, dqn, a2c, ddpg), a model that stable-baselines3 saved. "trained" is the policy
            that comes with the package for `task`, "untrained" the same before it learned anything.
        task: That it is to fly.
        trust: Whether files that can run code when they are read may do so: stable-baselines3's models.

    Raises:
        ValueError: There is none of that name (the nearest are told), or its file is not trusted.
        FileNotFoundError: There is no such file.
    """
    if isinstance(source, type) and issubclass(source, Policy):
        _require_policy(source)
        return PolicySpec(source.name, source.actions, source.reads_swarm, source)
    if not isinstance(source, str | Path) or not str(source):
        raise ValueError(
            f"policy is {shown(source)}: a name, a run's folder, 'ppo:model.zip', or a class is needed"
        )
    source = str(source)
    if source in SHIPPED_NAMES:
        if task is None:
            raise ValueError(f"policy {source!r} is another one in each task: say which task")
        run = shipped(find_task(task).name)
        return _run(run if source == "trained" else run / CHECKPOINTS / "000", source, trust)
    if source not in POLICIES and Path(source).is_dir():
        return _run(Path(source), source, trust)
    algorithm, colon, path = source.partition(":")
    if colon:
        choose("algorithm", algorithm, dict.fromkeys(ALGORITHMS))
        if not path:
            raise ValueError(
                f"policy is {source!r}: the path of a model is needed after the colon, such as 'ppo:model.zip'"
            )
        path = (
            path if Path(path).is_file() else f"{path}.zip"
        )  # which the library adds to names without it
        return _model(source, algorithm, Path(path), trust)
    kind = choose("policy", source, {**POLICIES, **dict.fromkeys(SHIPPED_NAMES)})
    return PolicySpec(kind.name, kind.actions, kind.reads_swarm, kind)


def _require_policy(kind: type[Policy]) -> None:
    """Raise ValueError, naming what is missing, unless a class has what a policy is made of."""
    lacks = [
        *sorted(kind.__abstractmethods__),
        *(name for name in NEEDED if not hasattr(kind, name)),
    ]
    if lacks:
        raise ValueError(
            f"policy {kind.__name__} has no {lacks[0]}: a policy needs it, see bulletuav.policies.base.Policy"
        )


def _run(folder: Path, name: str, trust: bool) -> PolicySpec:
    """The policy of a run, or of a checkpoint two folders below it."""
    home = (
        folder
        if folder.parent.name != CHECKPOINTS or (folder / CONFIG).exists()
        else folder.parents[1]
    )
    config, path = RunConfig.read(home / CONFIG), folder / POLICY
    if (
        not path.is_file() and (folder / OLD_MODEL).is_file()
    ):  # of a version that kept models as stable-baselines3 does
        pilot = _model(name, config.algo, folder / OLD_MODEL, trust)
    else:
        pilot = _file(name, path, lambda aviary: Trained(aviary, config, path))
    return pilot._replace(actions=(config.action,), options=config.interface)


def _model(name: str, algorithm: str, path: Path, trust: bool) -> PolicySpec:
    pilot = _file(name, path, lambda aviary: Sb3Model(aviary, algorithm, path, trust))
    if not trust:
        raise ValueError(f"{path} is not read: {TRUST}")
    return pilot


def _file(name: str, path: Path, make: Callable[[Aviary], Policy]) -> PolicySpec:
    if not path.is_file():
        raise FileNotFoundError(f"no model {path}: a file that training saved is needed")
    return PolicySpec(name, (), SharedPolicy.reads_swarm, make, path)
