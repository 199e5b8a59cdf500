"""Installing: what setup.py says where pybullet cannot be built."""

import re
import runpy
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

from bulletuav.version import __version__

ROOT = Path(__file__).parents[1]
SETUP = ROOT / "setup.py"
OTHER = {"torchrl": set(), "benchmarl": {"torchrl", "tensordict"}}
"""Packages of which an extra needs another version than the suite"""


@pytest.fixture
def made(monkeypatch, tmp_path):
    """What setup.py makes, on a machine without pybullet and without compilers."""
    made = []
    monkeypatch.setattr("setuptools.setup", lambda **given: made.append(given))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path / name))
    monkeypatch.setattr(sysconfig, "get_config_var", lambda name: "g++ -pthread")
    monkeypatch.delenv("CXX", raising=False)
    (tmp_path / "platlib").mkdir()
    return made


@pytest.mark.parametrize("version", [(3, 12, 1), (3, 13, 0), (3, 14, 0)])
def test_without_a_wheel_and_a_compiler_one_line_tells_what_to_do(version, made, monkeypatch):
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(
        SystemExit,
        match=rf"no wheel for Python {version[0]}\.{version[1]}: .*apt-get install g\+\+",
    ):
        runpy.run_path(str(SETUP))
    assert made == []


def test_a_compiler_a_wheel_or_pybullet_itself_is_enough(made, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "version_info", (3, 11, 7))
    runpy.run_path(str(SETUP))
    monkeypatch.setattr(sys, "version_info", (3, 12, 1))
    (tmp_path / "platlib" / "pybullet.so").write_text("")
    runpy.run_path(str(SETUP))
    (tmp_path / "platlib" / "pybullet.so").unlink()
    (tmp_path / "own-g++").write_text("#!/bin/sh\n")
    (tmp_path / "own-g++").chmod(0o755)
    monkeypatch.setenv("CXX", f"{tmp_path / 'own-g++'} -O2")
    runpy.run_path(str(SETUP))
    assert len(made) == 3
    assert all(given["ext_modules"][0].optional for given in made)


def pins(path):
    """Version of each package in a file of constraints, by its name in lower case."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return dict(line.lower().replace("-", "_").split("==") for line in lines)


@pytest.mark.parametrize("extra", OTHER)
def test_extras_are_pinned_to_the_versions_of_the_suite_where_they_can_be(extra):
    own, suite = pins(ROOT / "constraints" / f"{extra}.txt"), pins(ROOT / "constraints.txt")
    assert {extra, "torch", "numpy", "gymnasium"} <= own.keys()
    assert {name for name in own.keys() & suite.keys() if own[name] != suite[name]} == OTHER[extra]


def test_the_citation_is_of_this_version():
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_licenses_of_all_dependencies_are_told():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {}
    lists = {"always": project["dependencies"], **project["optional-dependencies"]}
    for extra, requirements in lists.items():
        for requirement in requirements:
            name = re.split(r"[\[<>= ;]", requirement)[0]
            if name != "bulletuav":
                wanted.setdefault(name, set()).add(extra)
    _, told_of = (ROOT / "THIRD_PARTY.md").read_text().split("## What it is installed with")
    _, *rows = re.findall(r"^\| ([\w-]+) \| (.*?) \| \S", told_of, re.MULTILINE)
    told = {name: set(extras.replace("`", "").split(", ")) for name, extras in rows}
    assert told == wanted
