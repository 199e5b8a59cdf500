"""Every snippet of the README and the docs runs.

Those of tutorials and of the first flight run in `test_tutorials.py`.
"""

import ast
import re
import shlex
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
        page for page in DOCS.rglob("*.md") if page.relative_to(DOCS).parts[0] not in ("results", "lab")
    ),
]
TUTORIALS = [page for page in PAGES if page.parent.name == "tutorials" or page.stem == "first_flight"]
BY_HAND = {"benchmarl.md": "tests/clients/benchmarl_client.py"}
"""Pages whose programs need what the suite has not, and what flies the same by hand"""
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
    (code,) = [param.values[0] for param in PYTHON if "class Gather(Task[" in param.values[0]]
    assert len(code.splitlines()) < 60


def test_the_gallery_has_every_task():
    folder = ROOT / "docs" / "results" / "gallery"
    headings = re.findall(r"^## (.*)$", (folder / "gallery.md").read_text(), re.MULTILINE)
    pictures = sorted(path.stem for path in folder.glob("*.png"))
    assert headings == pictures == bulletuav.list_tasks()
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1e6


@pytest.mark.parametrize("code", PYTHON)
def test_python(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "snippet", "exec"), {})


def test_the_first_program_reaches_its_goals(capsys):
    exec(compile(PYTHON[0].values[0], "snippet", "exec"), {})
    assert capsys.readouterr().out.count("reached its goal") >= 6


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
    for page in PAGES:
        for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_runs_of_the_page_on_learning_can_be(tmp_path):
    page = (ROOT / "docs" / "howto" / "train.md").read_text()
    files = []
    for text in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL):
        (tmp_path / "run.yaml").write_text(text)
        kind = Study if "space:" in text else RunConfig
        files.append(kind.read(tmp_path / "run.yaml"))
    one, study, of_any_size, in_a_minute = files
    assert study.space["model.n_epochs"].is_whole
    assert one.steps == 4_000_000
    assert (
        one.options["weights"]
        == RunConfig.read(shipped("crossing") / "run.yaml").options["weights"]
    )
    assert of_any_size.settings["features"] == "swarm"
    # The same rewards as in the file that it is compared with
    beside = (ROOT / "examples" / "fast_ppo.py").read_text()
    paid = ast.literal_eval(re.search(r"^STAY = (.*)$", beside, re.MULTILINE)[1])
    assert in_a_minute.options["weights"] == paid
