"""Folders of policies and environments for the Hugging Face Hub."""

import importlib.util
import re
import shutil

import numpy as np
import pytest
import yaml

import bulletuav
from bulletuav.adapters.hub import write_hub
from bulletuav.cli import main
from bulletuav.policies.run import CONFIG, CURVE, POLICY, SHIPPED, RunConfig, shipped
from bulletuav.policies.scores import read_scores


def load(folder):
    """The module `env.py` of a folder, as EnvHub loads it."""
    spec = importlib.util.spec_from_file_location("hub_env", folder / "env.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_card(folder):
    """The data and the text of a model card."""
    _, data, text = (folder / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(data), text


def test_a_policy_of_the_package_is_a_folder_that_flies_as_it_did(tmp_path):
    out = tmp_path / "hub"
    main(["export", "free_flight", "--to", "hub", "--out", str(out)])
    names = {"README.md", "env.py", "requirements.txt", POLICY, CONFIG}
    assert {path.name for path in out.iterdir()} == names
    flown = [
        bulletuav.evaluate("free_flight", policy, 2, 0, dynamics="point_mass").hash
        for policy in (out, "trained")
    ]
    assert flown[0] == flown[1]


def test_the_card_has_the_scores_of_the_package(tmp_path):
    write_hub(shipped("free_flight"), tmp_path)
    data, text = read_card(tmp_path)
    (model,) = data["model-index"]
    found = {one["dataset"]["name"]: one["metrics"][0]["value"] for one in model["results"]}
    scores = read_scores("free_flight")
    assert list(found.values()) == [one["trained"][0] for one in scores.values()]
    assert any("difficulty hard" in name for name in found)
    assert "| difficulty hard, " in text
    for block in ("velocity", "goal_offset", "intruders"):
        assert f"`{block}`" in text


def test_the_environment_has_the_observation_of_the_policy(tmp_path):
    write_hub(shipped("hover"), tmp_path)
    module = load(tmp_path)
    (worlds,) = module.make_env(n_envs=3)["bulletuav"].values()
    seen, _ = worlds.reset(seed=0)
    options = RunConfig.read(shipped("hover") / CONFIG).evaluated
    env = bulletuav.parallel_env("hover", **options)
    width = env.observation_space(env.possible_agents[0]).shape[0]
    assert seen.shape == (3, width)
    seen, reward, _, _, _ = worlds.step(worlds.action_space.sample())
    assert reward.shape == (3,)
    assert np.isfinite(seen).all()
    worlds.close()
    env.close()
    with pytest.raises(ValueError, match="cfg is 'fast'"):
        module.make_env(cfg="fast")


@pytest.mark.slow
def test_environments_in_processes_have_the_observations_of_the_batch(tmp_path):
    write_hub(shipped("free_flight"), tmp_path)
    module, seen = load(tmp_path), []
    for is_async in (False, True):
        (worlds,) = module.make_env(2, use_async_envs=is_async)["bulletuav"].values()
        seen.append(worlds.reset(seed=[0, 1])[0])
        worlds.close()
    assert np.array_equal(*seen)


def test_the_scores_of_a_run_are_those_of_the_end_of_its_curve(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(shipped("free_flight"), run)
    write_hub(run, tmp_path / "unmeasured")
    data, text = read_card(tmp_path / "unmeasured")
    assert "model-index" not in data
    assert "Not measured." in text
    names = "safe_success,return,conflict,collision,difficulty,dynamics,episodes"
    rows = ["0.1,1,0.3,0.2,easy,point_mass,20", "0.75,-2.5,0.25,0.0,easy,point_mass,20"]
    (run / CURVE).write_text("\n".join([names, *rows]) + "\n")
    main(["export", str(run), "--to", "hub"])
    data, text = read_card(run / "hub")
    (model,) = data["model-index"]
    found = [(one["metrics"][0]["type"], one["metrics"][0]["value"]) for one in model["results"]]
    wanted = [("safe_success", 0.75), ("return", -2.5), ("conflict", 0.25), ("collision", 0.0)]
    assert found == wanted
    assert "| difficulty easy, dynamics point_mass, 20 episodes | return | -2.5 |" in text


@pytest.mark.parametrize(
    ("name", "title", "note"),
    [
        ("crossing", "bulletuav-crossing", "| note | One policy for 2 to 64 drones"),
        ("foundation", "bulletuav-foundation", "| note | bulletuav 0.9.0, "),
    ],
)
def test_the_card_says_where_a_policy_comes_from(name, title, note, tmp_path):
    write_hub(SHIPPED / name, tmp_path)
    _, text = read_card(tmp_path)
    assert f"# {title}\n" in text
    assert note in text
    assert (tmp_path / CONFIG).read_text() == (SHIPPED / name / CONFIG).read_text()


def test_the_card_of_a_checkpoint_says_that_it_is_one(tmp_path):
    write_hub(shipped("free_flight") / "checkpoints" / "000", tmp_path)
    data, text = read_card(tmp_path)
    assert "| note | checkpoint 000 of this training |" in text
    assert "model-index" not in data


def test_links_and_commands_of_the_card_are_real(tmp_path):
    write_hub(shipped("free_flight"), tmp_path)
    _, text = read_card(tmp_path)
    (command,) = re.findall(r"bulletuav train --config (\S+)`", text)
    assert (tmp_path / command).is_file()
    (program,) = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    assert program.split()[:3] == ["bulletuav", "fly", "free_flight"]
    assert bulletuav.__version__ in (tmp_path / "requirements.txt").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["free_flight", "--to", "hub"], "--out is missing"),
        (
            ["free_flight", "--to", "hub", "--out", "x", "--precision", "float"],
            "--precision is for",
        ),
        (["free_flight", "--to", "hub", "--out", "x", "--airframe", "racer"], "--airframe is for"),
        (["fre_flight", "--to", "hub", "--out", "x"], "fre_flight"),
    ],
)
def test_what_cannot_be_exported_is_one_error(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["export", *arguments])
    assert message in f"{end.value}{capsys.readouterr().err}"
    assert not list(tmp_path.iterdir())


def test_folders_without_a_policy_or_of_another_task_are_refused(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(shipped("free_flight"), run)
    with pytest.raises(ValueError, match="choose another one by --out"):
        write_hub(run, run)
    (run / POLICY).unlink()
    with pytest.raises(FileNotFoundError, match="train until the first checkpoint"):
        write_hub(run, tmp_path / "hub")


def test_own_tasks_are_refused_as_others_lack_them(tmp_path, monkeypatch):
    monkeypatch.setattr("bulletuav.adapters.hub.list_tasks", lambda: ["hover"])
    with pytest.raises(ValueError, match="'free_flight', which others do not have"):
        write_hub(shipped("free_flight"), tmp_path)
