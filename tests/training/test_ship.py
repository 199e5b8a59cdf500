"""The command that trains policies, and puts the best ones into the package."""

import dataclasses
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from bulletuav.policies import run as run_module
from bulletuav.policies import scores as scores_module
from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.run import CONFIG, FAST, POLICY, RunConfig
from bulletuav.policies.scores import read_scores

ACTED = re.compile(r"action|mlp_extractor\.policy_net")
SMALL = RunConfig(
    "hover",
    FAST,
    steps=64,
    worlds=2,
    evaluations=1,
    episodes=1,
    options={"dynamics": "rigid_body", "difficulty": "medium"},
    evaluation={"horizon": 5},
    model={"n_steps": 8, "batch_size": 16, "policy_kwargs": {"net_arch": [8]}},
)


@pytest.fixture
def ship(tmp_path, monkeypatch):
    path = Path(__file__).parents[2] / "benchmarks" / "ship.py"
    spec = importlib.util.spec_from_file_location("ship", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # An empty package, and a short training
    for one in (run_module, scores_module, module):
        monkeypatch.setattr(one, "SHIPPED", tmp_path / "package")
    monkeypatch.setattr(module, "default_run", lambda task, algo: dataclasses.replace(SMALL))
    return module


def test_the_best_seed_is_put_into_the_package(ship, tmp_path, monkeypatch, capsys):
    runs = [ship.train_seed("hover", seed, tmp_path / "runs") for seed in (0, 1)]
    outcomes = {runs[0]: 0.25, runs[1]: 0.5, "stay": 0.0}
    monkeypatch.setattr(ship, "decide", lambda task, policy, *of: outcomes[policy])
    assert ship.ship_best("hover", runs, 2)
    assert "hover: seed 1 is in the package" in capsys.readouterr().out
    place = tmp_path / "package" / "hover"
    assert {path.relative_to(place).as_posix() for path in place.rglob("*.*")} == {
        CONFIG,
        POLICY,
        f"checkpoints/000/{POLICY}",
    }
    assert RunConfig.read(place / CONFIG).text() == dataclasses.replace(SMALL, seed=1).text()
    for name in (POLICY, f"checkpoints/000/{POLICY}"):
        shipped, learned = read_weights(place / name), read_weights(runs[1] / name)
        # Of the network only the actor
        assert shipped.keys() == {name for name in learned if ACTED.match(name)}
        assert all(np.array_equal(shipped[key], learned[key]) for key in shipped)
    choice = ship.CHOICE.search((place / CONFIG).read_text())[1]
    assert choice.startswith("seeds 0, 1: 0.250, 0.500; CPU-s ")


@pytest.mark.parametrize(
    ("stay", "present", "is_better"),
    [(0.5, 0.0, False), (0.4, 0.6, False), (0.4, 0.5, True)],
)
def test_a_policy_that_is_not_better_stays_out(
    stay, present, is_better, ship, tmp_path, monkeypatch
):
    run = ship.train_seed("hover", 0, tmp_path / "runs")
    outcomes = {run: 1.0, "stay": 0.0}
    monkeypatch.setattr(ship, "decide", lambda task, policy, *of: outcomes[policy])
    assert ship.ship_best("hover", [run], 2)
    place = tmp_path / "package" / "hover"
    before = (place / CONFIG).read_text()
    outcomes |= {run: 0.5, "stay": stay, "trained": present}
    assert ship.ship_best("hover", [run], 2) == is_better
    assert ((place / CONFIG).read_text() != before) == is_better


def test_only_trained_policies_fly_with_the_options_of_their_evaluations(
    ship, tmp_path, monkeypatch
):
    """Their decisions may be slower, and `stay` and baselines have those of the task."""
    run = ship.train_seed("hover", 0, tmp_path / "runs")
    monkeypatch.setattr(ship, "decide", lambda task, policy, *of: float(policy == run))
    assert ship.ship_best("hover", [run], 2)
    assert ship.evaluation_options("hover", "trained") == {"horizon": 5}
    assert ship.evaluation_options("hover", run) == {"horizon": 5}
    assert ship.evaluation_options("hover", "stay") == {}


def test_scores_are_written_beside_the_policy_and_into_the_page(ship, tmp_path, monkeypatch):
    run = ship.train_seed("hover", 0, tmp_path / "runs")
    monkeypatch.setattr(ship, "decide", lambda task, policy, *of: float(policy == run))
    assert ship.ship_best("hover", [run], 2)
    ship.measure("hover", ["hard"], 1)
    ship.measure("hover", ["easy"], 1)
    path = tmp_path / "package" / "hover" / "scores.yaml"
    scores = read_scores("hover")
    assert list(scores) == ["easy", "hard"]
    assert list(scores["easy"]) == ["episodes", "trained", "stay", "straight"]
    page = tmp_path / "page.md"
    ship.write_page(page)
    lines = page.read_text().splitlines()
    low, high = scores["easy"]["trained"][1:]
    assert lines[-2].startswith(f"| `hover` | easy | 0.00 [{low:.2f}, {high:.2f}] | ")
    assert lines[-2].endswith("`straight` \\* | 1 |")  # the baseline reads the true state
    assert lines[-1].startswith("| `hover` | hard | ")
    assert any("difficulty medium, dynamics rigid_body" in line for line in lines)
    assert max(map(len, lines)) <= 240
    # Another policy has not been measured
    monkeypatch.setattr(ship, "decide", lambda task, policy, *of: float(policy != "stay"))
    assert ship.ship_best("hover", [run], 2)
    assert not path.exists()


def test_only_levels_that_policies_can_fly_decide(ship, tmp_path, monkeypatch):
    run = ship.train_seed("hover", 0, tmp_path / "runs")
    flown = []

    def decide(task, policy, episodes, levels):
        flown.append(list(levels))
        return float(policy == run)

    monkeypatch.setattr(ship, "decide", decide)
    assert ship.ship_best("hover", [run], 2, ["easy", "hard"])
    assert ship.ship_best("hover", [run], 2, ["easy", "hard"])
    assert flown == [["easy"], ["easy"], ["easy"], ["easy"], ["easy", "hard"], ["easy", "hard"]]


def test_a_level_has_to_decide(ship, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["ship.py", "hover", "--levels", "hard", "extreme"])
    with pytest.raises(SystemExit):
        ship.main()
    assert "--levels hard extreme: easy or medium has to decide" in capsys.readouterr().err
