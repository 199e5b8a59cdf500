"""Metrics of users, and numbers that tasks tell by themselves, in evaluations and their files."""

import copy
import csv
import json
import sys
import textwrap

import numpy as np
import pytest

import bulletuav
from bulletuav import registry
from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.infos import select_task_infos
from bulletuav.analysis.metrics import METRICS, StandardMetric, find_metric
from bulletuav.cli import main
from bulletuav.policies import find_policy
from bulletuav.registry import register
from bulletuav.report.leaderboard import write_csv
from bulletuav.tasks import find_task

QUICK = {"dynamics": "point_mass", "num_drones": 3, "horizon": 20, "radius": 30.0}


def final_height(step, aviary):
    """Height of the drones at the end, m.

    Mean of the drones.
    """
    return aviary.swarm.position[:, :, 2].mean(axis=1)


class TopSpeed:
    """Highest speed of any drone, m/s."""

    name = "top_speed"

    def __init__(self, aviary):
        assert aviary.alive.any()
        assert not aviary.steps[aviary.alive.any(axis=1)].any()
        self.top = np.zeros(aviary.num_worlds)

    def __call__(self, step, aviary):
        speed = np.linalg.norm(aviary.swarm.velocity, axis=-1).max(axis=1)
        self.top = np.maximum(self.top, speed)
        return self.top


class Faster:
    """Decisions in which some drone was faster than a limit."""

    def __init__(self, limit):
        self.name = f"faster_than_{limit}"
        self.limit = limit
        self.count = 0

    def __call__(self, step, aviary):
        flown = aviary.alive | step.terminated | step.truncated
        speed = np.linalg.norm(aviary.swarm.velocity, axis=-1)
        self.count = self.count + ((speed > self.limit) & flown).any(axis=1)
        return self.count


ALL = (final_height, TopSpeed, Faster(5))
NAMES = ["final_height", "top_speed", "faster_than_5"]


@pytest.fixture(scope="module")
def measured():
    return evaluate("converge", "straight", 13, seed=4, metrics=ALL, **QUICK)


def column(result, name):
    return [row[name] for row in result.rows]


def test_each_form_of_a_metric_measures_each_episode_alone(measured):
    aviary = bulletuav.Aviary("converge", **QUICK)
    policy = find_policy("straight")(aviary)
    for episode in (0, 11):
        observations = aviary.reset(seeds=4 + episode)
        top, faster = 0.0, 0
        while aviary.alive.any():
            flown = aviary.alive.copy()
            observations = aviary.step(policy.act(observations, aviary.swarm)).observations
            speed = np.linalg.norm(aviary.swarm.velocity[0], axis=-1)
            top = max(top, speed.max())
            faster += (speed[flown[0]] > 5).any()
        row = measured.rows[episode]
        assert row["final_height"] == aviary.swarm.position[0, :, 2].mean()
        assert row["top_speed"] == top
        assert row["faster_than_5"] == faster > 0
    aviary.close()
    assert ALL[2].count == 0


def test_standard_metrics_stay_as_they_are(measured):
    plain = evaluate("converge", "straight", 13, seed=4, **QUICK)
    for name in METRICS:
        np.testing.assert_array_equal(column(plain, name), column(measured, name))
    assert list(plain.estimates()) == list(plain.metrics) == list(METRICS)
    assert list(measured.estimates()) == list(measured.metrics) == [*METRICS, *NAMES]
    assert measured.metrics["final_height"] == "Height of the drones at the end, m."
    assert plain.about["metrics"] == []


def test_workers_and_folders_change_no_bit_of_them(measured, tmp_path):
    run = {"seed": 4, "metrics": ALL, "out": tmp_path, **QUICK}
    evaluate("converge", "straight", 10, **run)
    more = evaluate("converge", "straight", 13, workers=2, **run)
    again = evaluate("converge", "straight", 13, **run)
    for result in (more, again):
        assert str(result.rows) == str(measured.rows)
        assert result.about["metrics"] == NAMES
    with (tmp_path / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["episode", "seed", *METRICS, *NAMES]
    assert float(rows[12]["top_speed"]) == measured.rows[12]["top_speed"]
    summary = json.loads(more.save(tmp_path).read_text())
    assert summary["estimates"]["top_speed"]["mean"] == np.mean(column(measured, "top_speed"))
    write_csv([more], tmp_path / "board.csv")
    assert f"straight,True,{more.hash},final_height," in (tmp_path / "board.csv").read_text()
    for others in (ALL[:2], (*ALL[:2], Faster(6))):
        with pytest.raises(ValueError, match="its metrics is"):
            evaluate("converge", "straight", 13, **{**run, "metrics": others})
    slower = copy.copy(ALL[2])
    slower.limit = 4
    with pytest.raises(ValueError, match="its fingerprint is"):
        evaluate("converge", "straight", 13, **{**run, "metrics": (*ALL[:2], slower)})


def test_policies_are_the_tasks_own_unless_told():
    result = bulletuav.evaluate("converge", episodes=1, metrics=(final_height,), **QUICK)
    assert result.about["policy"] == find_task("converge").baseline
    assert result.estimates()["final_height"].episodes == 1
    result = bulletuav.evaluate("hover", episodes=1, horizon=3, metrics=(final_height,))
    assert result.about["options"]["action"] == "velocity"  # which the baseline can give
    with pytest.raises(ValueError, match="supports velocity .*, not 'rotor'"):
        bulletuav.evaluate("hover", episodes=1, action="rotor")


MINE = """
    def low(step, aviary):
        '''Least height [m].'''
        return aviary.swarm.position[:, :, 2].min(axis=1)

    not_a_metric = 5
    """


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A file with a metric, which a package also names as an entry point."""
    (tmp_path / "mine.py").write_text(textwrap.dedent(MINE))
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[bulletuav.metric]\nlowest = mine:low\n")
    registry.names("metric")  # modules register their metrics only once
    table = dict(registry._registered["metric"])
    monkeypatch.setitem(registry._registered, "metric", table)
    monkeypatch.setattr(registry, "_loaded", registry._loaded - {"metric"})
    yield tmp_path
    sys.modules.pop("mine", None)


def test_metrics_are_found_by_name_module_and_entry_point(mine, monkeypatch):
    monkeypatch.syspath_prepend(mine)
    register("metric", "height")(final_height)
    result = evaluate("converge", "straight", 1, metrics=("height", "mine:low", "lowest"), **QUICK)
    (row,) = result.rows
    assert row["height"] >= row["low"] == row["lowest"]
    assert {*METRICS, "height", "lowest"} <= set(registry.names("metric"))
    with pytest.raises(ValueError, match="did you mean 'lowest'"):
        find_metric("lowst")
    with pytest.raises(ValueError, match="metric mine:not_a_metric is 5"):
        find_metric("mine:not_a_metric")


def test_a_standard_metric_may_be_named_too():
    assert find_metric("jerk") == StandardMetric("jerk", METRICS["jerk"])
    result = evaluate("converge", "straight", 1, metrics=("jerk",), **QUICK)
    assert list(result.estimates()) == list(METRICS)


def test_the_command_line_takes_metrics_of_the_current_folder(mine, monkeypatch, capsys):
    monkeypatch.chdir(mine)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv("COLUMNS", "200")
    arguments = ["evaluate", "hover", "--episodes", "1", "--horizon", "3", "--out", "out"]
    main([*arguments, "--metric", "mine:low", "--dynamics", "point_mass"])
    told = capsys.readouterr().out
    assert "low" in told
    assert "Least height [m]." in told
    assert "low" in (mine / "out" / "episodes.csv").read_text().splitlines()[0].split(",")
    with pytest.raises(SystemExit):
        main([*arguments, "--metric", "lov"])
    assert "unknown metric 'lov'" in capsys.readouterr().err


def jerk(step, aviary): ...


def of_drones(step, aviary):
    return aviary.swarm.position[:, :, 2]


def number(step, aviary):
    return 1.0


class NotCalled:
    def __init__(self, aviary): ...


@pytest.mark.parametrize(
    ("metrics", "said"),
    [
        (final_height, "metrics is"),
        ("final_height", "metrics is 'final_height': a list or tuple"),
        ((5,), "unknown metric 5"),
        (("jirk",), "did you mean 'jerk'"),
        (("nowhere:low",), "metric nowhere:low cannot be imported"),
        ((lambda step, aviary: 0,), "name of metric .*a word is needed"),
        ((jerk,), "metric 'jerk' is a standard metric already"),
        ((final_height, final_height), "metric 'final_height' is given twice"),
        (
            (of_drones,),
            r"metric 'of_drones' returned an array \(10, 3\) of float64: an array \(10,\)",
        ),
        ((number,), r"metric 'number' returned 1.0: an array \(10,\) of numbers"),
        ((NotCalled,), "metric 'NotCalled' constructs .*__call__"),
    ],
)
def test_what_is_no_metric_is_refused(metrics, said):
    with pytest.raises(ValueError, match=said):
        evaluate("converge", "straight", 1, metrics=metrics, **QUICK)


# Infos of tasks


class Telling(find_task("converge")):
    """Tells of itself."""

    name = "telling"

    def info(self, frame):
        height = frame.after.position[:, :, 2]
        told = {
            "height": height,
            "is_high": height > 100,
            "jerk": np.full(height.shape, -5.0),
            "seed": np.full(height.shape, -5),
            "never": np.full(height.shape, np.nan),
        }
        # Infos of other forms, which are refused at a reset.
        if frame.time.max() > 0:
            told |= {"place": frame.after.position, "of_world": height.mean(axis=1)}
        # An info that comes in some episodes alone.
        if frame.time.max() > 1.95:
            told["late"] = height + 1
        return told


def test_scalar_infos_of_a_task_are_told_as_they_are_at_the_end(tmp_path):
    run = {"episodes": 13, "seed": 4, "metrics": (final_height,), **QUICK}
    result = evaluate(Telling, "straight", out=tmp_path, **run)
    assert list(result.metrics) == [*METRICS, "final_height", "height", "is_high", "never", "late"]
    assert column(result, "height") == column(result, "final_height")
    at_the_end = [row["height"] + 1 if row["length"] == 2.0 else np.nan for row in result.rows]
    np.testing.assert_array_equal(column(result, "late"), at_the_end)
    assert 1 < result.estimates()["late"].episodes <= 13
    assert column(result, "seed") == list(range(4, 17))
    assert min(column(result, "jerk")) >= 0
    found = result.estimates()
    assert found["height"].mean == found["final_height"].mean
    assert found["is_high"][:3] == (0, 0, 0)
    assert found["never"].episodes == 0
    plain = evaluate("converge", "straight", 13, 4, **QUICK)
    for name in METRICS:
        np.testing.assert_array_equal(column(result, name), column(plain, name))
    again = evaluate(Telling, "straight", out=tmp_path, workers=2, **run)
    assert again.flight == 0
    assert str(again.rows) == str(result.rows)
    assert again.metrics == result.metrics
    assert json.loads(result.save(tmp_path).read_text())["estimates"]["height"]["episodes"] == 13


def test_episodes_without_an_info_have_none():
    result = evaluate(Telling, "straight", 2, **{**QUICK, "horizon": 5})
    assert "late" not in result.metrics
    assert "height" in result.metrics


CITY = ("city_alpha", "city_beta", "city_gamma")
EDGE = (*CITY, "dwell_time", "mean_service", "dropped", "utilisation", "queue")


def test_standard_infos_are_no_tasks_own():
    for task, options, own in (
        ("converge", {"randomization": {"radio_delay": 0.05, "mass": 0.1}}, set()),
        (Telling, {}, {"height", "is_high", "place", "of_world", "jerk", "seed", "never"}),
        ("mec", {"area": 200.0, "num_layouts": 1}, {"served", "completed", "latency", *EDGE}),
    ):
        aviary = bulletuav.Aviary(task, num_drones=2, dynamics="point_mass", **options)
        aviary.reset(seeds=0)
        assert set(select_task_infos(aviary.first_info())) == own - {"place", "of_world"}
        step = aviary.step(np.zeros((1, *aviary.action.low.shape)))
        assert set(select_task_infos(step.info)) == own
        aviary.close()
