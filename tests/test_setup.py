"""Installing: dependencies, their pins and licenses."""

import configparser
import re
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from bulletuav.version import __version__

ROOT = Path(__file__).parents[1]
OTHER = {"torchrl": set(), "benchmarl": {"torchrl", "tensordict"}}
"""Packages of which an extra needs another version than the suite"""


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


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, True),
        ({"python_version": "3.12"}, False),
        ({"python_version": "3.14"}, False),
        ({"platform_system": "Darwin"}, False),
        ({"platform_system": "Windows", "platform_machine": "AMD64"}, False),
        ({"platform_machine": "aarch64"}, False),
        ({"platform_python_implementation": "PyPy"}, False),
    ],
)
def test_pybullet_is_required_where_it_has_wheels(environment, expected):
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    lines = setup["options"]["install_requires"].split("\n")
    (required,) = (Requirement(line) for line in lines if line.startswith("pybullet"))
    here = {"python_version": "3.11", "platform_system": "Linux", "platform_machine": "x86_64"}
    here["platform_python_implementation"] = "CPython"
    assert required.marker.evaluate({**here, **environment}) == expected
    assert setup["options.extras_require"]["bullet"].strip() == "pybullet>=3.2.6"


def test_licenses_of_all_dependencies_are_told():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    wanted = {}
    lists = {"always": setup["options"]["install_requires"], **setup["options.extras_require"]}
    for extra, lines in lists.items():
        for line in filter(None, map(str.strip, lines.splitlines())):
            name = re.split(r"[\[<>=]", line)[0]
            if name != "bulletuav":
                wanted.setdefault(name, set()).add(extra)
    _, told_of = (ROOT / "THIRD_PARTY.md").read_text().split("## What it is installed with")
    _, *rows = re.findall(r"^\| ([\w-]+) \| (.*?) \| \S", told_of, re.MULTILINE)
    told = {name: set(extras.replace("`", "").split(", ")) for name, extras in rows}
    assert told == wanted
