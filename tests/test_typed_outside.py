"""What users write outside the package is type-checked against it, strictly, as any editor does."""

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from waiting import LONG

ROOT = Path(__file__).parents[1]
OWN = ROOT / "examples" / "own"
MISTAKES = '''\
"""Mistakes that a type checker must see; the comments tell which."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import bulletuav
from bulletuav.sensors import Label, Moment, Sensor
from bulletuav.tasks import Frame, Spawn, Task, TaskConfig


@dataclass(frozen=True)
class PerchConfig(TaskConfig):
    height: float = 1.0


class Perch(Task[PerchConfig]):
    name = 3  # assignment
    observation = ("velocity",)
    reward: ClassVar = {"distance": -1.0}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        height: float = self.config.heigth  # attr-defined
        return Spawn(position=np.array((0.0, 0.0, height)))  # call-arg

    def info(self, frame: Frame) -> float:  # override
        return float(frame.distances.mean())  # attr-defined


class Uwb(Sensor):
    name = "uwb"
    numbers = (Label("distance", "m", "0", 1.0),)  # arg-type

    def measure(self, moment: Moment) -> np.ndarray:  # override
        place: np.ndarray = moment.after.place  # attr-defined
        return place


bulletuav.check_task(3)  # arg-type
bulletuav.paralel_env("hover")  # attr-defined
height: str = Perch.Config().d_safe  # assignment
'''
ERROR = re.compile(r"^(.*):(\d+): error: .*\[([\w-]+)\]$", re.MULTILINE)


@pytest.fixture
def place(tmp_path):
    """A folder far from the checkout, with copies of the examples and a file full of mistakes."""
    folder = tmp_path / "elsewhere"
    shutil.copytree(OWN, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "mistakes.py").write_text(MISTAKES)
    return folder


def errors_of_mypy(python, folder, cache):
    """File, line and kind of each error in the files of a folder."""
    files = sorted(path.name for path in folder.glob("*.py"))
    options = ["--strict", "--warn-unreachable", "--config-file=", f"--cache-dir={cache}"]
    words = [python, "-m", "mypy", *options, *files]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=LONG)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    assert "checked" in done.stdout, done.stdout + done.stderr
    return [(name, int(line), kind) for name, line, kind in ERROR.findall(done.stdout)]


def check(python, folder, cache):
    lines = enumerate(MISTAKES.splitlines(), start=1)
    wanted = [(k, line.split("  # ")[1]) for k, line in lines if "  # " in line]
    found = errors_of_mypy(python, folder, cache)
    assert [one for one in found if one[0] != "mistakes.py"] == []
    assert {one[1:] for one in found} == set(wanted)


def test_examples_are_strictly_typed_and_mistakes_are_seen_from_another_folder(place):
    cache = ROOT / ".mypy_cache" / "outside"  # which saves 20 s next time
    if not cache.exists():
        # With the package's own options mypy takes over what it found out of NumPy and others.
        for known in ROOT.glob(".mypy_cache/3.*"):
            shutil.copytree(known, cache / known.name)
    check(sys.executable, place, cache)


@pytest.mark.slow
def test_they_are_so_after_the_installation_of_the_readme(place, tmp_path):
    checkout = tmp_path / "checkout"
    left_out = (".git", ".venv", "build", "*.egg-info", ".*_cache", "__pycache__", "*.so")
    shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(*left_out))
    home = tmp_path / "venv"
    venv.create(home, with_pip=True)
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    install = [python, "-m", "pip", "install", "-q", "-c", "constraints.txt", "-e", ".", "mypy"]
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    subprocess.run(install, cwd=checkout, env=clean, check=True, timeout=LONG)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONPATH", raising=False)
        check(python, place, tmp_path)
        subprocess.run([python, "barometer.py"], cwd=place, check=True, timeout=LONG)
