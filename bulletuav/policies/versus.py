"""One policy for each team: how opponents fly against each other."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.teams import team_names
from bulletuav.errors import shown, unknown
from bulletuav.policies.base import Policy
from bulletuav.policies.trained import SharedPolicy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

VERSUS = " vs "
"""What stands between the policies of teams in a name, such as "lead vs flee" """
Rows = Callable[[Any], np.ndarray]
"""Function from M rows of observations, or a dict of such arrays, to M rows of actions"""
Maker = Callable[[Aviary], Policy]
"""What makes a policy for an aviary, such as its class"""


class Versus:
    """A policy for each team of a task, by the team's name.

        bulletuav.evaluate("pursuit_evasion", bulletuav.Versus(chasers="lead", evaders="flee"))

    Attributes:
        sides: What flies each team: all that `find_policy` takes.
    """

    def __init__(self, **sides: Any) -> None:
        """Keep the policies.

        Args:
            **sides: A name, a class, a run's folder, or a function of rows of observations, for
                each team.

        Raises:
            ValueError: There are less than two.
        """
        if len(sides) < 2:
            raise ValueError(
                f"Versus has {list(sides)}: a policy for each of two teams or more is needed, such "
                f"as Versus(chasers='lead', evaders='flee')"
            )
        self.sides = sides

    def __repr__(self) -> str:
        """Write it as it is called."""
        return f"Versus({', '.join(f'{team}={shown(side)}' for team, side in self.sides.items())})"


class TeamPolicies(Policy):
    """Each team of a task flown by a policy of its own, which sees what all of it observe."""

    name = "teams"
    actions = ()
    reads_swarm = True

    def __init__(self, aviary: Aviary, makers: Sequence[Maker], teams: Sequence[str] = ()) -> None:
        """Make the policies.

        Args:
            aviary: The worlds that they fly.
            makers: What makes each team's policy.
            teams: Names of their teams; the task's own, in their order, when left out.

        Raises:
            ValueError: There is another number of teams, or none of a name.
        """
        super().__init__(aviary)
        # Policies may come in another order than the teams
        names = team_names(aviary.task)
        given = teams or names
        for name in given:
            if name not in names:
                raise unknown(f"team of task {aviary.task.name!r}:", name, names)
        if len(makers) != len(names):
            raise ValueError(
                f"policies of {len(makers)} teams are given, and task {aviary.task.name!r} has "
                f"{', '.join(names)}: give one for each"
            )
        self._policies = [
            (aviary.task.team == names.index(name), make(aviary))
            for name, make in zip(given, makers, strict=True)
        ]

    def reset(self, mask: np.ndarray) -> None:
        """Let all forget the worlds of `mask` (W,)."""
        for _, policy in self._policies:
            policy.reset(mask)

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Take of each policy the actions of its own team; see `Policy.act`."""
        aviary = self.aviary
        actions = np.zeros((*aviary.alive.shape, aviary.action.low.shape[-1]))
        for own, policy in self._policies:
            if own.any():
                actions[:, own] = policy.act(observations, swarm)[:, own]
        return actions

    def memory(self) -> dict[str, Any]:
        """Copy all that the teams' policies remember, by their place; see `Policy.memory`."""
        return {
            f"{place}: {type(policy).__name__}": policy.memory()
            for place, (_, policy) in enumerate(self._policies)
        }

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on with what `memory` gave; see `Policy.restore`.

        Raises:
            ValueError: It is of other policies; nothing has changed then.
        """
        own = self.memory()
        if list(memory) != list(own):
            raise ValueError(
                f"the snapshot is of policies {shown(list(memory))}, and {shown(list(own))} fly "
                f"here: load it where they are the same"
            )
        for (_, policy), one in zip(self._policies, memory.values(), strict=True):
            policy.restore(one)


class RowsPolicy(SharedPolicy):
    """A function of rows of observations, one for each drone, that gives rows of actions.

    It is asked anew at every decision: a model that learns meanwhile flies as it has learned.
    """

    def __init__(self, aviary: Aviary, function: Rows) -> None:
        """Take the aviary to fly, and the function."""
        super().__init__(aviary)
        self._function = function

    def _choose(self, rows: Any) -> np.ndarray:
        """Ask the function; refuse what are no rows of actions."""
        given = np.asarray(self._function(rows))
        drones, size = self.aviary.alive.size, self.aviary.action.low.shape[-1]
        if given.shape != (drones, size) and (size > 1 or given.shape != (drones,)):
            raise ValueError(
                f"function {shown(self._function)} gave an array {given.shape} of actions: "
                f"{(drones, size)} is needed, a row for each row of observations"
            )
        return given


def joint_actions(kinds: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Find the actions that all of some policies can give, as the first that has some prefers them.

    Args:
        kinds: Actions that each can give; none named: any.

    Returns:
        Those that all can give; none named: any.

    Raises:
        ValueError: There are none.
    """
    named = [kind for kind in kinds if kind]
    if not named:
        return ()
    common = tuple(one for one in named[0] if all(one in kind for kind in named))
    if not common:
        raise ValueError(
            f"policies of teams give {' and '.join(map(str, named))} actions: no action is common"
        )
    return common


def joint_options(options: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Join the options that environments need for several policies.

    Args:
        options: Those of each policy.

    Raises:
        ValueError: Two policies need different values of one.
    """
    joined: dict[str, Any] = {}
    for one in options:
        for name, value in one.items():
            if name in joined and joined[name] != value:
                raise ValueError(
                    f"policies of teams learned with {name} {shown(joined[name])} and "
                    f"{shown(value)}: they cannot fly in one environment"
                )
            joined[name] = value
    return joined
