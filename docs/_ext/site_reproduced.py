"""Sphinx extension: write the page of reproduced tables from the results of `bulletuav reproduce`.

The page is not kept in the repository. `python docs/_ext/site_reproduced.py` writes it without
building the site.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

from site_reference import RESULTS, ROOT, rows_table

from bulletuav.reproduction.table import (
    HEADINGS,
    VERDICTS,
    format_cells,
    list_reasons,
    rows_of_record,
)

REPRODUCED = RESULTS / "reproduced"
MAX_ROWS = 40
"""Maximum number of rows of a table of which all are on the page"""
PAGE = ROOT / "docs" / "benchmarks" / "reproduced.md"
INTRODUCTION = """# Reproduced tables

Numbers that others published, and the same numbers of bulletuav. `bulletuav reproduce` lists the
tables; `bulletuav reproduce NAME` computes one of them, and writes its numbers and its picture.
Repeated calls give the same numbers; fits by least squares can differ between processors in their
last digits. This page is generated from the results.

- **within**: the published number lies in the 95 % interval of ours, or differs by no more than the
  digits of the published number or the error of reading its curve.
- **better**: ours is better than that.
- **explained**: ours is worse or different, and the reason is stated.
- **outside**: ours is worse or different, and the reason is unknown.
- **not comparable**: the published number is of another quantity, or of a method that knows more or
  less.
- **unpublished**: there is no published number to compare with."""


def records() -> list[dict[str, Any]]:
    """Read the results, sorted by name."""
    return [
        json.loads(path.read_text(encoding="utf-8")) for path in sorted(REPRODUCED.glob("*.json"))
    ]


def page() -> str:
    """Write the page."""
    found = records()
    rows = []
    for record in found:
        counts = Counter(row.verdict for row in rows_of_record(record))
        numbers = [counts[verdict] or "" for verdict in VERDICTS]
        rows.append([f"[{record['table']}](#{anchor(record['title'])})", record["title"], *numbers])
    parts = [INTRODUCTION, rows_table(("name", "table", *VERDICTS), rows)]
    for record in found:
        parts += sections(record)
    return "\n\n".join(parts)


def anchor(title: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST compute it."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def sections(record: dict[str, Any]) -> Iterator[str]:
    """Write the section of a table: publication, command, numbers, explanations, picture."""
    name, data, rows = record["table"], record["data"], rows_of_record(record)
    yield f"## {record['title']}"
    # Parentheses would end the link
    address = record["address"].replace("(", "%28").replace(")", "%29")
    yield f"[{record['publication']}]({address})"
    yield record["about"]
    command = f"bulletuav reproduce {name}"
    if data is not None:
        yield f"Data: <{data['repository']}>, licence: {data['licence']}."
        folder = data["repository"].rstrip("/").rpartition("/")[2]
        command = (
            f"git clone {data['repository']}\ngit -C {folder} checkout {data['commit']}\n"
            f"{command} --data {folder}"
        )
    size = "" if record["size"] == 1.0 else f" at {record['size']:g} of the full size"
    yield f"About {record['minutes']:g} minutes on two cores{size}:\n\n```sh\n{command}\n```"
    shown = [row for row in rows if len(rows) <= MAX_ROWS or row.verdict != "within"]
    if shown:
        yield rows_table(HEADINGS, [format_cells(row) for row in shown])
    if len(shown) < len(rows):
        also = "Further" if shown else "All"
        yield (
            f"{also} {len(rows) - len(shown)} numbers are within: they are in "
            f"[{name}.json](../results/reproduced/{name}.json), and the command prints them."
        )
    for sentence in [*list_reasons(rows), *record["notes"]]:
        yield f"- {sentence}"
    yield f"![{record['title']}](../results/reproduced/{name}.png)"


def write(*_: Any) -> None:
    """Write the page if it has changed."""
    text = page().rstrip() + "\n"
    if not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text:
        PAGE.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    write()
