import contextlib
import csv
import json
import multiprocessing
import os
import signal
from typing import ClassVar

import numpy as np
import pytest
from PIL import Image

import bulletuav
from bulletuav.analysis.episodes import EvaluationJob
from bulletuav.analysis.evaluation import BATCH, evaluate
from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.policies import find_policy
from bulletuav.policies.base import Policy
from bulletuav.report.charts import plot_evaluation, plot_leaderboard
from bulletuav.report.leaderboard import format_leaderboard, write_csv

QUICK = {"dynamics": "point_mass", "num_drones": 3, "horizon": 120, "radius": 30.0}


@pytest.fixture(scope="module")
def straight():
    return evaluate("converge", "straight", 13, seed=4, **QUICK)


def numbers(result):
    return np.array([list(row.values()) for row in result.rows])


def test_episode_e_is_the_one_of_seed_plus_e_flown_alone(straight):
    assert [row["episode"] for row in straight.rows] == list(range(13))
    assert [row["seed"] for row in straight.rows] == list(range(4, 17))
    aviary = bulletuav.Aviary("converge", **QUICK)
    policy = find_policy("straight")(aviary)
    observations = aviary.reset(seeds=4 + 11)
    steps = 0
    nearest = np.inf
    while aviary.alive.any():
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations, steps = step.observations, steps + 1
        nearest = min(nearest, step.info["separation"].min())
    assert straight.rows[11]["length"] == pytest.approx(steps / 10)
    assert straight.rows[11]["min_separation"] == pytest.approx(nearest)
    aviary.close()


@pytest.fixture
def start_method(request):
    """Starts processes in another way, as a user's program or TorchRL may."""
    usual = multiprocessing.get_start_method()
    multiprocessing.set_start_method(request.param, force=True)
    yield request.param
    multiprocessing.set_start_method(usual, force=True)


@pytest.mark.parametrize(
    ("workers", "start_method", "policy"),
    [(2, "fork", "straight"), (2, "spawn", "random"), (3, "fork", "random")],
    indirect=["start_method"],
)
def test_workers_change_no_bit(workers, start_method, policy, tmp_path):
    options = QUICK | {"dynamics": "bullet", "horizon": 40, "difficulty": "extreme"}
    one = evaluate("converge", policy, 25, out=tmp_path / "one", **options)
    more = evaluate("converge", policy, 25, workers=workers, out=tmp_path / "more", **options)
    np.testing.assert_array_equal(numbers(one), numbers(more))
    assert one.about == more.about
    assert one.about["batch"] == BATCH
    assert (tmp_path / "one" / "episodes.csv").read_text() == (
        tmp_path / "more" / "episodes.csv"
    ).read_text()


def test_an_interrupted_run_goes_on_where_it_was(tmp_path, straight, monkeypatch):
    flown = []
    original = EvaluationJob._fly_batch

    def watched(self, aviary, policy, batch):
        if len(flown) == 1:
            flown.append("interrupted")
            raise KeyboardInterrupt
        flown.append(batch)
        return original(self, aviary, policy, batch)

    monkeypatch.setattr(EvaluationJob, "_fly_batch", watched)
    with pytest.raises(KeyboardInterrupt):
        evaluate("converge", "straight", 13, 4, out=tmp_path, **QUICK)
    (tmp_path / "episodes.csv.part").write_text(
        "epis"
    )  # as an interruption while writing leaves it
    told = []
    result = evaluate("converge", "straight", 13, 4, out=tmp_path, progress=told.append, **QUICK)
    assert flown == [range(10), "interrupted", range(10, 13)]
    assert told == [10, 3]
    np.testing.assert_array_equal(numbers(result), numbers(straight))
    with (tmp_path / "episodes.csv").open() as file:
        assert [int(row["episode"]) for row in csv.DictReader(file)] == list(range(13))


def test_more_episodes_can_follow(tmp_path, straight):
    evaluate("converge", "straight", 10, 4, out=tmp_path, **QUICK)
    result = evaluate("converge", "straight", 13, 4, out=tmp_path, **QUICK)
    np.testing.assert_array_equal(numbers(result), numbers(straight))


def test_a_folder_of_another_run_is_refused(tmp_path):
    evaluate("converge", "straight", 2, out=tmp_path, **QUICK)
    with pytest.raises(ValueError, match="holds another run: its horizon is 120, not 60"):
        evaluate("converge", "straight", 2, out=tmp_path, **QUICK | {"horizon": 60})
    with pytest.raises(ValueError, match="its policy is 'straight', not 'orca'"):
        evaluate("converge", "orca", 2, out=tmp_path, **QUICK)
    with pytest.raises(ValueError, match="its seed is 0, not 3"):
        evaluate("converge", "straight", 2, 3, out=tmp_path, **QUICK)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be written to"):
        evaluate("converge", "orca", 2, out=tmp_path / "file", **QUICK)


@pytest.mark.parametrize(
    ("name", "text"),
    [("run.json", ""), ("run.json", "[]"), ("run.json", "{}"), ("episodes.csv", "a,b\n1,2\n")],
)
def test_a_damaged_folder_is_told(tmp_path, name, text):
    evaluate("converge", "straight", 2, out=tmp_path, **QUICK)
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=r"holds a run that is damaged .*delete it"):
        evaluate("converge", "straight", 2, out=tmp_path, **QUICK)


def test_what_a_folder_cannot_tell_apart_is_not_taken_for_the_same(tmp_path):
    class Mine(Broken):
        """Of the same name."""

    class Heavy(bulletuav.tasks.find_task("converge")):
        """Of the same name."""

    evaluate("converge", Broken, 2, out=tmp_path, **QUICK)
    for task, policy in (("converge", Mine), (Heavy, Broken)):
        with pytest.raises(ValueError, match="its fingerprint is"):
            evaluate(task, policy, 2, out=tmp_path, **QUICK)
    with pytest.raises(ValueError, match="wind is a function"):
        evaluate(
            "converge",
            "straight",
            2,
            out=tmp_path,
            wind=lambda position, time: np.zeros_like(position),
            **QUICK,
        )


class Broken(Policy):
    """Fails in the way of `fault`."""

    name, actions, reads_swarm = "broken", ("velocity",), False
    fault: staticmethod = staticmethod(lambda: None)

    def reset(self, mask):
        type(self).fault()

    def act(self, observations, swarm):
        return np.zeros((self.aviary.num_worlds, self.aviary.num_drones, 3))


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def fail():
    raise LookupError("no such thing")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (die, r"3 worker processes in turn have died in episodes \d+ to \d+ \(seeds 1?\d+ to "),
        (fail, "no such thing"),
    ],
)
@pytest.mark.filterwarnings("ignore:a worker process has died")
def test_the_end_of_a_worker_is_told(fault, said, monkeypatch):
    monkeypatch.setattr(Broken, "fault", staticmethod(fault))
    with pytest.raises(RuntimeError, match=said):
        evaluate("converge", Broken, 25, seed=1, workers=2, **QUICK)
    assert not multiprocessing.active_children()


class Doomed(Policy):
    """Ends its process in the second batch that it flies, as often as there are files to remove."""

    name, actions, reads_swarm = "doomed", ("velocity",), False
    folder: ClassVar = None

    def __init__(self, aviary):
        super().__init__(aviary)
        self.resets = 0

    def reset(self, mask):
        self.resets += 1
        for file in type(self).folder.glob("*") if self.resets == 2 else ():
            file.unlink()
            os.kill(os.getpid(), signal.SIGKILL)

    def act(self, observations, swarm):
        return np.full((self.aviary.num_worlds, self.aviary.num_drones, 3), 0.5)


def test_a_worker_that_is_killed_is_replaced_and_no_bit_changes(tmp_path, monkeypatch):
    deaths = tmp_path / "deaths"
    deaths.mkdir()
    monkeypatch.setattr(Doomed, "folder", deaths)
    undisturbed = evaluate("converge", Doomed, 65, workers=2, out=tmp_path / "one", **QUICK)
    (deaths / "first").touch()
    done = []
    with pytest.warns(RuntimeWarning, match=r"died \(exit code -9\): another flies episodes"):
        disturbed = evaluate(
            "converge", Doomed, 65, workers=2, out=tmp_path / "two", progress=done.append, **QUICK
        )
    assert not list(deaths.iterdir())  # one was killed
    assert (sum(done), len(done)) == (65, 8)
    np.testing.assert_array_equal(numbers(disturbed), numbers(undisturbed))
    for name in ("episodes.csv", "run.json"):
        one, two = ((tmp_path / run / name).read_bytes() for run in ("one", "two"))
        assert one == two
    assert not multiprocessing.active_children()


@pytest.mark.filterwarnings("ignore:a worker process has died")
def test_what_was_flown_before_the_last_death_is_kept(tmp_path, monkeypatch):
    """Each process dies in its second batch; the episodes of the first are in the folder."""
    deaths = tmp_path / "deaths"
    deaths.mkdir()
    monkeypatch.setattr(Doomed, "folder", deaths)
    for k in range(100):
        (deaths / str(k)).touch()
    monkeypatch.setattr("bulletuav.analysis.episodes.MAX_DEATHS", 1)
    with pytest.raises(RuntimeError, match="not flown again"):
        evaluate("converge", Doomed, 40, workers=2, out=tmp_path / "run", **QUICK)
    kept = (tmp_path / "run" / "episodes.csv").read_text().splitlines()
    assert len(kept) > 10
    for file in deaths.iterdir():
        file.unlink()
    done = []
    evaluate("converge", Doomed, 40, out=tmp_path / "run", progress=done.append, **QUICK)
    assert done[0] == len(kept) - 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"task": "convrge"}, "did you mean 'converge'"),
        ({"policy": "orka"}, "did you mean 'orca'"),
        ({"policy": 5}, "policy is 5: a name"),
        ({"policy": "pppo:model.zip"}, "did you mean 'ppo'"),
        ({"episodes": 0}, "episodes is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"workers": 0}, "workers is 0"),
        ({"radios": 3.0}, "did you mean 'radius'"),
        ({"action": "rotor", "dynamics": "bullet"}, "policy 'straight' supports velocity"),
    ],
)
def test_what_cannot_be_is_refused(arguments, said):
    with pytest.raises(ValueError, match=said):
        evaluate(**{"task": "converge", "policy": "straight", "episodes": 1, **QUICK, **arguments})


def test_summary_pictures_and_leaderboard(straight, tmp_path):
    about = json.loads(straight.save(tmp_path).read_text())
    assert about["options"]["radius"] == 30
    assert about["estimates"]["conflict"]["mean"] == 1
    assert about["estimates"]["messages"]["mean"] is None
    plot_evaluation(straight, tmp_path / "one.png")
    orca = evaluate("converge", "orca", 13, seed=4, **QUICK)
    plot_leaderboard([straight, orca], tmp_path / "all.png")
    for name in ("one.png", "all.png"):
        assert np.asarray(Image.open(tmp_path / name).convert("L")).std() > 10
    text = format_leaderboard([straight, orca])
    assert (
        "### converge, medium: 3 drones, point_mass at 240 Hz, 13 episodes, seeds 4 to 16\n" in text
    )
    assert "| straight \\* | 0." in text
    assert "1.00 [0.77, 1.00]" in text
    assert format_leaderboard([straight, orca], "potential") == text  # which is not among them
    paired = format_leaderboard([straight, orca], "orca")
    (line,) = paired.split("More than `orca` in the same episodes:")[1].strip().splitlines()[2:3]
    difference = np.array(
        [one["length"] - two["length"] for one, two in zip(straight.rows, orca.rows, strict=True)]
    )
    assert f"| {difference.mean():.2f} [" in line
    assert (
        "| 1.00 [1.00, 1.00] |" in line
    )  # straight has a conflict in every episode, and orca in none
    assert line.startswith("| straight")
    write_csv([straight, orca], tmp_path / "board.csv")
    with (tmp_path / "board.csv").open() as file:
        rows = list(csv.DictReader(file))
    row = next(row for row in rows if row["policy"] == "orca" and row["metric"] == "conflict")
    assert (row["mean"], row["episodes"], row["task"], row["drones"], row["seed"]) == (
        "0.0",
        "13",
        "converge",
        "3",
        "4",
    )


def test_runs_in_another_city_are_not_gone_on_with(tmp_path):
    path, options = tmp_path / "town.obj", {"dynamics": "point_mass", "leg": 50.0, "horizon": 5}
    for kind in ("suburban", "high_rise"):
        write_obj(generate(kind, 200.0, np.random.default_rng(0)), path)
        expected = (
            contextlib.nullcontext()
            if kind == "suburban"
            else pytest.raises(ValueError, match="its fingerprint is")
        )
        with expected:
            evaluate("navigation", "straight", 1, out=tmp_path / "out", city=str(path), **options)


def cells(text):
    """Of each table of a leaderboard the cells of its rows, the headings first."""
    tables = [part.splitlines() for part in text.split("### ")[1:]]
    rows = [
        [line for line in table if line.startswith("|") and not line.startswith("|---")]
        for table in tables
    ]
    return [
        [[cell.strip() for cell in line.strip("|").split("|")] for line in table] for table in rows
    ]


@pytest.fixture(scope="module")
def served():
    """Two policies and two dynamics in a task over users."""
    options = {"area": 250.0, "num_layouts": 1, "horizon": 4, "num_drones": 2}
    ways = [
        (dynamics, policy)
        for policy in ("random", "kmeans")
        for dynamics in ("single_integrator", "point_mass")
    ]
    return [evaluate("mec", policy, 2, dynamics=dynamics, **options) for dynamics, policy in ways]


COMMON = ["safe success", "success", "drones", "return"]
COMMON += ["conflict", "collision", "nearest m", "time s"]


def test_columns_that_no_episode_has_are_left_out(straight, served):
    goals, users = cells(format_leaderboard([straight, *served[::2]]))
    # No drone succeeds, so none has an efficiency
    assert goals[0] == ["policy", *COMMON, "fairness", "hash"]
    assert users[0] == ["policy", *COMMON, "served", "completed", "latency s", "hash"]
    assert [row[0] for row in users[1:]] == ["random", "kmeans \\*"]
    assert {len(row) for row in goals} == {len(COMMON) + 3}
    assert {len(row) for row in users} == {len(COMMON) + 5}


def test_a_cell_that_an_evaluation_has_not_is_a_dash():
    """Who flies at random is not at its goal after half a second."""
    lost, there = (
        evaluate("converge", "random", 2, **QUICK | {"horizon": 5}),
        evaluate("converge", "orca", 2, **QUICK),
    )
    assert there.estimates()["success"].mean == 1
    (table,) = cells(format_leaderboard([lost, there]))
    ways = [row[table[0].index("efficiency")] for row in table[1:]]
    assert ways[0] == "-"
    assert float(ways[1].split()[0]) > 0.8


def test_dynamics_have_a_column_where_there_are_several(served, tmp_path):
    text = format_leaderboard(served)
    assert (
        "### mec, easy: 2 drones, single_integrator at 240 Hz, point_mass at 240 Hz, 2 episodes"
        in text
    )
    (table,) = cells(text)
    assert table[0] == ["policy", "dynamics", *COMMON, "served", "completed", "latency s", "hash"]
    single, point = "single_integrator at 240 Hz", "point_mass at 240 Hz"
    ways = [["random", single], ["random", point], ["kmeans \\*", single], ["kmeans \\*", point]]
    assert [row[:2] for row in table[1:]] == ways
    for row, result in zip(table[1:], served, strict=True):
        assert row[table[0].index("completed")].startswith(
            f"{result.estimates()['completed'].mean:.2f} ["
        )
    (one,) = cells(format_leaderboard(served[::2]))
    assert "dynamics" not in one[0]
    plot_leaderboard(served, tmp_path / "all.png")
    write_csv(served, tmp_path / "board.csv")
    with (tmp_path / "board.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["metric"] == "completed"]
    assert [row["dynamics"] for row in rows] == ["single_integrator", "point_mass"] * 2
    assert [float(row["mean"]) for row in rows] == [
        result.estimates()["completed"].mean for result in served
    ]
