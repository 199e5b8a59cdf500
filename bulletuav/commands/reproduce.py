"""`bulletuav reproduce`: compute published tables again."""

import argparse

from rich.table import Table

from bulletuav.commands.arguments import make_out_folder
from bulletuav.commands.output import print_files, print_table, print_text
from bulletuav.commands.parsers.reproduce import DEFAULT_OUT
from bulletuav.commands.progress import show_progress
from bulletuav.reproduction import find_reproduction, list_reproductions
from bulletuav.reproduction.table import (
    HEADINGS,
    Settings,
    format_cells,
    list_reasons,
    record_outcome,
    write_outcome,
)


def run(arguments: argparse.Namespace) -> None:
    """List the tables; or compute one, print it and write its files."""
    given = {
        name: value
        for name in ("data", "size", "workers", "out")
        if (value := getattr(arguments, name)) is not None
    }
    if arguments.table is None:
        if given:
            raise ValueError(
                f"--{min(given)} needs the name of a table: {', '.join(list_reproductions())}"
            )
        print_table(_overview())
        return
    table = find_reproduction(arguments.table)
    out = make_out_folder(given.pop("out", DEFAULT_OUT))
    with show_progress("reproducing", 100, "%") as report:
        settings = Settings(**given, progress=lambda fraction: report(100 * fraction))
        outcome = table.reproduce(arguments.table, settings)
    record = record_outcome(arguments.table, table, outcome, settings.size)
    size = "" if settings.size == 1.0 else f", {settings.size:g} of the full size"
    printed = Table(title=f"{table.title} ({table.publication}){size}")
    for heading in HEADINGS:
        numeric = heading in ("published", "bulletuav", "95 % interval")
        printed.add_column(heading, justify="right" if numeric else "left")
    for row in outcome.rows:
        printed.add_row(*format_cells(row))
    print_table(printed)
    for reason in list_reasons(outcome.rows):
        print_text(reason)
    if settings.size < 1.0:
        print_text(
            f"Computed at {settings.size:g} of the full size: intervals are wider, and verdicts "
            "can differ from those of the full size."
        )
    for note in outcome.notes:
        print_text(note)
    print_files(write_outcome(record, outcome.figure, out))


def _overview() -> Table:
    """Return a table of all published tables."""
    overview = Table(title="published tables: bulletuav reproduce NAME")
    for heading in ("name", "title", "minutes", "data"):
        overview.add_column(heading, justify="right" if heading == "minutes" else "left")
    for name in list_reproductions():
        table = find_reproduction(name)
        data = "" if table.data is None else table.data.repository
        overview.add_row(name, table.title, f"{table.minutes:g}", data)
    return overview
