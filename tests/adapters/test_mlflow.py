"""Logging of trainings to MLflow."""

import csv
import dataclasses
import sys

import pytest
from inline import no_processes
from mlflow import MlflowClient

from bulletuav.adapters.mlflow import EXPERIMENT, RUN_ID
from bulletuav.cli import main
from bulletuav.policies.run import RunConfig
from bulletuav.training import campaign
from bulletuav.training.trainer import train

OPTIONS = {
    "dynamics": "single_integrator",
    "num_drones": 2,
    "difficulty": "easy",
    "horizon": 12,
    "observation": ["goal"],
}
CONFIG = RunConfig(
    "converge",
    steps=200,
    worlds=2,
    options=OPTIONS,
    model={"n_steps": 16, "batch_size": 64},
    evaluations=2,
    episodes=1,
    evaluation={"dynamics": "single_integrator", "horizon": 5},
)


@pytest.fixture
def client(tmp_path, monkeypatch):
    """MLflow on files, which take no server."""
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"file:{tmp_path}/told")
    return MlflowClient()


def runs(client):
    """All runs that MLflow knows."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    return client.search_runs([experiment.experiment_id])


def columns(file, name):
    """Steps and values of a column, without those that are no number."""
    with open(file, newline="") as text:
        rows = list(csv.DictReader(text))
    told = [(int(float(row["steps"])), float(row[name])) for row in rows]
    return [one for one in told if one[1] == one[1]]


def test_settings_and_curves_are_those_of_the_folder(client, tmp_path):
    """Also of a training that was interrupted, which goes on in the same run."""

    def interrupt(done):
        if done > 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(CONFIG, tmp_path / "run", interrupt, tracker="mlflow")
    assert [run.info.status for run in runs(client)] == ["KILLED"]
    train(CONFIG, tmp_path / "run", tracker="mlflow")
    (run,) = runs(client)
    assert (tmp_path / "run" / RUN_ID).read_text().strip() == run.info.run_id
    assert (run.info.run_name, run.info.status) == ("converge-ppo-0", "FINISHED")
    assert (run.data.params["task"], run.data.params["steps"]) == ("converge", "200")
    assert run.data.params["options"] == str(OPTIONS)
    assert "1 episode, seed 1000000" in run.data.tags["evaluation/conditions"]
    for name, file, column in (
        ("evaluation/return", "curve.csv", "return"),
        ("rollout/return", "updates.csv", "rollout/return"),
        ("train/loss", "updates.csv", "train/loss"),
    ):
        history = {one.step: one.value for one in client.get_metric_history(run.info.run_id, name)}
        kept = dict(columns(tmp_path / "run" / file, column))
        assert kept == pytest.approx({step: history[step] for step in kept}), name
        assert kept, name


def test_a_training_that_fails_is_told_as_such(client, tmp_path):
    """Here one whose model cannot be made."""
    broken = dataclasses.replace(CONFIG, model={**CONFIG.model, "learning_rate": "fast"})
    with pytest.raises(ValueError, match="fast"):
        train(broken, tmp_path / "run", tracker="mlflow")
    assert [run.info.status for run in runs(client)] == ["FAILED"]


def test_several_seeds_are_several_runs(client, tmp_path, monkeypatch):
    """Here one after the other, in the process of the test."""
    monkeypatch.setattr(campaign, "training_processes", no_processes)
    sets = [f"--set={name}={value}" for name, value in (("horizon", 12), ("num_drones", 2))]
    usual = ["--steps", "64", "--worlds", "2", "--evaluations", "1", "--episodes", "1"]
    usual += [
        "--model",
        "n_steps=16",
        "--model",
        "batch_size=32",
        "--seeds",
        "0,1",
        "--tracker",
        "mlflow",
    ]
    out = ["--out", str(tmp_path / "out"), "--dynamics", "single_integrator"]
    main(["train", "obstacles", *sets, *usual, *out])
    assert sorted(run.info.run_name for run in runs(client)) == [
        "obstacles-ppo-0",
        "obstacles-ppo-1",
    ]


def test_a_place_that_is_none_is_told_before_anything_is_trained(tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "nowhere://here")
    with pytest.raises(RuntimeError, match="MLflow rejects the run: .*MLFLOW_TRACKING_URI"):
        train(CONFIG, tmp_path, tracker="mlflow")
    assert not (tmp_path / "curve.csv").exists()


def test_the_extra_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mlflow", None)
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.mlflow")
    with pytest.raises(ImportError, match="logging a training to MLflow needs the extra 'mlflow'"):
        train(CONFIG, tmp_path / "run", tracker="mlflow")
