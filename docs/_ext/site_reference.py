"""Sphinx extension: write the pages of the reference from the code and from measured results.

The pages stand in docs/reference, next to those that people write, and are not kept in the
repository. `python docs/_ext/site_reference.py` writes them without building the site.
"""

import ast
import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

import bulletuav  # noqa: E402
from bulletuav import cli  # noqa: E402
from bulletuav.commands import task_description as description  # noqa: E402
from bulletuav.envs.options import EnvOptions  # noqa: E402
from bulletuav.registry import PACKAGES, find, names  # noqa: E402
from bulletuav.tasks import find_task  # noqa: E402
from bulletuav.vehicle.envelope import find_envelope  # noqa: E402

REFERENCE = ROOT / "docs" / "reference"
RESULTS = ROOT / "docs" / "results"
INCENTIVES = RESULTS / "incentives" / "incentives.md"
ROLES = {
    "oracle": "oracle",
    "baseline": "baseline",
    "blind": "best blind policy",
    "shirker": "policy that avoids the task",
}
"""Roles of policies in `INCENTIVES`, with their headings"""
"""Folders of results of `bulletuav compare` on several difficulties"""
NAME_ROW = re.compile(r"^\| `(bulletuav[\w.]*)` \| (.*) \|$", re.MULTILINE)
MDP_PARTS = ("Observation", "Action", "Reward", "End", "Success")
"""First words of the paragraphs of a task's docstring that get a heading"""
API_ROOT = "bulletuav"
PAGE_WIDTH = 100
"""Width of the help texts of commands, characters"""


def cell(value: Any) -> str:
    """Format a value for a cell of a Markdown table."""
    return " ".join(str(value).split()).replace("|", "\\|")


def rows_table(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(map(cell, line))} |" for line in lines) + "\n"


def rich_table(table: Table, headings: Sequence[str] | None = None) -> str:
    """Write a table of the command line as Markdown; names in the first column become code."""
    shown = headings or [str(column.header) for column in table.columns]
    first, *others = (list(column.cells) for column in table.columns)
    return rows_table(shown, zip([f"`{one}`" for one in first], *others, strict=True))


def summary(ingredient: Any) -> str:
    """Return the first sentence of a docstring, with code in backticks."""
    return (inspect.getdoc(ingredient) or "").partition("\n")[0]


def text_before_sections(ingredient: Any) -> str:
    """Return a docstring up to its sections of arguments or attributes."""
    text = inspect.getdoc(ingredient) or ""
    return re.split(r"\n\n(?:Args|Attributes|Returns|Raises|References):\n", text)[0]


def task_page(name: str) -> str:
    """Write the page of a task: MDP, difficulties, measured rates, options, observation."""
    task = find_task(name)
    first, *others = (inspect.getdoc(task) or "").split("\n\n")
    parts = [f"# `{name}`", first, f"<!-- replay: {name} -->"]
    parts.append(f"```sh\nbulletuav fly {name} --html --out flight\n```")
    for paragraph in others:
        if (word := re.match(r"\w+", paragraph)) and word[0] in MDP_PARTS:
            parts.append(f"## {word[0]}")
        parts.append(paragraph)
    training = ["in training"] if task.training_weights else []
    parts += [
        "## Reward terms",
        "Terms of weight 0 are computed if the option `weights` sets their weight.",
        *(['The option `reward="training"` selects the weights for training.'] if training else []),
        rich_table(description.reward_table(task), ("term", "weight", *training, "value")),
        "## Ends of an episode",
        rich_table(description.ends_table(task), ("condition", "effect", "meaning")),
        "## Difficulties",
        "An empty cell is the default.",
        rich_table(description.main_options_table(task)),
        rich_table(description.difficulties_table(task), ("name", "options")),
        *rates(name),
        "## Options",
        rich_table(description.options_table(task), ("option", "default", "meaning")),
        "[Options that all tasks have](../options.md).",
        "## Numbers of the observation",
        "With the default options:",
        rich_table(description.observation_table(name, {})),
    ]
    return "\n\n".join(parts)


def rates(task: str) -> Iterator[str]:
    """Write the safe success of oracle, baseline, blind and shirking policies by difficulty.

    Args:
        task: Name of the task; without measured rates there is no table.
    """
    found = [row for row in read_incentives(INCENTIVES) if row["task"] == task]
    if not found:
        return
    levels = list(dict.fromkeys(row["difficulty"] for row in found))
    values = {
        (
            row["role"],
            row["difficulty"],
        ): f"`{row['policy']}` {row['safe success']}, {row['return']}"
        for row in found
    }
    roles = [role for role in ROLES if any(row["role"] == role for row in found)]
    yield "## Measured rates"
    yield (
        "Safe success (fraction of drones that succeed without conflict or collision) and return, "
        f"with 95 % confidence intervals: dynamics `{found[0]['dynamics']}`. The oracle knows the "
        "whole state, blind policies observe nothing, and the other policy is the best paid of "
        f"those that avoid the task. Make the table again with `bulletuav incentives {task} "
        f"--dynamics {found[0]['dynamics']}`."
    )
    yield rows_table(
        ["difficulty", *(ROLES[role] for role in roles)],
        [[level, *(values.get((role, level), "") for role in roles)] for level in levels],
    )


def read_incentives(path: Path) -> Iterator[dict[str, str]]:
    """Read the tables of `bulletuav incentives`: a dict for each row, by the names of columns."""
    columns: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("| task |"):
            columns = _cells(line)
        elif line.startswith("| "):
            yield dict(zip(columns, _cells(line), strict=True))


def read_leaderboard(path: Path) -> Iterator[dict[str, str]]:
    """Read a leaderboard of `bulletuav compare`, as Markdown.

    Args:
        path: The file.

    Yields:
        A dict for each row: its cells by the names of their columns, and "task", "difficulty",
        "dynamics", "episodes" and "reads".
    """
    for part in re.split(r"(?m)^## ", path.read_text(encoding="utf-8"))[1:]:
        title, head, _, *lines = (line for line in part.splitlines() if line)
        task, difficulty, _, dynamics, *_, episodes, _ = title.replace(":", ",").split(", ")
        columns = _cells(head)
        for line in lines:
            row = dict(zip(columns, _cells(line), strict=True))
            policy, _, mark = row["policy"].partition(" ")
            yield {
                **row,
                "task": task,
                "difficulty": difficulty,
                "dynamics": row.get("dynamics", dynamics).split()[0],
                "episodes": episodes.split()[0],
                "policy": policy,
                "reads": "true state" if mark else "observation",
            }


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("| ").split("|")]


def tasks_index() -> str:
    """Write the list of tasks."""
    rows = (
        (
            f"[![A flight of {name}](../../results/gallery/{name}.png)]({name}.md)",
            f"[`{name}`]({name}.md)",
            summary(task),
            f"`{task.baseline}`",
        )
        for name in bulletuav.list_tasks()
        for task in (find_task(name),)
    )
    text = (
        "# Tasks\n\nEach page has the MDP, the difficulties, the options and a replay of the task. "
        "`bulletuav tasks TASK` prints the same in a terminal.\n\n"
    )
    return text + rows_table(("flight", "task", "summary", "baseline policy"), rows)


def options_page() -> str:
    """Write the page of the options that all environments have."""
    texts = description.option_texts(EnvOptions)
    rows = (
        (
            f"`{field.name}`",
            "" if field.default is dataclasses.MISSING else f"`{field.default!r}`",
            texts.get(field.name, ""),
        )
        for field in dataclasses.fields(EnvOptions)
    )
    return (
        "# Options of all environments\n\nPass them to `bulletuav.parallel_env`, `batch_env` and "
        "the others by name, or on the command line by `--set NAME=VALUE`. Each task overrides "
        "some defaults, and has [options of its own](tasks/index.md).\n\n"
    ) + rows_table(("option", "default", "meaning"), rows)


def ingredients_page(kind: str, title: str, introduction: str) -> str:
    """Write the page of all ingredients of a kind, with the first paragraphs of their texts."""
    parts = [f"# {title}", introduction]
    for name in names(kind):
        one = find(kind, name, lambda _: True)
        about = getattr(one, "about", None)
        text = about if isinstance(about, str) else text_before_sections(one)
        parts += [f"## `{name}`", text[:1].upper() + text[1:]]
        if kind == "policy":
            reads = "the true state" if one.reads_swarm else "its observation"
            actions = ", ".join(f"`{action}`" for action in one.actions) or "all"
            parts.append(f"Reads {reads}. Actions: {actions}.")
        if kind == "sensor" and (texts := description.option_texts(one)):
            uncertain = {key: texts[key] for key in one.uncertain if key in texts}
            if uncertain:
                parts.append("Uncertain parameters (option `randomization`):")
                rows = ((f"`{name}_{key}`", value) for key, value in uncertain.items())
                parts.append(rows_table(("parameter", "meaning"), rows))
    return "\n\n".join(parts)


def airframes_page() -> str:
    """Write the page of the airframes, with their main constants."""
    rows = []
    for name in bulletuav.available_airframes():
        one = bulletuav.load_airframe(name)
        weight = one.mass * 9.80665
        span = max((wing.position[1] + wing.span / 2 for wing in one.wings), default=0.0)
        rows.append(
            (
                f"[`{name}`](../../assets/urdf/{name}.urdf)",
                f"{1000 * one.mass:.0f}",
                len(one.rotors),
                f"{1000 * one.propeller_radius:.0f}",
                f"{one.max_thrust / weight:.2f}",
                f"{2 * span:.2g}" if one.wings else "",
                f"{find_envelope(one).stall_speed:.1f}" if one.wings else "",
                f"{one.max_speed:g}",
            )
        )
    headings = (
        "name",
        "mass, g",
        "rotors",
        "propeller radius, mm",
        "thrust along z to weight",
        "span, m",
        "stall speed, m/s",
        "max speed, m/s",
    )
    return (
        "# Airframes\n\nThe option `airframe` takes a name, the path of a URDF file, or an "
        "`Airframe`. Each file lists the sources of its constants. Those with a span have "
        "[wings](../explanation/wings.md).\n\n"
    ) + rows_table(headings, rows)


def cli_page() -> str:
    """Write the page of the command line: the help of each command."""
    parts = ["# Command line", "`bulletuav COMMAND --help` prints these texts."]
    for name in cli.COMMANDS:
        _, parsers = cli._parser([name])
        parser = parsers[name]
        parser.formatter_class = lambda prog: cli._Formatter(prog, width=PAGE_WIDTH)
        help_text = parser.format_help().rstrip()
        parts += [f"## bulletuav {name}", f"```text\n{help_text}\n```"]
    return "\n\n".join(parts)


def errors_page() -> str:
    """Write the catalogue of errors: message templates of all `raise` statements, by package."""
    parts = [
        "# Error messages",
        "Messages of invalid input, by the package that raises them. `...` stands for a value. "
        "Each message names the value and the remedy.",
    ]
    packages: dict[str, dict[str, str]] = {}
    for path in sorted((ROOT / "bulletuav").rglob("*.py")):
        package = path.relative_to(ROOT / "bulletuav").parts[0].removesuffix(".py")
        for message, error in messages(path):
            packages.setdefault(package, {})[message] = error
    for package, found in packages.items():
        rows = ((f"`{error}`", message) for message, error in sorted(found.items()))
        parts += [f"## {package}", rows_table(("error", "message"), rows)]
    return "\n\n".join(parts)


def messages(path: Path) -> Iterator[tuple[str, str]]:
    """List the templates of messages that a module raises, each with the name of its error."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not (isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args):
            continue
        called, text = node.exc.func, node.exc.args[0]
        if isinstance(called, ast.Name) and called.id.endswith("Error"):
            parts = text.values if isinstance(text, ast.JoinedStr) else [text]
            if any(isinstance(part, ast.Constant) for part in parts):
                shown = (
                    str(part.value) if isinstance(part, ast.Constant) else "..." for part in parts
                )
                yield re.sub(r"[`<>*_]", r"\\\g<0>", "".join(shown)), called.id


def public_names() -> dict[str, list[tuple[str, str]]]:
    """Read the table of public names, as (module, name) by package."""
    packages: dict[str, list[tuple[str, str]]] = {}
    for module, row in NAME_ROW.findall((REFERENCE / "names.md").read_text(encoding="utf-8")):
        package = f"{module}.{API_ROOT}".split(".")[1]
        own = packages.setdefault(package, [])
        own += [(module, name) for name in re.findall(r"`(\w+)`", row)]
    return packages


def api_page(package: str, own: Iterable[tuple[str, str]]) -> str:
    """Write the page of the public names of a package, which autodoc fills."""
    parts = [f"# {package}" if package == API_ROOT else f"# {API_ROOT}.{package}"]
    described: dict[int, str] = {}
    for module, name in own:
        path = f"{module}.{name}"
        try:
            value = getattr(importlib.import_module(module), name, None)
        except ImportError as error:
            text = f"``{path}``: not documented in this build ({error})."
        else:
            # One object can have two public addresses; only the first has an entry
            first = described.setdefault(id(value) if callable(value) else id(path), path)
            text = directive(path, value) if first == path else f"``{path}`` is :obj:`{first}`."
        parts += [f"## {name}", f"```{{eval-rst}}\n{text}\n```"]
    return "\n\n".join(parts)


def directive(path: str, value: Any) -> str:
    """Return the directive of autodoc for an object, or for a module if there is no object."""
    if inspect.isclass(value):
        return f".. autoclass:: {path}\n   :members:\n"
    if value is None or inspect.ismodule(value):
        return f".. automodule:: {path}\n   :members:\n"
    kind = "function" if callable(value) else "data"
    return f".. auto{kind}:: {path}\n"


def skip_field(app: Any, what: str, name: str, value: Any, skip: bool, options: Any) -> bool | None:
    """Leave out fields of named tuples: the docstring of the class describes them."""
    return True if (getattr(value, "__doc__", None) or "").startswith("Alias for field") else None


KINDS = {
    "observation": (
        "Observation blocks",
        "The option `observation` takes these names, and those of [sensors](sensors.md).",
    ),
    "reward": ("Reward terms", "The options `weights` and `reward` take these names."),
    "metric": ("Metrics", "`bulletuav evaluate` and `bulletuav compare` report these numbers."),
    "sensor": ("Sensors", "The options `observation` and `sensors` take these names."),
    "dynamics": (
        "Dynamics",
        "The option `dynamics` takes these names. "
        "[What each of them models](../explanation/dynamics.md).",
    ),
    "action": ("Actions", "The option `action` takes these names."),
    "policy": ("Policies", "The option `--policy` of the command line takes these names."),
    "mobility": (
        "Mobility of users",
        "The option `mobility` of tasks with users takes these names.",
    ),
}
"""Titles and introductions of the pages of ingredients, by kind"""
FILES: Mapping[str, str] = {"policy": "policies", "dynamics": "dynamics", "mobility": "mobility"}


def pages() -> Iterator[tuple[str, str]]:
    """Return all generated pages, each with its path below docs/reference."""
    assert set(KINDS) <= set(PACKAGES)
    yield "tasks/index.md", tasks_index()
    for name in bulletuav.list_tasks():
        yield f"tasks/{name}.md", task_page(name)
    yield "options.md", options_page()
    for kind, (title, introduction) in KINDS.items():
        page = FILES.get(kind, f"{kind}s")
        yield f"{page}.md", ingredients_page(kind, title, introduction)
    yield "airframes.md", airframes_page()
    yield "cli.md", cli_page()
    yield "errors.md", errors_page()
    for package, own in public_names().items():
        yield f"api/{package}.md", api_page(package, own)


def write(*_: Any) -> None:
    """Write the pages that have changed."""
    for name, text in pages():
        path = REFERENCE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        content = text.rstrip() + "\n"
        if not path.exists() or path.read_text(encoding="utf-8") != content:
            path.write_text(content, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("builder-inited", write)
    app.connect("autodoc-skip-member", skip_field)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    write()
