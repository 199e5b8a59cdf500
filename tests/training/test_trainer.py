import contextlib
import dataclasses
import importlib.util
import math
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import bulletuav
from bulletuav.adapters.sb3 import algorithm
from bulletuav.charts import plot_curves
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.training.campaign import Campaign, learning_table
from bulletuav.training.models import make_model
from bulletuav.training.store import Store, opened
from bulletuav.training.trainer import train

OPTIONS = {"dynamics": "single_integrator", "num_drones": 2, "difficulty": "easy", "horizon": 12, "observation": ["goal"]}
MODELS = {
    "ppo": {"n_steps": 16, "batch_size": 64},
    "a2c": {"n_steps": 8},
    "dqn": {"learning_starts": 40, "batch_size": 32, "buffer_size": 500},
    "sac": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
    "td3": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
    "ddpg": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
}


def config(algo="ppo", **changes):
    options = {**OPTIONS, "action": "discrete"} if algo == "dqn" else OPTIONS
    run = RunConfig("converge", algo, steps=200, worlds=2, options=options, model=MODELS[algo], evaluations=3, episodes=1)
    return dataclasses.replace(run, evaluation={"dynamics": "single_integrator", "horizon": 5}, **changes)


def weights(folder, algo="ppo", name="model.zip"):
    model = algorithm(algo).load(folder / name, device="cpu")
    return torch.cat([one.detach().ravel().float() for one in model.policy.state_dict().values()])


def interrupt_after(steps):
    def progress(done):
        if done > steps:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("algo", MODELS)
def test_an_interrupted_run_goes_on_to_the_weights_of_one_that_was_not(tmp_path, algo):
    rows = train(config(algo), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(config(algo), tmp_path / "cut", interrupt_after(150))
    assert 1 < len(Store(tmp_path / "cut", config(algo)).rows) < len(rows)
    again = train(config(algo), tmp_path / "cut")
    assert torch.equal(weights(tmp_path / "whole", algo), weights(tmp_path / "cut", algo))
    assert [row["steps"] for row in again] == [row["steps"] for row in rows]
    assert [row["return"] for row in again] == [row["return"] for row in rows]
    assert not torch.equal(weights(tmp_path / "whole", algo, "checkpoints/000.zip"), weights(tmp_path / "whole", algo))
    assert len(list((tmp_path / "whole").glob("checkpoints/*.replay.pkl"))) == (algo not in ("ppo", "a2c"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    return folder, train(config(), folder)


def test_run_yaml_reproduces_the_run(run, tmp_path):
    folder, _ = run
    told = RunConfig.read(folder / "run.yaml")
    assert told.text() == config().text()
    assert "stable_baselines3" in (folder / "run.yaml").read_text().splitlines()[0]
    train(told, tmp_path)
    assert torch.equal(weights(folder), weights(tmp_path))


def test_another_seed_gives_other_weights(run, tmp_path):
    train(config(seed=1), tmp_path)
    assert not torch.equal(weights(run[0]), weights(tmp_path))


def test_the_curve_begins_before_learning_and_ends_with_the_last_step(run):
    folder, rows = run
    assert [row["steps"] for row in rows] == [0, 128, 192, 256]
    assert all(math.isnan(rows[0][name]) for name in rows[0] if name.startswith("train/"))
    assert rows[0]["seconds"] == 0.0
    assert all(row["seconds"] > 0 for row in rows[1:])
    assert rows[-1]["decisions"] == 256
    assert -200 < rows[1]["train/return"] < 200
    assert rows[1]["train/decisions"] == 12
    lines = (folder / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("steps,decisions,level,seconds,train/return")
    assert len(lines) == 5
    assert list((folder / "tensorboard").glob("events.*"))


def test_a_finished_run_is_not_trained_again(run):
    folder, rows = run
    before = (folder / "model.zip").stat().st_mtime_ns
    done = []
    np.testing.assert_equal(train(config(), folder, done.append), rows)
    assert done == [200]
    assert (folder / "model.zip").stat().st_mtime_ns == before


def test_the_folder_of_another_run_is_refused(run):
    with pytest.raises(ValueError, match="holds another run: its steps is 200, not 300"):
        train(config(steps=300), run[0])


def test_a_folder_that_another_process_trains_in_is_refused(tmp_path):
    with opened(tmp_path, config()), pytest.raises(ValueError, match="by another process"):
        train(config(), tmp_path)


def test_a_run_ends_with_the_process_that_wants_it(tmp_path):
    """Killed, so that it cannot end its runs itself."""
    script = "from training.test_trainer import config; from bulletuav.training.campaign import Campaign; "
    script += f"Campaign([config(steps=10**7)], __import__('pathlib').Path({str(tmp_path)!r})).train()"
    process = subprocess.Popen([sys.executable, "-c", script], cwd=Path(__file__).parents[1])
    store = tmp_path / "converge" / "0"
    wait_until(lambda: (store / "state.json").exists())
    with pytest.raises(ValueError, match="by another process"):
        train(config(steps=10**7), store)
    process.kill()
    process.wait()

    def is_free():
        with contextlib.suppress(ValueError), opened(store, config(steps=10**7)):
            return True

    wait_until(is_free)


def wait_until(done, seconds=60):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_damaged_or_impossible_folder_is_refused(run, tmp_path):
    (tmp_path / "run.yaml").write_text(config().text())
    (tmp_path / "state.json").write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        train(config(), tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot be a folder to write to"):
        train(config(), tmp_path / "file")


def test_a_run_flies_with_the_observation_that_it_learned_with(run):
    folder, _ = run
    pilot = find_policy(folder)
    assert pilot.options == {"observation": ["goal"]}
    calm = {"dynamics": "single_integrator", "difficulty": "easy", "horizon": 5}
    result = bulletuav.evaluate("converge", str(folder), 1, **calm)
    assert result.about["options"]["observation"] == ["goal"]
    assert result.about["options"]["num_drones"] == 4  # and not as many as in training
    with pytest.raises(ValueError, match="was trained for observations"):
        bulletuav.evaluate("converge", str(folder), 1, observation="position", **calm)
    with pytest.raises(FileNotFoundError, match=r"run\.yaml of a run"):
        find_policy(folder / "checkpoints")


def test_a_curriculum_goes_on_where_it_was(tmp_path):
    levels = [{"num_drones": 1}, {"num_drones": 2}]
    easy = {"up": 0.1, "down": 0.0, "window": 1}
    learner = config(levels=levels, curriculum=easy, options={**OPTIONS, "goal_radius": 300.0})
    rows = train(learner, tmp_path / "whole")
    assert rows[-1]["level"] == 1
    assert rows[-1]["decisions"] < rows[-1]["steps"]  # the slot of the second drone was empty at first
    with pytest.raises(KeyboardInterrupt):
        train(learner, tmp_path / "cut", interrupt_after(150))
    train(learner, tmp_path / "cut")
    assert torch.equal(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": {"gama": 0.9}}, "settings of model ppo.*gama"),
        ({"model": {"features": "symlg"}}, "did you mean 'symlog'"),
        ({"algo": "sac", "options": {**OPTIONS, "action": "discrete"}, "model": {}}, "model sac.*only supports"),
        ({"options": {**OPTIONS, "observation": ["goal", "rgb"]}}, "one drone a world"),
        ({"curriculum": {"up": 2.0}}, "0 <= down < up <= 1"),
        ({"options": {"dynamic": "bullet"}}, "did you mean 'dynamics'"),
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path, changes, said):
    with pytest.raises(ValueError, match=said):
        train(config(**changes), tmp_path)


def test_pictures_can_be_learned_from(tmp_path):
    options = {"num_drones": 1, "observation": ["goal", "rgb"], "camera_size": [36, 36], "dynamics": "single_integrator"}
    learner = config(options={**options, "horizon": 4}, steps=32, model={"n_steps": 8}, evaluations=1)
    assert train(learner, tmp_path)[-1]["steps"] == 32


def test_learning_rates_may_fall_and_features_be_left_out():
    from bulletuav.adapters.sb3 import DroneVecEnv

    env = DroneVecEnv("converge", 1, **OPTIONS)
    model = make_model(config(model={"n_steps": 8, "learning_rate": [1e-3, 1e-4], "features": None}), env)
    assert model.lr_schedule(1.0) == 1e-3
    assert model.lr_schedule(0.5) == pytest.approx(5.5e-4)
    assert model.lr_schedule(0.0) == pytest.approx(1e-4)
    assert type(model.policy.features_extractor).__name__ == "FlattenExtractor"
    env.close()


def test_a_campaign_trains_all_in_processes_as_one_would(run, tmp_path):
    campaign = Campaign([config(), config(seed=1)], tmp_path)
    done = []
    runs = campaign.train(2, done.append)
    assert [one.seed for one, _ in runs] == [0, 1]
    assert torch.equal(weights(tmp_path / "converge" / "0"), weights(run[0]))
    assert done[-1] == campaign.total == 400
    table = learning_table(runs)
    assert table.count("\n") == 4
    assert "| converge | ppo | 1 | 256 |" in table
    plot_curves(runs, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="settings of model"):
        Campaign([config(model={"gama": 1.0})], tmp_path / "other").train()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("task: crosing", "did you mean 'crossing'"),
        ("task: crossing\nstep: 5", "did you mean 'steps'"),
        ("steps: 5", "a run without a task"),
        ("task: crossing\nsteps: 2.5", "steps is 2.5"),
        ("task: crossing\nalgo: pppo", "did you mean 'ppo'"),
        ("task: crossing\nlevels: {a: 1}", "levels is"),
        ("task: crossing\nmodel: 5", "model is 5"),
        ("task: [", "is no YAML file"),
        ("crossing", "names with values are needed"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused(tmp_path, text, said):
    (tmp_path / "run.yaml").write_text(text)
    with pytest.raises(ValueError, match=said):
        RunConfig.read(tmp_path / "run.yaml")


def test_steps_may_be_written_as_people_do(tmp_path):
    (tmp_path / "run.yaml").write_text("task: crossing\nsteps: 2e6\n")
    assert RunConfig.read(tmp_path / "run.yaml").steps == 2_000_000
    with pytest.raises(FileNotFoundError, match="no file"):
        RunConfig.read(tmp_path / "none.yaml")


def test_a_configuration_is_the_same_after_a_file(tmp_path):
    told = dataclasses.replace(
        config(), options={**OPTIONS, "height": (1.0, 2.0), "wind": np.array([1.0, 0.0, 0.0]).tolist()}
    )
    (tmp_path / "run.yaml").write_text(told.text())
    assert RunConfig.read(tmp_path / "run.yaml").text() == told.text()


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "yaml", None)
    with pytest.raises(ImportError, match=r"bulletuav\[sb3\]"):
        config().text()


def test_the_best_run_is_shipped_without_what_only_training_needs(run, tmp_path, monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("ship", Path(__file__).parents[2] / "benchmarks" / "ship.py")
    ship = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(ship)
    package, learned = tmp_path / "trained", tmp_path / "learned" / "runs" / "converge"
    (package / "converge").mkdir(parents=True)
    (package / "converge" / "run.yaml").write_text(f"# ours\n{config().text()}")
    for seed, outcome in (("0", "1.0"), ("1", "2.0")):
        shutil.copytree(run[0], learned / seed)
        (learned / seed / "run.yaml").write_text(config(seed=int(seed)).text())
        (learned / seed / "curve.csv").write_text(f"steps,return\n0,5.0\n256,{outcome}\n")
    monkeypatch.setattr(ship, "SHIPPED", package)
    monkeypatch.setattr(ship, "shipped_tasks", lambda: ["converge"])
    monkeypatch.setattr("sys.argv", ["ship.py", str(tmp_path / "learned")])
    ship.main()
    assert "converge: seed 1" in capsys.readouterr().out
    assert (package / "converge" / "run.yaml").read_text().startswith("# ours\n")
    assert RunConfig.read(package / "converge" / "run.yaml").seed == 1
    assert torch.equal(weights(package / "converge"), weights(run[0]))
    assert (package / "converge" / "model.zip").stat().st_size < 0.7 * (run[0] / "model.zip").stat().st_size
    (learned / "1" / "run.yaml").write_text(config(seed=1, steps=7).text())
    with pytest.raises(SystemExit, match="other settings"):
        ship.main()
