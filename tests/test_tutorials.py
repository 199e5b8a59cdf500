"""Tutorials can be followed: their snippets run from top to bottom and print what the page states.

The page of the first flight is followed in the same way.
"""

import importlib.util
import json
import os
import re
import shlex
import shutil
import site
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from waiting import LONG

from bulletuav.cli import main

pytest.importorskip("nbclient", reason="needs the extra docs")

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
LESSONS = [*TUTORIALS, ROOT / "docs" / "start" / "first_flight.md"]
SHORTENED = ("--steps 2e5", "--steps 2e3")
"""Training of the pages, and of the suite"""


def stem(page):
    return page.stem


def load_notebooks():
    spec = importlib.util.spec_from_file_location(
        "notebooks", ROOT / "docs" / "_ext" / "notebooks.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


notebooks = load_notebooks()


def snippets(page):
    """Snippets of a page without the installation."""
    parts = notebooks.split_page(page.read_text())
    return [part for part in parts if not isinstance(part, str) and part.kind != "install"]


def require_extra_of(page):
    if "bulletuav train" in page.read_text():
        pytest.importorskip("stable_baselines3", reason="needs the extra sb3")


def assert_printed(stated, printed):
    """Compare an output that a page states; `...` stands for any text."""
    lines = "\n".join(line.rstrip() for line in printed.splitlines())
    pattern = re.escape(stated.rstrip()).replace(r"\.\.\.", ".*")
    assert re.fullmatch(rf"{pattern}\s*", lines, re.DOTALL), f"{stated}\nis not:\n{printed}"


# In the present environment


@pytest.mark.parametrize("page", LESSONS, ids=stem)
def test_the_snippets_run_and_print_what_the_page_states(page, tmp_path, monkeypatch, capsys):
    """Trainings are shorter; what follows them prints something else."""
    require_extra_of(page)
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    monkeypatch.setenv("COLUMNS", "80")
    names, is_stated_size = {"__name__": "__main__"}, True
    for one in snippets(page):
        capsys.readouterr()
        pictures = set(tmp_path.glob("*.png"))
        if one.file:
            Path(one.file).write_text(one.code)
            sys.modules.pop(Path(one.file).stem, None)
            continue
        if one.kind == "python":
            exec(compile(one.code, "snippet", "exec"), names)
        else:
            for line in one.code.splitlines():
                is_stated_size &= SHORTENED[0] not in line
                program, *words = shlex.split(line.replace(*SHORTENED))
                assert program == "bulletuav"
                main(words)
        printed = capsys.readouterr().out
        assert printed or set(tmp_path.glob("*.png")) > pictures, one.code
        if one.output is not None and is_stated_size:
            assert_printed(one.output, printed)
    plt.close("all")


# As the pages say: from a wheel, in an empty folder


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Python of a fresh environment, in which the wheel is installed.

    The dependencies are those of the present environment, which spares their download.
    """
    place = tmp_path_factory.mktemp("wheel")
    checkout, home = place / "checkout", place / "venv"
    left_out = (".git", ".venv", "build", "docs", "*.egg-info", ".*_cache", "__pycache__", "*.so")
    shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(*left_out))
    wheel = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*wheel, "-w", place, checkout], check=True, timeout=LONG)
    shutil.rmtree(checkout)
    venv.create(home, with_pip=True)
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    install = [python, "-m", "pip", "install", "-q", "--no-deps", *place.glob("*.whl")]
    subprocess.run(install, env=clean_environment(place), check=True, timeout=LONG)
    # Files *.pth of these folders, such as that of an editable installation, are not read there.
    folders = [path for path in sys.path if path.endswith("site-packages")]
    (own,) = [Path(path) for path in site.getsitepackages([os.fspath(home)]) if Path(path).is_dir()]
    (own / "dependencies.pth").write_text("\n".join(folders) + "\n")
    return python


def clean_environment(home):
    """Environment variables of a reader whose caches are empty."""
    ours = ("PYTHON", "NUMBA", "COLUMNS", "FORCE_COLOR")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    return kept | {"HOME": os.fspath(home), "XDG_CACHE_HOME": os.fspath(home / "cache")}


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=stem)
def test_a_reader_can_follow_it_from_a_wheel_in_an_empty_folder_in_time(page, tmp_path, python):
    """CPU time is compared with the stated time, since other programs may keep the machine busy."""
    require_extra_of(page)
    (minutes,) = re.findall(r"takes\s(\d+)\sminutes", page.read_text())
    assert 10 <= int(minutes) <= 15
    found = snippets(page)
    steps = [{"kind": one.kind, "code": one.code, "file": one.file} for one in found]
    file, folder = tmp_path / "steps.json", tmp_path / "empty"
    file.write_text(json.dumps(steps))
    folder.mkdir()
    driver = [python, Path(__file__).with_name("tutorial_driver.py"), file]
    env = clean_environment(tmp_path)
    subprocess.run(driver, cwd=folder, env=env, check=True, timeout=LONG)
    result = json.loads(file.read_text())
    assert Path(result["package"]).is_relative_to(python.parents[1])
    for one, printed in zip(found, result["printed"], strict=True):
        if one.output is not None:
            assert_printed(one.output, printed)
    assert result["seconds"] < 60 * int(minutes)


# As notebooks


@pytest.mark.parametrize("page", TUTORIALS, ids=stem)
def test_its_notebook_has_all_of_the_page(page):
    text = page.read_text()
    notebook = notebooks.make_notebook(text)
    first, *cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    (requirement,) = re.findall(r'^pip install "?(bulletuav[^"\n]*)"?$', text, re.MULTILINE)
    assert f"%pip install -q {requirement}\n" in f"{first}\n"
    assert len(cells) == len(snippets(page))
    for one, cell in zip(snippets(page), cells, strict=True):
        for line in one.code.splitlines():
            assert (f"!{line}" if one.kind == "bash" else line) in cell.splitlines()
    texts = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert "```" not in texts
    assert ".md)" not in texts


def test_pages_and_notebooks_have_the_outputs():
    page = (
        "# Title\n\nText with a [link](other.md).\n\n"
        "```sh\npip install bulletuav\n```\n\n"
        '```python\n# own.py\nNAME = "Ada"\n```\n\n'
        "```python\nfrom own import NAME\n\nprint(NAME)\n```\n\n```text\nAda\n```\n\n"
        "```bash\nbulletuav --version\n```\n\n"
        "```python\nimport sys\n\nimport matplotlib.pyplot as plt\n\n"
        'print("message", file=sys.stderr)\nplt.plot([0, 1])\nplt.savefig("own.png")\n```\n\n'
        "The end.\n"
    )
    empty = "# Other\n\n```python\nprint('NAME' in globals())\n```\n"
    made = notebooks.execute({"own": page, "other": empty})
    text, pictures = notebooks.page_with_outputs(page, made["own"], "own")
    ((name, picture),) = pictures.items()
    assert picture.startswith(b"\x89PNG")
    assert text.startswith("# Title\n\n[Open in Colab](https://colab.research.google.com/github/")
    assert "[link](other.md)" in text
    assert text.count("Ada\n```") == 1
    assert "print(NAME)\n```\n\n```output\nAda\n```" in text
    assert re.search(r"--version\n```\n\n```output\n\S+ ?\S*\n```", text)
    assert f"]({name})\n\nThe end.\n" in text
    assert "```output\nmessage" not in text
    assert "Writing" not in text
    other, none = notebooks.page_with_outputs(empty, made["other"], "other")
    assert "```output\nFalse\n```" in other
    assert none == {}
    content = json.loads(notebooks.notebook_text(made["own"]))
    code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    assert [len(cell["outputs"]) for cell in code[:4]] == [0, 1, 1, 1]
    assert "".join(code[3]["source"]) == "!bulletuav --version"


def test_an_error_in_a_snippet_is_an_error_of_the_build():
    from nbclient.exceptions import CellExecutionError

    for snippet in ("```python\n1 / 0\n```\n", "```bash\nbulletuav fly nothing\n```\n"):
        with pytest.raises(CellExecutionError):
            notebooks.execute({"own": f"# Title\n\n{snippet}"})
