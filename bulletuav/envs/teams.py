"""Teams of a task by their names."""

from typing import Any

from bulletuav.tasks.base import Task

ALL = "drones"
"""Name of the only, unnamed team of a task"""


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
