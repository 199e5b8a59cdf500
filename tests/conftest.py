import gc
import importlib.util
import multiprocessing
import os
import runpy
import shutil
import sys
from pathlib import Path

# Two processes fly at once: threads of PyTorch and BLAS in each would wait for one another.
# Set before these are imported, and inherited by what tests start.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Bullet takes 30 MB for each client, and tests make thousands: the C library keeps what is freed,
# instead of asking the system anew. It reads this when a process starts, as those of xdist do.
os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(2**26))
os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(2**28))
# Workers and a hundred children import the package: they read what the first of them compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import bench
import placing
import pytest
from hypothesis import settings

from bulletuav.engine.calls import HAS_BULLET

sys.dont_write_bytecode = False  # of this process, which began before

# TorchRL sets "spawn" for the whole process when it is imported, if nobody has asked before.
multiprocessing.get_start_method()

settings.register_profile(
    "bulletuav", deadline=None, derandomize=True
)  # the first call may compile
settings.load_profile("bulletuav")


TRAINERS = ("stable_baselines3", "supersuit", "tensorboard", "tensordict", "torch", "torchrl")
ABSENT = frozenset(name for name in TRAINERS if importlib.util.find_spec(name) is None)
"""Modules of trainers that are not installed, as PyTorch is large"""
LENGTHY = frozenset(Path(__file__).with_name("lengthy.txt").read_text().splitlines())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark tests that take long, and those to skip, before pytest selects by marks."""
    for item in items:
        name = item.nodeid.partition("[")[0]
        if name in LENGTHY or name.partition("::")[0] in LENGTHY:
            item.add_marker("lengthy")
        if item.get_closest_marker("bullet") and not HAS_BULLET:
            item.add_marker(pytest.mark.skip(reason="needs PyBullet"))


def find_missing(error):
    """Return the package that an error is about, if it is optional and not installed.

    The error of a missing extra is raised while that of the import is handled.
    """
    while isinstance(error, ImportError | SystemExit):
        if not HAS_BULLET and "PyBullet is needed" in str(error):
            return "PyBullet"
        root = (getattr(error, "name", None) or "").partition(".")[0]
        if root in ABSENT:
            return root
        error = error.__cause__ or error.__context__
    return None


class Module(pytest.Module):
    """Tests of a file, skipped if the file imports an optional package that is not installed."""

    def collect(self):
        try:
            return super().collect()
        except self.CollectError as error:
            missing = find_missing(error.__cause__)
            if missing is None:
                raise
            pytest.skip(f"needs {missing}", allow_module_level=True)


def pytest_pycollect_makemodule(module_path, parent):
    return Module.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Skip tests of what needs an optional package that is not installed."""
    report = yield
    missing = find_missing(call.excinfo and call.excinfo.value)
    if missing is not None:
        report.outcome = "skipped"
        report.longrepr = (str(item.path), item.location[1], f"Skipped: needs {missing}")
    return report


@pytest.fixture(autouse=True, scope="module")
def little_to_collect():
    """Leaves what imports and compiled kernels keep out of later searches for garbage.

    Without it, a quarter of the suite's time goes into these searches.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def compiles_in_silence():
    """Tests that read the log would meet it or not, by what was compiled before them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bulletuav.compiled.dispatcher.MANY", 10**9)
        yield


@pytest.fixture
def make_bench():
    """Builds benches and closes their worlds."""
    made = []

    def make(*args, **options):
        made.append(bench.Bench(*args, **options))
        return made[-1]

    yield make
    for one in made:
        one.engine.close()


@pytest.fixture
def users_bench():
    """Builds aviaries of tasks over users and closes them."""
    one = placing.Placing()
    yield one
    one.close()


@pytest.fixture
def make(users_bench):
    return users_bench.make


@pytest.fixture
def put(users_bench):
    return users_bench.put


@pytest.fixture
def urdf(tmp_path):
    """Writes a changed copy of an airframe: urdf("cf2x", ("old", "new"), ...) -> path."""
    from bulletuav import load_airframe

    def write(name, *changes):
        file = load_airframe(name).urdf
        text = file.read_text()
        for mesh in file.parent.glob(f"{name}_*.obj"):
            shutil.copy(mesh, tmp_path)
        for old, new in changes:
            assert old in text, f"{old!r} is not in {name}.urdf"
            text = text.replace(old, new)
        path = tmp_path / "own.urdf"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def finned(urdf):
    """Path of a hummingbird with a fin, and no forward rotor."""
    fin = '<wing name="fin" x="-0.1" y="0" z="0" span="0.1" chord="0.1" dihedral="1.57" '
    fin += 'zero_lift="0" stall="0.2" drag="0.01" moment="0" efficiency="0.8"/></airframe>'
    return urdf("hummingbird", ("</airframe>", fin))


@pytest.fixture
def turns(monkeypatch):
    """Periods of the turns that were waited for; nothing waits."""
    from bulletuav.envs.pacer import Pacer

    waited = []
    monkeypatch.setattr(Pacer, "wait", lambda self: waited.append(self.period))
    return waited


@pytest.fixture
def run_program(tmp_path, monkeypatch, capsys):
    """Runs a program as its command does, in an empty folder; gives what it printed."""

    def run(path, arguments=""):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [str(path), *arguments.split()])
        # What Python does for a script, and runpy does not
        monkeypatch.syspath_prepend(path.parent)
        runpy.run_path(str(path), run_name="__main__")
        return capsys.readouterr().out

    return run
