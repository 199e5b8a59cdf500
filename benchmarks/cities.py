"""Cities: rays beside the engine's own, and `lidar_navigation` beside urbanmarl; per CPU-second, medians.

    python benchmarks/cities.py --out out/cities

As compare.py measures: each simulator in a process and an environment of its own, one thread each, in turn with bulletuav.
Writes cities.md and cities.csv.
"""

import sys
from collections.abc import Sequence

from compare import Comparison, Row, Server, install, make_parser, measure_all, parse, report

PEER, FLOOR = "urbanmarl", "the floor"
BUILDINGS = (100, 400, 2500)
WORLDS = (1, 64, 256)
STEPS = "environment steps/s"
GOAL = 10.0  # times as fast as the peer
BEAMS, BLIND, ALONE = "beams, 256", "blind, 256", "48 rays in C, 256"


def comparisons() -> list[Comparison]:
    """Rays, the cost of a decision, and the peer; those of one size follow each other, as what was built is kept."""
    rows = []
    for count in BUILDINGS:
        for how in ("C", "pybullet"):
            title, ours = f"rays of 60 m, {count} buildings", f"rays, bulletuav, {count}"
            rows.append(Comparison(title, ours, FLOOR, f"rays, {how}, {count}", "rays/s"))
    rows += [
        Comparison("decision with 16 beams, W = 256", BEAMS, FLOOR, ALONE, STEPS),
        Comparison("decision with 16 beams, W = 256", BEAMS, FLOOR, BLIND, STEPS),
    ]
    for worlds in WORLDS:
        theirs = f"lidar_navigation, {worlds}"
        for title, case in (
            ("decisions of 0.1 s in one piece", "city"),
            ("decisions of 0.1 s in 24 substeps", "city at 240 Hz"),
            ("steps of 1 s, their ends and volume", "city by the second"),
        ):
            rows.append(
                Comparison(f"{title}, W = {worlds}", f"{case}, {worlds}", PEER, theirs, STEPS, GOAL)
            )
    rows.append(Comparison("bullet, W = 256", "city in the engine, 256", PEER, theirs, STEPS))
    return rows


def costs(rows: list[Row]) -> list[str]:
    """What a decision takes, in words."""
    of = {row.against: row for row in rows}
    alone, blind = (of.get(f"{FLOOR} ({case})") for case in (ALONE, BLIND))
    if alone is None or blind is None:
        return []
    as_int, without, rays = (1e6 / rate for rate in (blind.ours, blind.theirs, alone.theirs))
    return [
        "",
        f"A decision of 256 worlds of 3 hovering drones: {as_int:.3g} us an environment step with 16 beams, {without:.3g} us "
        f"without; its 48 rays alone {rays:.3g} us.",
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
