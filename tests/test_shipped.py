"""Machine code that wheels ship: how it is built, and that it is complete.

What is loaded from where is tested in `test_kernel.py`.
"""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.serialize import dumps
from numba.core.types import float64

from bulletuav.compiled.shipped import CODE

sys.path.append(str(Path(__file__).parents[1] / "tools"))
import build_code

CHECK = """
import sys
from bulletuav.commands.covering import list_flights
from bulletuav.compiled import dispatcher

compiled = []
make = dispatcher._Stored._make

def noted(self, sig, *arguments):
    compiled.append(f"{self.py_func.__module__}.{self.py_func.__name__}{sig}")
    return make(self, sig, *arguments)

dispatcher._Stored._make = noted
for flight in list_flights()[int(sys.argv[1])::int(sys.argv[2])]:
    flight.run()
print("compiled:", compiled)
"""
"""Flies some of the flights, and prints what was compiled"""


def fly_with_shipped_code(cache, first, step):
    if CODE is None:
        pytest.skip("python tools/build_code.py has built no machine code for this processor")
    command = [sys.executable, "-W", "ignore", "-c", CHECK, str(first), str(step)]
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    assert done.stdout == "compiled: []\n", done.stdout + done.stderr


def test_a_covering_set_compiles_nothing(tmp_path):
    fly_with_shipped_code(tmp_path, 7, 97)


@pytest.mark.slow
def test_no_flight_compiles_anything(tmp_path):
    fly_with_shipped_code(tmp_path, 0, 1)


@pytest.fixture
def build(tmp_path):
    """Builds code of a function for AVX-512; gives the content of files by name."""
    if platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("levels are of x86-64")
    root = build_code.Root("bulletuav.compiled.functions", "tan", False, (float64,))
    (tmp_path / "roots").write_bytes(dumps(({}, [dumps(root)])))

    def build(name):
        build_code.run_for("x86-64-v4", tmp_path / "roots", tmp_path / name)
        return {file.name: file.read_bytes() for file in (tmp_path / name).glob("x86-64-v4/*")}

    return build


def test_code_is_built_for_a_level_that_the_processor_may_lack(build):
    """Running the code would end the process."""
    assert sorted(name.split("-")[0] for name in build("one")) == ["cos", "sin", "tan"]


@pytest.mark.slow
def test_two_builds_are_alike(build):
    assert build("one") == build("other")


def test_roots_are_what_the_process_has_used():
    from bulletuav.compiled.functions import moderate_exp, tan

    tan(1.0)
    roots = build_code.find_roots()
    assert ("bulletuav.compiled.functions", "tan", False, (float64,)) in roots
    # Inlined functions are part of their callers
    assert (float64,) not in moderate_exp.overloads
    assert not [root for root in roots if root.name == moderate_exp.__name__]
