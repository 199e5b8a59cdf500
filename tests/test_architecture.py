"""The house: each folder imports only those to its left, and the engine is known in three files of physics alone."""

import ast
from pathlib import Path

import pytest

import bulletuav

PACKAGE = Path(bulletuav.__file__).parent
LAYERS = [
    {"errors", "files", "kernel", "version"},
    {"physics", "control"},
    {"city", "network"},
    {"sensors"},
    {"tasks"},
    {"envs"},
    {"policies", "adapters"},
    {"record", "metrics", "evaluation"},
    {"training"},
    {"pictures", "charts", "leaderboard", "benchmark", "doctor"},
    {"__init__", "commands", "cli", "__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
FILES = sorted(PACKAGE.rglob("*.py"))
EXTRAS = {"shapely", "imageio_ffmpeg", "stable_baselines3", "torch", "filelock", "ray", "torchrl", "imageio"}


def imported(path):
    """(module, is it imported when the file is) of every import in a file."""
    tree = ast.parse(path.read_text())
    at_once = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, id(node) in at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module, id(node) in at_once


def part(parts):
    """Which room of the house a dotted path or file belongs to."""
    return parts[0] if parts else "__init__"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_to_the_left(path):
    own = path.relative_to(PACKAGE).with_suffix("").parts
    assert own[0] in RANK, f"{own[0]} has no place in the house"
    for module, _ in imported(path):
        if module == "bulletuav" or module.startswith("bulletuav."):
            assert RANK[part(module.split(".")[1:])] <= RANK[own[0]], f"{path} imports {module}"


def test_tasks_never_import_each_other():
    tasks = [path for path in FILES if path.parent.name == "tasks" and path.stem not in ("__init__", "base", "check")]
    names = {f"bulletuav.tasks.{path.stem}" for path in tasks}
    for path in tasks:
        assert not names & {module for module, _ in imported(path)}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_engine_and_extras_stay_in_their_places(path):
    for module, at_once in imported(path):
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
        assert not [call for call in calls if isinstance(call.func, ast.Name) and call.func.id in ("print", "exit")]
    assert text.count("\n") <= 340
