"""Every example in the help of a command runs, in an empty folder, one after the other."""

import importlib
import shlex

import pytest

from bulletuav.bridges.hil import HilServer
from bulletuav.cli import COMMANDS, EPILOG, main
from bulletuav.report.doctor import examine
from bulletuav.report.live import LiveView

SHORTER = {
    "benchmark": "--drones 1 --seconds 0.01",
    "compare": "--episodes 1 --workers 1 --dynamics single_integrator",
    "dataset": "--horizon 2 --workers 1 --dynamics point_mass",
    "evaluate": "--horizon 2 --workers 1 --dynamics point_mass",
    "fly": "--horizon 3 --animation none",
    "identify": "--fit drag_xy",
    "incentives": "--episodes 1 --horizon 2 --difficulties easy --dynamics point_mass",
    "serve": "--seconds 0.05 --port 0",
    "train": "--steps 16 --worlds 1 --evaluations 1 --episodes 1 --horizon 4 --seeds 0 --workers 1"
    " --dynamics point_mass",
    "tune": "--steps 16 --worlds 1 --evaluations 1 --episodes 1 --horizon 4 --trials 1 --batch 1"
    " --dynamics point_mass",
    "verify": "--workers 1",
}
"""Words that make a command take less time, without another meaning of the example"""


def examples(epilog):
    """Commands of an epilog, as lists of words after `bulletuav`."""
    _, *lines = epilog.replace("\\\n", "").splitlines()
    found = []
    for line in lines:
        for command in line.split("&&"):
            program, *words = shlex.split(command)
            assert program == "bulletuav"
            found.append(words)
    return found


def missing_extras():
    return {one.subject.split()[1] for one in examine() if one.remedy and "extra" in one.subject}


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs an example, shortened; those that need an extra which is not there say so."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(LiveView, "wait", lambda self: None)
    # It flies when all autopilots have answered, and there are none here
    monkeypatch.setattr(HilServer, "run", lambda self, seconds: None)
    # Tests of the command itself are in test_compile.py
    monkeypatch.setattr("bulletuav.commands.covering.list_flights", lambda: [])
    monkeypatch.setattr("bulletuav.commands.compile.native_mark", lambda: tmp_path / "native")
    monkeypatch.setattr("bulletuav.commands.compile._run_again", lambda variables: None)

    def run(words):
        # Stages are measured of a task as it is
        shorter = "" if "--stages" in words else SHORTER.get(words[0], "")
        if words[0] == "train" and "--all" not in words and "--seeds" not in words:
            shorter = shorter.replace("--seeds 0 --workers 1", "")
        if "pursuit" in words:  # laps take time
            shorter = shorter.replace("--horizon 4", "--horizon 400")
        code = 0
        try:
            main([*words, *shorter.split()])
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr().err
        # Without an extra it says so, and nothing else goes wrong
        is_missing = any(f"needs the extra '{extra}'" in said for extra in missing_extras())
        assert code == (2 if is_missing else 0), said

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_run_in_an_empty_folder(name, run):
    module = importlib.import_module(f"bulletuav.commands.parsers.{name}")
    commands = examples(module.ABOUT["epilog"])
    assert any(words[0] == name for words in commands)
    for words in commands:
        if "--all" in words and name == "train":
            continue  # trains every task of the package; see below
        run(words)


@pytest.mark.slow
def test_the_example_that_trains_all_tasks_runs(run):
    epilog = importlib.import_module("bulletuav.commands.parsers.train").ABOUT["epilog"]
    (words,) = [words for words in examples(epilog) if "--all" in words]
    run(words)


def test_the_first_example_runs(run, tmp_path):
    heading, example, *_ = EPILOG.splitlines()
    (words,) = examples(f"{heading}\n{example}")
    run(words)
    assert (tmp_path / "out" / "trajectory.npz").exists()
