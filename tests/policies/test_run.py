"""The version of run.yaml; what else it holds is tested with the trainer."""

import re

import pytest
import yaml

from bulletuav.policies import find_policy
from bulletuav.policies.run import SHIPPED, VERSION, RunConfig, shipped_tasks


def test_the_version_is_written_first_and_read(tmp_path):
    path = tmp_path / "run.yaml"
    told = RunConfig("crossing", seed=3)
    path.write_text(told.text())
    assert path.read_text().startswith(f"version: {VERSION}\ntask: crossing\n")
    assert RunConfig.read(path).plain() == told.plain()


def test_what_another_trainer_did_not_use_is_not_written(tmp_path):
    path = tmp_path / "run.yaml"
    told = RunConfig("crossing", "dqn", seed=3, worlds=7)
    path.write_text(told.text("algo", "seed"))
    known = {"version": VERSION, "task": "crossing", "algo": "dqn", "seed": 3}
    assert yaml.safe_load(path.read_text()) == known
    assert RunConfig.read(path) == RunConfig("crossing", "dqn", seed=3)


@pytest.mark.parametrize("task", shipped_tasks())
def test_runs_of_the_package_are_of_this_version(task):
    path = SHIPPED / task / "run.yaml"
    assert path.read_text().startswith(f"version: {VERSION}\n")
    assert RunConfig.read(path).task == task


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("", "no version"),
        ("version: 0\n", "version: 0"),
        ("version: 2\n", "version: 2"),
        ("version: one\n", "version: 'one'"),
        ("version: true\n", "version: True"),
        ("version: 1.0\n", "version: 1.0"),
        ("version:\n", "version: None"),
    ],
)
def test_another_version_is_refused_with_the_remedy(line, found, tmp_path):
    path = tmp_path / "run.yaml"
    path.write_text(f"{line}task: crossing\n")
    said = (
        f"{path} has {found}, and version: {VERSION} is needed: "
        f"train again, or use the version of bulletuav that wrote the file"
    )
    for reader in (RunConfig.read, lambda path: find_policy(path.parent)):
        with pytest.raises(ValueError, match=re.escape(said)):
            reader(path)


def test_a_file_that_names_a_module_is_refused_and_nothing_is_imported(tmp_path, monkeypatch):
    (tmp_path / "evil_module.py").write_text("raise SystemExit('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "run.yaml"
    for text in (
        "version: 1\ntask: 'evil_module:Task'\n",
        "version: 1\ntask: crossing\noptions: {dynamics: 'evil_module:Fast'}\n",
        "version: 1\ntask: crossing\noptions: {observation: [velocity, 'evil_module:block']}\n",
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match="evil_module.*--trust"):
            RunConfig.read(path)
    path.write_text("version: 1\ntask: 'evil_module:Task'\n")
    with pytest.raises(SystemExit):
        RunConfig.read(path, trust=True)


def test_a_file_may_name_the_task_that_the_user_named(tmp_path, monkeypatch):
    source = "from bulletuav.tasks.hover import Hover\n\n\nclass Mine(Hover):\n    name = 'mine'\n"
    (tmp_path / "my_hover_task.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "run.yaml"
    path.write_text("version: 1\ntask: 'my_hover_task:Mine'\n")
    assert RunConfig.read(path, known=("my_hover_task:Mine",)).task == "my_hover_task:Mine"
    # Nothing else in the file becomes trusted
    path.write_text("version: 1\ntask: 'my_hover_task:Mine'\noptions: {dynamics: 'evil:Fast'}\n")
    with pytest.raises(ValueError, match="'evil:Fast'.*--trust"):
        find_policy(tmp_path, "my_hover_task:Mine")
    with pytest.raises(ValueError, match="'my_hover_task:Mine'.*--trust"):
        find_policy(tmp_path, "hover")
