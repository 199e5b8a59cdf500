"""Find a policy by name, `module:Name`, class, run folder, model file or function."""

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, cast

from bulletuav.catalogue import SHIPPED_NAMES
from bulletuav.control.actions import ActionNames, action_names
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import action_for, resolve_options
from bulletuav.errors import find_choice, shown, unknown
from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.mismatch import naming_task
from bulletuav.policies.recurrent import RecurrentPolicy
from bulletuav.policies.run import (
    CHECKPOINTS,
    CONFIG,
    FOUNDATION,
    POLICY,
    SB3_ALGORITHMS,
    SHIPPED,
    RunConfig,
    shipped,
)
from bulletuav.policies.scores import warn_of_difficulty
from bulletuav.policies.trained import TRUST, SharedPolicy, Trained, actions_given
from bulletuav.policies.versus import (
    VERSUS,
    RowsFunction,
    RowsPolicy,
    TeamPolicies,
    Versus,
    joint_actions,
    joint_options,
)
from bulletuav.registry import find, names, require_declared
from bulletuav.tasks import TaskSource, find_task
from bulletuav.version import CONSTANTS

PolicySource = str | Path | type[Policy] | Versus | RowsFunction
"""Name, `module:Name`, file, folder or class of a policy; one policy per team; or a function"""
NEEDED = ("name", "actions", "reads_swarm")
"""Attributes that every policy class defines"""
OLD_MODEL = "model.zip"
"""Model file of a run from older versions, saved by stable-baselines3"""
SB3_MODEL = "bulletuav.adapters.sb3_model"
"""Module that runs stable-baselines3 models; imported lazily, as it needs an extra"""


class PolicySpec(NamedTuple):
    """Description of a policy that is not instantiated yet; call it with an aviary to do so.

    Attributes:
        name: Name in tables and messages.
        actions: Supported action types, the preferred one first; empty if all are supported.
        reads_swarm: Whether the policy reads the true state instead of the observations.
        make: Function that instantiates the policy for an aviary.
        models: Files of trained policies; empty for all others.
        options: Options of the environment that reproduce the observations and actions of training.
    """

    name: str
    actions: tuple[ActionNames, ...]
    reads_swarm: bool
    make: Callable[[Aviary], Policy]
    models: tuple[Path, ...] = ()
    options: Mapping[str, Any] = MappingProxyType({})

    def __call__(self, aviary: Aviary) -> Policy:
        """Instantiate the policy for an aviary.

        Raises:
            ValueError: If the policy does not support the action type of the aviary, or the task
                lacks something that the policy reads.
        """
        check_action(self.name, self.actions, aviary.options.action)
        with naming_task(self.name, aviary):
            return self.make(aviary)

    def complete(self, task: TaskSource, options: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the options of an environment with those that the policy requires.

        Args:
            task: The task to fly.
            options: Options of the user, which override those of the policy.

        Returns:
            The merged options. If the user set no action and the policy does not support the
            default action of the task, the action is the first one that the policy supports and the
            dynamics accepts.

        Raises:
            ValueError: If an option is invalid, or the dynamics accepts no action of the policy.
        """
        whole = {**self.options, **options}
        # This also validates the options before any flight.
        common = resolve_options(find_task(task), whole).options
        # An empty list of actions means that all are supported.
        if not self.actions or "action" in options:
            return whole
        usable = [one for one in self.actions if _is_usable(one, common)]
        if not usable:
            raise ValueError(
                f"policy {self.name!r} supports {' or '.join(map(str, self.actions))} actions, "
                f"which dynamics {common.dynamics_name!r} does not accept: choose another policy, "
                f"or dynamics 'rigid_body' or 'bullet'"
            )
        if "action" in whole or common.action in self.actions:
            return whole
        return {**whole, "action": usable[0]}


def _is_usable(action: ActionNames, options: EnvOptions) -> bool:
    """Return True if the dynamics of an environment accepts an action type, or all of several."""
    return all(
        action_for(options.dynamics, name, options.airframe) == name
        for name in action_names(action)
    )


def policy_names() -> list[str]:
    """List the names of all policies: baselines, plugins and shipped policies."""
    return [*names("policy"), *SHIPPED_NAMES]


def find_policy(
    source: PolicySource, task: TaskSource | None = None, trust: bool = False
) -> PolicySpec:
    """Find a policy.

    Args:
        source: One of

            - a name from `policy_names`; "trained" is the shipped policy for `task`, "untrained"
              its initial weights, and "foundation" the shipped policy for all quadrotors;
            - "module:Name", a class derived from `Policy` in an importable module;
            - such a class itself;
            - the folder of a training run, or of a checkpoint (RUN/checkpoints/003);
            - "ppo:model.zip" (also sac, td3, dqn, a2c, ddpg), saved by stable-baselines3;
            - a function from rows of observations (M, D), or a dict of such, to rows of actions;
            - one policy for each team: a `Versus`, or "lead vs flee" in the order of the teams.
        task: The task to fly; required for "trained" and "untrained".
        trust: Whether to read files that can execute code, such as models of stable-baselines3.

    Returns:
        The specification of the policy; call it with an aviary to instantiate the policy.

    Raises:
        ValueError: If there is no such policy (the message suggests similar names), its class is
            incomplete, or its file is not trusted.
        FileNotFoundError: If there is no such file.
    """
    # Objects: classes, policies of teams, and functions of observations
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
    # Strings: names or files
    text = str(source)
    if VERSUS in text:
        return _from_sides(text.split(VERSUS), task, trust)
    if text in SHIPPED_NAMES:
        return _from_package(text, task, trust)
    if text not in names("policy") and Path(text).is_dir():
        return _from_run(Path(text), text, trust, task)
    before, colon, after = text.partition(":")
    if not colon:
        return _from_name(text)
    # An algorithm before the colon, or a path after it, means a model file; else it is a class.
    if before in SB3_ALGORITHMS or not after.isidentifier():
        return _from_model(text, before, after, trust)
    return _from_class(find("policy", text, _is_policy))


def _from_sides(
    sides: Mapping[str, Any] | Sequence[Any], task: TaskSource | None, trust: bool
) -> PolicySpec:
    """Find one policy per team, by team name or in the order of the teams, and join them."""
    teams = tuple(sides) if isinstance(sides, Mapping) else ()
    listed = sides.values() if isinstance(sides, Mapping) else sides
    found = [find_policy(side, task, trust) for side in listed]
    makers = [one.__call__ for one in found]
    actions = joint_actions([one.actions for one in found])
    # All policies use the common action type, even if trained with another one
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
    """Describe a policy class; raise ValueError if it lacks a required attribute."""
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


def _from_package(name: str, task: TaskSource | None, trust: bool) -> PolicySpec:
    """Find the policy for all quadrotors, or that of a task, trained or with initial weights."""
    if name == FOUNDATION:
        return _from_run(SHIPPED / FOUNDATION, name, trust, task)
    if task is None:
        raise ValueError(f"policy {name!r} is another one in each task: say which task")
    own = find_task(task).name
    run = shipped(own)
    if name == "untrained":
        return _from_run(run / CHECKPOINTS / "000", name, trust, task)
    spec = _from_run(run, name, trust, task)

    def make(aviary: Aviary) -> Policy:
        policy = spec.make(aviary)
        warn_of_difficulty(own, aviary.options.difficulty)
        return policy

    return spec._replace(make=make)


def config_file(folder: Path) -> Path:
    """Return the path of the run configuration for a run folder or a checkpoint folder."""
    is_checkpoint = folder.parent.name == CHECKPOINTS and not (folder / CONFIG).exists()
    return (folder.parents[1] if is_checkpoint else folder) / CONFIG


def read_run_config(folder: Path, trust: bool = False, task: TaskSource | None = None) -> RunConfig:
    """Read the configuration of a training run.

    Args:
        folder: Folder of the run, or of a checkpoint two levels below it.
        trust: Whether modules that the file names may be imported.
        task: Task that the user named; the file may name it, too.

    Raises:
        ValueError: If the file is of another kind, or contains an invalid setting.
        FileNotFoundError: If there is no such file.
    """
    return RunConfig.read(config_file(folder), trust, (task,))


def _from_run(folder: Path, name: str, trust: bool, task: TaskSource | None) -> PolicySpec:
    """Find the policy of a run, or of a checkpoint two levels below it."""
    config = read_run_config(folder, trust, task)
    if config.constants != CONSTANTS:
        warnings.warn(
            f"policy {name!r} of {config.task} was trained with constants {config.constants}, and "
            f"this package has {CONSTANTS}: it may perform worse; train it again",
            stacklevel=3,
        )
    path = folder / POLICY
    actions: tuple[ActionNames, ...] = (config.action,)
    if not path.is_file() and (folder / OLD_MODEL).is_file():
        spec = _trusted(folder / OLD_MODEL, name, config.algo, trust)
    elif not path.exists() and (folder / CHECKPOINTS).is_dir():
        raise FileNotFoundError(_describe_unfinished(folder))
    else:
        spec = _from_file(name, path, lambda aviary: _make_trained(aviary, config, path))
        actions = actions_given(config.action)
    return spec._replace(actions=actions, options=config.interface)


def _make_trained(aviary: Aviary, config: RunConfig, path: Path) -> Policy:
    """Instantiate the policy of a run."""
    is_recurrent = config.algo == FOUNDATION
    return RecurrentPolicy(aviary, path) if is_recurrent else Trained(aviary, config, path)


def _describe_unfinished(folder: Path) -> str:
    """Return a text about a run without a final policy: how to resume it, or use a checkpoint."""
    names = (path.parent for path in (folder / CHECKPOINTS).glob(f"*/{POLICY}"))
    saved = sorted(names, key=lambda path: (len(path.name), path))
    other = f", or use its last checkpoint, {saved[-1]}" if saved else ""
    return (
        f"the run {folder} is not finished, it has no {POLICY}: resume it by "
        f"bulletuav train --config {folder / CONFIG} --out {folder}{other}"
    )


def _from_model(source: str, algorithm: str, file: str, trust: bool) -> PolicySpec:
    """Find a model of stable-baselines3 from the text before and after the colon."""
    find_choice("algorithm", algorithm, dict.fromkeys(SB3_ALGORITHMS))
    if not file:
        raise ValueError(
            f"policy is {source!r}: the path of a model is needed after the colon, "
            f"such as 'ppo:model.zip'"
        )
    # stable-baselines3 appends the suffix if it is missing.
    path = file if Path(file).is_file() else f"{file}.zip"
    return _trusted(Path(path), source, algorithm, trust)


def _trusted(path: Path, name: str, algorithm: str, trust: bool) -> PolicySpec:
    """Describe a model of stable-baselines3; raise ValueError unless the user trusts it."""

    def make(aviary: Aviary) -> Policy:
        adapter = importlib.import_module(SB3_MODEL)
        return cast(Policy, adapter.Sb3Model(aviary, algorithm, path, trust))

    spec = _from_file(name, path, make)
    if not trust:
        raise ValueError(f"{path} is not read: {TRUST}")
    return spec


def _from_file(name: str, path: Path, make: Callable[[Aviary], Policy]) -> PolicySpec:
    """Describe a policy file; raise FileNotFoundError if it does not exist."""
    if not path.is_file():
        raise FileNotFoundError(f"no model {path}: a file saved by training is needed")
    return PolicySpec(name, (), SharedPolicy.reads_swarm, make, (path,))
