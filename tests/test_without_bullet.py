"""PyBullet is optional: what works without it, to the bit, and the errors of what does not."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest
import without_bullet

from bulletuav.cli import main
from bulletuav.report.verification import Verifier

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("digests.txt").read_text().splitlines()


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A flight of the default dynamics, on a machine with PyBullet."""
    folder = tmp_path_factory.mktemp("bullet") / "flight"
    main(["fly", "hover", "--out", str(folder), "--animation", "none", "--horizon", "15"])
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("absent")


@pytest.fixture(scope="module")
def found(recording, folder):
    """Results of a process without PyBullet."""
    command = [sys.executable, without_bullet.__file__, str(recording), str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT / "tests", check=False)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def test_flights_without_it_have_the_bits_of_the_table(found):
    assert {line.split("dynamics=")[1].split()[0] for line in found["digests"]} == {
        "single_integrator",
        "double_integrator",
        "point_mass",
        "rigid_body",
    }
    assert set(found["digests"]) <= set(TABLE)


def test_bodies_rays_and_snapshots_have_the_same_bits_with_it(found, tmp_path):
    assert list(without_bullet.airspace_hash(tmp_path / "one.obj")) == found["airspace"]
    assert found["airspace"][1] > 0, "the drones touch the walls"
    assert without_bullet.pictures_hash() == found["pictures"]


@pytest.mark.parametrize(
    "what",
    ["dynamics", "rays", "contacts", "camera", "airspace", "airspace contacts"],
)
def test_an_error_names_reason_and_remedy(found, what):
    error = found["errors"][what]
    assert error.startswith("ImportError")
    for part in ("No module named 'pybullet'", "pip install", "[bullet]'", "C++ compiler"):
        assert part in error


def test_the_default_is_rigid_body_with_one_warning(found):
    flown = found["warned"]["flown"]
    assert flown[:3] == ["rigid_body", "rigid_body", "single_integrator"]
    assert "rigid_body" in flown[3]
    (warning,) = found["warned"]["warnings"]
    for part in ("'rigid_body' instead of 'bullet'", "2 cm", "pip install", "[bullet]'"):
        assert part in warning


def test_commands_fly_draw_and_verify(found, folder):
    flown = found["commands"]["fly"]
    assert flown["code"] == 0, flown["err"]
    assert "dynamics rigid_body" in flown["out"]
    about = json.loads((folder / "own" / "run.json").read_text())
    assert about["options"]["dynamics"] == "rigid_body"
    assert {"tracks.png", "replay.html"} <= {path.name for path in (folder / "own").iterdir()}
    assert found["commands"]["verify"]["code"] == 0
    assert "NO" not in found["commands"]["verify"]["out"]
    refused = found["commands"]["fly bullet"]
    assert refused["code"] == 2
    assert "error: PyBullet is needed" in refused["err"]
    doctor = " ".join(found["commands"]["doctor"]["out"].split())
    assert "pybullet │ not installed" in doctor
    assert "pybullet: pip install" in doctor
    speeds = found["commands"]["benchmark"]
    assert speeds["code"] == 0, speeds["err"]
    assert "rigid_body" in speeds["out"]
    assert "bullet " not in speeds["out"]


@pytest.mark.bullet
def test_recordings_are_verified_in_the_dynamics_that_flew_them(found, folder):
    """Both were flown by the default, which differs."""
    refused = found["commands"]["verify bullet"]
    assert refused["code"] == 2
    assert "which was flown with dynamics 'bullet'" in refused["err"]
    assert all(check.same for check in Verifier().verify(folder / "own"))


def imports_it(path):
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {one.name.split(".")[0] for one in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or "").split(".")[0])
    return "pybullet" in names


def test_one_module_imports_it():
    folders = ("bulletuav", "tests", "examples", "tools")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert {path.relative_to(ROOT).as_posix() for path in paths if imports_it(path)} == {
        "bulletuav/engine/calls.py"
    }
