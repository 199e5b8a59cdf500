"""`bulletuav reproduce`: compute published tables again."""

import argparse

from rich.table import Table

from bulletuav.commands.arguments import make_out_folder
from bulletuav.commands.output import print_files, print_table, print_text
from bulletuav.commands.progress import show_progress
from bulletuav.reproduction import find_reproduction, list_reproductions
from bulletuav.reproduction.table import (
    HEADINGS,
    Settings,
    format_cells,
    record_outcome,
    write_outcome,
)


def run(arguments: argparse.Namespace) -> None:
    """List the tables; or compute one, print it and write its files."""
    if arguments.table is None:
        print_table(_overview())
        return
    table = find_reproduction(arguments.table)
    if not 0.0 < arguments.size <= 1.0:
        raise ValueError(f"--size {arguments.size:g}: a fraction above 0 and up to 1 is needed")
    if arguments.workers < 1:
        raise ValueError(f"--workers {arguments.workers}: 1 or more are needed")
    if table.data is not None:
        table.data.find(arguments.data, arguments.table)
    elif arguments.data is not None:
        raise ValueError(f"--data {arguments.data}: {arguments.table} needs no data")
    out = make_out_folder(arguments.out)
    with show_progress("reproducing", 100, "%") as report:
        outcome = table.compute(
            Settings(
                arguments.size,
                arguments.data,
                arguments.workers,
                lambda fraction: report(100 * fraction),
            )
        )
    record = record_outcome(arguments.table, table, outcome, arguments.size)
    printed = Table(title=f"{table.title} ({table.publication})")
    for heading in HEADINGS:
        numeric = heading in ("published", "bulletuav", "95 % interval")
        printed.add_column(heading, justify="right" if numeric else "left")
    for row in outcome.rows:
        printed.add_row(*format_cells(row))
    print_table(printed)
    for row in outcome.rows:
        if row.verdict == "explained":
            print_text(f"{row.name}: {row.why}")
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
