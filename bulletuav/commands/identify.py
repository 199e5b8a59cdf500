"""`bulletuav identify`: identify constants of an airframe from flight logs."""

import argparse

from rich.console import JustifyMethod
from rich.table import Table

from bulletuav.commands.arguments import make_out_folder
from bulletuav.commands.output import print_files, print_table
from bulletuav.commands.parsers.identify import EXAMPLE_SECONDS
from bulletuav.commands.progress import show_progress
from bulletuav.identification.curves import make_curves
from bulletuav.identification.example import add_sensor_noise, fly_example, write_example_log
from bulletuav.identification.identify import WINDOW, Identification, Prediction, identify
from bulletuav.identification.intervals import LEVEL
from bulletuav.identification.logs import Log
from bulletuav.identification.write import (
    KINDS,
    MEASURES,
    compute_rms,
    summarize,
    write_report,
    write_urdf,
)
from bulletuav.report.identification import plot_identification
from bulletuav.vehicle.airframes import load_airframe

COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("constant", "left"),
    ("before", "right"),
    ("after", "right"),
    (f"{100 * LEVEL:.0f} % interval", "right"),
)
CLOCK_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("log", "left"),
    ("quantity", "left"),
    ("delay", "right"),
    (f"{100 * LEVEL:.0f} % interval", "right"),
)
MAX_LISTED = 20
"""Maximum number of unused columns that are printed for a log"""


def run(arguments: argparse.Namespace) -> None:
    """Fit constants, print and write them; or write an example log."""
    if (arguments.example is None) != bool(arguments.logs):
        raise ValueError("identify what? Give either flight logs or --example FILE")
    if arguments.example is not None:
        if arguments.measured:
            raise ValueError("--measured has no effect with --example: the example has commands")
        if arguments.clocks:
            raise ValueError("--clocks has no effect with --example: the example has one clock")
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
            window=WINDOW if arguments.window is None else arguments.window,
            measured=arguments.measured,
            clocks=arguments.clocks,
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
    if result.clocks:
        print_table(_clocks(result))
    print_table(_errors(result))
    for log in {one.part.flight.log.path: one.part.flight.log for one in _all(result)}.values():
        print(describe_unused(log))
    if result.note:
        print(result.note)
    print_files(files)


def _all(result: Identification) -> list[Prediction]:
    """Return the predictions of all logs."""
    return [*result.fitted, *result.kept]


def describe_unused(log: Log) -> str:
    """Return a line on the columns of a log that are used and not used."""
    topics: dict[str, list[str]] = {}
    for name, source in log.used.items():
        if name != source:
            topics.setdefault(source.partition(".")[0], []).append(name)
    read = "; ".join(f"{', '.join(names)} from {topic}" for topic, names in topics.items())
    text = f"{log.path.name}: " + (f"{read}; " if read else "")
    names, rest = log.unused[:MAX_LISTED], len(log.unused) - MAX_LISTED
    more = f" and {rest} more, see the report" if rest > 0 else ""
    return text + (f"not used: {', '.join(names)}{more}" if names else "all columns are used")


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


def _clocks(result: Identification) -> Table:
    """Return a table of the clock offsets of the fitted logs."""
    table = Table(title="Delays behind the attitude, ms")
    for heading, side in CLOCK_COLUMNS:
        table.add_column(heading, justify=side)
    for one in result.clocks:
        delay, low, high = (f"{1e3 * time:.2f}" for time in (one.delay, one.low, one.high))
        table.add_row(one.log, one.quantity, delay, f"{low} to {high}")
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
