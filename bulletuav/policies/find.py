"""Lookup of policies: by name, as `module:Name`, by class, by run folder, or by model file."""

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, cast

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import action_for, resolve_options
from bulletuav.errors import choose, shown, unknown
from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.mismatch import naming_task
from bulletuav.policies.run import ALGORITHMS, CHECKPOINTS, CONFIG, POLICY, RunConfig, shipped
from bulletuav.policies.trained import TRUST, SharedPolicy, Trained, actions_given
from bulletuav.policies.versus import (
    VERSUS,
    Rows,
    RowsPolicy,
    TeamPolicies,
    Versus,
    joint_actions,
    joint_options,
)
from bulletuav.registry import find, names, require_declared
from bulletuav.tasks import TaskSource, find_task
from bulletuav.version import CONSTANTS

PolicySource = str | Path | type[Policy] | Versus | Rows
"""A policy by its name, `module:Name`, file or folder; its class; one for each team; a function"""
NEEDED = ("name", "actions", "reads_swarm")
"""Attributes that every policy class has"""
SHIPPED_NAMES = ("trained", "untrained")
"""Names of the policies that come with the package, another one for each task"""
OLD_MODEL = "model.zip"
"""File in which older versions kept the policy of a run, as stable-baselines3 saves it"""
SB3_MODEL = "bulletuav.adapters.sb3_model"
"""Module that flies models of stable-baselines3; it is above this room and needs the extra"""


class PolicySpec(NamedTuple):
    """A policy that was found but not made yet: call it with an aviary to make it.

    Attributes:
        name: Its name in tables and messages.
        actions: Actions that it can give, the preferred one first; none named: any.
        reads_swarm: Whether it uses the true state instead of the observations.
        make: Makes the policy for an aviary.
        models: Files of trained policies; none for all others.
        options: Options that environments need for the policy to see and do what it learned with.
    """

    name: str
    actions: tuple[str, ...]
    reads_swarm: bool
    make: Callable[[Aviary], Policy]
    models: tuple[Path, ...] = ()
    options: Mapping[str, Any] = MappingProxyType({})

    def __call__(self, aviary: Aviary) -> Policy:
        """Make the policy that flies an aviary.

        Raises:
            ValueError: The aviary's action is not one that the policy can give, or the task lacks
                what it needs.
        """
        check_action(self.name, self.actions, aviary.options.action)
        with naming_task(self.name, aviary):
            return self.make(aviary)

    def complete(self, task: TaskSource, options: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the options of an environment by what the policy needs to fly in it.

        Args:
            task: What it is to fly.
            options: Options that the user gave; they go before those of the policy.

        Returns:
            The options with those that a trained policy needs. Where the user chose no action and
            the policy cannot give the task's own, they have the first that it can give and that
            the dynamics takes.

        Raises:
            ValueError: An option is none that can be, or the dynamics takes no action of the
                policy.
        """
        whole = {**self.options, **options}
        # Also refuses what cannot be, before any flight.
        common = resolve_options(find_task(task), whole).options
        # A policy without a list of actions can give all of them.
        if not self.actions or "action" in options:
            return whole
        usable = [one for one in self.actions if _is_usable(one, common)]
        if not usable:
            raise ValueError(
                f"policy {self.name!r} gives {' or '.join(self.actions)} actions, which dynamics "
                f"{common.dynamics_name!r} does not take: choose another policy, or dynamics "
                f"'rigid_body' or 'bullet'"
            )
        if "action" in whole or common.action in self.actions:
            return whole
        return {**whole, "action": usable[0]}


def _is_usable(action: str, options: EnvOptions) -> bool:
    """Return True if the dynamics of an environment takes an action."""
    return action_for(options.dynamics, action, options.airframe) == action


def policy_names() -> list[str]:
    """List the names of all policies: baselines, those of other packages, and shipped ones."""
    return [*names("policy"), *SHIPPED_NAMES]


def find_policy(
    source: PolicySource,
    task: TaskSource | None = None,
    trust: bool = False,
) -> PolicySpec:
    """Find a policy.

    Args:
        source: One of

            - a name: one of `policy_names`, where "trained" is the policy that comes with the
              package for `task`, and "untrained" the same before it learned anything;
            - "module:Name", a class derived from `Policy` in a module that can be imported;
            - such a class itself;
            - the folder of a training run, or of one of its checkpoints (RUN/checkpoints/003);
            - "ppo:model.zip" (also sac, td3, dqn, a2c, ddpg), saved by stable-baselines3;
            - a function from rows of observations (M, D), or a dict of such, to rows of actions;
            - one of these for each team: a `Versus`, or "lead vs flee" in the teams' order.
        task: The task that it is to fly; needed for "trained" and "untrained".
        trust: Whether to read files that can run code when they are read, which
            stable-baselines3's models can.

    Returns:
        The policy to be made, which takes an aviary.

    Raises:
        ValueError: There is no such policy (the nearest names are told), its class lacks
            something, or its file is not trusted.
        FileNotFoundError: There is no such file.
    """
    # Objects: classes, sides, and functions of observations
    if isinstance(source, type) and issubclass(source, Policy):
        return _from_class(source)
    if isinstance(source, Versus):
        return _from_sides(source.sides, task, trust)
    if callable(source) and not isinstance(source, type):
        name = str(getattr(source, "__name__", type(source).__name__))
        return PolicySpec(name, (), False, lambda aviary: RowsPolicy(aviary, source))
    if not isinstance(source, str | Path) or not str(source):
        raise ValueError(
            f"policy is {shown(source)}: a name, module:Name, a run's folder, 'ppo:model.zip', "
            f"a class, a function, or a Versus is needed"
        )
    # Texts, of which some are names, some files
    text = str(source)
    if VERSUS in text:
        return _from_sides(text.split(VERSUS), task, trust)
    if text in SHIPPED_NAMES:
        return _from_package(text, task, trust)
    if text not in names("policy") and Path(text).is_dir():
        return _from_run(Path(text), text, trust)
    before, colon, after = text.partition(":")
    if not colon:
        return _from_name(text)
    # What follows the colon tells a model's file from a class, unless an algorithm stands before.
    if before in ALGORITHMS or not after.isidentifier():
        return _from_model(text, before, after, trust)
    return _from_class(find("policy", text, _is_policy))


def _from_sides(
    sides: Mapping[str, Any] | Sequence[Any],
    task: TaskSource | None,
    trust: bool,
) -> PolicySpec:
    """Find a policy for each team, by name or in the teams' order, and join them."""
    teams = tuple(sides) if isinstance(sides, Mapping) else ()
    listed = sides.values() if isinstance(sides, Mapping) else sides
    found = [find_policy(side, task, trust) for side in listed]
    makers = [one.__call__ for one in found]
    actions = joint_actions([one.actions for one in found])
    # Each flies by the common action, also where it learned with another one
    needed = [
        {**one.options, "action": actions[0]} if "action" in one.options else one.options
        for one in found
    ]
    return PolicySpec(
        name=VERSUS.join(one.name for one in found),
        actions=actions,
        reads_swarm=any(one.reads_swarm for one in found),
        make=lambda aviary: TeamPolicies(aviary, makers, teams),
        models=tuple(model for one in found for model in one.models),
        options=joint_options(needed),
    )


def _is_policy(found: object) -> bool:
    """Tell whether an object is a class of policies."""
    return isinstance(found, type) and issubclass(found, Policy)


def _from_name(name: str) -> PolicySpec:
    """Find a policy in the registry."""
    known = policy_names()
    if name not in known:
        raise unknown("policy", name, known)
    kind = find("policy", name, _is_policy)
    if not _is_policy(kind):
        raise ValueError(f"policy {name!r} is {shown(kind)}: a class derived from Policy is needed")
    return _from_class(kind)


def _from_class(kind: type[Policy]) -> PolicySpec:
    """Describe a class; raise ValueError, naming what is missing, unless it is whole."""
    lacks = [
        *sorted(kind.__abstractmethods__),
        *(name for name in NEEDED if not hasattr(kind, name)),
    ]
    if lacks:
        raise ValueError(
            f"policy {kind.__name__} has no {lacks[0]}: a policy needs it, "
            f"see bulletuav.policies.base.Policy"
        )
    require_declared("policy", kind, Policy)
    return PolicySpec(kind.name, kind.actions, kind.reads_swarm, kind)


def _from_package(
    name: str,
    task: TaskSource | None,
    trust: bool,
) -> PolicySpec:
    """Find the package's own trained policy of a task, or what it was before."""
    if task is None:
        raise ValueError(f"policy {name!r} is another one in each task: say which task")
    run = shipped(find_task(task).name)
    return _from_run(run if name == "trained" else run / CHECKPOINTS / "000", name, trust)


def config_file(folder: Path) -> Path:
    """Return the path of the settings of a run, for its folder or that of a checkpoint."""
    is_checkpoint = folder.parent.name == CHECKPOINTS and not (folder / CONFIG).exists()
    return (folder.parents[1] if is_checkpoint else folder) / CONFIG


def read_run_config(folder: Path, trust: bool = False) -> RunConfig:
    """Read the settings of a run.

    Args:
        folder: The folder of the run, or that of a checkpoint two folders below it.
        trust: Whether modules that the file names may be imported.

    Raises:
        ValueError: The file is of another kind, or holds an impossible setting.
        FileNotFoundError: There is no such file.
    """
    return RunConfig.read(config_file(folder), trust)


def _from_run(
    folder: Path,
    name: str,
    trust: bool,
) -> PolicySpec:
    """Find the policy of a run, or of a checkpoint two folders below it."""
    config = read_run_config(folder, trust)
    if config.constants != CONSTANTS:
        warnings.warn(
            f"policy {name!r} of {config.task} learned with constants {config.constants}, and this "
            f"package has {CONSTANTS}: it may fly worse than it did; train it anew",
            stacklevel=3,
        )
    path = folder / POLICY
    actions: tuple[str, ...] = (config.action,)
    if not path.is_file() and (folder / OLD_MODEL).is_file():
        spec = _trusted(folder / OLD_MODEL, name, config.algo, trust)
    else:
        spec = _from_file(name, path, lambda aviary: Trained(aviary, config, path))
        actions = actions_given(config.action)
    return spec._replace(actions=actions, options=config.interface)


def _from_model(
    source: str,
    algorithm: str,
    file: str,
    trust: bool,
) -> PolicySpec:
    """Find a model that stable-baselines3 saved, from what stands before and after the colon."""
    choose("algorithm", algorithm, dict.fromkeys(ALGORITHMS))
    if not file:
        raise ValueError(
            f"policy is {source!r}: the path of a model is needed after the colon, "
            f"such as 'ppo:model.zip'"
        )
    # The library adds the ending to names without it.
    path = file if Path(file).is_file() else f"{file}.zip"
    return _trusted(Path(path), source, algorithm, trust)


def _trusted(
    path: Path,
    name: str,
    algorithm: str,
    trust: bool,
) -> PolicySpec:
    """Describe a model of stable-baselines3; raise ValueError unless the user trusts it."""

    def make(aviary: Aviary) -> Policy:
        adapter = importlib.import_module(SB3_MODEL)
        return cast(Policy, adapter.Sb3Model(aviary, algorithm, path, trust))

    spec = _from_file(name, path, make)
    if not trust:
        raise ValueError(f"{path} is not read: {TRUST}")
    return spec


def _from_file(
    name: str,
    path: Path,
    make: Callable[[Aviary], Policy],
) -> PolicySpec:
    """Describe a policy that is read from a file; raise FileNotFoundError unless it is there."""
    if not path.is_file():
        raise FileNotFoundError(f"no model {path}: a file that training saved is needed")
    return PolicySpec(name, (), SharedPolicy.reads_swarm, make, (path,))
