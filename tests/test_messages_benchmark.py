"""The benchmark of learned messages: what drones observe, rewards, and intervals."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bulletuav

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def messages(monkeypatch):
    """The benchmark's module."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    yield importlib.import_module("messages")
    sys.modules.pop("messages", None)


@pytest.fixture
def searches(messages):
    """Two worlds of the benchmark, with a channel."""
    env = bulletuav.batch_env("search", 2, **messages.OPTIONS, communication={"size": 2})
    yield env
    env.close()


def test_only_the_first_drone_observes_the_clue(searches):
    observed, _ = searches.reset(seed=0)
    clue = searches.aviary.scene.memory["clue"]
    np.testing.assert_allclose(observed[:, 0, 2:4], clue[:, :2] / 50.0, rtol=1e-6)
    assert (observed[:, :, 4] == [1, 0, 0]).all()
    assert (observed[:, 1:, 2:4] == 0).all()
    place = searches.aviary.swarm.position[..., :2]
    np.testing.assert_allclose(observed[..., :2], place / 50.0, rtol=1e-6)


def test_progress_is_half_that_of_the_drone_and_half_the_mean_of_its_world(messages):
    # The first victim is found: both drones fly to the second, by 3 m and by 1 m
    frame = SimpleNamespace(
        before=SimpleNamespace(position=np.array([[[0.0, 0, 5], [20, 0, 5]]])),
        after=SimpleNamespace(position=np.array([[[3.0, 0, 5], [19, 0, 5]]])),
        scene=SimpleNamespace(
            obstacle=np.array([[[0.0, 0, 0.4], [10, 0, 0.4]]]),
            memory={"found_at": np.array([[4.0, 0.0]])},
        ),
        alive=np.array([[True, True]]),
    )
    np.testing.assert_allclose(messages.progress_to_victim(frame), [[2.5, 1.5]])
    frame.alive = np.array([[True, False]])
    np.testing.assert_allclose(messages.progress_to_victim(frame), [[2.25, 0.75]])
    frame.scene.memory["found_at"] = np.array([[4.0, 5.0]])
    np.testing.assert_allclose(messages.progress_to_victim(frame), [[0.0, 0.0]])


def test_written_messages_are_the_observed_clue_and_arrive(messages, searches):
    observed, _ = searches.reset(seed=0)
    seen = observed.reshape(6, -1)
    actions = messages.write_messages(seen, np.ones((6, 5)))
    assert (actions[:, :3] == 1).all()
    assert (actions[:, 3:] == seen[:, 2:4]).all()
    heard, *_ = searches.step(actions.reshape(2, 3, 5))
    names = [label.name for label in searches.observation_labels]
    at = names.index("neighbour 1 message 1")
    np.testing.assert_allclose(np.abs(heard[:, 1:, [at, at + 3]]).max(axis=(1, 2)) > 0, True)


def test_intervals_are_those_of_student(messages):
    # The quantile of 0.975 with 2 degrees of freedom is 4.3027
    mean, low, high = messages.t_interval(np.array([1.0, 2.0, 3.0]))
    assert (mean, low, high) == pytest.approx((2.0, -0.4841, 4.4841), abs=1e-4)


def test_differences_are_paired_by_seed(messages):
    found = {
        "lost": [{"found": 0.1, "find_time": 30.0}, {"found": 0.5, "find_time": 20.0}],
        "learned": [{"found": 0.2, "find_time": 29.0}, {"found": 0.7, "find_time": 18.0}],
        "written": [{"found": 0.3, "find_time": 28.0}, {"found": 0.8, "find_time": 16.0}],
    }
    lines = messages.table(found).splitlines()
    # Differences 0.1 and 0.2: their standard error is 0.05, and the quantile 12.706
    assert "| fraction of victims found | learned |" in lines[3]
    assert "| +0.15 [-0.485, +0.785] |" in lines[3]


def test_one_seed_has_no_interval(messages):
    with pytest.raises(SystemExit):
        messages.parse(["--seeds", "3"])


@pytest.mark.slow
def test_a_call_trains_once_and_writes_its_files(messages, tmp_path, capsys):
    call = ["--seeds", "0", "1", "--steps", "1", "--episodes", "2", "--out", str(tmp_path)]
    messages.main(call)
    first = capsys.readouterr().out
    result = tmp_path / "runs" / "written-1" / "result.json"
    before = result.stat().st_mtime_ns
    messages.main(call)
    assert result.stat().st_mtime_ns == before
    assert capsys.readouterr().out.endswith(first[first.index("| |") :])
    page = (tmp_path / "messages.md").read_text()
    assert page.endswith(first[first.index("| |") :])
    assert len((tmp_path / "messages.csv").read_text().splitlines()) == 7
    assert (tmp_path / "messages.png").stat().st_size > 1000
