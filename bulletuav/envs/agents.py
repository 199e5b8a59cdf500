"""Convert between per-agent dictionaries and batched arrays.

If it was built, the C extension `_agents.c` does the same in a fraction of the time.
"""

import importlib
import os
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from bulletuav.engine.c_extension import SWITCH

ACTION_TYPES = tuple(map(np.dtype, ("f8", "f4", "i8", "i4")))
"""Types of action arrays that are copied without further conversion"""
Function = TypeVar("Function", bound=Callable[..., Any])
AgentRows = list[int] | None
"""Row of each agent in the arrays; None if all agents are listed in order"""
ResultsByAgent = tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], bool]
"""Observations, rewards, terminated, truncated, each by agent; and whether any episode ended"""


def take_plainly(actions: Any, agents: list[str], rows: AgentRows, given: np.ndarray) -> bool:
    """Copy the action of each agent to its row.

    Args:
        actions: A dict with an array (A,) for each agent, and no other keys.
        agents: Names of the agents.
        rows: Rows of the agents.
        given: (1, N, A) float64, written.

    Returns:
        True if the actions were copied. False if they have another form; some may be copied then.
    """
    if type(actions) is not dict or len(actions) != len(agents):
        return False
    own = [actions.get(agent) for agent in agents]
    for one in own:
        if type(one) is not np.ndarray or one.shape != given.shape[2:]:
            return False
        if one.dtype not in ACTION_TYPES:
            return False
    if own:
        given[0, slice(len(own)) if rows is None else rows] = own
    return True


def take_one_plainly(action: Any, given: np.ndarray) -> bool:
    """Copy the action of the only agent.

    Args:
        action: An array (A,) of numbers.
        given: (1, 1, A) float64, written.

    Returns:
        True if the action was copied, False if it has another form.
    """
    return take_plainly({"": action}, [""], None, given)


def share_plainly(
    agents: list[str],
    rows: AgentRows,
    observations: np.ndarray,
    rewards: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
) -> ResultsByAgent:
    """Split results into dictionaries by agent, with Python's own types.

    Args:
        agents: Names of the agents.
        rows: Rows of the agents.
        observations: (1, N, ...) of all drones.
        rewards: (1, N) float64.
        terminated: (1, N) bool.
        truncated: (1, N) bool.

    Returns:
        Observations (views of the rows), rewards, terminated and truncated by agent; and whether
        any agent's episode ended.
    """
    chosen = list(range(len(agents)) if rows is None else rows)
    seen = {agent: observations[0][row] for agent, row in zip(agents, chosen, strict=True)}
    lists = [array[0, chosen].tolist() for array in (rewards, terminated, truncated)]
    earned, ended, cut = (dict(zip(agents, one, strict=True)) for one in lists)
    return seen, earned, ended, cut, True in lists[1] or True in lists[2]


def in_c(plain: Function) -> Function:
    """Return the C implementation of a function, or the function itself if C was not built.

    The C function has the same name without "_plainly".
    """
    if os.environ.get(SWITCH) == "0":
        return plain
    try:
        module = importlib.import_module("bulletuav.envs._agents")
    except ImportError:
        return plain
    in_c: Function = getattr(module, plain.__name__.removesuffix("_plainly"))
    return in_c


take = in_c(take_plainly)
take_one = in_c(take_one_plainly)
share = in_c(share_plainly)
