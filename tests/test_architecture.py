"""Rooms import those above them alone, and one file of the engine imports pybullet."""

import ast
import graphlib
import importlib
import sys
from pathlib import Path

import pytest

import bulletuav

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import rooms

PACKAGE = Path(bulletuav.__file__).parent
RANK = {name: rank for rank, names in enumerate(rooms.ROOMS) for name in names}
FILES = sorted(PACKAGE.rglob("*.py"))
PARTS = {"__init__", "frame_measures", "base", "check", "config", "ends", "frame", "given"}
PARTS |= {"goal_flight", "user_service"}
PARTS |= {"families", "ingredients", "loops", "spawns", "stages", "starts", "targets"}
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
    "pyulog",
    "rerun",
    "rosbags",
}


def own(path):
    return path.relative_to(PACKAGE).as_posix()


@pytest.fixture(scope="module")
def imports():
    """(file, module, whether it is imported with the file) of all imports."""
    return [(path, *one) for path in FILES for one in rooms.imported(path)]


def test_rooms_import_those_above_them_alone(imports):
    assert not {rooms.room_of(path) for path in FILES} - set(RANK), "no place in the architecture"
    against = []
    for path, module, _ in imports:
        here, parts = rooms.room_of(path), module.split(".")
        is_ours = parts[0] == "bulletuav" and len(parts) > 1 and parts[1] != here
        if is_ours and RANK[parts[1]] >= RANK[here]:
            against.append(f"{own(path)} imports {module}")
    assert not against


def test_no_file_imports_itself_by_others(imports):
    edges = {}
    for path, module, _ in imports:
        if module.startswith("bulletuav."):
            parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
            name = ".".join(part for part in parts if part != "__init__")
            edges.setdefault(name, set()).add(module)
    assert len(list(graphlib.TopologicalSorter(edges).static_order())) > 100


def test_tasks_never_import_each_other(imports):
    tasks = [path for path in FILES if path.parent.name == "tasks" and path.stem not in PARTS]
    assert [path.stem for path in tasks] == bulletuav.list_tasks()
    names = {f"bulletuav.tasks.{path.stem}" for path in tasks}
    assert not [own(path) for path, module, _ in imports if path in tasks and module in names]


def test_chains_of_classes_in_tasks_and_environments_have_three_links_at_most():
    def links(kind):
        own = [base for base in kind.__bases__ if base.__module__.startswith("bulletuav")]
        return 1 + max(map(links, own), default=0)

    kinds = set()
    for path in FILES:
        if {"tasks", "envs"} & set(path.parts):
            name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
            module = importlib.import_module(name.removesuffix(".__init__"))
            kinds |= {one for one in vars(module).values() if isinstance(one, type)}
    own = [kind for kind in kinds if kind.__module__.startswith("bulletuav")]
    assert len(own) > 150
    assert not [kind.__name__ for kind in own if links(kind) > 3]


INTERFACES = {"add_arguments", "run", "main"}
"""Names that each command, or each program, has to define"""
NAMED = {"register", "reward", "end", "block"}
"""Decorators of ingredients, whose names are those that users give"""


def is_ingredient(node):
    calls = [one.func if isinstance(one, ast.Call) else one for one in node.decorator_list]
    return any(isinstance(one, ast.Name) and one.id in NAMED for one in calls)


def test_no_public_name_is_defined_in_two_files():
    files = {}
    for path in FILES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                is_public = not node.name.startswith("_") and node.name not in INTERFACES
                if is_public and not is_ingredient(node):
                    files.setdefault(node.name, set()).add(own(path))
    assert len(files) > 1500
    assert not {name: sorted(where) for name, where in files.items() if len(where) > 1}


def test_engine_and_extras_stay_in_their_places(imports):
    engine = {own(path) for path, module, _ in imports if module.split(".")[0] == "pybullet"}
    assert engine == {"engine/calls.py"}
    needed = [
        f"{own(path)} needs the extra {module} to be imported"
        for path, module, at_once in imports
        if at_once and module.split(".")[0] in EXTRAS
    ]
    assert not needed


def test_the_library_does_not_print():
    prints = [
        f"{own(path)}, line {node.lineno}"
        for path in FILES
        if path.parent.name != "commands"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("print", "exit")
    ]
    assert not prints


def bases_of_classes():
    """(file, names of its bases) of each class, by its name; a name may be there twice."""
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                bases = [one.value if isinstance(one, ast.Subscript) else one for one in node.bases]
                yield node.name, own(path), [ast.unparse(one).split(".")[-1] for one in bases]


def test_environments_are_composed_and_not_derived_in_chains():
    every = list(bases_of_classes())
    here = {name: bases for name, path, bases in every if path.startswith("envs/")}

    def depth(name):
        return 1 + max(map(depth, here[name]), default=0) if name in here else 0

    assert {name: depth(name) for name in here if depth(name) > 3} == {}
    assert max(map(depth, here)) == 3
    derived = [base for _, _, bases in every for base in bases]
    assert [name for name in here if derived.count(name) == 1] == [], "made to be derived from once"
