"""`bulletuav city`: make a city, or read one, and write what it looks like."""

import argparse
import dataclasses
import inspect
import json
import math
from collections.abc import Container
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table

from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.city.imports import READERS
from bulletuav.city.maps import draw_map
from bulletuav.city.model import City
from bulletuav.city.render import render
from bulletuav.city.statistics import KINDS, Statistics, realised
from bulletuav.commands.arguments import out_folder, tell_files
from bulletuav.errors import as_int, choose
from bulletuav.files import replace_file, whole_file
from bulletuav.report.pictures import blank_figure, save_figure

ABOUT = {
    "help": "make a city and write its map, OBJ file and statistics",
    "description": (
        "Make a city with the statistics of ITU-R P.1410, or read one from a file; print what it has against what was aimed "
        "at; write a map, a Wavefront OBJ file and the statistics."
    ),
    "epilog": """examples:
  bulletuav city --kind dense --seed 3 --out dense
  bulletuav city --kind urban --irregularity 1 --gamma 30 --out towers
  bulletuav city --import footprints.geojson --default-height 9 --out home""",
}
NUMBERS = ("alpha", "beta", "gamma")
GENERATOR = {"kind", "seed", "irregularity", *NUMBERS}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What city, and where to."""
    parser.add_argument("--kind", help=f"{', '.join(KINDS)} (default: urban)")
    parser.add_argument(
        "--alpha", type=float, help="built-up share of the ground (default: the kind's)"
    )
    parser.add_argument("--beta", type=float, help="buildings per km^2 (default: the kind's)")
    parser.add_argument(
        "--gamma", type=float, metavar="M", help="most frequent height (default: the kind's)"
    )
    parser.add_argument(
        "--irregularity", type=float, help="from 0, a regular grid (the default), to 1"
    )
    parser.add_argument("--seed", type=int, help="(default: 0)")
    parser.add_argument(
        "--side",
        type=float,
        metavar="M",
        help="of the square (default: 500, or what an import needs)",
    )
    parser.add_argument(
        "--import",
        type=Path,
        dest="file",
        metavar="FILE",
        help="footprints (GeoJSON), or pieces (OBJ)",
    )
    parser.add_argument(
        "--height",
        metavar="NAME",
        help="GeoJSON: the property with the height in m (default: height)",
    )
    parser.add_argument(
        "--default-height", type=float, metavar="M", help="GeoJSON: of buildings without a height"
    )
    parser.add_argument(
        "--metres",
        action="store_true",
        default=None,
        help="GeoJSON: coordinates are no degrees but metres",
    )
    parser.add_argument(
        "--scale", type=float, help="OBJ: metres in a unit of the file (default: 1)"
    )
    parser.add_argument("--y-up", action="store_true", default=None, help="OBJ: y points up, not z")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("city"),
        metavar="DIR",
        help="folder for the files (default: city)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Make or read, print and write."""
    city, target = _city(arguments)
    measured = realised(city, target)
    out = out_folder(arguments.out)
    files = [out / "map.png", out / "city.obj", out / "statistics.json", out / "city.png"]
    figure = blank_figure(9, 8)
    draw_map(city, figure.add_subplot())
    save_figure(figure, files[0])
    with whole_file(files[3]) as part:
        Image.fromarray(render(city.solids, city.side)).save(part)
    write_obj(city, files[1])
    replace_file(files[2], json.dumps(_described(city, measured), indent=2) + "\n")
    console = Console()
    console.print(_table(city, measured))
    tell_files(console, files)


def _city(arguments: argparse.Namespace) -> tuple[City, Statistics | None]:
    """The city that was asked for, and the statistics that it aims at if it is a generated one."""
    options = {name: value for name, value in vars(arguments).items() if value is not None}
    options = {name: value for name, value in options.items() if name not in ("command", "out")}
    if file := options.pop("file", None):
        reader = choose(f"kind of file {str(file)!r} with ending", file.suffix.lower(), READERS)
        _refuse_others(options, inspect.signature(reader).parameters, f"an import of {file}")
        return reader(file, **options), None
    _refuse_others(options, GENERATOR | {"side"}, "a generated city")
    kind = options.get("kind", "urban")
    own = {name: options[name] for name in NUMBERS if name in options}
    target = dataclasses.replace(choose("kind of city", kind, KINDS), **own)
    rng = np.random.default_rng(as_int("seed", options.get("seed", 0), least=0))
    return generate(
        target if own else kind, options.get("side", 500.0), rng, options.get("irregularity", 0.0)
    ), target


def _refuse_others(options: dict[str, Any], known: Container[str], what: str) -> None:
    """Raise ValueError for an option without a meaning."""
    for name in options:
        if name not in known:
            raise ValueError(f"--{name.replace('_', '-')} has no meaning for {what}: leave it out")


def _described(city: City, measured: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """What goes into statistics.json; what was not aimed at is null."""
    told = {
        name: {"realised": value, "target": None if math.isnan(aim) else aim}
        for name, (value, aim) in measured.items()
    }
    return {
        "name": city.name,
        "side_m": city.side,
        "buildings": len(city.heights),
        "statistics": told,
    }


def _table(city: City, measured: dict[str, tuple[float, float]]) -> Table:
    table = Table(
        title=f"city {city.name}, {city.side:g} m x {city.side:g} m, {len(city.heights)} buildings"
    )
    for heading, side in (("statistic", "left"), ("realised", "right"), ("target", "right")):
        table.add_column(heading, justify=side)  # type: ignore[arg-type]
    for name, (value, aim) in measured.items():
        table.add_row(name, f"{value:.4g}", "" if math.isnan(aim) else f"{aim:.4g}")
    return table
