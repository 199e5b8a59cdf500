"""`bulletuav city`: make a city, or read one, and write what it looks like."""

import argparse
import dataclasses
import inspect
import json
import math
import warnings
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rich.console import JustifyMethod
from rich.table import Table

from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.city.import_report import FIRST_SHOWN, ImportReport, MendedWarning
from bulletuav.city.import_report import KINDS as NOTE_KINDS
from bulletuav.city.imports import READERS
from bulletuav.city.maps import draw_map
from bulletuav.city.model import City
from bulletuav.city.render import render
from bulletuav.city.statistics import KINDS, Statistics, realised
from bulletuav.commands.arguments import out_folder
from bulletuav.commands.output import print_files, print_table
from bulletuav.errors import as_int, choose
from bulletuav.files import replace_file, whole_file
from bulletuav.report.pictures import blank_figure, save_figure

ABOUT = {
    "help": "make a city and write its map, OBJ file and statistics",
    "description": (
        "Make a city with the statistics of ITU-R P.1410, or read one from a file. Print its "
        "statistics beside those aimed at. Write a map, a Wavefront OBJ file and the statistics."
    ),
    "epilog": """examples:
  bulletuav city --kind dense --seed 3 --out dense
  bulletuav city --kind urban --irregularity 1 --gamma 30 --out towers
  bulletuav city --import dense/city.obj --elevation ground --out town""",
}
NUMBERS = ("alpha", "beta", "gamma")
GENERATOR = {"kind", "seed", "irregularity", "side", *NUMBERS}
"""Options that have a meaning for a generated city"""
COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("statistic", "left"),
    ("realised", "right"),
    ("target", "right"),
)
Measured = dict[str, tuple[float, float]]
"""Value of each statistic, and the value aimed at, NaN where there is none"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what to generate, what to import, and where to write."""
    _add_generator(parser)
    _add_import(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("city"),
        metavar="DIR",
        help="folder for the files (default: city)",
    )


def _add_generator(parser: argparse.ArgumentParser) -> None:
    """Add the options of a generated city."""
    # Statistics of the ITU-R; a kind is a name for three of them
    parser.add_argument("--kind", help=f"{', '.join(KINDS)} (default: urban)")
    parser.add_argument(
        "--alpha", type=float, help="built-up share of the ground (default: the kind's)"
    )
    parser.add_argument("--beta", type=float, help="buildings per km^2 (default: the kind's)")
    parser.add_argument(
        "--gamma", type=float, metavar="M", help="most frequent height (default: the kind's)"
    )
    # How regular, and how large
    parser.add_argument(
        "--irregularity", type=float, help="from 0, a regular grid (the default), to 1"
    )
    parser.add_argument("--seed", type=int, help="same seed, same city (default: 0)")
    parser.add_argument(
        "--side",
        type=float,
        metavar="M",
        help="side of the square (default: 500, or what an import needs)",
    )


def _add_import(parser: argparse.ArgumentParser) -> None:
    """Add the options of a city from a file."""
    # Any file: strict is None when left out, as a generated city takes no such option
    parser.add_argument(
        "--import",
        type=Path,
        dest="file",
        metavar="FILE",
        help="read footprints (GeoJSON) or meshes (OBJ) instead of generating",
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        default=None,
        help="refuse what is repaired, guessed or left out otherwise",
    )
    parser.add_argument(
        "--height",
        metavar="NAME",
        help="GeoJSON: the property with the height in m (default: height)",
    )
    parser.add_argument(
        "--default-height",
        type=float,
        metavar="M",
        help="GeoJSON: height of buildings that tell neither height nor levels (default: 10)",
    )
    parser.add_argument(
        "--metres",
        action="store_true",
        default=None,
        help="GeoJSON: coordinates are metres, not degrees",
    )
    parser.add_argument(
        "--scale", type=float, help="OBJ: metres in a unit of the file (default: 1)"
    )
    parser.add_argument("--y-up", action="store_true", default=None, help="OBJ: y points up, not z")
    parser.add_argument(
        "--elevation",
        metavar="HOW",
        help="OBJ: ground puts each building on the ground, keep leaves heights as they are "
        "(default: auto, ground where the whole model is above it)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Make or read a city, print and write."""
    city, target = _city(arguments)
    measured = realised(city, target)
    out = out_folder(arguments.out)
    files = [out / "map.png", out / "city.obj", out / "statistics.json", out / "city.png"]
    map_file, obj_file, statistics_file, picture_file = files

    # Pictures and the OBJ file first, then the numbers.
    figure = blank_figure(9, 8)
    draw_map(city, figure.add_subplot())
    save_figure(figure, map_file)
    with whole_file(picture_file) as part:
        Image.fromarray(render(city.solids, city.side)).save(part)
    write_obj(city, obj_file)
    replace_file(statistics_file, json.dumps(_described(city, measured), indent=2) + "\n")
    print_table(_table(city, measured))
    if city.report is not None and (city.report.notes or city.report.splits):
        print_table(_report_table(city.report))
    print_files(files)


def _city(arguments: argparse.Namespace) -> tuple[City, Statistics | None]:
    """Make or read the city, and give the statistics that a generated one aims at."""
    options = {
        name: value
        for name, value in vars(arguments).items()
        if value is not None and name not in ("command", "out")
    }
    file = options.pop("file", None)
    if file is None:
        return _generated(options)
    # The ending chooses the reader, whose parameters are the options with a meaning.
    reader = choose(f"kind of file {str(file)!r} with ending", file.suffix.lower(), READERS)
    _refuse_others(options, inspect.signature(reader).parameters, f"an import of {file}")
    # The report is printed, so there is no need of its one line.
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return reader(file, **options), None


def _generated(options: dict[str, Any]) -> tuple[City, Statistics]:
    """Generate a city, and give the statistics that it aims at."""
    _refuse_others(options, GENERATOR, "a generated city")
    kind = options.get("kind", "urban")
    numbers = {name: options[name] for name in NUMBERS if name in options}
    target = dataclasses.replace(choose("kind of city", kind, KINDS), **numbers)
    side = options.get("side", 500.0)
    irregularity = options.get("irregularity", 0.0)
    rng = np.random.default_rng(as_int("seed", options.get("seed", 0), least=0))
    # An unchanged kind goes by its name, which becomes the name of the city.
    return generate(target if numbers else kind, side, rng, irregularity), target


def _refuse_others(options: dict[str, Any], known: Container[str], what: str) -> None:
    """Raise ValueError for an option that has no meaning."""
    for name in options:
        if name not in known:
            raise ValueError(f"--{name.replace('_', '-')} has no meaning for {what}: leave it out")


def _described(city: City, measured: Measured) -> dict[str, Any]:
    """Collect what goes into statistics.json; what was not aimed at is null."""
    statistics = {
        name: {"realised": value, "target": None if math.isnan(target) else target}
        for name, (value, target) in measured.items()
    }
    report = city.report
    told = {} if report is None else {"import": _described_import(report)}
    return {
        "name": city.name,
        "side_m": city.side,
        "buildings": len(city.heights),
        "statistics": statistics,
        **told,
    }


def _described_import(report: ImportReport) -> dict[str, Any]:
    """Collect what an importer did, for statistics.json."""
    return {
        "file": str(report.path),
        "counts": report.counts,
        "notes": [note._asdict() for note in report.notes],
        "splits": [split._asdict() for split in report.splits],
    }


def _report_table(report: ImportReport) -> Table:
    """Lay out what an importer did: how often, and where first."""
    table = Table(title=f"what was done to read {report.path.name}")
    table.add_column("count", justify="right")
    table.add_column("what")
    table.add_column("first")
    for kind, count in report.counts.items():
        table.add_row(str(count), NOTE_KINDS[kind].meaning, ", ".join(report.first(kind)))
    if report.splits:
        excess = max(abs(one.pieces_volume / one.mesh_volume - 1) for one in report.splits)
        beyond = max(one.beyond for one in report.splits)
        table.add_row(
            str(len(report.splits)),
            f"meshes split into convex pieces: at most {excess:.2%} off in volume, "
            f"{beyond:.2g} m beyond",
            ", ".join(one.where for one in report.splits[:FIRST_SHOWN]),
        )
    return table


def _table(city: City, measured: Measured) -> Table:
    """Lay out the statistics beside their targets."""
    table = Table(
        title=f"city {city.name}, {city.side:g} m x {city.side:g} m, {len(city.heights)} buildings"
    )
    for heading, side in COLUMNS:
        table.add_column(heading, justify=side)
    for name, (value, target) in measured.items():
        table.add_row(name, f"{value:.4g}", "" if math.isnan(target) else f"{target:.4g}")
    return table
