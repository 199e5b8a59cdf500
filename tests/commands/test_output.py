"""Tables of commands lose nothing, however narrow the terminal is."""

import importlib
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import flown
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from bulletuav.cli import COMMANDS, main
from bulletuav.commands import output
from bulletuav.commands.output import print_table
from bulletuav.policies.run import shipped
from bulletuav.vehicle.airframes import load_airframe

FRAME = str.maketrans(dict.fromkeys("│┃┏━┳┓┡╇┩└─┴┘┌┬┐├┼┤:;", " "))
POINTS = ["--dynamics", "point_mass", "--horizon", "2"]
RUNS = {
    "benchmark": [["benchmark", "--drones", "1", "3", "--seconds", "0.001"]],
    "city": [["city", "--side", "200"]],
    "convert": [["convert", "--example", "a.urdf"], ["convert", "a.urdf", "--out", "b.urdf"]],
    "doctor": [["doctor"]],
    "evaluate": [["evaluate", "hover", *POINTS, "--episodes", "1"]],
    "fly": [["fly", "crossing", *POINTS, "--animation", "none"]],
    "identify": [["identify", "log.csv", "--airframe", "cf2x", "--fit", "drag_xy"]],
    "reproduce": [["reproduce"], ["reproduce", "erlang"]],
    "tasks": [
        ["tasks", "crossing"],
        ["tasks", "crossing", "--all"],
        ["tasks", "crossing", "--observation"],
    ],
    "verify": [["fly", "hover", *POINTS, "--animation", "none"], ["verify", "out"]],
}
"""Calls by which each command prints its tables"""
MODULES = {name: f"bulletuav.commands.{name}" for name in COMMANDS}
MODULES["tasks"] = "bulletuav.commands.task_description"
WITH_TABLES = [
    name
    for name, module in MODULES.items()
    if hasattr(importlib.import_module(module), "print_table")
]


def words(table):
    """All words of a table, with how often they occur; headings once."""
    cells = [str(cell) for column in table.columns for cell in column.cells]
    cells += [str(column.header) for column in table.columns if any(map(str, column.cells))]
    return Counter(" ".join(cells).translate(FRAME).split())


def assert_whole(table, monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", columns)
    print_table(table)
    said = capsys.readouterr().out
    assert "…" not in said
    assert not words(table) - Counter(said.translate(FRAME).split())
    lines = [line for line in said.splitlines() if line[:1] in "│┃┏└┌"]
    if columns.isdigit():
        assert all(len(line) <= int(columns) for line in lines)


@pytest.mark.parametrize("name", WITH_TABLES)
def test_no_command_loses_columns_or_digits(name, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    if name == "identify":
        rows = flown.fly_example(load_airframe("cf2x"), 12, seed=0)
        flown.write_example_log("log.csv", flown.add_sensor_noise(rows, 0))
    tables = []
    monkeypatch.setattr(f"{MODULES[name]}.print_table", tables.append)
    for arguments in RUNS[name]:
        main(arguments)
    assert tables
    capsys.readouterr()
    for columns in ("40", "60", "80", "120", "0", "1", "-5", "odd", ""):
        for table in tables:
            assert_whole(table, monkeypatch, capsys, columns)
    # In a pipe there is no width at all
    monkeypatch.delenv("COLUMNS")
    for table in tables:
        print_table(table)
        assert not words(table) - Counter(capsys.readouterr().out.translate(FRAME).split())


@given(
    st.lists(st.lists(st.text("ab 1[]/\n", max_size=30), min_size=3, max_size=3), max_size=4),
    st.integers(0, 130),
    st.booleans(),
)
def test_no_table_loses_words(rows, columns, with_headings):
    """With what rich takes for markup among them."""
    table = Table(show_header=with_headings)
    for heading in ("first one", "[second]", "third"):
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr("builtins.print", lambda text: said.append(text))
        patch.setattr(output, "Console", lambda: Wide(columns, said))
        print_table(table)
    shown = Counter(" ".join(said).translate(FRAME).split())
    expected = Counter(" ".join(cell for row in rows for cell in row).split())
    assert not expected - shown


class Wide(output.Console):
    """A console of some width that keeps what is printed."""

    def __init__(self, columns, said):
        super().__init__(width=columns)
        self._said = said

    def print(self, table):
        with self.capture() as capture:
            super().print(table)
        self._said.append(capture.get())


def test_only_one_file_prints_tables():
    """Tables that are printed otherwise would be cut."""
    folder = output.Path(output.__file__).parent
    own = {"output.py", "progress.py"}
    texts = {path.name: path.read_text() for path in folder.glob("*.py")}
    assert {name for name, text in texts.items() if "rich.console import C" in text} == own


def test_files_are_utf_8_in_every_locale(tmp_path):
    """Also where Python would take another encoding for files, as on Windows."""
    command = ["fly", "hover", "--dynamics", "point_mass", "--horizon", "2", "--animation", "none"]
    subprocess.run(
        [sys.executable, "-X", "utf8=0", "-m", "bulletuav", *command, "--html", "--out", "flight"],
        env={**os.environ, "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"},
        cwd=tmp_path,
        check=True,
    )
    assert "</html>" in (tmp_path / "flight" / "replay.html").read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names of files")
def test_names_of_files_may_be_no_utf_8(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    own = os.fsdecode(b"own\xff")
    shutil.copytree(shipped("crossing"), own)
    command = ["evaluate", "crossing", "--policy", own, "--horizon", "2", "--episodes", "1"]
    main([*command, "--dynamics", "point_mass", "--drones", "2", "--out", os.fsdecode(b"out\xff")])
    assert Path(os.fsdecode(b"out\xff"), "summary.png").stat().st_size
    capsys.readouterr()
    shutil.copy(load_airframe("cf2x").urdf, f"{own}.urdf")
    with pytest.raises(ValueError, match="bytes in its path that are no UTF-8"):
        load_airframe(f"{own}.urdf")
