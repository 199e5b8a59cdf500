import contextlib
import csv
import dataclasses
import json
import math
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from waiting import PATIENCE, until

import bulletuav
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.run import RunConfig
from bulletuav.report.charts import plot_curves
from bulletuav.sensors.imperfect import Imperfect
from bulletuav.sensors.imu import Imu
from bulletuav.training.campaign import (
    Campaign,
    describe_wall_time,
    learning_table,
    training_processes,
)
from bulletuav.training.models import make_model
from bulletuav.training.store import WALL_COLUMNS, Store, open_store
from bulletuav.training.trainer import train

OPTIONS = {
    "dynamics": "single_integrator",
    "num_drones": 2,
    "difficulty": "easy",
    "horizon": 12,
    "observation": ["goal"],
}
MODELS = {
    "ppo": {"n_steps": 16, "batch_size": 64},
    "a2c": {"n_steps": 8},
    "dqn": {"learning_starts": 40, "batch_size": 32, "buffer_size": 500},
    "sac": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
    "td3": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
    "ddpg": {"learning_starts": 40, "batch_size": 32, "gradient_steps": 1, "buffer_size": 500},
}


def config(**changes):
    algo = changes.setdefault("algo", "ppo")
    options = {**OPTIONS, "action": "discrete"} if algo == "dqn" else OPTIONS
    usual = {
        "steps": 200,
        "worlds": 2,
        "options": options,
        "model": MODELS[algo],
        "evaluations": 3,
        "episodes": 1,
    }
    evaluation = {"dynamics": "single_integrator", "horizon": 5}
    return RunConfig("converge", **{**usual, "evaluation": evaluation, **changes})


def weights(folder, name="policy.safetensors"):
    found = read_weights(folder / name)
    return np.concatenate([found[known].ravel() for known in sorted(found)])


FIRST = "checkpoints/000/policy.safetensors"


def interrupt_after(steps):
    def progress(done):
        if done > steps:
            raise KeyboardInterrupt

    return progress


CASES = {algo: {"algo": algo} for algo in MODELS} | {
    "chapters shorter than a rollout": {"evaluations": 20},
    "ppo, noise of states": {"model": {**MODELS["ppo"], "use_sde": True}},
    "sac, noise of states": {
        "algo": "sac",
        "model": {**MODELS["sac"], "use_sde": True, "train_freq": [4, "step"]},
    },
}


def comparable(rows):
    wall = ("seconds", *WALL_COLUMNS)
    return [{name: value for name, value in row.items() if name not in wall} for row in rows]


SLOW = {"ddpg": pytest.mark.slow}  # which is TD3 with other settings


@pytest.mark.parametrize(
    "changes",
    [pytest.param(changes, id=name, marks=SLOW.get(name, ())) for name, changes in CASES.items()],
)
def test_an_interrupted_run_goes_on_to_the_weights_of_one_that_was_not(tmp_path, changes):
    learner = config(**changes)
    rows = train(learner, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(learner, tmp_path / "cut", interrupt_after(150))
    assert 1 < len(Store(tmp_path / "cut", learner).rows) < len(rows)
    again = train(RunConfig.read(tmp_path / "cut" / "run.yaml"), tmp_path / "cut")
    np.testing.assert_equal(comparable(again), comparable(rows))
    whole = weights(tmp_path / "whole")
    np.testing.assert_array_equal(weights(tmp_path / "cut"), whole)
    told = [(tmp_path / name / "updates.csv").read_text() for name in ("whole", "cut")]
    assert told[0] == told[1]
    assert not np.array_equal(weights(tmp_path / "whole", FIRST), whole)
    assert len(list((tmp_path / "whole").glob("checkpoints/*/training.safetensors"))) == 1
    assert len(list((tmp_path / "whole").glob("checkpoints/*/replay.safetensors"))) == (
        learner.algo not in ("ppo", "a2c")
    )


@pytest.mark.parametrize(
    ("name", "call"),
    [("shutil.copyfile", 4), ("replace_file", 11), ("replace_file", 12), ("replace_file", 13)],
)
def test_a_kill_between_two_files_of_the_last_chapter_costs_no_more_than_it(
    tmp_path, monkeypatch, run, name, call
):
    calls = []
    original = shutil.copyfile if name == "shutil.copyfile" else replace_file

    def killed(*arguments):
        calls.append(arguments)
        if len(calls) == call:
            raise KeyboardInterrupt
        return original(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(f"bulletuav.training.store.{name}", killed)
        with pytest.raises(KeyboardInterrupt):
            train(config(), tmp_path)
    assert len(Store(tmp_path, config()).rows) == 3
    np.testing.assert_equal(comparable(train(config(), tmp_path)), comparable(run[1]))
    np.testing.assert_array_equal(weights(tmp_path), weights(run[0]))
    assert (tmp_path / "curve.csv").read_text().count("\n") == 5


def test_the_versions_of_a_run_leave_out_pybullet_where_it_is_not_installed(tmp_path, monkeypatch):
    monkeypatch.setattr("bulletuav.training.store.HAS_BULLET", False)
    Store(tmp_path, config())
    first_line = (tmp_path / "run.yaml").read_text().splitlines()[0]
    assert "numba" in first_line
    assert "pybullet" not in first_line


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
    np.testing.assert_array_equal(weights(folder), weights(tmp_path))


def test_another_seed_gives_other_weights(run, tmp_path):
    train(config(seed=1), tmp_path)
    assert not np.array_equal(weights(run[0]), weights(tmp_path))


def test_the_curve_begins_before_learning_and_ends_with_the_last_step(run):
    folder, rows = run
    assert [row["steps"] for row in rows] == [0, 128, 192, 256]
    assert all(math.isnan(rows[0][name]) for name in rows[0] if name.startswith("train/"))
    assert rows[0]["simulation"] + rows[0]["update"] < rows[0]["evaluation"]
    for row in rows[1:]:
        assert min(row[name] for name in WALL_COLUMNS) > 0
        assert row["seconds"] == pytest.approx(sum(row[name] for name in WALL_COLUMNS))
    assert describe_wall_time(rows).count("%") == 3
    assert rows[-1]["decisions"] == 256
    assert -200 < rows[1]["train/return"] < 200
    assert rows[1]["train/decisions"] == 12
    lines = (folder / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("steps,decisions,stage,seconds,simulation,update,evaluation,")
    assert len(lines) == 5


def test_each_update_is_told_to_tensorboard_and_a_table(run):
    folder, rows = run
    with (folder / "updates.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["steps"]) for row in table] == [64, 128, 192, 256]
    assert all(row["train/value_loss"] for row in table)
    last = [float(row["rollout/return"]) for row in table]
    assert np.mean(last[:2]) == pytest.approx(rows[1]["train/return"])
    told = EventAccumulator(str(folder / "tensorboard")).Reload()
    points = told.Scalars("rollout/return")
    assert [point.step for point in points] == [64, 128, 192, 256]
    assert [point.value for point in points] == pytest.approx(last, rel=1e-6)
    assert len(told.Scalars("evaluation/return")) == 4
    for name, part in (("rollout", "training episodes of seed 0"), ("evaluation", "seed 1000000")):
        (text,) = told.Tensors(f"{name}/conditions/text_summary")
        assert part in str(text.tensor_proto.string_val)


def test_long_runs_tell_of_a_thousand_updates(tmp_path, monkeypatch):
    monkeypatch.setattr("bulletuav.training.segments.MAX_UPDATES", 2)
    train(config(), tmp_path)
    assert (tmp_path / "updates.csv").read_text().count("\n") == 3  # at 128 and 256 of 200 steps


def test_training_says_how_it_goes(tmp_path):
    said = []
    train(config(), tmp_path, note=said.append)
    assert re.fullmatch(
        r"training return -?[\d.]+, training success \d\.\d\d at easy, [\d,]+ steps/s", said[-1]
    )


def test_a_run_of_an_older_version_is_still_read(run, tmp_path):
    shutil.copytree(run[0], tmp_path / "run")
    (tmp_path / "run" / "updates.csv").unlink()
    path = tmp_path / "run" / "state.json"
    state = json.loads(path.read_text())
    state["rows"] = [
        {name: value for name, value in row.items() if name not in WALL_COLUMNS}
        for row in state["rows"]
    ]
    path.write_text(json.dumps(state))
    rows = train(config(), tmp_path / "run")
    np.testing.assert_equal(comparable(rows), comparable(run[1]))
    assert math.isnan(rows[-1]["update"])


@pytest.mark.slow
def test_signals_cost_no_more_than_the_chapter_that_they_cut(tmp_path):
    """The command itself, stopped by Ctrl-C, then as a job is, then as by a power cut."""
    learner = config(steps=6000, evaluations=60)
    train(learner, tmp_path / "whole")
    (tmp_path / "run.yaml").write_text(learner.text())
    folder, reached = tmp_path / "cut", 0
    command = [sys.executable, "-m", "bulletuav", "train", "--config", str(tmp_path / "run.yaml")]
    for number, code in ((2, 130), (15, -15), (9, -9)):
        process = subprocess.Popen(
            [*command, "--out", str(folder)], stderr=subprocess.PIPE, text=True
        )
        until(lambda: count_rows(folder) > reached + 2)  # noqa: B023 - ends at once
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE)
        assert process.returncode == code, said
        assert ("the same command resumes" in said) == (number == 2)
        reached = count_rows(folder)
        assert reached < 60
    train(learner, folder)
    np.testing.assert_array_equal(weights(folder), weights(tmp_path / "whole"))
    tables = [(tmp_path / name / "updates.csv").read_text() for name in ("cut", "whole")]
    assert tables[0] == tables[1]


def count_rows(folder):
    state = folder / "state.json"
    return len(json.loads(state.read_text())["rows"]) if state.exists() else 0


def test_a_finished_run_is_not_trained_again(run):
    folder, rows = run
    before = (folder / "policy.safetensors").stat().st_mtime_ns
    done = []
    np.testing.assert_equal(train(config(), folder, done.append), rows)
    assert done == [200]
    assert (folder / "policy.safetensors").stat().st_mtime_ns == before


def test_the_folder_of_another_run_is_refused(run):
    with pytest.raises(ValueError, match="holds another run: its steps is 200, not 300"):
        train(config(steps=300), run[0])


def test_a_folder_that_another_process_trains_in_is_refused(tmp_path):
    with open_store(tmp_path, config()), pytest.raises(ValueError, match="by another process"):
        train(config(), tmp_path)


@pytest.mark.slow
def test_a_run_ends_with_the_process_that_wants_it(tmp_path):
    """Killed, so that it cannot end its runs itself."""
    script = "; ".join(
        (
            "from pathlib import Path",
            "from training.test_trainer import config",
            "from bulletuav.training.campaign import Campaign",
            f"Campaign([config(steps=10**7)], Path({str(tmp_path)!r})).train()",
        )
    )
    process = subprocess.Popen([sys.executable, "-c", script], cwd=Path(__file__).parents[1])
    store = tmp_path / "converge" / "0"
    until(lambda: (store / "state.json").exists())
    with pytest.raises(ValueError, match="by another process"):
        train(config(steps=10**7), store)
    workers = [child.pid for child in psutil.Process(process.pid).children(recursive=True)]
    assert workers
    process.kill()
    process.wait()

    def is_free():
        with contextlib.suppress(ValueError), open_store(store, config(steps=10**7)):
            return True

    until(is_free)
    until(lambda: not any(psutil.pid_exists(pid) for pid in workers))


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
    assert pilot.options == {"observation": ("goal",)}
    calm = {"dynamics": "single_integrator", "difficulty": "easy", "horizon": 5}
    result = bulletuav.evaluate("converge", str(folder), 1, **calm)
    assert result.about["options"]["observation"] == ["goal"]
    assert result.about["options"]["num_drones"] == 4  # and not as many as in training
    with pytest.raises(ValueError, match=r"trained for task 'converge' with \['goal'\]"):
        bulletuav.evaluate("converge", str(folder), 1, observation="position", **calm)
    with pytest.raises(FileNotFoundError, match=r"run\.yaml of a run"):
        find_policy(folder / "checkpoints")


def test_sensors_and_the_limit_of_climbs_hold_where_the_policy_flies():
    """With options of training alone beside them, such as noise."""
    held = {"sensors": (Imperfect(Imu(), delay=0.1),), "max_climb": 2.0}
    told = RunConfig("hover", options={**held, "randomization": {"imu_noise": 0.1}})
    assert told.interface == held


def test_what_a_preset_says_of_actions_holds_where_the_policy_flies():
    told = RunConfig("hover", options={"preset": "hover_aviary"})
    assert told.interface == {"action": "hover_rpm"}
    assert told.evaluated == {"action": "hover_rpm", "preset": "hover_aviary"}
    stages = [{"num_drones": 2}, {"num_drones": 4, "decision_hz": 5}]
    told = RunConfig(
        "converge", options={"dynamics": "point_mass", "difficulty": "easy"}, stages=stages
    )
    assert told.evaluated == {"num_drones": 4, "decision_hz": 5, "difficulty": "easy"}


def test_a_model_leaves_global_random_states_alone(run):
    aviary = bulletuav.Aviary("converge", 1, **OPTIONS)
    states = []
    for policy in ("straight", run[0]):
        torch.manual_seed(5)
        random.seed(5)
        np.random.seed(5)  # noqa: NPY002
        find_policy(policy)(aviary)
        states.append((torch.rand(1).item(), random.random(), np.random.rand()))  # noqa: NPY002
    aviary.close()
    assert states[0] == states[1]


def test_untrained_is_what_the_run_began_with(run):
    folder, _ = run
    aviary = bulletuav.Aviary("converge", 1, **OPTIONS)
    observations, actions = aviary.reset(seeds=0), []
    for path in (folder / "checkpoints" / "000", folder / "checkpoints" / "003", folder):
        actions.append(find_policy(path)(aviary).act(observations, aviary.swarm))
    env = DroneVecEnv("converge", config().worlds, **OPTIONS)
    model = make_model(config(), env)
    env.close()
    aviary.close()
    np.testing.assert_allclose(
        actions[0][0], model.predict(observations[0], deterministic=True)[0], atol=1e-6
    )
    assert not np.array_equal(actions[0], actions[1])
    np.testing.assert_array_equal(actions[1], actions[2])


def test_a_folder_where_nothing_was_learned_yet_may_be_used_again(tmp_path):
    with pytest.raises(ValueError, match="gama"):
        train(config(model={"gama": 0.9}), tmp_path)
    assert train(config(), tmp_path)[-1]["steps"] == 256


def test_other_versions_are_told(tmp_path, run):
    shutil.copytree(run[0], tmp_path / "run")
    path = tmp_path / "run" / "run.yaml"
    path.write_text("# bulletuav 0.0.9\n" + config().text())
    train(config(), tmp_path / "run")  # which is finished
    assert path.read_text().startswith("# bulletuav 0.0.9\n")
    with pytest.raises(KeyboardInterrupt):
        train(config(), tmp_path / "cut", interrupt_after(150))
    (tmp_path / "cut" / "run.yaml").write_text("# bulletuav 0.0.9\n" + config().text())
    with pytest.warns(UserWarning, match=r"was begun with bulletuav 0\.0\.9"):
        train(config(), tmp_path / "cut")


def test_a_curriculum_goes_on_where_it_was(tmp_path):
    stages = [{"num_drones": 1}, {"num_drones": 2}]
    easy = {"up": 0.1, "down": 0.0, "window": 1}
    learner = config(stages=stages, curriculum=easy, options={**OPTIONS, "goal_radius": 300.0})
    rows = train(learner, tmp_path / "whole")
    assert rows[-1]["stage"] == 1
    assert (
        rows[-1]["decisions"] < rows[-1]["steps"]
    )  # the slot of the second drone was empty at first
    with pytest.raises(KeyboardInterrupt):
        train(learner, tmp_path / "cut", interrupt_after(150))
    train(learner, tmp_path / "cut")
    np.testing.assert_array_equal(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": {"gama": 0.9}}, "setting of PPO: 'gama': did you mean 'gamma'"),
        ({"model": {"gamma": "abc"}}, "gamma is 'abc'"),
        ({"model": {"n_epochs": 0}}, "n_epochs is 0"),
        ({"model": {"batch_size": 2.5}}, "batch_size is 2.5"),
        ({"model": {"policy_kwargs": 5}}, "policy_kwargs is 5"),
        ({"model": {"learning_rate": [1e-3]}}, "learning_rate is"),
        ({"model": {"normalize_advantage": 3}}, "normalize_advantage"),
        ({"model": {"features": "user_sum"}}, "do not fit"),
        ({"algo": "td3", "model": {"action_noise": "loud"}}, "action_noise is 'loud'"),
        (
            {"algo": "sac", "model": {"optimize_memory_usage": True}},
            "optimize_memory_usage is True",
        ),
        ({"model": {"features": "symlg"}}, "did you mean 'symlog'"),
        (
            {"algo": "sac", "options": {**OPTIONS, "action": "discrete"}, "model": {}},
            "model sac.*only supports",
        ),
        ({"options": {**OPTIONS, "observation": ["goal", "rgb"]}}, "one drone in each world"),
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path, changes, said):
    with pytest.raises(ValueError, match=said):
        train(config(**changes), tmp_path)


def test_pictures_can_be_learned_from(tmp_path):
    options = {
        "num_drones": 1,
        "observation": ["goal", "rgb"],
        "camera_size": [36, 36],
        "dynamics": "single_integrator",
    }
    learner = config(
        options={**options, "horizon": 4}, steps=32, model={"n_steps": 8}, evaluations=1
    )
    assert train(learner, tmp_path)[-1]["steps"] == 32
    with pytest.raises(ValueError, match="observations with images need 'symlog' or None"):
        train(dataclasses.replace(learner, model={"features": "swarm"}), tmp_path / "swarm")


def test_learning_rates_may_fall_and_features_be_left_out():
    env = DroneVecEnv("converge", 1, **OPTIONS)
    model = make_model(
        config(model={"n_steps": 8, "learning_rate": [1e-3, 1e-4], "features": None}), env
    )
    assert model.lr_schedule(1.0) == 1e-3
    assert model.lr_schedule(0.5) == pytest.approx(5.5e-4)
    assert model.lr_schedule(0.0) == pytest.approx(1e-4)
    assert type(model.policy.features_extractor).__name__ == "FlattenExtractor"
    env.close()


def test_a_campaign_trains_in_processes_as_one_would(run, tmp_path):
    campaign = Campaign([config()], tmp_path)
    done = []
    runs = campaign.train(2, done.append)
    np.testing.assert_array_equal(weights(tmp_path / "converge" / "0"), weights(run[0]))
    assert done[-1] == campaign.total == 200
    runs = [*runs, (config(seed=1), run[1])]
    options = {"num_drones": 2, "dynamics": "single_integrator", "horizon": 3}
    table = learning_table(runs, [bulletuav.evaluate("converge", "random", 1, **options)] * 2)
    assert table.count("\n") == 4
    assert "| converge | ppo | 1 | 256 |" in table
    assert "| medium | single_integrator | 1 episode, seed 0 |" in table
    plot_curves(runs, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_process_that_dies_in_training_is_told_with_what_to_do():
    """Of `train` and `tune` with workers; each run continues from its checkpoint."""
    said = "a worker process has died: .* continues from its last checkpoint"
    with pytest.raises(RuntimeError, match=said), training_processes(1) as pool:
        pool.submit(os._exit, 1).result()


def test_what_a_run_of_a_campaign_raises_is_raised(tmp_path):
    with pytest.raises(ValueError, match="did you mean 'gamma'"):
        Campaign([config(model={"gama": 1.0})], tmp_path).train()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("task: crosing", "did you mean 'crossing'"),
        ("task: crossing\nstep: 5", "did you mean 'steps'"),
        ("steps: 5", "a run needs a task"),
        ("task: crossing\nsteps: 2.5", "steps is 2.5"),
        ("task: crossing\nalgo: pppo", "did you mean 'ppo'"),
        ("task: crossing\nstages: {a: 1}", "stages is"),
        ("task: crossing\nmodel: 5", "model is 5"),
        ("task: crossing\nstages: 5", "stages is 5"),
        ("task: crossing\nstages: []", "stages is"),
        ("task: crossing\nshared_reward: 1", "shared_reward is 1"),
        ("task: crossing\nstaggered: 1", "staggered is 1"),
        ("task: crossing\ncurriculum: {upp: 0.9}", "did you mean 'up'"),
        ("task: crossing\ncurriculum: {up: 2.0}", "0 <= down < up <= 1"),
        ("task: crossing\noptions: {dynamic: bullet}", "did you mean 'dynamics'"),
        ("task: crossing\noptions: {num_worlds: 3}", "unknown option"),
        ("task: crossing\noptions: {5: 3}", "the name 5 is no text"),
        ("task: crossing\nstages: [{dynamics: bulet}]", "did you mean 'bullet'"),
        ("task: crossing\nevaluation: {policy: orca}", "unknown option"),
        ("task: [", "is not valid YAML"),
        ("crossing", "names with values are needed"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused(tmp_path, text, said):
    version = "version: 1\n" if ":" in text else ""
    (tmp_path / "run.yaml").write_text(version + text)
    with pytest.raises(ValueError, match=said):
        RunConfig.read(tmp_path / "run.yaml")


def test_steps_may_be_written_as_people_do(tmp_path):
    (tmp_path / "run.yaml").write_text(
        "version: 1\ntask: crossing\nsteps: 2e6\n"
        "model: {gamma: 9.9e-1, learning_rate: [1e-3, 1e-5]}\n"
    )
    told = RunConfig.read(tmp_path / "run.yaml")
    assert told.steps == 2_000_000
    assert told.model == {"gamma": 0.99, "learning_rate": [1e-3, 1e-5]}
    with pytest.raises(FileNotFoundError, match="no file"):
        RunConfig.read(tmp_path / "none.yaml")


def test_a_configuration_is_the_same_after_a_file(tmp_path):
    told = dataclasses.replace(
        config(),
        options={
            **OPTIONS,
            "start_speed": (1.0, 2.0),
            "max_speed": np.float64(9.0),
            "wind": np.array([1.0, 0.0, 0.0]),
        },
    )
    (tmp_path / "run.yaml").write_text(told.text())
    assert RunConfig.read(tmp_path / "run.yaml").text() == told.text()


def test_features_of_a_swarm_are_learned_and_fly_among_any_number(tmp_path):
    """Learned with two others in sight, flown with five drones and four in sight."""
    seen = {"observation": ["velocity", "goal", "intruders"], "dynamics": "point_mass"}
    options = {**seen, "num_drones": 3, "num_neighbours": 2}
    small = {"n_steps": 4, "batch_size": 8, "policy_kwargs": {"net_arch": [8]}}
    learned = RunConfig(
        "converge",
        steps=1,
        worlds=2,
        options=options,
        evaluations=1,
        episodes=1,
        model={"features": "swarm", **small},
    )
    train(learned, tmp_path)
    many = {"num_drones": 5, "num_neighbours": 4, "horizon": 5, "dynamics": "point_mass"}
    assert bulletuav.evaluate("converge", tmp_path, 1, 0, **many).estimates()["length"].mean == 0.5
    with pytest.raises(ValueError, match=r"observation is \['velocity', 'intruders'\]"):
        bulletuav.evaluate(
            "converge", tmp_path, 1, 0, **many, observation=["velocity", "intruders"]
        )


def test_a_policy_of_other_constants_is_told(run, tmp_path):
    folder = tmp_path / "old"
    shutil.copytree(run[0], folder)
    settings = (folder / "run.yaml").read_text()
    (folder / "run.yaml").write_text(re.sub(r"constants: \d+", "constants: 1", settings))
    with pytest.warns(UserWarning, match=r"trained with constants 1, and this package has 2"):
        find_policy(folder)
