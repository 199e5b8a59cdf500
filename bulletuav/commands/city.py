"""`bulletuav city`: generate or import a city, and write its map, mesh and statistics."""

import argparse
import dataclasses
import inspect
import json
import math
import warnings
from collections.abc import Container
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
from bulletuav.city.terrain import (
    TERRAINS,
    Terrain,
    find_terrain,
    generate_terrain,
    measure_terrain,
)
from bulletuav.commands.arguments import make_out_folder
from bulletuav.commands.output import print_files, print_table
from bulletuav.errors import as_int, find_choice
from bulletuav.files import replace_file, whole_file
from bulletuav.report.pictures import blank_figure, save_figure

NUMBERS = ("alpha", "beta", "gamma")
GENERATOR = {"kind", "seed", "irregularity", "side", *NUMBERS}
"""Options of generated cities"""
TERRAIN = {"kind", "seed", "side"} | {field.name for field in dataclasses.fields(Terrain)}
"""Options of terrain"""
COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("statistic", "left"),
    ("realised", "right"),
    ("target", "right"),
)
Measured = dict[str, tuple[float, float]]
"""Value and target of each statistic; the target is NaN if there is none"""


def run(arguments: argparse.Namespace) -> None:
    """Generate or import a city, print its statistics and write the files."""
    city, target = _city(arguments)
    measured = _measured(city, target)
    out = make_out_folder(arguments.out)
    files = [out / "map.png", out / "city.obj", out / "statistics.json", out / "city.png"]
    map_file, obj_file, statistics_file, picture_file = files

    # Pictures and the OBJ file first, then the statistics
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


def _measured(city: City, target: Statistics | None) -> Measured:
    """Measure a city or terrain."""
    if city.is_terrain:
        return {name: (value, math.nan) for name, value in measure_terrain(city).items()}
    return realised(city, target)


def _city(arguments: argparse.Namespace) -> tuple[City, Statistics | None]:
    """Return the city and, if it is a generated one, its target statistics."""
    options = {
        name: value
        for name, value in vars(arguments).items()
        if value is not None and name not in ("command", "out")
    }
    file = options.pop("file", None)
    if file is None and options.get("kind") in TERRAINS:
        return _terrain(options), None
    if file is None:
        return _generated(options)
    # The extension selects the importer, whose parameters are the valid options
    reader = find_choice(f"kind of file {str(file)!r} with ending", file.suffix.lower(), READERS)
    _refuse_others(options, inspect.signature(reader).parameters, f"an import of {file}")
    # The report is printed as a table, so its one-line warning is not needed
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return reader(file, **options), None


def _generated(options: dict[str, Any]) -> tuple[City, Statistics]:
    """Return a generated city and its target statistics."""
    _refuse_others(options, GENERATOR, "a generated city")
    kind = options.get("kind", "urban")
    numbers = {name: options[name] for name in NUMBERS if name in options}
    find_choice("kind of city", kind, {**KINDS, **TERRAINS})
    target = dataclasses.replace(KINDS[kind], **numbers)
    side = options.get("side", 500.0)
    irregularity = options.get("irregularity", 0.0)
    rng = np.random.default_rng(as_int("seed", options.get("seed", 0), least=0))
    # An unchanged kind is passed by name, which becomes the name of the city
    return generate(target if numbers else kind, side, rng, irregularity), target


def _terrain(options: dict[str, Any]) -> City:
    """Return generated terrain."""
    kind = options.pop("kind")
    _refuse_others(options, TERRAIN, f"terrain such as {kind}")
    rng = np.random.default_rng(as_int("seed", options.pop("seed", 0), least=0))
    side = options.pop("side", 500.0)
    # An unchanged kind is passed by name, which becomes the name of the city
    terrain = find_terrain(kind, options) if options else kind
    return generate_terrain(terrain, side, rng)


def _refuse_others(options: dict[str, Any], known: Container[str], what: str) -> None:
    """Raise ValueError for an option that does not apply."""
    for name in options:
        if name not in known:
            raise ValueError(f"--{name.replace('_', '-')} has no meaning for {what}: leave it out")


def _described(city: City, measured: Measured) -> dict[str, Any]:
    """Return the contents of statistics.json; targets that do not exist are null."""
    statistics = {
        name: {"realised": value, "target": None if math.isnan(target) else target}
        for name, (value, target) in measured.items()
    }
    report = city.report
    extra = {} if report is None else {"import": _described_import(report)}
    return {
        "name": city.name,
        "side_m": city.side,
        _buildings(city): len(city.heights),
        "statistics": statistics,
        **extra,
    }


def _buildings(city: City) -> str:
    return "trees" if city.is_terrain else "buildings"


def _described_import(report: ImportReport) -> dict[str, Any]:
    """Return the import report for statistics.json."""
    return {
        "file": str(report.path),
        "counts": report.counts,
        "others": report.others,
        "notes": [note._asdict() for note in report.notes],
        "splits": [split._asdict() for split in report.splits],
    }


def _report_table(report: ImportReport) -> Table:
    """Return a table of the notes of an import: their number and first locations."""
    table = Table(title=f"changes on import of {report.path.name}")
    table.add_column("count", justify="right")
    table.add_column("change")
    table.add_column("first locations")
    for kind, count in report.counts.items():
        meaning = NOTE_KINDS[kind].meaning
        if kind == "other":
            meaning += ": " + ", ".join(f"{of} {name}" for name, of in report.others.items())
        table.add_row(str(count), meaning, ", ".join(report.first(kind)))
    if report.splits:
        excess = max(abs(one.pieces_volume / one.mesh_volume - 1) for one in report.splits)
        beyond = max(one.beyond for one in report.splits)
        table.add_row(
            str(len(report.splits)),
            f"meshes split into convex pieces: at most {excess:.2%} error in volume, "
            f"at most {beyond:.2g} m outside the mesh",
            ", ".join(one.where for one in report.splits[:FIRST_SHOWN]),
        )
    return table


def _table(city: City, measured: Measured) -> Table:
    """Return a table of the statistics and their targets."""
    table = Table(
        title=f"{'terrain' if city.is_terrain else 'city'} {city.name}, "
        f"{city.side:g} m x {city.side:g} m, {len(city.heights)} {_buildings(city)}"
    )
    for heading, side in COLUMNS:
        table.add_column(heading, justify=side)
    for name, (value, target) in measured.items():
        table.add_row(name, f"{value:.4g}", "" if math.isnan(target) else f"{target:.4g}")
    return table
