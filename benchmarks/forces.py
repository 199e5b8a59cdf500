"""Measure what today's forces cost of a substep, beside those of bulletuav's first model.

    python benchmarks/forces.py --out out/forces

A substep is controller, rotors, forces, integration and contacts, without Python around it. The
first model had thrust, linear drag, lag, a ground effect on the whole drone and a wake that pushes.
Each set of forces flies in a process of its own, in turn. Writes forces.md and forces.csv.
"""

import csv
import statistics
import sys
from collections.abc import Sequence
from typing import NamedTuple

from compare import make_parser, parse
from rich.progress import track
from simulators import Server

SETS = ("now", "laws", "first")
"""See peers/serve_forces.py"""
SIZES = ((1, 1), (1, 10), (64, 8))
"""Worlds and drones"""
WAYS = ("apart", "near the ground", "above each other")
GOAL = 1.15


class Row(NamedTuple):
    """One line of the result.

    Attributes:
        case: Dynamics, worlds, drones, and how they fly.
        now: Time of a substep, ns a drone.
        laws: Median ratio to the forces of the first model under the same controller.
        first: Median ratio to the first model, whose controller has no torque of drag to make up
            for.
    """

    case: str
    now: float
    laws: float
    first: float


def measure(servers: dict[str, Server], case: str, rounds: int, seconds: float) -> Row:
    """Measure a case with all sets of forces in turn."""
    times: dict[str, list[float]] = {name: [] for name in SETS}
    for _ in range(rounds):
        for name in SETS:
            times[name].append(1e9 / servers[name].rate(case, seconds))
    ratios = [
        statistics.median(now / then for now, then in zip(times["now"], times[name], strict=True))
        for name in SETS[1:]
    ]
    return Row(case, statistics.median(times["now"]), *ratios)


def table(rows: list[Row]) -> str:
    """Lay out the rows as Markdown."""
    lines = ["| case | ns a drone and substep | forces alone | with the controller | goal |"]
    lines.append("|---|---|---|---|---|")
    for row in rows:
        costs = f"{row.laws - 1:+.1%} | {row.first - 1:+.1%}"
        lines.append(f"| {row.case} | {row.now:.0f} | {costs} | {GOAL - 1:+.0%} |")
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    given = parse(make_parser(__doc__, "out/forces"), argv)
    given.out.mkdir(parents=True, exist_ok=True)
    servers = {
        name: Server(sys.executable, "serve_forces.py", name, str(given.out.resolve()))
        for name in SETS
    }
    cases = [
        f"{dynamics}, {worlds} x {drones}, {how}"
        for dynamics in ("rigid_body", "bullet")
        for worlds, drones in SIZES
        for how in WAYS
        if drones > 1 or how != "above each other"
    ]
    # One set after the other compiles
    for name in track(SETS, description="compiling"):
        for case in (cases[0], cases[-1]):
            servers[name].rate(case, 0.01)
    rows = [
        measure(servers, case, given.rounds, given.seconds)
        for case in track(cases, description="measuring")
    ]
    for server in servers.values():
        server.close()
    with open(given.out / "forces.csv", "w", newline="") as file:
        csv.writer(file).writerows([Row._fields, *rows])
    (given.out / "forces.md").write_text(table(rows))
    sys.stdout.write(table(rows))


if __name__ == "__main__":
    main()
