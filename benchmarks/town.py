"""Write a town that nobody built, in the way of OpenStreetMap, and measure its import and flights.

    python benchmarks/town.py --buildings 5000 --out out/town
    python benchmarks/town.py --buildings 250 --odd --out out/town --no-flights

Footprints are rectangles, L, U and stepped shapes, each turned as it likes, on a grid of lots. With
`--odd` they have what real files have: units, lists, levels, no heights, parts, parts in the air,
courtyards, rings that cross themselves, points. Writes town.geojson; prints the seconds of the
import, and the CPU time of a decision of `navigation` beside a generated city of as many pieces.
"""

import argparse
import json
import math
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_geojson
from bulletuav.city.model import City
from bulletuav.city.statistics import Statistics
from bulletuav.earth import degree_lengths

LOT = 40.0  # side, m
LATITUDE, LONGITUDE = 52.0, 13.0
WORLDS = 8
DECISIONS = 200
Outline = list[tuple[float, float]]
ODD = (
    {"height": "12 m"},
    {"height": "40 ft"},
    {"height": "12;14"},
    {"height": "12,5"},
    {"building:levels": "4", "roof:levels": "1"},
    {},
    {"height": "tall", "building:levels": "2"},
    {"height": 0},
    {"min_height": "4", "height": "16"},
)


def outlines(width: float, depth: float) -> list[Outline]:
    """List the shapes of footprints, with corners in m: a rectangle, an L, a U, and steps."""
    w, d = width, depth
    return [
        [(0, 0), (w, 0), (w, d), (0, d)],
        [(0, 0), (w, 0), (w, d / 2), (w / 2, d / 2), (w / 2, d), (0, d)],
        [
            *((0, 0), (w, 0), (w, d), (0.7 * w, d)),
            *((0.7 * w, 0.4 * d), (0.3 * w, 0.4 * d), (0.3 * w, d), (0, d)),
        ],
        [
            *((0, 0), (w / 3, 0), (w / 3, -2), (2 * w / 3, -2), (2 * w / 3, 0)),
            *((w, 0), (w, d), (w / 2, d), (w / 2, 0.8 * d), (0, 0.8 * d)),
        ],
    ]


def ring(outline: Outline, size: tuple[float, float], place: np.ndarray, turn: float) -> Any:
    """Turn an outline about its middle, put it at a place, m, and give the ring in degrees."""
    ways = np.array([(math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))])
    metres = (np.array(outline) - np.array(size) / 2) @ ways + place
    corners = np.round(metres / degree_lengths(LATITUDE) + (LONGITUDE, LATITUDE), 7).tolist()
    return [*corners, corners[0]]


def feature(rings: list[Any], properties: dict[str, Any], kind: str = "Polygon") -> dict[str, Any]:
    """Make a feature."""
    geometry = {"type": kind, "coordinates": rings}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def features(buildings: int, odd: bool, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the features of a town."""
    rng = np.random.default_rng(seed)
    row = math.ceil(math.sqrt(buildings))
    for k in range(buildings):
        place = LOT * np.array(divmod(k, row))
        size = w, d = tuple(rng.uniform(10, 28, 2).round(1).tolist())
        turn = rng.uniform(0, math.pi / 2)
        told = {"building": "yes", "height": round(float(rng.rayleigh(15)) + 3, 1)}
        shape = outlines(w, d)[k % 4]
        if not odd or k % 3:
            yield feature([ring(shape, size, place, turn)], told)
            continue
        match case := k // 3 % (len(ODD) + 6):
            case 0:  # a ring that crosses itself
                bow = [(0, 0), (w, d), (w, 0), (0, d)]
                yield feature([ring(bow, size, place, turn)], told)
            case 1:  # an entrance, and a building without corners
                yield feature(ring(shape, size, place, turn)[0], {"entrance": "yes"}, "Point")
                yield feature([], told)
            case 2:  # a courtyard
                hole = [
                    (w / 3, d / 3),
                    (w / 3, 2 * d / 3),
                    (2 * w / 3, 2 * d / 3),
                    (2 * w / 3, d / 3),
                ]
                block = outlines(w, d)[0]
                yield feature([ring(one, size, place, turn) for one in (block, hole)], told)
            case 3:  # two wings of one building
                wings = [[(0, 0), (w / 3, 0), (w / 3, d), (0, d)], [(w / 2, 0), (w, 0), (w, d)]]
                rings = [[ring(wing, size, place, turn)] for wing in wings]
                yield feature(rings, told, "MultiPolygon")
            case 4 | 5:  # a hall with a tower, or with a bridge
                yield feature([ring(outlines(w, d)[0], size, place, turn)], told)
                low = [(0, 0), (w / 2, 0), (w / 2, d), (0, d)]
                high = [(w / 2, 0), (w, 0), (w, d), (w / 2, d)]
                part = {"building:part": "yes", "building:levels": "2"}
                yield feature([ring(low, size, place, turn)], part)
                part = {"building:part": "yes", "height": 30}
                part |= {"building:min_level": "2"} if case == 5 else {}
                yield feature([ring(high, size, place, turn)], part)
            case _:
                yield feature(
                    [ring(shape, size, place, turn)], {"building": "yes", **ODD[case - 6]}
                )


def write_town(path: Path, buildings: int, odd: bool, seed: int = 0) -> None:
    """Write a town as GeoJSON, one feature a line."""
    lines = [json.dumps(one, separators=(",", ":")) for one in features(buildings, odd, seed)]
    body = ",\n".join(lines)
    path.write_text(f'{{"type": "FeatureCollection", "features": [\n{body}\n]}}\n')


def decision(city: City, dynamics: str) -> float:
    """Measure the median CPU time of a decision in worlds of a city, ms."""
    env = bulletuav.batch_env("navigation", WORLDS, city=city, dynamics=dynamics)
    env.reset(seed=0)
    shape = (*env.aviary.swarm.position.shape[:2], *env.action_space.shape)
    rng = np.random.default_rng(0)
    spent = []
    for _ in range(DECISIONS):
        actions = rng.uniform(-1, 1, shape)
        begin = time.process_time()
        env.step(actions)
        spent.append(time.process_time() - begin)
    env.close()
    return 1e3 * float(np.median(spent))


def main() -> None:
    """Write, read and fly."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--buildings", type=int, default=5000)
    parser.add_argument("--odd", action="store_true", help="with what real files have")
    parser.add_argument("--no-flights", action="store_true", help="write and read only")
    parser.add_argument("--out", type=Path, default=Path("out/town"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "town.geojson"
    write_town(path, arguments.buildings, arguments.odd)
    begin, spent = time.perf_counter(), time.process_time()
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        town = from_geojson(path)
    pieces = len(town.building)
    took, spent = time.perf_counter() - begin, time.process_time() - spent
    print(
        f"read in {took:.1f} s ({spent:.1f} s of CPU time): {len(town.heights)} buildings, ", end=""
    )
    print(f"{pieces} pieces, {path.stat().st_size / 1000:.0f} kB; {town.report.counts}")
    if arguments.no_flights:
        return
    density = pieces / (town.side / 1000) ** 2
    dense = Statistics(0.3, density, 15)
    city = generate(dense, town.side, np.random.default_rng(0))
    for dynamics in ("point_mass", "bullet"):
        ours, theirs = decision(town, dynamics), decision(city, dynamics)
        print(
            f"{dynamics}: {ours:.2f} ms a decision, {theirs:.2f} ms in a generated city of ", end=""
        )
        print(f"{len(city.building)} pieces, {WORLDS} worlds")


if __name__ == "__main__":
    main()
