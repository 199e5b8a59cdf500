"""Measure edge computing: `mec` beside urbanmarl.

    python benchmarks/edge.py --out out/edge

Rates are environment steps per CPU-second, resets included, medians. As in compare.py each
simulator runs in a process and an environment of its own, with one thread, in turn with bulletuav.
Writes edge.md and edge.csv.
"""

import sys
from collections.abc import Sequence

from cities import GOAL, PEER, STEPS, WORLDS
from compare import Comparison, make_parser, measure_all, parse, report
from simulators import Server, install


def comparisons() -> list[Comparison]:
    """List the comparisons.

    Those of one number of worlds follow each other, as the peer keeps what it built for them.
    """
    rows = []
    for worlds in WORLDS:
        theirs = f"mec, {worlds}"
        for title, case in (("mec", "mec"), ("their sizes and formulas", "mec as urbanmarl")):
            ours = f"{case}, {worlds}"
            rows.append(Comparison(f"{title}, W = {worlds}", ours, PEER, theirs, STEPS, GOAL))
    rows.append(Comparison("bullet, W = 256", "mec in the engine, 256", PEER, theirs, STEPS))
    return rows


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    arguments = parse(make_parser(__doc__, "out/edge"), argv)
    servers = {
        "bulletuav": Server(sys.executable, "serve_bulletuav.py"),
        PEER: Server(install(PEER, arguments.environments), "serve_urbanmarl.py"),
    }
    rows = measure_all(comparisons(), servers, arguments.rounds, arguments.seconds)
    report(rows, [], arguments.out, "edge")


if __name__ == "__main__":
    main()
