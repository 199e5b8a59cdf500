"""Output of commands on standard output: tables, texts, and lists of written files."""

import shutil
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

PADDING = 2
"""Width of the padding of a cell, in characters"""

MIN_TEXT_WIDTH, MAX_TEXT_WIDTH = 40, 100
"""Minimum and maximum width of wrapped text; narrower terminals wrap it themselves"""


def print_table(table: Table) -> None:
    """Print a table without truncating words, whatever the width of the terminal.

    Cells are wrapped between words. If the table still does not fit, each row is printed as lines
    of the form `heading: cell`.

    Args:
        table: The table. Its cells are plain text, without rich's markup, or `rich.text.Text`.
    """
    console = Console()
    headings = [str(column.header) for column in table.columns]
    rows = [
        [cell if isinstance(cell, Text) else Text(str(cell)) for cell in row]
        for row in zip(*(column.cells for column in table.columns), strict=True)
    ]
    if table.title:
        print(table.title)
    texts = [[cell.plain for cell in row] for row in rows]
    num_edges = 0 if table.box is None else len(headings) + 1
    widths = _column_widths(
        [headings if table.show_header else [""] * len(headings), *texts],
        console.width - PADDING * len(headings) - num_edges,
    )
    if widths is None:
        print("\n".join(_lines(headings if table.show_header else [], texts)))
    else:
        console.print(_grid(table, rows, widths))
    if table.caption:
        print(table.caption)


def _column_widths(rows: Sequence[Sequence[str]], total_width: int) -> list[int] | None:
    """Distribute the width of a terminal over the columns of a table.

    Args:
        rows: Texts of all cells, including headings.
        total_width: Total width of all columns.

    Returns:
        The width of each column, at least that of its longest word; None if the columns do not fit.
    """
    columns = list(zip(*rows, strict=True))
    needed = [max(_longest(text.split()) for text in column) for column in columns]
    widths = [max(_longest(text.splitlines()) for text in column) for column in columns]
    if sum(needed) > total_width:
        return None
    # Narrow the widest column that is not at its minimum
    while sum(widths) > total_width:
        slack = [width if width > need else 0 for width, need in zip(widths, needed, strict=True)]
        widths[slack.index(max(slack))] -= 1
    return widths


def _longest(texts: Iterable[str]) -> int:
    """Return the width of the widest text; 0 if there are none."""
    return max(map(cell_len, texts), default=0)


def _grid(table: Table, rows: Sequence[Sequence[Text]], widths: Sequence[int]) -> Table:
    """Return a table with columns of the given widths."""
    edges = box.HEAVY_HEAD if table.show_header else box.SQUARE
    grid = Table(
        box=None if table.box is None else edges,
        show_header=table.show_header,
        show_lines=table.show_lines,
    )
    for column, width in zip(table.columns, widths, strict=True):
        grid.add_column(Text(str(column.header)), justify=column.justify, width=width)
    for row in rows:
        grid.add_row(*row)
    return grid


def _lines(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterable[str]:
    """Yield each row as lines of the form `heading: cell`, or as one line without headings."""
    for row in rows:
        first, *others = (" ".join(text.split()) for text in row)
        if not headings:
            yield f"{first}: {'; '.join(filter(None, others))}"
            continue
        yield f"{headings[0]}: {first}"
        pairs = zip(headings[1:], others, strict=True)
        yield from (f"  {heading}: {text}" for heading, text in pairs if text)


def print_text(text: str) -> None:
    """Print a text, wrapped to the width of the terminal; list items stay separate lines."""
    width = min(max(shutil.get_terminal_size().columns, MIN_TEXT_WIDTH), MAX_TEXT_WIDTH)
    for line in text.replace("\n  ", " ").splitlines():
        print(textwrap.fill(line, width, subsequent_indent="  ", break_on_hyphens=False))


def print_files(files: Iterable[Path]) -> None:
    """Print the paths of written files."""
    print("\n".join(f"wrote {path}" for path in files))
