"""Write the tables of stages and of the state in docs/architecture.md.

    python tools/stages.py

`tests/envs/test_simulation.py` checks that the page has them as they are.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bulletuav.envs.stages import decision_stages  # noqa: E402
from bulletuav.envs.state import ARRAYS  # noqa: E402

PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- written by tools/stages.py -->\n", "<!-- end -->\n"


def tables() -> str:
    """Write both tables."""
    lines = ["| stage | class | what it does | reads | writes |", "|---|---|---|---|---|"]
    for stage in decision_stages():
        module = type(stage).__module__.rpartition(".")[2]
        link = f"[{type(stage).__name__}](../bulletuav/envs/stages/{module}.py)"
        arrays = f"{_names(stage.reads)} | {_names(stage.writes)}"
        lines.append(f"| {stage.name} | {link} | {stage.summary} | {arrays} |")
    lines += ["", "| array | shape | type | meaning |", "|---|---|---|---|"]
    for name, one in ARRAYS.items():
        shape = ", ".join(one.axes.split())
        lines.append(f"| `{name}` | ({shape}) | {one.dtype.__name__} | {one.meaning} |")
    return "\n".join([*lines, ""])


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def updated(page: str) -> str:
    """Return a page with the tables between their marks."""
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + tables() + END + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text()))
