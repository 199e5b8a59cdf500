"""Measure cities: rays beside the engine's own, and `lidar_navigation` beside urbanmarl.

    python benchmarks/cities.py --out out/cities

Rates are per CPU-second, medians. As in compare.py each simulator runs in a process and an
environment of its own, with one thread, in turn with bulletuav. Writes cities.md and cities.csv.
"""

import sys
from collections.abc import Sequence

from compare import Comparison, Row, make_parser, measure_all, parse, report
from simulators import Server, install

PEER = "urbanmarl"
FLOOR = "the floor"
BUILDINGS = (100, 400, 2500)
WORLDS = (1, 64, 256)
STEPS = "environment steps/s"
GOAL = 10.0  # times as fast as the peer
# Cases of peers/serve_bulletuav.py, of which a decision's cost is told.
BEAMS = "beams, 256"
BLIND = "blind, 256"
ALONE = "48 rays in C, 256"


def comparisons() -> list[Comparison]:
    """List the comparisons: rays, the cost of a decision, and the peer.

    Those of one size follow each other, as a server keeps what it built for the last case.
    """
    rows = []
    for count in BUILDINGS:
        title = f"rays of 60 m, {count} buildings"
        ours = f"rays, bulletuav, {count}"
        for how in ("C", "pybullet"):
            rows.append(Comparison(title, ours, FLOOR, f"rays, {how}, {count}", "rays/s"))
    for theirs in (ALONE, BLIND):
        rows.append(Comparison("decision with 16 beams, W = 256", BEAMS, FLOOR, theirs, STEPS))
    for worlds in WORLDS:
        theirs = f"lidar_navigation, {worlds}"
        for title, case in (
            ("decisions of 0.1 s in one piece", "city"),
            ("decisions of 0.1 s in 24 substeps", "city at 240 Hz"),
            ("steps of 1 s, their ends and volume", "city by the second"),
        ):
            ours = f"{case}, {worlds}"
            rows.append(Comparison(f"{title}, W = {worlds}", ours, PEER, theirs, STEPS, GOAL))
    rows.append(Comparison("bullet, W = 256", "city in the engine, 256", PEER, theirs, STEPS))
    return rows


def costs(rows: list[Row]) -> list[str]:
    """Tell in words what a decision costs, if it was measured."""
    by_case = {row.against: row for row in rows}
    alone = by_case.get(f"{FLOOR} ({ALONE})")
    blind = by_case.get(f"{FLOOR} ({BLIND})")
    if alone is None or blind is None:
        return []
    with_beams, without, rays = (1e6 / rate for rate in (blind.ours, blind.theirs, alone.theirs))
    return [
        "",
        f"A decision of 256 worlds of 3 hovering drones: {with_beams:.3g} us an environment step "
        f"with 16 beams, {without:.3g} us without; its 48 rays alone {rays:.3g} us.",
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    arguments = parse(make_parser(__doc__, "out/cities"), argv)
    servers = {
        "bulletuav": Server(sys.executable, "serve_bulletuav.py"),
        FLOOR: Server(sys.executable, "serve_bulletuav.py"),
        PEER: Server(install(PEER, arguments.environments), "serve_urbanmarl.py"),
    }
    rows = measure_all(comparisons(), servers, arguments.rounds, arguments.seconds)
    report(rows, costs(rows), arguments.out, "cities")


if __name__ == "__main__":
    main()
