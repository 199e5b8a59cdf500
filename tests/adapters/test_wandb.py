"""Logging of trainings to Weights & Biases, here by a stand-in for the library, which is large."""

import dataclasses
import sys
import types

import pytest

from bulletuav.policies.run import FAST, RunConfig
from bulletuav.training.trainer import train

CONFIG = RunConfig(
    "hover",
    FAST,
    steps=64,
    worlds=2,
    options={"dynamics": "point_mass", "action": "velocity", "horizon": 10},
    model={"n_steps": 8, "batch_size": 16},
    evaluations=2,
    episodes=1,
)


class Run:
    """A run: the arguments of its creation, what it logged, and how it ended."""

    def __init__(self, **arguments):
        self.arguments, self.logged, self.end = arguments, {}, None

    def log(self, values, step):
        self.logged.setdefault(step, {}).update(values)

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self.end = kind


@pytest.fixture
def runs(monkeypatch):
    """The runs that trainings created."""
    found = []
    errors = types.SimpleNamespace(Error=type("Error", (Exception,), {}))

    def init(**arguments):
        if arguments["project"] == "closed":
            raise errors.Error("no account")
        found.append(Run(**arguments))
        return found[-1]

    monkeypatch.setitem(sys.modules, "wandb", types.SimpleNamespace(init=init, errors=errors))
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.wandb", raising=False)
    monkeypatch.delenv("WANDB_PROJECT", raising=False)
    yield found
    sys.modules.pop("bulletuav.adapters.wandb", None)


def test_a_training_logs_its_settings_and_curves(runs, tmp_path):
    rows = train(CONFIG, tmp_path, tracker="wandb")
    (run,) = runs
    assert run.arguments["name"] == "hover-fast_ppo-0"
    assert run.arguments["project"] == "bulletuav"
    assert run.arguments["config"]["steps"] == 64
    assert "1 episode" in run.arguments["config"]["evaluation/conditions"]
    for row in rows:
        assert run.logged[row["steps"]]["evaluation/return"] == row["return"]
    assert any("train/value_loss" in values for values in run.logged.values())
    assert all(value == value for values in run.logged.values() for value in values.values())
    assert run.end is None


def test_an_interrupted_training_continues_its_run(runs, tmp_path):
    def interrupt(done):
        if done > 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, tmp_path, interrupt, tracker="wandb")
    assert runs[0].end is KeyboardInterrupt
    train(CONFIG, tmp_path, tracker="wandb")
    assert runs[1].arguments["id"] == runs[0].arguments["id"]
    assert {run.arguments["resume"] for run in runs} == {"allow"}
    assert runs[1].end is None
    other = dataclasses.replace(CONFIG, seed=1)
    train(other, tmp_path / "other", tracker="wandb")
    assert runs[2].arguments["id"] != runs[0].arguments["id"]


def test_a_rejected_run_is_an_error_that_names_the_remedy(runs, tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_PROJECT", "closed")
    with pytest.raises(RuntimeError, match="no account; log in .* WANDB_MODE=offline"):
        train(CONFIG, tmp_path, tracker="wandb")


def test_the_missing_extra_and_unknown_trackers_are_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "wandb", None)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.wandb", raising=False)
    with pytest.raises(ImportError, match="needs the extra 'wandb'"):
        train(CONFIG, tmp_path, tracker="wandb")
    with pytest.raises(ValueError, match="mlflow"):
        train(CONFIG, tmp_path, tracker="mlfow")
    assert not list(tmp_path.iterdir())
