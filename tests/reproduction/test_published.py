"""Results that the page of reproduced tables shows: all tables, with verdicts of today's code."""

import json
import sys
from pathlib import Path

import pytest

from bulletuav.reproduction import find_reproduction, list_reproductions
from bulletuav.reproduction.table import rows_of_record

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs" / "_ext"))
import site_reproduced  # noqa: E402

OUTSIDE = {"erlang": 7, "glas": 1, "idsia": 11, "nanobench": 13}
"""Number of rows outside by table"""
RECORDS = {record["table"]: record for record in site_reproduced.records()}


def test_every_table_has_a_result_of_full_size():
    assert set(RECORDS) == set(list_reproductions())
    assert {record["size"] for record in RECORDS.values()} == {1.0}


@pytest.mark.parametrize("name", RECORDS)
def test_results_have_the_texts_and_verdicts_of_the_code(name):
    record, table = RECORDS[name], find_reproduction(name)
    for field in ("title", "publication", "address", "about", "minutes"):
        assert record[field] == getattr(table, field), field
    assert [row.verdict for row in rows_of_record(record)] == [
        row["verdict"] for row in record["rows"]
    ]
    assert table.minutes <= 60
    assert (site_reproduced.REPRODUCED / f"{name}.png").exists()
    assert "/work/" not in json.dumps(record)
    assert "/tmp/" not in json.dumps(record)


def test_the_page_has_all_tables_commands_and_pictures():
    text = site_reproduced.page()
    for name, record in RECORDS.items():
        assert f"## {record['title']}\n" in text
        assert f"bulletuav reproduce {name}" in text
        assert f"(../results/reproduced/{name}.png)" in text
        assert f"(#{site_reproduced.anchor(record['title'])})" in text


def test_numbers_that_differ_without_a_known_reason_are_listed():
    """The notes of their tables state what was tried."""
    counts = {
        name: sum(row.verdict == "outside" for row in rows_of_record(record))
        for name, record in RECORDS.items()
    }
    assert {name: count for name, count in counts.items() if count} == OUTSIDE
