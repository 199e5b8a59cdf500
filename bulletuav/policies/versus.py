"""Policies of opposing teams, one policy per team."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.actions import ActionNames
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.teams import team_names
from bulletuav.errors import shown, unknown
from bulletuav.policies.base import Policy
from bulletuav.policies.trained import SharedPolicy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

VERSUS = " vs "
"""Separator between the policies of teams in a name, as in "lead vs flee" (both names)"""
RowsFunction = Callable[[Any], np.ndarray]
"""Function from M rows of observations, or a dict of such arrays, to M rows of actions"""
Maker = Callable[[Aviary], Policy]
"""Function or class that creates a policy for an aviary"""


class Versus:
    """One policy per team of a task, by team name.

        bulletuav.evaluate("pursuit_evasion", bulletuav.Versus(chasers="lead", evaders="flee"))

    Attributes:
        sides: Policy of each team, as accepted by `find_policy`.
    """

    def __init__(self, **sides: Any) -> None:
        """Set the policy of each team.

        Args:
            **sides: Name, class, run folder, or function of rows of observations, for each team.

        Raises:
            ValueError: If there are fewer than two teams.
        """
        if len(sides) < 2:
            raise ValueError(
                f"Versus has {list(sides)}: policies for at least two teams are needed, such "
                f"as Versus(chasers='lead', evaders='flee')"
            )
        self.sides = sides

    def __repr__(self) -> str:
        """Return the constructor call."""
        return f"Versus({', '.join(f'{team}={shown(side)}' for team, side in self.sides.items())})"


class TeamPolicies(Policy):
    """Policy that controls each team with a separate policy."""

    name = "teams"
    actions = ()
    reads_swarm = True

    def __init__(self, aviary: Aviary, makers: Sequence[Maker], teams: Sequence[str] = ()) -> None:
        """Create the policies of the teams.

        Args:
            aviary: The worlds to control.
            makers: Functions that create the policy of each team.
            teams: Names of the teams; by default those of the task, in order.

        Raises:
            ValueError: If the number of teams does not match, or a name is unknown.
        """
        super().__init__(aviary)
        # The order of policies may differ from the order of teams
        names = team_names(aviary.task)
        given = teams or names
        for name in given:
            if name not in names:
                raise unknown(f"team of task {aviary.task.name!r}:", name, names)
        if len(makers) != len(names):
            raise ValueError(
                f"there are policies for {len(makers)} teams, and task {aviary.task.name!r} has "
                f"{', '.join(names)}: name one policy for each team"
            )
        self._policies = [
            (aviary.task.team == names.index(name), make(aviary))
            for name, make in zip(given, makers, strict=True)
        ]

    def reset(self, mask: np.ndarray) -> None:
        """Reset the state of all policies in the worlds of `mask` (W,)."""
        for _, policy in self._policies:
            policy.reset(mask)

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Combine the actions of each policy for its own team; see `Policy.act`."""
        aviary = self.aviary
        actions = np.zeros((*aviary.alive.shape, aviary.action.low.shape[-1]))
        for own, policy in self._policies:
            if own.any():
                actions[:, own] = policy.act(self._unpadded(observations, own), swarm)[:, own]
        return actions

    def _unpadded(self, observations: Observation, own: np.ndarray) -> Observation:
        """Cut observations to the numbers that the drones of a team (N,) observe."""
        first = int(np.argmax(own))
        cut: Observation = self.aviary.observer.unpadded(observations, first)
        return cut

    def memory(self) -> dict[str, Any]:
        """Return a copy of the state of all policies, by index; see `Policy.memory`."""
        return {
            f"{place}: {type(policy).__name__}": policy.memory()
            for place, (_, policy) in enumerate(self._policies)
        }

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned; see `Policy.restore`.

        Raises:
            ValueError: If the state belongs to other policies; nothing is restored in this case.
        """
        own = self.memory()
        if list(memory) != list(own):
            raise ValueError(
                f"the snapshot contains policies {shown(list(memory))}, and this environment has "
                f"{shown(list(own))}: load it with the same policies"
            )
        for (_, policy), one in zip(self._policies, memory.values(), strict=True):
            policy.restore(one)


class RowsPolicy(SharedPolicy):
    """Policy from a function that maps rows of observations, one per drone, to rows of actions.

    The function is called at every decision, so a model that is being trained flies with its latest
    weights.
    """

    def __init__(self, aviary: Aviary, function: RowsFunction) -> None:
        """Set the function; see `Policy`."""
        super().__init__(aviary)
        self._function = function

    def _choose(self, rows: Any) -> np.ndarray:
        """Call the function; raise ValueError if the result has the wrong shape."""
        given = np.asarray(self._function(rows))
        drones, size = self.aviary.alive.size, self.aviary.action.low.shape[-1]
        if given.shape != (drones, size) and (size > 1 or given.shape != (drones,)):
            raise ValueError(
                f"function {shown(self._function)} returned an array {given.shape} of actions: "
                f"{(drones, size)} is needed, a row for each row of observations"
            )
        return given


def joint_actions(kinds: Sequence[tuple[ActionNames, ...]]) -> tuple[ActionNames, ...]:
    """Return the action types that all policies support, in the order of the first non-empty list.

    Args:
        kinds: Action types that each policy supports; empty if all are supported.

    Returns:
        The common action types; empty if all are supported.

    Raises:
        ValueError: If there is no common action type.
    """
    named = [kind for kind in kinds if kind]
    if not named:
        return ()
    common = tuple(one for one in named[0] if all(one in kind for kind in named))
    if not common:
        raise ValueError(
            f"policies of teams support {' and '.join(map(str, named))} actions: none is common"
        )
    return common


def joint_options(options: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Merge the options that several policies require.

    Args:
        options: Options of each policy.

    Raises:
        ValueError: If two policies require different values of an option.
    """
    joined: dict[str, Any] = {}
    for one in options:
        for name, value in one.items():
            if name in joined and joined[name] != value:
                raise ValueError(
                    f"policies of teams were trained with {name} {shown(joined[name])} and "
                    f"{shown(value)}: they cannot fly in one environment"
                )
            joined[name] = value
    return joined
