"""Every snippet of the README and the docs runs.

Those of tutorials and of the first flight run in `test_tutorials.py`.
"""

import os
import re
import shlex
from importlib.util import find_spec
from pathlib import Path

import pytest

import bulletuav
from bulletuav.cli import main
from bulletuav.policies.run import RunConfig, shipped
from bulletuav.training.study import Study

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(
        page
        for page in DOCS.rglob("*.md")
        if page.relative_to(DOCS).parts[0] not in ("results", "lab", "reference")
    ),
]
TUTORIALS = [
    page for page in PAGES if page.parent.name == "tutorials" or page.stem == "first_flight"
]
BY_HAND = {"benchmarl.md": "tests/clients/benchmarl_client.py"}
"""Pages whose programs need what the suite has not, and what flies the same by hand"""
NOT_EVERYWHERE = "supersuit"
"""Package that has no wheels for some Pythons; see `pyproject.toml`"""
GROWING = "write_a_task.md"
"""Page on which each snippet goes on where the one before ended"""


def snippets(page):
    """Python programs of a page; those of a growing page are one."""
    found = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    return ["\n".join(found)] if page.name == GROWING else found


PYTHON = [
    pytest.param(code, id=f"{page.name}-{k}")
    for page in PAGES
    if page not in TUTORIALS and page.name not in BY_HAND
    for k, code in enumerate(snippets(page))
]
COMMANDS = re.findall(r"```bash\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)


def test_a_task_of_ones_own_takes_less_than_60_lines():
    text = (ROOT / "docs" / "howto" / GROWING).read_text()
    first = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    assert "(Task[" in first
    assert len(first.splitlines()) < 60


def test_the_first_flight_prints_the_table_of_its_page(tmp_path, monkeypatch, capsys):
    page = (DOCS / "start" / "first_flight.md").read_text()
    command = re.findall(r"```bash\nbulletuav (fly .*)", page)[0]
    printed = re.search(r"```text\n(.*?)```", page, re.DOTALL).group(1)
    monkeypatch.chdir(tmp_path)
    main(shlex.split(command))
    words = capsys.readouterr().out.replace("│", " ").split()
    rows = [line.split() for line in printed.splitlines() if line.startswith(" drone_")]
    assert len(rows) == 4
    for row in rows:
        start = words.index(row[0])
        assert words[start : start + len(row)] == row


def test_the_readme_is_one_page():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_the_gallery_has_every_task():
    folder = ROOT / "docs" / "results" / "gallery"
    pictures = sorted(path.stem for path in folder.glob("*.png"))
    assert pictures == bulletuav.list_tasks()
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1e6


@pytest.mark.parametrize("code", PYTHON)
def test_python(code, tmp_path, monkeypatch):
    if f"import {NOT_EVERYWHERE}" in code and not find_spec(NOT_EVERYWHERE):
        pytest.skip(f"{NOT_EVERYWHERE} is not installed")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "snippet", "exec"), {})


def test_the_first_program_flies_straight_into_conflicts(capsys):
    exec(compile(PYTHON[0].values[0], "snippet", "exec"), {})
    said = capsys.readouterr().out
    assert said.count("had a conflict or crashed") == 6
    assert said.count("succeeded") == 2


def test_ci_runs_the_test_command_of_the_readme():
    _, test_command = COMMANDS
    assert test_command.strip() in (ROOT / ".ci" / "run").read_text().splitlines()


def test_the_main_command_of_the_readme(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    *setup, job = COMMANDS[0].strip().split(" && ")
    assert all("constraints.txt" in step or "venv" in step for step in setup)
    words = shlex.split(job)
    assert words[0] == ".venv/bin/bulletuav"
    main(words[1:])
    assert (tmp_path / "out" / "flight.gif").stat().st_size > 10000


def test_the_first_file_of_the_page_on_tasks_is_flown_by_its_command(tmp_path, monkeypatch):
    text = (ROOT / "docs" / "howto" / GROWING).read_text()
    (tmp_path / "wedge.py").write_text(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0])
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(r"```bash\nbulletuav (.*?)\n```", text)
    main([*shlex.split(command), "--set", "horizon=20", "--dynamics", "single_integrator"])
    assert (tmp_path / "out" / "flight.gif").stat().st_size > 1000


def test_links_lead_somewhere():
    """Pages of the reference are generated, into files that .gitignore lists."""
    generated = (ROOT / ".gitignore").read_text().splitlines()
    for page in PAGES:
        for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
            path = os.path.relpath(page.parent / target, ROOT)
            is_generated = path in generated or f"{os.path.dirname(path)}/" in generated
            assert is_generated or (ROOT / path).exists(), f"{page.name}: {target}"


def test_the_runs_of_the_pages_on_learning_can_be(tmp_path):
    files = []
    for page in (
        "howto/train",
        "howto/tune",
        "howto/swarms_of_any_size",
        "benchmarks/learning",
    ):
        (text,) = re.findall(r"```yaml\n(.*?)```", (DOCS / f"{page}.md").read_text(), re.DOTALL)
        (tmp_path / "run.yaml").write_text(text)
        kind = Study if "space:" in text else RunConfig
        files.append(kind.read(tmp_path / "run.yaml"))
    one, study, of_any_size, _ = files
    assert study.space["model.n_epochs"].is_whole
    assert one.steps == 4_000_000
    assert (
        one.options["weights"]
        == RunConfig.read(shipped("crossing") / "run.yaml").options["weights"]
    )
    assert of_any_size.settings["features"] == "swarm"
