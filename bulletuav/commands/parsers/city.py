"""Arguments of `bulletuav city`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp

ABOUT = {
    "help": "generate a city or terrain and write its map, OBJ file and statistics",
    "description": (
        "Generate a city with the statistics of ITU-R P.1410, or hills and forests, or import a "
        "city from a file. Print its statistics next to the targets. Write a map, a Wavefront OBJ "
        "file and the statistics."
    ),
    "epilog": """examples:
  bulletuav city --kind dense --seed 3 --out dense
  bulletuav city --kind urban --irregularity 1 --gamma 30 --out towers
  bulletuav city --kind wooded_hills --relief 30 --tree-density 50 --out wood
  bulletuav city --import dense/city.obj --elevation ground --out town""",
}


@DeferredHelp
def _kinds() -> str:
    from bulletuav.city.statistics import KINDS
    from bulletuav.city.terrain import TERRAINS

    return f"{', '.join((*KINDS, *TERRAINS))} (default: urban)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of generated and imported cities, and the output folder."""
    _add_generator(parser)
    _add_terrain(parser)
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
    # Statistics of the ITU-R; a kind is a preset of three of them
    parser.add_argument("--kind", help=_kinds)
    parser.add_argument(
        "--alpha", type=float, help="built-up fraction of the ground (default: that of the kind)"
    )
    parser.add_argument("--beta", type=float, help="buildings per km^2 (default: that of the kind)")
    parser.add_argument(
        "--gamma",
        type=float,
        metavar="M",
        help="mode of building heights (default: that of the kind)",
    )
    # Regularity and size
    parser.add_argument("--irregularity", type=float, help="0 (a regular grid, the default) to 1")
    parser.add_argument("--seed", type=int, help="random seed of the city (default: 0)")
    parser.add_argument(
        "--side",
        type=float,
        metavar="M",
        help="side of the square (default: 500, or as large as an import needs)",
    )


def _add_terrain(parser: argparse.ArgumentParser) -> None:
    """Add the options of terrain."""
    parser.add_argument(
        "--relief", type=float, metavar="M", help="hills: height of the highest point"
    )
    parser.add_argument(
        "--wavelength", type=float, metavar="M", help="hills: shortest distance between two"
    )
    parser.add_argument("--tree-density", type=float, help="forests: trees per hectare")
    parser.add_argument("--tree-height", type=float, metavar="M", help="forests: mean height")
    parser.add_argument("--trunk-radius", type=float, metavar="M", help="forests: radius of trunks")


def _add_import(parser: argparse.ArgumentParser) -> None:
    """Add the options of a city from a file."""
    # Flags default to None, as generated cities have no such options
    parser.add_argument(
        "--import",
        type=Path,
        dest="file",
        metavar="FILE",
        help="import footprints (GeoJSON) or meshes (OBJ) instead of generating a city",
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        default=None,
        help="fail where the import would otherwise repair, guess or skip something",
    )
    parser.add_argument(
        "--height",
        metavar="NAME",
        help="GeoJSON: name of the property with the height in m (default: height)",
    )
    parser.add_argument(
        "--default-height",
        type=float,
        metavar="M",
        help="GeoJSON: height of buildings without height and levels (default: 10)",
    )
    parser.add_argument(
        "--metres",
        action="store_true",
        default=None,
        help="GeoJSON: coordinates are metres, not degrees",
    )
    parser.add_argument("--scale", type=float, help="OBJ: metres per unit of the file (default: 1)")
    parser.add_argument("--y-up", action="store_true", default=None, help="OBJ: y points up, not z")
    parser.add_argument(
        "--elevation",
        metavar="HOW",
        help="OBJ: ground moves each building to the ground, keep leaves heights unchanged "
        "(default: auto, ground if the whole model is above the ground)",
    )
