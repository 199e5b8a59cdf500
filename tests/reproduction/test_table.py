"""Rows of reproduced tables, their verdicts, their files, and the command."""

import json
import subprocess
from dataclasses import replace

import pytest

from bulletuav.cli import main
from bulletuav.report.figures import blank_figure
from bulletuav.reproduction import find_reproduction, list_reproductions
from bulletuav.reproduction.table import (
    VERDICTS,
    Data,
    Reproduction,
    Row,
    Settings,
    TableOutcome,
    format_cells,
    record_outcome,
    rows_of_record,
    write_outcome,
)

DATA = Data("https://example.org/them/flights", "0123abc", "MIT", "data/flights.csv")


def make_table(**changes):
    """A table of one exact row."""

    def compute(settings):
        return TableOutcome(
            [Row("answer", 42.0, 42.0)], blank_figure(2, 2), ["note"], {"fit": [1.0]}
        )

    values = {"title": "Answers", "publication": "them, 1979", "address": "https://example.org"}
    values |= {"about": "An answer.", "minutes": 1.0, "compute": compute}
    return Reproduction(**{**values, **changes})


@pytest.mark.parametrize(
    ("row", "verdict"),
    [
        (Row("exact", 1.0, 1.0), "within"),
        (Row("rounded", 1.004, 1.0, tolerance=0.005), "within"),
        (Row("rounded", 1.006, 1.0, tolerance=0.005), "outside"),
        (Row("interval", 1.2, 1.0, low=0.9, high=1.5), "within"),
        (Row("interval", 1.2, 1.0, low=1.1, high=1.5), "outside"),
        (Row("interval and digits", 1.2, 1.0, low=1.1, high=1.5, tolerance=0.1), "within"),
        (Row("error", 0.8, 1.0, goal="lower"), "better"),
        (Row("error", 0.8, 1.0, low=0.5, high=1.1, goal="lower"), "within"),
        (Row("error", 1.2, 1.0, goal="lower"), "outside"),
        (Row("success", 1.2, 1.0, goal="higher"), "better"),
        (Row("success", 0.8, 1.0, goal="higher"), "outside"),
        (Row("success", 0.8, 1.0, goal="higher", why="other rooms"), "explained"),
        (Row("error", 0.8, 1.0, goal="lower", why="not needed"), "better"),
        (Row("equal has no better", 0.8, 1.0), "outside"),
        (Row("again", 1.2, 1.0, low=0.9, high=1.5, is_exact=True), "outside"),
        (Row("again", 1.0, 1.0, low=0.9, high=1.5, is_exact=True), "within"),
        (Row("first", 0.8), "unpublished"),
        (Row("force", 0.8, 1.0, goal="lower", is_comparable=False), "not comparable"),
        (Row("force", 1.0, 1.0, is_comparable=False), "not comparable"),
        (Row("broken", float("nan"), 1.0, goal="lower"), "outside"),
    ],
)
def test_verdicts(row, verdict):
    assert row.verdict == verdict
    assert verdict in VERDICTS


def test_names_of_tables_are_those_of_files():
    assert "erlang" in list_reproductions()
    assert find_reproduction("erlang").title
    with pytest.raises(ValueError, match="'erlagn'.*did you mean 'erlang'"):
        find_reproduction("erlagn")


@pytest.mark.parametrize(
    ("changes", "settings", "error", "message"),
    [
        ({}, {"size": 0.0}, ValueError, "size 0 of answers: a fraction above 0"),
        ({}, {"size": 1.5}, ValueError, "up to 1"),
        ({}, {"size": float("nan")}, ValueError, "size nan"),
        ({"is_scalable": False}, {"size": 0.5}, ValueError, "no smaller size"),
        ({}, {"workers": 0}, ValueError, "0 workers"),
        ({}, {"workers": 2}, ValueError, "runs in one process"),
        ({}, {"data": "FOLDER"}, ValueError, "needs no data"),
        ({"data": DATA}, {}, ValueError, "git -C flights checkout 0123abc"),
        ({"data": DATA}, {"data": "FOLDER"}, FileNotFoundError, "no data/flights.csv: fetch"),
    ],
)
def test_settings_without_effect_are_errors(changes, settings, error, message, tmp_path):
    if "data" in settings:
        settings = {"data": tmp_path}
    with pytest.raises(error, match=message):
        make_table(**changes).reproduce("answers", Settings(**settings))


def test_a_table_with_its_data_is_computed(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "flights.csv").write_text("t\n0\n")
    outcome = make_table(data=DATA).reproduce("answers", Settings(data=tmp_path))
    assert [row.verdict for row in outcome.rows] == ["within"]


def test_a_clone_at_another_commit_is_an_error(tmp_path):
    """Its numbers would be recorded as those of the table's commit."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "flights.csv").write_text("t\n0\n")
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    for command in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "empty"]):
        subprocess.run([*git, *command], check=True)
    with pytest.raises(ValueError, match="checkout 0123abc"):
        DATA.find(tmp_path, "answers")
    head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    assert replace(DATA, commit=head.stdout[:7]).find(tmp_path, "answers") == tmp_path


def test_tables_of_several_processes_get_them():
    seen = []

    def compute(settings):
        seen.append(settings.workers)
        return TableOutcome([], blank_figure(2, 2))

    make_table(compute=compute, is_parallel=True).reproduce("answers", Settings(workers=2))
    assert seen == [2]


def test_size_scales_counts_and_keeps_the_least():
    assert Settings(0.01).count(1000) == 10
    assert Settings(0.01).count(50) == 1
    assert Settings(0.01).count(50, least=4) == 4
    assert Settings().count(1000) == 1000


def test_files_keep_the_rows(tmp_path):
    table = make_table(data=DATA)
    outcome = table.compute(Settings())
    record = record_outcome("answers", table, outcome, 1.0)
    written, picture = write_outcome(record, outcome.figure, tmp_path)
    read = json.loads(written.read_text())
    assert rows_of_record(read) == list(outcome.rows)
    assert read["rows"][0]["verdict"] == "within"
    assert read["data"]["commit"] == "0123abc"
    assert read["extra"] == {"fit": [1.0]}
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_cells_have_four_digits_and_the_interval():
    row = Row("error", 0.123456, 0.2, "m", 0.1, 0.15, goal="lower")
    assert format_cells(row) == ["error", "m", "0.2", "0.1235", "0.1 to 0.15", "better"]
    assert format_cells(Row("printed", 580.652, 580.65, tolerance=0.005))[2:4] == ["580.65"] * 2
    assert format_cells(Row("zero", -1e-300 * 1e-300, 0.0))[2:4] == ["0", "0"]
    assert format_cells(Row("digit", 1.23456, 1.23451))[2:4] == ["1.23451", "1.23456"]
    assert format_cells(Row("computed", 1 / 3, 1 / 3))[2:4] == ["0.3333", "0.3333"]
    assert format_cells(Row("first", 2.0)) == ["first", "", "", "2", "", "unpublished"]


def test_the_command_lists_tables(capsys):
    main(["reproduce"])
    said = capsys.readouterr().out
    assert all(name in said for name in list_reproductions())


def test_the_command_computes_a_table_twice_alike(tmp_path, capsys):
    for name in "ab":
        main(["reproduce", "erlang", "--out", str(tmp_path / name)])
    assert "within" in capsys.readouterr().out
    first, second = ((tmp_path / name / "erlang.json").read_bytes() for name in "ab")
    assert first == second


def test_the_command_prints_explanations_and_notes(tmp_path, capsys, monkeypatch):
    row = Row("lap", 8.0, 7.0, "s", goal="lower", why="Their rotors react faster.")
    rows = [row, replace(row, name="second lap"), Row("unexplained", 8.0, 7.0)]
    outcome = TableOutcome(rows, blank_figure(2, 2), ["Laps of one track."])
    table = make_table(compute=lambda settings: outcome)
    monkeypatch.setattr("bulletuav.commands.reproduce.find_reproduction", lambda name: table)
    main(["reproduce", "erlang", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.count("lap, second lap: Their rotors react faster.") == 1
    assert "Laps of one track." in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--size", "0.1"], "--size needs the name of a table"),
        (["erlang", "--size", "0.1"], "no smaller size"),
        (["erlnag"], "did you mean 'erlang'"),
        (["erlang", "--workers", "2"], "one process"),
    ],
)
def test_bad_arguments_are_one_line(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["reproduce", *arguments])
    said = capsys.readouterr().err
    assert message in said
    assert len(said.splitlines()) == 1
