"""What is imported at the start: names, commands and ids are there before their modules are."""

import ast
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from waiting import PATIENCE

import bulletuav
from bulletuav import catalogue, deferred_import, registry
from bulletuav.cli import COMMANDS
from bulletuav.envs import registration
from bulletuav.policies import policy_names
from bulletuav.tasks import find_task

SLOW = {"gymnasium", "matplotlib", "numba", "pettingzoo", "pybullet", "rich", "scipy", "torch"}
"""Packages that take long to import"""
REPORT = """
import atexit, json, sys
atexit.register(lambda: sys.stderr.write("\\n" + json.dumps(sorted(sys.modules))))
"""
COMPLETION = {
    "_ARGCOMPLETE": "1",
    "_ARGCOMPLETE_IFS": "\n",
    "_ARGCOMPLETE_STDOUT_FILENAME": os.devnull,
}


def imported(program, *words, **variables):
    """Top-level packages and modules that a program has imported at its end."""
    command = [sys.executable, "-c", REPORT + program, *words]
    run = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables)
    modules = json.loads(run.stderr.rpartition("\n")[2])
    assert "bulletuav" in modules, run.stderr
    return {name.partition(".")[0] for name in modules} | set(modules)


COMMAND = """
import sys
sys.argv = ["bulletuav", *sys.argv[1:]]
from bulletuav.cli import main
main()
"""


def test_importing_the_package_imports_no_other():
    assert not imported("import bulletuav; dir(bulletuav)") & {*SLOW, "numpy"}


@pytest.mark.parametrize("words", [["--help"], ["--version"], []])
def test_help_imports_no_other_package(words):
    assert not imported(COMMAND, *words) & {*SLOW, "numpy", "bulletuav.registry"}


def test_the_list_of_tasks_imports_no_task():
    assert not imported(COMMAND, "tasks") & {*SLOW, "bulletuav.tasks"}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_arguments_of_commands_import_nothing_slow(name):
    """As when an invalid argument ends the command."""
    program = COMMAND.replace("main()", "main([*sys.argv[1:], '--no-such-option'])")
    assert not imported(program, name) & SLOW


@pytest.mark.parametrize("line", ["bulletuav tra", "bulletuav fly cross", "bulletuav fly x --pol"])
def test_completion_imports_nothing_slow(line):
    pytest.importorskip("argcomplete", reason="needs the extra completion")
    asked = COMPLETION | {"COMP_LINE": line, "COMP_POINT": str(len(line))}
    program = "import os\nos._exit = sys.exit\n" + COMMAND  # as exit handlers report the modules
    assert not imported(program, **asked) & SLOW


STEP = """
import bulletuav
env = bulletuav.parallel_env("crossing", num_drones=2)
env.reset(seed=0)
env.step({agent: env.action_space(agent).sample() for agent in env.agents})
"""


def test_a_first_step_imports_no_more_than_it_needs():
    """Numba imports SciPy's linear algebra where code is compiled, and not where it is loaded."""
    unneeded = SLOW - {"gymnasium", "numba", "pettingzoo", "pybullet", "scipy"} | {"scipy.linalg"}
    first = imported(STEP) & unneeded
    assert not first or not imported(STEP) & unneeded  # the first may compile


def test_a_first_flight_imports_no_more_than_it_needs(tmp_path):
    """Neither SciPy nor what only live views use; numba imports the linear algebra to compile."""
    words = ["fly", "crossing", "--drones", "2", "--policy", "straight", "--out", str(tmp_path)]
    words += ["--set", "horizon=2", "--set", "dynamics=point_mass"]
    assert not imported(COMMAND, *words) & {"scipy.spatial", "asyncio"}
    assert (tmp_path / "tracks.png").exists()


# Names


def test_names_are_those_that_type_checkers_see():
    tree = ast.parse(Path(bulletuav.__file__).read_text())
    (block,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    typed = {
        (alias.asname, node.module)
        for node in block.body
        for alias in node.names
        if alias.name == alias.asname
    }
    assert typed == set(bulletuav.MODULES.items())
    assert set(bulletuav.__all__) == {*bulletuav.MODULES, "__version__"}


def test_names_are_found_kept_and_listed():
    for name, module in bulletuav.MODULES.items():
        found = getattr(bulletuav, name)
        assert found is getattr(sys.modules[module], name)
        assert vars(bulletuav)[name] is found
    assert set(bulletuav.__all__) <= set(dir(bulletuav))
    everything = {}
    exec("from bulletuav import *", everything)
    assert set(bulletuav.__all__) <= everything.keys()


def test_subpackages_are_found_and_other_names_are_not(tmp_path):
    program = "import bulletuav\nassert bulletuav.tasks.find_task('hover').name == 'hover'\n"
    program += "assert not hasattr(bulletuav, 'paralel_env')\n"
    subprocess.run([sys.executable, "-c", program], check=True)
    with pytest.raises(AttributeError, match=r"module 'bulletuav' has no attribute 'paralel_env'"):
        bulletuav.paralel_env  # noqa: B018


# Names that are read from source files


@pytest.mark.parametrize("kind", ["task", "policy", "action", "dynamics"])
def test_declared_names_are_those_of_the_registry(kind):
    own = {
        name
        for name in registry.names(kind)
        if registry.find(kind, name, lambda _: True).__module__.startswith("bulletuav.")
    }
    assert set(catalogue.declarations(kind)) == own


def test_declared_tasks_have_the_summary_and_the_version_of_their_class():
    for name, declared in catalogue.declarations("task").items():
        task = find_task(name)
        assert declared == (task.__doc__.partition("\n")[0], task.version)


def test_policies_are_listed_as_they_are_found():
    assert set(catalogue.list_policies()) >= {"orca", "trained"}
    assert set(catalogue.list_policies()) <= set(policy_names())


def test_a_version_is_read(tmp_path, monkeypatch):
    source = 'from typing import ClassVar\n\n\n@register("task")\nclass Own(Task[Config]):\n'
    source += (
        '    """Fly.\n\n    Far.\n    """\n\n    name = "mine"\n    version: ClassVar[int] = 3\n'
    )
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mine.py").write_text(source)
    monkeypatch.setattr(catalogue, "PACKAGE", tmp_path)
    monkeypatch.setitem(registry.PACKAGES, "task", "bulletuav.own")
    assert catalogue.declarations.__wrapped__("task") == {"mine": ("Fly.", 3)}


# Ids of Gymnasium and PettingZoo

MAKE = """
for name in ("gymnasium", "pettingzoo"):  # as programs do that only look for a package
    importlib.util.find_spec(name)
env = gymnasium.make("bulletuav/Hover-v2", dynamics="point_mass")
env.reset(seed=0)
env = gymnasium.make_vec("bulletuav/Crossing-v2", 2, dynamics="point_mass")
if hasattr(pettingzoo, "register"):
    pettingzoo.make("parallel", "bulletuav/Hover-v2", dynamics="point_mass")
    pettingzoo.make("aec", "bulletuav/Hover-v2", dynamics="point_mass")
"""


@pytest.mark.parametrize(
    "imports",
    [
        "import bulletuav, importlib.util\nimportlib.util.find_spec('gymnasium')\n"
        "import gymnasium, pettingzoo\n",
        "import gymnasium, pettingzoo, bulletuav, importlib.util\n",
        "import gymnasium, bulletuav, pettingzoo, importlib.util\n",
    ],
)
def test_ids_are_registered_whatever_is_imported_first(imports):
    subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", imports + MAKE], check=True)


def test_registration_imports_neither_numba_nor_a_task():
    program = "import bulletuav, gymnasium, pettingzoo\n"
    program += "assert 'bulletuav/Hover-v2' in gymnasium.registry\n"
    assert not imported(program) & {"numba", "scipy", "pybullet", "bulletuav.tasks"}


PLUGIN = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav import check_task
from bulletuav.tasks import Frame, Spawn, Task, TaskConfig


class Perch(Task[TaskConfig]):
    """Drones perch."""

    Config = TaskConfig
    name = "perch"
    version = 2
    observation = ("velocity",)
    reward: ClassVar = {"distance": -1.0}

    def spawn(self, rng):
        return Spawn(position=np.zeros((self.num_drones, 3)) + (0, 0, 2))
'''


@pytest.fixture
def plugin(tmp_path):
    """A folder with a package that declares a task by an entry point."""
    (tmp_path / "perching.py").write_text(PLUGIN)
    folder = tmp_path / "perching-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: perching\nVersion: 1\n")
    (folder / "entry_points.txt").write_text("[bulletuav.task]\nperch = perching:Perch\n")
    return tmp_path


@pytest.mark.parametrize(
    "imports",
    [
        "import bulletuav, gymnasium",
        "import gymnasium, bulletuav",
        "import bulletuav; bulletuav.parallel_env; import gymnasium",
    ],
)
def test_tasks_of_other_packages_get_ids_and_are_listed(imports, plugin):
    program = f"{imports}\nassert 'bulletuav/Perch-v2' in gymnasium.registry\n"
    variables = {**os.environ, "PYTHONPATH": str(plugin)}
    command = [sys.executable, "-W", "error::UserWarning", "-c", program]
    subprocess.run(command, env=variables, check=True)


def test_tasks_of_other_packages_are_listed(plugin):
    command = [sys.executable, "-m", "bulletuav", "tasks"]
    variables = {**os.environ, "PYTHONPATH": str(plugin)}
    listed = subprocess.run(command, env=variables, check=True, capture_output=True, text=True)
    assert "\nperch            Drones perch.\n" in listed.stdout
    assert "\npursuit " in listed.stdout


def test_what_cannot_be_imported_registers_nothing():
    finder = registration._Finder()
    assert finder.find_spec("numpy", None) is None
    assert finder.find_spec("gymnasium", ["/nowhere"]) is None


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_process_forked_during_an_import_imports():
    holds, may_end = threading.Event(), threading.Event()

    def import_for_long():
        with deferred_import._lock:
            holds.set()
            may_end.wait(PATIENCE)

    thread = threading.Thread(target=import_for_long)
    thread.start()
    assert holds.wait(PATIENCE)
    child = os.fork()
    if not child:
        signal.alarm(60)  # ends a child that hangs
        os._exit(deferred_import.import_name("math", "pi") < 3)
    may_end.set()
    thread.join()
    assert os.waitpid(child, 0)[1] == 0
