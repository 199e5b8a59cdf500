"""Baseline policies, and those that were trained."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from bulletuav.envs.aviary import Aviary
from bulletuav.errors import pick
from bulletuav.policies.base import Policy
from bulletuav.policies.orca import Orca
from bulletuav.policies.placement import Centroid, Hotspot, KMeans, Oracle
from bulletuav.policies.planner import Planner
from bulletuav.policies.potential import PotentialField
from bulletuav.policies.random import RandomActions
from bulletuav.policies.straight import StraightLine
from bulletuav.policies.trained import ALGORITHMS, Trained

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy
    for policy in (StraightLine, PotentialField, Orca, Planner, RandomActions, Centroid, Hotspot, KMeans, Oracle)
}
PolicySource = str | type[Policy]


class Pilot(NamedTuple):
    """A policy to be: its name, the actions that it can give (none named: any), what it reads, and how to make it.

    `model`: its file, where it is a trained one.
    """

    name: str
    actions: tuple[str, ...]
    reads_swarm: bool
    make: Callable[[Aviary], Policy]
    model: Path | None = None

    def __call__(self, aviary: Aviary) -> Policy:
        """The policy, to fly that aviary."""
        return self.make(aviary)


def find_policy(source: PolicySource) -> Pilot:
    """The policy of that name, a class of one, or a trained model: "ppo:model.zip" (also sac, td3, dqn).

    Raises ValueError with the nearest names when there is none, FileNotFoundError when there is no such file.
    """
    if isinstance(source, type) and issubclass(source, Policy):
        return Pilot(source.name, source.actions, source.reads_swarm, source)
    algorithm, colon, path = source.partition(":") if isinstance(source, str) else ("", "", "")
    if colon:
        pick("algorithm", algorithm, dict.fromkeys(ALGORITHMS))
        path = path if Path(path).is_file() else f"{path}.zip"  # which the library adds to names without it
        if not Path(path).is_file():
            raise FileNotFoundError(f"no model {path}: a file that {algorithm} saved is needed")
        return Pilot(str(source), (), Trained.reads_swarm, lambda aviary: Trained(aviary, algorithm, path), Path(path))
    if not isinstance(source, str):
        raise ValueError(f"policy is {source!r}: a name, a trained model such as 'ppo:model.zip', or a class is needed")
    kind = pick("policy", source, POLICIES)
    return Pilot(kind.name, kind.actions, kind.reads_swarm, kind)
