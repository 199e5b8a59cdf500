"""Rooms import those above them alone, and pybullet is known in three files of the engine."""

import ast
import graphlib
import sys
from pathlib import Path

import pytest

import bulletuav

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import rooms

PACKAGE = Path(bulletuav.__file__).parent
RANK = {name: rank for rank, names in enumerate(rooms.ROOMS) for name in names}
FILES = sorted(PACKAGE.rglob("*.py"))
PARTS = {"__init__", "account", "base", "check", "config", "ends", "frame", "given"}
PARTS |= {"ingredients", "loops", "spawns", "stages", "starts", "targets"}
"""Files beside the tasks of which these are made"""
EXTRAS = {
    "argcomplete",
    "shapely",
    "imageio_ffmpeg",
    "stable_baselines3",
    "torch",
    "filelock",
    "ray",
    "torchrl",
    "tensordict",
    "benchmarl",
    "hydra",
    "omegaconf",
    "imageio",
    "msgpack",
    "onnx",
    "onnxruntime",
    "pymavlink",
    "rerun",
    "rosbags",
}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_rooms_import_those_above_them_alone(path):
    own = rooms.room_of(path)
    assert own in RANK, f"{own} has no place in the architecture"
    for module, _ in rooms.imported(path):
        if module.startswith("bulletuav."):
            other = module.split(".")[1]
            allowed = other == own or RANK[other] < RANK[own]
            assert allowed, f"{path} imports {module}"


def test_no_file_imports_itself_by_others():
    edges = {}
    for path in FILES:
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        own = ".".join(part for part in parts if part != "__init__")
        edges[own] = {
            module for module, _ in rooms.imported(path) if module.startswith("bulletuav.")
        }
    assert len(list(graphlib.TopologicalSorter(edges).static_order())) > 100


def test_tasks_never_import_each_other():
    tasks = [path for path in FILES if path.parent.name == "tasks" and path.stem not in PARTS]
    assert [path.stem for path in tasks] == bulletuav.list_tasks()
    names = {f"bulletuav.tasks.{path.stem}" for path in tasks}
    for path in tasks:
        assert not names & {module for module, _ in rooms.imported(path)}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_engine_and_extras_stay_in_their_places(path):
    for module, at_once in rooms.imported(path):
        root = module.split(".")[0]
        assert root != "pybullet" or path.relative_to(PACKAGE).as_posix() in (
            "engine/engine.py",
            "engine/calls.py",
            "engine/bodies.py",
        )
        assert root not in EXTRAS or not at_once, f"{path} needs the extra {root} to be imported"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_the_library_does_not_print_and_files_stay_short(path):
    text = path.read_text()
    if path.parent.name != "commands":
        calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
        assert not [
            call
            for call in calls
            if isinstance(call.func, ast.Name) and call.func.id in ("print", "exit")
        ]
    assert text.count("\n") <= 400
