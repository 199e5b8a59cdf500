"""The comparison of learners, as far as it goes without the peer."""

import csv
import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def learning(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("learning", BENCHMARKS / "learning.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "learning", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_learner_tells_frames_that_it_flew_and_times_that_lie_within_each_other(learning):
    context = {"environments": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 1}
    told = learning.run(
        [sys.executable, BENCHMARKS / "peers" / "learn_bulletuav.py"], context, 1024, 0
    )
    assert told.frames == 1024
    assert (
        5 < told.episodes < 200
    )  # random rotor speeds bring a drone down within two seconds or so
    assert 0 < told.resets < told.environment < told.cpu < told.wall * 1.1


def test_medians_of_rates_and_of_their_ratios(learning):
    ours = [learning.Run(2.0, cpu, 0.5, 0.25, 100, 4) for cpu in (1.0, 0.5, 2.0)]
    theirs = [learning.Run(20.0, cpu, 8.0, 6.0, 100, 5) for cpu in (10.0, 10.0, 50.0)]
    per_cpu, by_clock, without = learning.rows("a", ours, theirs)
    assert (per_cpu.ours, per_cpu.theirs, per_cpu.ratio, per_cpu.goal) == (100.0, 10.0, 20.0, 5.0)
    assert (by_clock.ours, by_clock.theirs, by_clock.ratio, by_clock.goal) == (
        50.0,
        5.0,
        10.0,
        None,
    )
    assert without.ours == pytest.approx(100 / 0.75)
    assert without.theirs == pytest.approx(100 / 4)
    assert without.ratio == pytest.approx(16)  # of 5.3, 16 and 25.1


def test_parts_of_the_time_add_up(learning):
    line = learning.parts("a", [learning.Run(2.0, 1.0, 0.75, 0.5, 1000, 40)] * 3)
    assert line == "| a | 250 | 250 | 500 | 25% | 25 |"


def test_a_learner_that_fails_is_quoted(learning, tmp_path):
    script = tmp_path / "broken.py"
    script.write_text("raise ValueError('no such drone')")
    with pytest.raises(RuntimeError, match="code 1: ValueError: no such drone"):
        learning.run([sys.executable, script], {}, 1, 0)


def test_both_learn_in_turn_with_the_same_settings(learning, tmp_path, monkeypatch, capsys):
    asked = []

    def run(command, context, frames, seed):
        asked.append((Path(command[1]).stem, context["environments"], frames, seed))
        return learning.Run(1.0, 1.0, 0.5, 0.25, frames, 10)

    monkeypatch.setattr(learning, "run", run)
    monkeypatch.setattr(learning, "install", lambda peer, folder: sys.executable)
    (tmp_path / "gym_pybullet_drones").mkdir()
    learning.main(
        ["--peer", str(tmp_path), "--out", str(tmp_path), "--rounds", "2", "--frames", "50"]
    )
    both = ("learn_bulletuav", "learn_gym_pybullet_drones")
    assert asked == [
        (who, count, 50, seed) for count in (1, 16, 64) for seed in (0, 1) for who in both
    ]
    assert capsys.readouterr().out == (tmp_path / "learning.md").read_text()
    with open(tmp_path / "learning.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["goal"] for row in rows] == ["", "", ""] + ["5.0", "", ""] * 2


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["--rounds", "0"], "numbers above 0"),
        (["--frames", "0"], "numbers above 0"),
        ([], "no checkout"),
    ],
)
def test_bad_arguments_are_refused(learning, tmp_path, capsys, wrong, words):
    with pytest.raises(SystemExit):
        learning.main(["--peer", str(tmp_path), *wrong])
    assert words in capsys.readouterr().err
