"""Write the tables of stages and of states in docs/explanation/architecture.md.

    python tools/stages.py

`tests/envs/test_simulation.py` checks that the page has them as they are.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bulletuav.envs.stages import Stage, airspace_stages, decision_stages  # noqa: E402
from bulletuav.envs.state import AirspaceState, Arrays, State  # noqa: E402

PAGE = ROOT / "docs" / "explanation" / "architecture.md"
BEGIN, END = "<!-- written by tools/stages.py -->\n", "<!-- end -->\n"


def tables(stages: Sequence[Stage], state: type[Arrays]) -> str:
    """Write the table of stages, and that of the arrays of a state."""
    lines = ["| stage | class | what it does | reads | writes |", "|---|---|---|---|---|"]
    for stage in stages:
        module = type(stage).__module__.rpartition(".")[2]
        link = f"[{type(stage).__name__}](../../bulletuav/envs/stages/{module}.py)"
        arrays = f"{_names(stage.reads)} | {_names(stage.writes)}"
        lines.append(f"| {stage.name} | {link} | {stage.summary} | {arrays} |")
    lines += ["", "| array | shape | type | meaning |", "|---|---|---|---|"]
    for name, one in state.declared().items():
        shape = ", ".join(one.axes.split())
        lines.append(f"| `{name}` | ({shape}) | {one.dtype.__name__} | {one.meaning} |")
    return "\n".join([*lines, ""])


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def updated(page: str) -> str:
    """Return a page with the tables of a decision, and of an airspace, between their marks."""
    before, *blocks = page.split(BEGIN)
    every = tables(decision_stages(), State), tables(airspace_stages(), AirspaceState)
    for text, block in zip(every, blocks, strict=True):
        before += BEGIN + text + END + block.partition(END)[2]
    return before


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text()))
