"""`bulletuav identify`: identify constants of an airframe from flight logs."""

import argparse
from pathlib import Path

from rich.console import JustifyMethod
from rich.table import Table

from bulletuav.commands.arguments import make_out_folder
from bulletuav.commands.output import print_files, print_table
from bulletuav.commands.progress import show_progress
from bulletuav.identification.constants import BATTERY, CONSTANTS, GROUPS
from bulletuav.identification.curves import make_curves
from bulletuav.identification.example import add_sensor_noise, fly_example, write_example_log
from bulletuav.identification.identify import WINDOW, Identification, identify
from bulletuav.identification.intervals import LEVEL
from bulletuav.identification.logs import FACTORS
from bulletuav.identification.write import (
    KINDS,
    MEASURES,
    compute_rms,
    summarize,
    write_report,
    write_urdf,
)
from bulletuav.report.identification import plot_identification
from bulletuav.vehicle.airframes import available_airframes, load_airframe

ABOUT = {
    "help": "fit an airframe's constants to flight logs and write its URDF",
    "description": (
        "Fit constants of an airframe to flight logs. Print them with 95 % intervals, and the "
        "errors of predictions of held-out data. Write a URDF, a report and a picture."
    ),
    "epilog": """examples:
  bulletuav identify --example flight.csv --airframe cf2x
  bulletuav identify flight.csv --airframe cf2x --out fitted
  bulletuav identify flight.csv --airframe cf2x --fit thrust,drag,lag --mass 0.0312""",
}
EXAMPLE_SECONDS = 20.0
"""Duration of the example flight, s"""
COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("constant", "left"),
    ("before", "right"),
    ("after", "right"),
    (f"{100 * LEVEL:.0f} % interval", "right"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add logs, airframe, constants to fit, and output folder."""
    # Data: logs and airframe
    parser.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG", help="CSV files with named columns"
    )
    parser.add_argument(
        "--example",
        type=Path,
        metavar="FILE",
        help=f"only write the log of a simulated flight of {EXAMPLE_SECONDS:g} s, as an example of "
        "the format of logs",
    )
    parser.add_argument(
        "--airframe",
        required=True,
        help=f"airframe of the logs: {', '.join(available_airframes())}, or the path of a URDF",
    )
    parser.add_argument(
        "--fit",
        default="",
        metavar="A,B",
        help=(
            f"groups ({', '.join((*GROUPS, BATTERY))}) or constants "
            f"({', '.join(constant.name for constant in CONSTANTS)}) (default: all identifiable)"
        ),
    )
    parser.add_argument(
        "--map",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=COLUMN[*FACTOR][+OFFSET]",
        help=(
            f"column of a quantity, if its name or unit differs; a factor is a number or one of "
            f"{', '.join(FACTORS)}, with a minus sign for a reversed axis, such as t=time*ms "
            f"q=gyro_y*-deg z=altitude*mm-0.03"
        ),
    )
    parser.add_argument(
        "--mass", type=float, metavar="KG", help="take-off mass (default: that of the airframe)"
    )
    parser.add_argument(
        "--window",
        type=float,
        default=WINDOW,
        metavar="S",
        help=f"duration of the predicted windows (default: {WINDOW:g})",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("identified"),
        metavar="DIR",
        help="folder for the files (default: identified)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Fit constants, print and write them; or write an example log."""
    if (arguments.example is None) != bool(arguments.logs):
        raise ValueError("identify what? Give either flight logs or --example FILE")
    if arguments.example is not None:
        rows = fly_example(load_airframe(arguments.airframe), EXAMPLE_SECONDS, seed=0)
        print_files([write_example_log(arguments.example, add_sensor_noise(rows, seed=0))])
        return
    # Without names, all identifiable constants are fitted
    names = [name.strip() for name in arguments.fit.split(",") if name.strip()]
    with show_progress("fitting", 100, "%") as report:
        result = identify(
            arguments.logs,
            arguments.airframe,
            fit=names,
            columns=arguments.map,
            mass=arguments.mass,
            window=arguments.window,
            progress=lambda share: report(100 * share),
        )
    # Plot the prediction of the longest held-out flight
    out = make_out_folder(arguments.out)
    picture = out / "prediction.png"
    shown = max(result.kept, key=lambda one: len(one.part.windows))
    title = f"{result.before.name}: {shown.part.flight.log.path.name}, held out"
    plot_identification(make_curves(shown), title, picture)
    files = [write_urdf(result, out), *write_report(result, out), picture]
    # Constants, errors before and after, and where the files are
    print_table(_constants(result))
    print_table(_errors(result))
    if result.note:
        print(result.note)
    print_files(files)


def _constants(result: Identification) -> Table:
    """Return a table of the constants before and after the fit."""
    table = Table(title=f"{result.before.name}, mass {result.airframe.mass:g} kg; SI units")
    for heading, side in COLUMNS:
        table.add_column(heading, justify=side)
    for name, row in summarize(result)["constants"].items():
        interval = f"{row['low']:.4g} to {row['high']:.4g}" if row["told"] else "not identifiable"
        after = f"{row['after']:.5g}" if row["told"] else "unchanged"
        table.add_row(name, f"{row['before']:.5g}", after, interval)
    return table


def _errors(result: Identification) -> Table:
    """Return a table of the prediction errors of held-out data."""
    kept = "logs" if result.whole_logs else "halves of the logs"
    table = Table(title=f"RMS prediction errors of held-out {kept}")
    table.add_column("error")
    for kind in KINDS:
        table.add_column(kind, justify="right")
    values = [compute_rms(result.kept, kind) for kind in KINDS]
    for (name, *_), *row in zip(MEASURES, *values, strict=True):
        table.add_row(name, *(f"{value:.4g}" for value in row))
    return table
