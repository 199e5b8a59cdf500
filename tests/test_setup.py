"""Installing: metadata, lock files, dependencies, their pins and licenses."""

import configparser
import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.tags import compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

from bulletuav.version import DOCUMENTATION, INDEX_NAME, REPOSITORY, __version__

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


def test_the_citation_the_recipe_and_the_changelog_are_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == recipe()["context"]["version"] == __version__
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[:2] == ["Unreleased", f"{__version__} - {citation['date-released']}"]


def test_all_packages_of_an_installation_without_extras_are_pinned(locked):
    """The list of parts of a release, and its audit, are made of the pinned versions."""
    found = {package["name"] for package in needed(locked, "3.11.9", extra=None)}
    assert len(found) > 20
    assert found <= {name.replace("_", "-") for name in pins(ROOT / "constraints.txt")}


def test_the_page_on_citing_has_the_data_of_the_citation_file():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    page = (ROOT / "docs" / "project" / "cite.md").read_text()
    (entry,) = re.findall(r"```bibtex\n@software\{(.*?)\n\}\n```", page, re.DOTALL)
    fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", entry, re.MULTILINE))
    assert fields == {
        "title": citation["title"],
        "abstract": citation["abstract"],
        "author": "{" + " and ".join(author["name"] for author in citation["authors"]) + "}",
        "version": citation["version"],
        "year": str(citation["date-released"].year),
        "license": citation["license"],
        "url": citation["repository-code"],
    }


def test_the_page_of_programs_names_the_versions_of_the_suite():
    """Those that are pinned; other programs are run in environments of their own."""
    page = (ROOT / "docs" / "project" / "used_with.md").read_text()
    rllib = pins(ROOT / "constraints" / "rllib.txt")
    suite = pins(ROOT / "constraints.txt") | {"ray": rllib["ray"]}
    names = {"stable-baselines3": "stable_baselines3", "TorchRL": "torchrl", "Minari": "minari"}
    names |= {"Optuna": "optuna", "SuperSuit": "supersuit", "pymavlink": "pymavlink"}
    for program, package in names.items():
        (row,) = re.findall(rf"^\| \[{program}\]\(.*?\) \| ([\d.]+)", page, re.MULTILINE)
        assert row == suite[package], program
    for package in ("torch", "tensordict", "onnx", "onnxruntime", "ray", "mcap", "rosbags"):
        assert set(re.findall(rf"\b{package} ([\d.]+\d)", page)) == {suite[package]}
    for package in ("mlflow-skinny", "foxglove-sdk", "rerun-sdk"):
        assert re.findall(rf"\b{package} ([\d.]+\d)", page) == [suite[package.replace("-", "_")]]
    own = pins(ROOT / "constraints" / "benchmarl.txt")
    assert f"{own['benchmarl']}, torchrl {own['torchrl']}" in page


# Addresses, which are placeholders until the project is published


TEXTS = {".cff", ".cfg", ".md", ".py", ".toml", ".txt", ".yaml", ".yml"}
"""Endings of files that may name the project's addresses"""


def texts():
    """Text of each file of the repository that may name an address, by its path."""
    folders = ("benchmarks", "bulletuav", "conda", "docs", "examples", "tests", "tools", ".github")
    paths = [path for path in ROOT.iterdir() if path.is_file()]
    paths += [path for folder in folders for path in (ROOT / folder).rglob("*")]
    found = [path for path in paths if path.suffix in TEXTS and path != Path(__file__)]
    return {path.relative_to(ROOT).as_posix(): path.read_text() for path in found}


def test_the_repository_has_one_address():
    """Another host, owner or name would be another spelling of the placeholder."""
    places = r"https?://[\w.-]+/[\w.~-]+/bullet-?_?uav\b|git@[\w.]+:[\w-]+/bullet-?_?uav\b|\bOWNER/"
    wrong = {
        (name, address)
        for name, text in texts().items()
        for address in re.findall(places, text.replace(REPOSITORY, ""), re.IGNORECASE)
    }
    assert not wrong
    assert DOCUMENTATION.startswith(f"{REPOSITORY}/")
    urls = project()["urls"]
    assert urls["Repository"] == REPOSITORY
    assert urls["Documentation"] == DOCUMENTATION
    assert all(url == REPOSITORY or url.startswith(f"{REPOSITORY}/") for url in urls.values())


def test_the_package_has_one_name():
    """What pip, uv and pipx are asked for, but files and folders, is `INDEX_NAME`."""
    assert project()["name"] == INDEX_NAME
    spellings = {
        spelling
        for text in texts().values()
        for line in re.findall(r"\b(?:install|add) (.*)", text)
        for spelling in re.findall(r"(?<![\w./*-])(py)?(bullet[-_. ]?uav)(?![\w./*-])", line, re.I)
    }
    assert {"".join(spelling) for spelling in spellings} == {INDEX_NAME}


# Metadata in one place, and what repeats some of it for other tools


def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def recipe():
    return yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())


def parts(requirement):
    """Name and version of a requirement, in the spelling of any tool."""
    name, version = re.match(r"([\w.-]+)(?:\[\w+\])? *([^;]*)", requirement).groups()
    return name.lower().replace("_", "-"), frozenset(version.replace(" ", "").split(","))


def test_tools_that_read_the_project_table_find_everything():
    found = project()
    assert {"name", "description", "readme", "requires-python", "license"} <= found.keys()
    assert found["dynamic"] == ["version"]
    assert found["scripts"] == {"bulletuav": "bulletuav.cli:main"}
    assert len(found["dependencies"]) > 9
    assert {"test", "dev", "sb3"} <= found["optional-dependencies"].keys()


def test_nothing_is_said_in_the_project_table_and_in_setup_cfg():
    """Which holds the installed constraints alone."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    assert config.sections() == ["options.data_files"]


def test_the_recipe_for_conda_has_the_requirements_of_the_package():
    names = {"matplotlib-base": "matplotlib"}  # the package without a window toolkit
    run = dict(map(parts, recipe()["requirements"]["run"]))
    assert run.pop("python") == {""}
    found = {names.get(name, name): version for name, version in run.items()}
    assert found == dict(map(parts, project()["dependencies"]))
    assert recipe()["about"]["summary"] == project()["description"]
    skipped = project()["requires-python"].removeprefix(">=")
    assert recipe()["build"]["skip"] == f'python < "{skipped}"'


@pytest.fixture(scope="module")
def locked():
    """Packages of uv.lock by name."""
    packages = {}
    for package in tomllib.loads((ROOT / "uv.lock").read_text())["package"]:
        packages.setdefault(package["name"], []).append(package)
    return packages


def test_the_lock_file_is_of_these_requirements(locked):
    (own,) = locked["bulletuav"]
    wanted = {
        (extra, *parts(one))
        for extra, requirements in {
            "": project()["dependencies"],
            **project()["optional-dependencies"],
        }.items()
        for one in requirements
        if not one.startswith("bulletuav[")
    }
    found = {
        (
            "".join(re.findall(r"extra == '(\w+)'", one.get("marker", ""))),
            one["name"],
            frozenset(one.get("specifier", "").split(",")),
        )
        for one in own["metadata"]["requires-dist"]
        if one["name"] != "bulletuav"
    }
    assert found == wanted, "python tools/lock.py writes it again"


def test_the_lock_file_has_the_versions_of_the_suite(locked):
    suite = pins(ROOT / "constraints.txt")
    found = {
        name: {package["version"] for package in packages if "version" in package}
        for name, packages in locked.items()
    }
    differing = {
        name
        for name, version in suite.items()
        if (there := found.get(name.replace("_", "-").replace(".", "-"))) and version not in there
    }
    assert not differing, "python tools/lock.py writes it again"
    assert len(suite.keys() & {name.replace("-", "_") for name in found}) > 60


def needed(locked, python, extra):
    """Packages of uv.lock that an installation on Linux (x86-64) has, with an extra or None."""
    minor = python.rpartition(".")[0]
    environment = {
        "python_full_version": python,
        "python_version": minor,
        "sys_platform": "linux",
        "platform_system": "Linux",
        "platform_machine": "x86_64",
        "platform_python_implementation": "CPython",
        "implementation_name": "cpython",
        "os_name": "posix",
        "extra": f"extra-9-bulletuav-{extra}" if extra else "",
    }
    (own,) = locked["bulletuav"]
    todo = [*own["dependencies"], *own["optional-dependencies"].get(extra, [])]
    found = {}
    while todo:
        wanted = todo.pop()
        if not Marker(wanted.get("marker", "python_version > '3'")).evaluate(environment):
            continue
        versions = locked[wanted["name"]]
        version = wanted.get("version", versions[0]["version"])
        (package,) = (one for one in versions if one["version"] == version)
        extras = wanted.get("extra", [])
        for name in ("", *extras):
            if (wanted["name"], name) not in found:
                found[wanted["name"], name] = package
                optional = package.get("optional-dependencies", {})
                todo += optional.get(name, []) if name else package.get("dependencies", [])
    return [package for (_, extra), package in found.items() if not extra]


@pytest.mark.parametrize("minor", [11, 12, 13, 14])
def test_the_suite_installs_from_wheels_on_each_python(locked, minor):
    """So that no compiler is needed."""
    platforms = [f"manylinux_2_{k}_x86_64" for k in range(5, 29)]
    platforms += [f"manylinux{year}_x86_64" for year in ("1", "2010", "2014")]
    version = (3, minor)
    tags = {*cpython_tags(version, platforms=platforms)}
    tags |= {*compatible_tags(version, f"cp3{minor}", platforms)}
    packages = needed(locked, f"3.{minor}.9", "test")
    without = {
        package["name"]
        for package in packages
        if not any(
            parse_wheel_filename(one["url"].rpartition("/")[2])[3] & tags
            for one in package.get("wheels", [])
        )
    }
    assert len(packages) > 150
    assert not without


def test_the_lock_file_names_the_usual_index_alone(locked):
    others = [one for packages in locked.values() for one in packages if one["name"] != "bulletuav"]
    assert {one["source"]["registry"] for one in others} == {"https://pypi.org/simple"}
    files = re.findall(r'url = "(.*?)"', (ROOT / "uv.lock").read_text())
    assert len(files) > 1000
    assert all(one.startswith("https://files.pythonhosted.org/packages/") for one in files)


def test_the_lock_file_has_no_wheels_of_other_systems(locked):
    packages = (one for packages in locked.values() for one in packages)
    wheels = [one["url"] for package in packages for one in package.get("wheels", [])]
    others = re.compile(r"-(cp31\dt|cp31[5-9]|win32|win_arm64|musllinux\w+|ios\w+)\b")
    assert len(wheels) > 1000
    assert not list(filter(others.search, wheels)), "python tools/lock.py writes it again"


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
    lines = project()["dependencies"]
    (required,) = (Requirement(line) for line in lines if line.startswith("pybullet"))
    here = {"python_version": "3.11", "platform_system": "Linux", "platform_machine": "x86_64"}
    here["platform_python_implementation"] = "CPython"
    assert required.marker.evaluate({**here, **environment}) == expected
    assert project()["optional-dependencies"]["bullet"] == ["pybullet>=3.2.6"]


def test_licenses_of_all_dependencies_are_told():
    wanted = {}
    lists = {"always": project()["dependencies"], **project()["optional-dependencies"]}
    for extra, requirements in lists.items():
        for requirement in requirements:
            name = re.split(r"[\[<>= ;]", requirement)[0]
            if name != "bulletuav":
                wanted.setdefault(name, set()).add(extra)
    _, told_of = (ROOT / "THIRD_PARTY.md").read_text().split("## What it is installed with")
    _, *rows = re.findall(r"^\| ([\w-]+) \| (.*?) \| \S", told_of, re.MULTILINE)
    told = {name: set(extras.replace("`", "").split(", ")) for name, extras in rows}
    assert told == wanted


# Continuous integration, and the image


def workflow(name):
    return yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text())["jobs"]


def commands(job):
    """Lines that a job runs."""
    return [line for step in job["steps"] for line in step.get("run", "").splitlines()]


def readme_commands():
    """Words of the README's first flight, and the commands of its tests."""
    flight, suite = re.findall(r"```bash\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    return shlex.split(flight.rpartition("&&")[2])[1:], suite.strip().split(" && ")


def test_ci_runs_on_all_pythons_that_the_package_names():
    check, flight = workflow("ci").values()
    tested = [step["with"]["python-version"] for step in check["steps"] if "with" in step]
    flown = flight["strategy"]["matrix"]["python"]
    name = "Programming Language :: Python :: "
    named = {one.removeprefix(name) for one in project()["classifiers"] if one.startswith(name)}
    assert {*tested, *flown} == named - {"3"}


def test_ci_flies_the_first_flight_of_the_readme():
    words, _ = readme_commands()
    lines = commands(workflow("ci")["flight"])
    assert shlex.join(["bulletuav", *words]) in lines
    assert lines[-1] == f"bulletuav verify {words[words.index('--out') + 1]}"


def test_newest_dependencies_run_the_test_command_of_the_readme():
    jobs = workflow("newest")
    _, (_, install, *checks) = readme_commands()
    lines = "\n".join(commands(jobs["suite"]))
    assert all(check in lines for check in checks)
    assert install.partition("constraints.txt ")[2] in lines  # what is installed, at any version
    assert "constraints" not in lines
    # Names whose bounds a second run leaves out
    (lifted,) = re.findall(r"printf '(.*?)' > lifted.txt", lines)
    bounded = {parts(one)[0] for one in project()["dependencies"] if "<" in one.partition(";")[0]}
    assert {*lifted.split("\\n")} - {""} == bounded
    assert "pip-audit --strict" in "\n".join(commands(jobs["audit"]))


def test_the_image_flies_the_first_flight_of_the_readme():
    text = (ROOT / "Dockerfile").read_text()
    (command,) = re.findall(r"^CMD (.*)$", text, re.MULTILINE)
    words, _ = readme_commands()
    assert json.loads(command) == words
    assert re.search(r"^USER (?!0|root)", text, re.MULTILINE)


def test_the_image_is_built_from_what_a_wheel_needs():
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert lines[1] == "*"
    given = {line[1:] for line in lines if line.startswith("!")}
    assert not [name for name in given if not (ROOT / name).exists()]
    manifest = re.findall(r"^(?:graft|include) (.*)$", (ROOT / "MANIFEST.in").read_text(), re.M)
    needed = {name.partition("/")[0] for line in manifest for name in line.split()}
    needed |= {project()["readme"], *project()["license-files"]}
    assert needed | {"bulletuav", "pyproject.toml", "setup.cfg", "setup.py"} <= given
