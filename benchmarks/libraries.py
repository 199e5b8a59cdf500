"""Train by other libraries, each in an environment of its own, and write a table of what they took.

    python -m venv skrl && skrl/bin/pip install -e . torch==2.13.0 supersuit skrl
    python benchmarks/libraries.py skrl=skrl/bin/python --out docs/results/trainers/libraries.md

Runs `pip check`, and tests/clients/NAME_client.py, which trains in `crossing` with 4 drones and
prints a line of JSON. Rows of libraries that are not named stay.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
CLIENTS = ROOT / "tests" / "clients"
OUT = ROOT / "docs" / "results" / "trainers" / "libraries.md"
ROW = "| `"
INTRODUCTION = """\
# Trainers of other libraries

Written by `python benchmarks/libraries.py`, which trains in `crossing` (4 drones, `point_mass`) by
unmodified libraries, each in an environment of its own. "Glue" counts the lines that a user writes
for the environment. "Collection" is the rate of the library's vector environment with random
actions, relative to `batch_env` with as many worlds, or "-" if the library has none; "training"
includes collection, updates and evaluations. Both are per second of CPU time.
"""
COLUMNS = {
    "library": "---",
    "versions": "---",
    "trained": "---",
    "glue, lines": "---:",
    "worlds": "---:",
    "collection": "---:",
    "training, decisions/s": "---:",
    "`pip check`": "---",
    "date": "---",
}
"""Names and alignments of the columns"""


def run(name: str, python: str, clients: Path) -> str:
    """Train by a library, and return its row of the table.

    Args:
        name: Name of the library, for which there is a client.
        python: Python of the environment that has it.
        clients: Folder of the clients.

    Raises:
        ValueError: If there is no such client.
        subprocess.CalledProcessError: If the client fails.
    """
    client = clients / f"{name}_client.py"
    if not client.is_file():
        known = ", ".join(
            sorted(path.stem.removesuffix("_client") for path in clients.glob("*_client.py"))
        )
        raise ValueError(f"unknown library {name!r}: choose from {known}")
    done = subprocess.run([python, client], check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    checked = subprocess.run([python, "-m", "pip", "check"], capture_output=True, text=True)
    versions = ", ".join(f"{package} {number}" for package, number in found["versions"].items())
    cells = (
        f"`{name}`",
        f"{versions}, Python {found['python']}",
        found["how"],
        str(found["glue"]),
        str(found["worlds"]),
        "-" if found["share"] is None else f"{found['share']:.2f}",
        f"{found['training']:,.0f}",
        "passes" if checked.returncode == 0 else checked.stdout.strip().replace("\n", "; "),
        date.today().isoformat(),
    )
    return f"| {' | '.join(cells)} |"


def main(words: Sequence[str] | None = None) -> None:
    """Run the named libraries, and write the table."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("libraries", nargs="+", metavar="NAME=PYTHON")
    parser.add_argument("--clients", type=Path, default=CLIENTS, help="folder of the clients")
    parser.add_argument("--out", type=Path, default=OUT, help="the page")
    given = parser.parse_args(words)
    rows = {}
    if given.out.is_file():
        lines = given.out.read_text(encoding="utf-8").splitlines()
        rows = {line.split("`")[1]: line for line in lines if line.startswith(ROW)}
    for one in given.libraries:
        name, _, python = one.partition("=")
        if not python:
            parser.error(f"{one!r} names no Python: write NAME=PYTHON")
        print(f"training by {name}", file=sys.stderr)
        rows[name] = run(name, python, given.clients)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'|'.join(COLUMNS.values())}|"]
    text = "\n".join([INTRODUCTION, *lines, *(rows[name] for name in sorted(rows)), ""])
    given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
