"""`bulletuav fly` prints what the task is about."""

import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.cli import main
from bulletuav.commands.fly import _table
from bulletuav.policies import find_policy

CITY = {"area": 200.0, "num_layouts": 1, "horizon": 3}
HEADINGS = {
    "mec": (
        "completed by all",
        "latency of all (s)",
        "in sight of any",
        "queue (tasks)",
        "collisions",
    ),
    "los": ("served by all", "collisions"),
    "coverage": ("covered by all", "collisions"),
    "hover": ("success", "at target", "collisions", "to target (m)"),
    "follow": ("success", "at station", "collisions", "to station (m)"),
    "crossing": ("success", "nearest (m)", "conflicts", "collisions", "to goal (m)"),
}


@pytest.mark.parametrize("task", HEADINGS)
def test_the_table_is_that_of_the_task(task):
    options = CITY if task in ("mec", "los", "coverage") else {"horizon": 3}
    options |= {"action": "velocity", "dynamics": "single_integrator"}
    aviary = bulletuav.Aviary(task, num_drones=2, **options)
    recording = fly_episode(aviary, find_policy("random")(aviary), seed=0)
    table = _table(recording, aviary, 0)
    headings = [column.header for column in table.columns]
    assert headings == ["drone", *HEADINGS[task], "time (s)"]
    assert table.row_count == 2
    cells = {column.header: list(column.cells) for column in table.columns}
    if task in ("los", "coverage"):
        assert cells[headings[1]] == [f"{recording.info['served'][-1, 0]:.2f}"] * 2
    if task == "crossing":
        assert cells["nearest (m)"][0] == f"{recording.separation[:, 0].min():.2f}"
        assert cells["success"] == ["no", "no"]
        assert cells["conflicts"][0].isdigit()
    aviary.close()


def test_headings_are_whole_in_a_narrow_window(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    quiet = ["--animation", "none", "--out", str(tmp_path)]
    main(["fly", "crossing", "--horizon", "2", "--dynamics", "point_mass", *quiet])
    said = capsys.readouterr().out
    assert "collisions" in said
    assert "…" not in said


def test_a_drone_alone_has_no_nearest(tmp_path, capsys):
    quiet = ["--animation", "none", "--out", str(tmp_path)]
    main(["fly", "crossing", "--drones", "1", "--horizon", "2", "--dynamics", "point_mass", *quiet])
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "drone_0" in line]
    assert [cell.strip() for cell in row.split("│")[2:5]] == ["no", "-", "0"]
