"""`bulletuav compile`, and that its flights cover everything that has a name."""

import os
import sys
import types

import pytest

from bulletuav.cli import main
from bulletuav.commands import compile, covering
from bulletuav.commands.progress import show_progress
from bulletuav.compiled import dispatcher
from bulletuav.compiled.dispatcher import COMPILATION
from bulletuav.compiled.kernel import kernel
from bulletuav.dynamics import DYNAMICS
from bulletuav.policies import policy_names
from bulletuav.registry import names
from bulletuav.tasks import find_task, list_tasks


@pytest.fixture
def mark(tmp_path, monkeypatch):
    path = tmp_path / "mark"
    monkeypatch.setattr(compile, "native_mark", lambda: path)
    return path


@pytest.fixture
def commands(monkeypatch):
    """Processes that are started, by their arguments and number of flights; each ends with 0."""
    started = []

    class Done:
        returncode = 0

    def run(command, env, check):
        added = {name: value for name, value in env.items() if os.environ.get(name) != value}
        started.append((command, added))
        return Done

    monkeypatch.setattr(compile.subprocess, "run", run)
    return started


def test_all_ingredients_are_flown():
    environments = list(covering.list_environments())
    flights = [flight.name for flight in covering.list_flights()]
    both = {(task, options.get("dynamics")) for task, options in environments}
    assert {(task, one) for task in list_tasks() for one in DYNAMICS} <= both
    for kind in ("action", "mobility"):
        assert {options.get(kind) for _, options in environments} >= set(names(kind))
    blocks = {options["observation"] for _, options in environments if "observation" in options}
    assert blocks >= {(block,) for block in names("observation")}
    assert {f"converge, {one}" for one in policy_names()} <= set(flights)
    assert {f"{one}, {find_task(one).baseline}" for one in list_tasks()} <= set(flights)


def test_options_of_a_flight_are_valid_in_some_task():
    """A name that no task takes would be skipped in silence."""
    covering.fly_shortly("hover", 1, dynamics="point_mass", weights="all")
    covering.fly_shortly("crossing", dynamics="point_mass", randomization=dict(covering.UNCERTAIN))


def test_compiling_reports_what_was_compiled(mark, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("bulletuav.compiled.kernel._CACHE", tmp_path)
    monkeypatch.setattr(COMPILATION, "num_functions", 0)
    own = kernel(lambda x: x + 41)
    flights = [covering.CoveringFlight("own", lambda: own(1))]
    monkeypatch.setattr(covering, "list_flights", lambda: flights)
    monkeypatch.setattr(covering, "compile_deferred", lambda: None)
    main(["compile"])
    output = capsys.readouterr()
    assert output.out.startswith("compiled 1 functions in ")
    assert "compiling: 1 of 1 flights (100 %)" in output.err
    monkeypatch.setattr(COMPILATION, "num_functions", 0)
    main(["compile"])
    assert capsys.readouterr().out.startswith("nothing to compile; machine code: ")


def test_progress_of_compilation_counts_its_time(capsys, monkeypatch):
    compilation = dispatcher.Compilation()
    monkeypatch.setattr(dispatcher, "COMPILATION", compilation)
    monkeypatch.setattr(dispatcher, "MANY", 1)
    now = [0.0]
    clock = types.SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr(dispatcher, "time", clock)
    monkeypatch.setattr("bulletuav.commands.progress.time", clock)
    with show_progress("compiling", 2, "flights", is_compilation=True) as report:
        for done in (1, 2):
            with compilation.count():
                now[0] += 60.0
            report.note(f"{compilation.num_functions} functions")
            report(done)
    assert capsys.readouterr().err.splitlines() == [
        "compiling: 1 of 2 flights (50 %), 0 s, 1 functions",
        "compiling: 2 of 2 flights (100 %), 60 s, 2 functions",
    ]


def test_options_that_cannot_be_combined_are_skipped_and_errors_are_not(monkeypatch):
    monkeypatch.setattr(covering, "compile_deferred", lambda: None)
    covering.CoveringFlight("", lambda: covering.fly_shortly("hover", 1, at_goal="never")).run()
    with pytest.raises(ZeroDivisionError):
        covering.CoveringFlight("", lambda: 1 // 0).run()


def test_native_code_is_used_from_then_on_until_it_is_not_requested(mark, commands):
    main(["compile", "--native"])
    again = [sys.executable, "-m", "bulletuav", "compile"]
    (first,) = commands
    assert first[0] == again
    assert set(first[1]) == {"NUMBA_CPU_NAME"}
    assert mark.is_file()
    main(["compile"])
    assert commands[1:] == [(again, {})]
    assert not mark.exists()


def test_native_code_is_not_used_if_it_could_not_be_compiled(mark, commands, monkeypatch):
    monkeypatch.setattr(compile.subprocess.run("", {}, False), "returncode", 3)
    with pytest.raises(SystemExit) as end:
        main(["compile", "--native"])
    assert end.value.code == 3
    assert not mark.exists()
