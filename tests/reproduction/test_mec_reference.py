"""The reference table of edge computing: its metrics by hand, its rows, and its published run."""

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from edge_users import DOWN, EQUAL, STAY
from placing import OPEN, fly

import bulletuav
from bulletuav.analysis.metrics import Estimate
from bulletuav.reproduction import edge_reference, find_reproduction
from bulletuav.reproduction.edge_reference import (
    EDGE_METRICS,
    LEARNED,
    DronePower,
    EdgeFlight,
    EdgeScene,
    SwarmEnergy,
    estimate_ratio,
    finished_tasks,
    fly_edge_scenes,
    train_edge_policy,
)
from bulletuav.reproduction.table import Settings, rows_of_record
from bulletuav.reproduction.tables import mec_reference
from bulletuav.reproduction.tables.mec_reference import (
    COLUMNS,
    DYNAMICS,
    PUBLISHED,
    SCENES,
    make_edge_rows,
    rounding_error,
)

DOCS = Path(__file__).parents[2] / "docs"
RESULTS = DOCS / "results" / "reproduced" / "mec-reference.json"
PAGE = DOCS / "benchmarks" / "mec_reference.md"
ABOVE, BELOW = [(0, 0, 50), (60, 0, 5)], [(0, 0, 1.5)]


def hover_watts():
    """Power of four rotors that carry a hummingbird, by hand: k_m w^3 each, and losses, W."""
    frame = bulletuav.load_airframe("hummingbird")
    speed = math.sqrt(frame.mass * 9.80665 / 4 / frame.thrust_coefficient)
    shafts = 4 * frame.thrust_coefficient * frame.torque_ratio * speed**3
    return shafts / frame.efficiency + frame.electronics


def test_hovering_drones_without_tasks_take_the_power_of_hover(put):
    """70.3 W is the power that docs/explanation/radio_and_edge.md states."""
    aviary = put("mec", OPEN, ABOVE, BELOW, arrival_rate=0.0, horizon=20)
    energy, power = SwarmEnergy(aviary), DronePower(aviary)
    for _ in range(20):
        step = fly(aviary, STAY)
        joules, watts = energy(step, aviary), power(step, aviary)
    assert watts == pytest.approx(hover_watts(), rel=1e-9)
    assert watts == pytest.approx(70.3, abs=0.05)
    assert joules == pytest.approx(2 * 20 * hover_watts(), rel=1e-9)


def test_a_drone_that_has_crashed_takes_no_energy(put):
    aviary = put("mec", OPEN, ABOVE, BELOW, arrival_rate=0.0, horizon=20)
    energy, power = SwarmEnergy(aviary), DronePower(aviary)
    joules, decisions = 0.0, 0
    while aviary.alive.any():
        decisions += aviary.alive.sum()
        step = fly(aviary, STAY, DOWN)
        joules += step.info["power"].sum()
        found = energy(step, aviary), power(step, aviary)
    assert 20 < decisions < 40
    np.testing.assert_allclose(found, [[joules], [joules / decisions]])


def test_work_in_the_system_obeys_littles_law(put):
    """Mean work in tasks is rate times (delay - half of a task's own time), at the cores.

    The law L = lambda W holds for any mean over the time in the system, here of the work that a
    task still needs: H = lambda G. A task of S seconds contributes S for its wait, and S / 2 on
    average while it is computed. Uploads take no time in this band, and no task is lost.
    """
    seconds, options = 0.2, {"num_cores": 4, "arrival_rate": 0.375, "deadline": 1e3, **EQUAL}
    users = [(3 * math.cos(k), 3 * math.sin(k), 1.5) for k in range(40)]
    fast = {"bandwidth": 1e12, "noise_figure": 0.0, "user_power": 1e6, "horizon": 300}
    aviary = put("mec", OPEN, [(0, 0, 30)], users, num_worlds=8, **options, **fast)
    queue = []
    while aviary.alive.any():
        queue.append(fly(aviary, STAY).info["queue"].mean())
    memory = aviary.scene.memory
    assert (memory["generated"] == memory["finished"]).all()
    rate = memory["generated"].sum() / (8 * 300)
    delay = memory["delay"].sum() / memory["generated"].sum()
    assert rate == pytest.approx(15.0, rel=0.02)
    assert delay > 1.1 * seconds  # tasks wait
    assert np.mean(queue) == pytest.approx(rate * (delay - seconds / 2), rel=0.02)


@pytest.mark.parametrize(
    ("number", "error"), [(1234.0, 0.5), (0.01234, 5e-6), (-64.32, 0.005), (1.0, 5e-4), (0.0, 0.0)]
)
def test_rounding(number, error):
    assert rounding_error(number) == pytest.approx(error)


def test_ratios_are_those_of_totals():
    assert estimate_ratio([4.0, 4.0], [1.0, 3.0])[0] == 2.0  # not the mean of 4 and 4 / 3
    same = estimate_ratio([2.0, 6.0, 10.0], [1.0, 3.0, 5.0])
    assert (same.mean, same.low, same.high) == pytest.approx((2.0, 2.0, 2.0))
    above, below = np.array([1.0, 2.0, 9.0, 4.0, 8.0]), [1.0, 0.0, 2.0, 1.0, 2.0]
    one, ten = estimate_ratio(above, below), estimate_ratio(10 * above, below)
    assert one.low < one.mean == 4.0 < one.high
    np.testing.assert_allclose(ten[:3], 10 * np.array(one[:3]))


def test_the_interval_of_a_ratio_covers_the_truth():
    """In 100 data sets of ratio 3, of 60 episodes each, intervals miss it 1 to 12 times."""
    rng, missed = np.random.default_rng(5), 0
    for _ in range(100):
        below = rng.poisson(20.0, 60)
        found = estimate_ratio(3 * below + rng.normal(0, 5, 60), below)
        missed += not found.low <= 3.0 <= found.high
    assert 1 <= missed <= 12


SMALL = EdgeScene("mec", "easy", ("stay", "kmeans"))


@pytest.fixture(scope="module")
def flights():
    """Results of two baselines at the smallest size, and the reported progress."""
    seen = []
    found = list(fly_edge_scenes([SMALL], DYNAMICS[:1], Settings(0.01, progress=seen.append)))
    return found, seen


def test_flights_are_in_order_with_all_metrics(flights):
    found, seen = flights
    assert [one.policy for one in found] == ["stay", "kmeans"]
    assert seen == [0.5, 1.0]
    for one in found:
        assert {*COLUMNS} <= {*one.estimates}
        assert all(one.estimates[key].episodes == 10 for key in COLUMNS)
    stay, kmeans = (one.estimates for one in found)
    assert stay["completed"].mean < kmeans["completed"].mean
    # Hovering drones compute at most with all of four cores of 12.5 W
    assert hover_watts() < stay["drone_power"].mean < hover_watts() + 50
    energy, tasks = (stay[name].mean for name in (SwarmEnergy.name, finished_tasks.__name__))
    assert energy == pytest.approx(3 * 100 * stay["drone_power"].mean)
    assert stay["task_energy"].mean == pytest.approx(energy / tasks)


def test_finished_and_dropped_tasks_are_all_tasks():
    flown = bulletuav.evaluate("mec", "stay", 2, 5, metrics=EDGE_METRICS, horizon=20, area=250.0)
    for row in flown.rows:
        tasks = row["finished_tasks"] + row["dropped"]
        assert row["completed"] == pytest.approx(row["finished_tasks"] / tasks)
        assert 0 < row["finished_tasks"] < tasks


def test_learned_policies_differ_by_their_critic_only(monkeypatch, tmp_path):
    runs = {}
    monkeypatch.setattr(edge_reference, "train", lambda run, folder, _: runs.update({folder: run}))
    for policy in LEARNED:
        train_edge_policy(SCENES[0], policy, 1000, tmp_path / policy, print)
    own, central = runs.values()
    assert own.settings["critic"] == "own"
    assert central == dataclasses.replace(own, model={**own.model, "critic": "state"})
    assert {"difficulty": "medium", "dynamics": "point_mass"}.items() <= own.options.items()
    assert (own.algo, own.seed, own.steps) == ("fast_ppo", 0, 1000)


def test_the_same_seeds_give_the_same_bits(flights):
    again = next(fly_edge_scenes([SMALL], DYNAMICS[:1], Settings(0.01)))
    assert again.hash == flights[0][0].hash


def _rows(flight, size):
    return {row.name.partition(": ")[2]: row for row in make_edge_rows([flight], size)}


def test_rows_compare_with_the_published_numbers(monkeypatch):
    found = {key: Estimate(2.0, 1.0, 3.0, 10) for key in COLUMNS}
    numbers = (2.5, 3.0004, 3.01, 1.0, 0.9, 2.0, 3.0)
    monkeypatch.setitem(PUBLISHED, ("mec easy", "fast_ppo"), numbers)
    monkeypatch.setitem(PUBLISHED, ("mec easy", "kmeans"), numbers)
    flown = EdgeFlight(SCENES[2], "fast_ppo", DYNAMICS[0], found, "")
    rows = _rows(flown, 1.0)
    # The same episodes give the same numbers; fewer episodes, numbers within their interval
    assert [row.verdict for row in rows.values()] == [*["outside"] * 5, "within"]
    assert [row.verdict for row in _rows(flown._replace(policy="kmeans"), 0.5).values()] == [
        "within", "within", "outside", "within", "outside", "within",
    ]  # fmt: skip
    assert rows["mean delay"].unit == "s"
    # A policy that is trained for a shorter time is another one
    assert _rows(flown, 0.5)["power of a drone"].verdict != "outside"
    rigid = _rows(flown._replace(dynamics=DYNAMICS[1]), 1.0)
    assert [row.published for row in rigid.values()] == [3.0]
    other = flown._replace(policy="unknown")
    assert all(row.verdict == "unpublished" for row in _rows(other, 1.0).values())


def test_each_policy_is_published_with_a_row_of_its_run():
    cases = {(scene.name, policy) for scene in SCENES for policy in scene.policies}
    assert {*PUBLISHED} == cases
    assert all(len(numbers) == len(COLUMNS) + 1 for numbers in PUBLISHED.values())
    record = json.loads(RESULTS.read_text())
    rows = rows_of_record(record)
    assert record["size"] == 1.0
    assert len(rows) == sum(map(len, PUBLISHED.values()))
    assert [row.published for row in rows] == [
        number
        for scene in SCENES
        for policy in scene.policies
        for number in PUBLISHED[scene.name, policy]
    ]
    # The bits are those of the run, so that numbers differ by rounding only
    for row in rows:
        assert row.ours == pytest.approx(row.published, abs=1.001 * row.tolerance), row.name


def test_the_page_has_the_published_numbers():
    tables = re.split(r"\n### ", PAGE.read_text())[1:]
    titles = ("`mec`, medium", "`mec_advanced`, medium", "`mec`, easy")
    for scene, title, table in zip(SCENES, titles, tables, strict=True):
        assert table.startswith(title)
        lines = [line for line in table.splitlines() if line.startswith("| `")]
        assert len(lines) == len(scene.policies)
        for policy, line in zip(scene.policies, lines, strict=True):
            name, *cells = line.strip("| ").split(" | ")
            assert name.startswith(f"`{policy}`")
            for cell, number in zip(cells, PUBLISHED[scene.name, policy], strict=True):
                shown = cell.partition(" [")[0]
                unit = 10.0 ** -len(shown.partition(".")[2])
                # Both are rounded
                assert float(shown) == pytest.approx(number, abs=0.6 * unit), (policy, cell)


def test_the_published_ranking():
    """The oracle is best, and hovering in place is worst, as the page states."""
    for scene in SCENES:
        by_policy = {name: PUBLISHED[scene.name, name] for name in scene.policies}
        for name, numbers in by_policy.items():
            best, worst = by_policy["oracle"], by_policy["stay"]
            assert worst[0] <= numbers[0] <= best[0]
            assert worst[1] >= numbers[1] >= best[1]
            assert worst[3] >= numbers[3] >= best[3]
            assert worst[5] <= numbers[5] <= best[5], name


@pytest.mark.slow
def test_the_table_at_its_smallest_size():
    table, seen = find_reproduction("mec-reference"), []
    outcome = table.compute(Settings(0.01, progress=seen.append))
    assert len(outcome.rows) == sum(map(len, PUBLISHED.values()))
    assert all(row.low <= row.ours <= row.high for row in outcome.rows)
    wrong = [row for row in outcome.rows if row.verdict == "outside"]
    # An interval of ten episodes misses about one of ten numbers
    assert len(wrong) < 0.25 * len(outcome.rows)
    assert not any(name in row.name for row in wrong for name in LEARNED)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert len(outcome.figure.axes) == 9
    assert len(outcome.extra["hashes"]) == sum(2 * len(scene.policies) for scene in SCENES)
    assert mec_reference.REPRODUCTION is table
