"""Baseline policies, and those that were trained."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import pick
from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.orca import Orca
from bulletuav.policies.placement import Centroid, Hotspot, KMeans, Oracle
from bulletuav.policies.planner import Planner
from bulletuav.policies.potential import PotentialField
from bulletuav.policies.random import RandomActions
from bulletuav.policies.run import ALGORITHMS, CONFIG, MODEL, RunConfig, shipped
from bulletuav.policies.straight import StraightLine
from bulletuav.policies.trained import Trained
from bulletuav.tasks import TaskSource, find_task

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy
    for policy in (StraightLine, PotentialField, Orca, Planner, RandomActions, Centroid, Hotspot, KMeans, Oracle)
}
PolicySource = str | Path | type[Policy]
SHIPPED_NAMES = ("trained", "untrained")


class Pilot(NamedTuple):
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


def find_policy(source: PolicySource, task: TaskSource | None = None) -> Pilot:
    """The policy of that name, a class of one, a trained model "ppo:model.zip" (also sac, td3, dqn), or a run's folder.

    "trained" is the one that comes with the package for `task`, "untrained" the same before it learned anything. Raises
    ValueError with the nearest names when there is none, FileNotFoundError when there is no such file.
    """
    if isinstance(source, type) and issubclass(source, Policy):
        return Pilot(source.name, source.actions, source.reads_swarm, source)
    if not isinstance(source, str | Path):
        raise ValueError(f"policy is {source!r}: a name, a run's folder, 'ppo:model.zip', or a class is needed")
    source = str(source)
    if source in SHIPPED_NAMES:
        if task is None:
            raise ValueError(f"policy {source!r} is another one in each task: say which task")
        return _run(shipped(find_task(task).name), source, fresh=source == "untrained")
    if source not in POLICIES and Path(source).is_dir():
        return _run(Path(source), source)
    algorithm, colon, path = source.partition(":")
    if colon:
        pick("algorithm", algorithm, dict.fromkeys(ALGORITHMS))
        path = path if Path(path).is_file() else f"{path}.zip"  # which the library adds to names without it
        return _model(source, algorithm, Path(path))
    kind = pick("policy", source, {**POLICIES, **dict.fromkeys(SHIPPED_NAMES)})
    return Pilot(kind.name, kind.actions, kind.reads_swarm, kind)


def _run(folder: Path, name: str, fresh: bool = False) -> Pilot:
    config = RunConfig.read(folder / CONFIG)
    return _model(name, config.algo, folder / MODEL, fresh)._replace(actions=(config.action,), options=config.interface)


def _model(name: str, algorithm: str, path: Path, fresh: bool = False) -> Pilot:
    if not path.is_file():
        raise FileNotFoundError(f"no model {path}: a file that {algorithm} saved is needed")
    return Pilot(name, (), Trained.reads_swarm, lambda aviary: Trained(aviary, algorithm, path, fresh), path)
