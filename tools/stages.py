"""Write docs/reference/stages.md: the tables of stages and of states.

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

PAGE = ROOT / "docs" / "reference" / "stages.md"
TEXT = """# Stages of a decision

A [Simulation](../../bulletuav/envs/simulation.py) is an ordered list of stages, which read and
write arrays of a [State](../../bulletuav/envs/state.py). `print(env.aviary.simulation)` lists them,
`Simulation.insert` adds a stage of your own, and `bulletuav benchmark --stages TASK` measures each.
[Architecture](../explanation/architecture.md) follows a decision through the package. W is the
number of worlds, N the number of drones in each, A the size of an action, and S that of a setpoint.

`python tools/stages.py` writes this page from the code.

## Environments

{decision}
## Airspaces

An [Airspace](../../bulletuav/envs/airspace.py) has no task. K is the number of its obstacles.

{airspace}"""


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


def written() -> str:
    """Return the page with the tables of a decision, and of an airspace."""
    return TEXT.format(
        decision=tables(decision_stages(has_events=True, has_rates=True), State),
        airspace=tables(airspace_stages(), AirspaceState),
    )


if __name__ == "__main__":
    PAGE.write_text(written())
