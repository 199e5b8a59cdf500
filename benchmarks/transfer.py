"""Fly the policies of the package outside of the conditions of their training.

    python benchmarks/transfer.py --out docs/results/transfer
    python benchmarks/transfer.py --tasks hover --episodes 10

Each case differs from the task at medium (`EASY`: at easy) in one respect: difficulty, dynamics,
airframe, number of drones, wind or latency. Safe success is the fraction of drones that succeed
without conflict or collision; brackets are 95 % intervals of means over episodes. Rows are kept in
transfer.csv, and the same command flies those that are missing, or whose policy has changed. Writes
transfer.md and transfer.png.
"""

import argparse
import contextlib
import csv
import datetime
import hashlib
import itertools
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import matplotlib
import numpy as np
from rich.progress import track

matplotlib.use("Agg")
from matplotlib import pyplot

import bulletuav
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.aviary import Aviary
from bulletuav.files import replace_file
from bulletuav.policies.base import Policy
from bulletuav.policies.find import find_policy
from bulletuav.policies.run import POLICY, shipped, shipped_tasks
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.airframes import available_airframes, load_airframe
from bulletuav.vehicle.swarm import Swarm
from bulletuav.version import CONSTANTS

SEED = 8_000_000
"""Seed of the first episode of each case; no training and no choice of a policy uses it"""
EASY = ("mec", "search")
"""Tasks whose policies fly at easy alone; the others fly at medium, unless a case differs"""
LATENCY = "latency"
"""Axis that delays the actions, in decisions; all others are options of the environment"""
AXES: dict[str, tuple[Any, ...]] = {
    "difficulty": ("easy", "medium", "hard", "extreme"),
    "dynamics": DYNAMICS,
    "airframe": tuple(name for name in available_airframes() if not load_airframe(name).wings),
    "num_drones": (2, 4, 8, 16, 32),
    "wind": (0.0, 2.0, 4.0, 8.0),
    LATENCY: (0, 1, 2, 4),
}
"""Values of each axis; wind blows to the east, m/s"""


class Row(NamedTuple):
    """A case and its result.

    Attributes:
        task: Name of the task.
        axis: Name of the axis, in `AXES`.
        value: Value on the axis.
        policy: First digits of the policy's digest.
        episodes: Number of episodes.
        mean: Safe success; empty if the case cannot be flown.
        low: Lower bound of its interval.
        high: Upper bound.
        reason: Why the case cannot be flown.
    """

    task: str
    axis: str
    value: str
    policy: str
    episodes: str
    mean: str = ""
    low: str = ""
    high: str = ""
    reason: str = ""


class Late(Policy):
    """The policy of the package, whose actions come some decisions after their observations.

    Until then drones fly the first action of the episode.

    Attributes:
        task: Name of the task.
        delay: Number of decisions.
    """

    name = "late"
    actions = ()
    reads_swarm = False
    task: ClassVar[str]
    delay: ClassVar[int]

    def __init__(self, aviary: Aviary) -> None:
        """Make the policy of the package for the aviary."""
        super().__init__(aviary)
        self._policy = find_policy("trained", self.task)(aviary)
        # (delay + 1, W, N, A), newest first
        self._actions: np.ndarray = np.empty(0)
        self._is_new = np.ones(len(aviary.alive), bool)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the actions of the worlds in `mask`."""
        self._policy.reset(mask)
        self._is_new |= mask

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose the actions of all drones; see `Policy.act`."""
        actions = self._policy.act(observations, swarm)
        if not len(self._actions):
            self._actions = np.stack([actions] * (self.delay + 1))
        self._actions = np.concatenate([actions[None], self._actions[:-1]])
        self._actions[:, self._is_new] = actions[self._is_new]
        self._is_new[:] = False
        flown: np.ndarray = self._actions[-1]
        return flown


def late(task: str, delay: int) -> type[Policy]:
    """Return the class of a task's policy with a latency in decisions."""
    return type("Late", (Late,), {"task": task, "delay": delay})


def measure(task: str, axis: str, value: Any, episodes: int) -> Row:
    """Fly a case.

    Args:
        task: Name of the task.
        axis: Name of the axis.
        value: Value on the axis.
        episodes: Number of episodes.

    Returns:
        The row. Cases that the task, its dynamics or the policy refuse have no result.
    """
    row = Row(task, axis, str(value), digest(task), str(episodes))
    own = {} if axis == LATENCY else {axis: (value, 0.0, 0.0) if axis == "wind" else value}
    base = {"difficulty": "easy" if task in EASY else "medium"}
    try:
        options = find_policy("trained", task).complete(task, {**base, **own})
        with contextlib.closing(bulletuav.Aviary(task, **options)) as aviary:
            find_policy("trained", task)(aviary)
            # A reset raises the error if there is no room for so many drones
            aviary.reset(seeds=SEED)
    except ValueError as error:
        place = f"{Path(bulletuav.__file__).parents[1]}/"
        return row._replace(reason=" ".join(str(error).replace(place, "").split()))
    policy = late(task, value if axis == LATENCY else 0)
    result = bulletuav.evaluate(task, policy, episodes, SEED, **options)
    found = result.estimates()["safe_success"]
    mean, low, high = (f"{number:.3f}" for number in (found.mean, found.low, found.high))
    return row._replace(mean=mean, low=low, high=high)


def digest(task: str) -> str:
    """Return the first digits of the digest of a task's policy."""
    return hashlib.sha256((shipped(task) / POLICY).read_bytes()).hexdigest()[:8]


def read_rows(path: Path) -> dict[tuple[str, ...], Row]:
    """Read the rows that were flown before, by task, axis, value, policy and episodes."""
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        rows = [Row(**row) for row in csv.DictReader(file)]
    return {row[:5]: row for row in rows}


def write_rows(rows: list[Row], path: Path) -> None:
    """Write all rows."""
    lines = [Row._fields, *rows]
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)


def markdown(rows: list[Row], episodes: int) -> str:
    """Return the page: a table for each axis, with a column for each of its values."""
    tasks = ",".join(dict.fromkeys(row.task for row in rows))
    lines = [
        "# Transfer of the trained policies",
        "",
        "Each policy of the package (`--policy trained`) flies its task at medium, but for one",
        f"condition; {' and '.join(f'`{task}`' for task in EASY)} at easy, the difficulty of their",
        "training. Numbers are the fraction of drones that succeed without conflict or collision,",
        "with 95 % intervals; a dash is a condition that the task, the dynamics or the policy does",
        "not accept. Wind blows to the east, in m/s. Latency is counted in decisions: actions are",
        f"flown that much later. {episodes} episodes from seed {SEED} on,",
        f"{datetime.date.today()}, bulletuav {bulletuav.__version__}, constants {CONSTANTS}:",
        "",
        "```sh",
        f"python benchmarks/transfer.py --episodes {episodes} --tasks {tasks} "
        f"--out docs/results/transfer",
        "```",
        "",
        "![Safe success of each task and condition](transfer.png)",
    ]
    axes = dict.fromkeys(row.axis for row in rows)
    for axis, values in ((axis, AXES[axis]) for axis in axes):
        lines += ["", f"## {axis.replace('_', ' ').capitalize()}", ""]
        lines += [f"| task | {' | '.join(map(str, values))} |", "|---" * (len(values) + 1) + "|"]
        for task in dict.fromkeys(row.task for row in rows):
            named = {row.value: row for row in rows if (row.task, row.axis) == (task, axis)}
            cells = (cell(named[str(value)]) for value in values)
            lines.append(f"| `{task}` | {' | '.join(cells)} |")
    refused: dict[str, list[str]] = {}
    for row in rows:
        if row.reason:
            refused.setdefault(row.reason, []).append(f"`{row.task}`, {row.axis} {row.value}")
    if refused:
        lines += ["", "## Not accepted", ""]
        lines += [f"- {'; '.join(cases)}: {reason}" for reason, cases in refused.items()]
    return "\n".join(lines) + "\n"


def cell(row: Row) -> str:
    """Return a cell of the table."""
    return (
        f"{float(row.mean):.2f} [{float(row.low):.2f}, {float(row.high):.2f}]" if row.mean else "-"
    )


def draw(rows: list[Row], path: Path) -> None:
    """Draw safe success as colours: a panel for each axis, a line for each task."""
    tasks = list(dict.fromkeys(row.task for row in rows))
    found = {(row.task, row.axis, row.value): float(row.mean or "nan") for row in rows}
    axes = {row.axis: AXES[row.axis] for row in rows}
    widths = [len(values) for values in axes.values()]
    figure, panels = pyplot.subplots(
        1,
        len(axes),
        figsize=(0.42 * sum(widths) + 2.5, 0.34 * len(tasks) + 1.6),
        width_ratios=widths,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for panel, (axis, values) in zip(panels[0], axes.items(), strict=True):
        table = [[found.get((task, axis, str(one)), np.nan) for one in values] for task in tasks]
        picture = panel.imshow(table, vmin=0.0, vmax=1.0, cmap="viridis", aspect="auto")
        panel.set_facecolor("#dddddd")
        panel.set_title(axis.replace("_", " "), fontsize=9)
        panel.set_xticks(range(len(values)), map(str, values), rotation=60, ha="right", fontsize=7)
        panel.set_yticks(range(len(tasks)), tasks, fontsize=8)
    figure.colorbar(picture, ax=panels, label="safe success", pad=0.01)
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def main() -> None:
    """Fly all cases and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default=",".join(shipped_tasks()))
    parser.add_argument("--axes", default=",".join(AXES))
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("out/transfer"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "transfer.csv"
    known = read_rows(path)
    rows: list[Row] = []
    axes = arguments.axes.split(",")
    cases = [
        (task, axis, value)
        for task, axis in itertools.product(arguments.tasks.split(","), axes)
        for value in AXES[axis]
    ]
    for task, axis, value in track(cases, "flying"):
        key = (task, axis, str(value), digest(task), str(arguments.episodes))
        rows.append(known.get(key) or measure(task, axis, value, arguments.episodes))
        known[key] = rows[-1]
        # Rows of cases that are still to come are kept, too
        write_rows(list(known.values()), path)
    write_rows(rows, path)
    replace_file(arguments.out / "transfer.md", markdown(rows, arguments.episodes))
    draw(rows, arguments.out / "transfer.png")


if __name__ == "__main__":
    main()
