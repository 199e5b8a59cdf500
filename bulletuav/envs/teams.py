"""Teams of a task by their names."""

from collections.abc import Mapping
from typing import Any, TypeVar

from bulletuav.errors import unknown
from bulletuav.tasks.base import Task

ALL = "drones"
"""Name of the only, unnamed team of a task"""
Value = TypeVar("Value")


def team_names(task: Task[Any]) -> tuple[str, ...]:
    """Return the names of a task's teams, in the order of their numbers.

    Args:
        task: The task.

    Returns:
        The task's own names, including teams without drones; "team_2" and so on for numbers without
        a name. A single team without a name is "drones".
    """
    count = int(task.team.max()) + 1
    own = task.team_names or ((ALL,) if count == 1 else ())
    return own + tuple(f"team_{k}" for k in range(len(own), count))


def team_rows(task: Task[Any]) -> dict[str, list[int]]:
    """Return the indices of each team's drones, by its name.

    Args:
        task: The task.

    Returns:
        Indices by name. Teams without drones are left out, as trainers do not accept empty groups.
    """
    teams = task.team.tolist()
    listed = {
        name: [i for i, team in enumerate(teams) if team == k]
        for k, name in enumerate(team_names(task))
    }
    return {name: rows for name, rows in listed.items() if rows}


def of_drones(name: str, values: Mapping[str, Value], task: Task[Any]) -> list[Value]:
    """Return the value of each drone from the values of the teams.

    Args:
        name: Name of the option, for messages.
        values: Values by the name of the team; teams without drones can be left out.
        task: The task.

    Raises:
        ValueError: If there is no such team, or the team of a drone has no value.
    """
    names = team_names(task)
    for team in values:
        if team not in names:
            raise unknown(f"team of task {task.name!r} in {name}:", team, names)
    missing = [team for team in team_rows(task) if team not in values]
    if missing:
        raise ValueError(f"{name} lacks the teams {missing}: give one for each of {list(names)}")
    return [values[names[team]] for team in task.team.tolist()]
