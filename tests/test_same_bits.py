"""The same bits on processors and C libraries that round differently, as far as they are emulated.

Not of dynamics `bullet`: Bullet's own sine and cosine are those of the C library.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import bulletuav

PACKAGE = Path(bulletuav.__file__).parent
PROGRAM = """
import bulletuav
import digests

# Networks of each kind, and a baseline that sums points up
for task, policy in (("hover", "trained"), ("crossing", "trained"), ("mec", "trained"),
                     ("mobile_users", "kmeans")):
    print(bulletuav.evaluate(task, policy, 2, 0, dynamics="rigid_body", horizon=20).hash)
CASES = [
    {"task": "crossing", "dynamics": "rigid_body", "difficulty": "extreme"},
    {"task": "converge", "dynamics": "point_mass", "difficulty": "hard"},
    {"task": "pursuit", "dynamics": "single_integrator"},
    {"task": "follow", "dynamics": "double_integrator"},
    {"task": "obstacles", "dynamics": "rigid_body", "action": "heading_speed"},
    {"task": "lidar_navigation", "dynamics": "rigid_body"},
    {"task": "mec_advanced", "difficulty": "hard"},
    {"task": "race", "dynamics": "rigid_body", "difficulty": "extreme", "randomization": {}},
    {"task": "mobile_users"},
    {"task": "formation", "dynamics": "rigid_body", "assignment": "free", "change_every": 2.0},
    {"task": "hover", "dynamics": "rigid_body", "controller": "pid", "effects": ("downwash",)},
    {"task": "hover", "observation": ("barometric_height", "magnetometer", "optical_flow")},
]
for case in CASES:
    print(digests.digest({**case, "num_worlds": 2}))
"""
EMULATED = {
    "another BLAS": {"OPENBLAS_CORETYPE": "Nehalem"},
    "NumPy without vector units": {
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
    },
    "a C library without FMA": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"
    },
    "compiled code for any processor": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
}
ONCE = "NumPy without vector units", "a C library without FMA", "another BLAS"
EMULATED["all of these at once"] = {k: v for name in ONCE for k, v in EMULATED[name].items()}


def flown(variables):
    """Digests of flights in a process of its own."""
    folder = str(Path(__file__).parent)
    paths = os.pathsep.join([folder, os.environ.get("PYTHONPATH", "")])
    told = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": paths, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr[-2000:]
    return told.stdout.split()


@pytest.fixture(scope="module")
def usual():
    """Those of this process, which has loaded most kernels already."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(PROGRAM, "program", "exec"), {})
    return told.getvalue().split()


@pytest.mark.parametrize(
    "machine",
    [
        name if "at once" in name else pytest.param(name, marks=pytest.mark.slow)
        for name in EMULATED
    ],
)
def test_flights_are_the_same_on(machine, usual):
    assert len(usual) == 16
    assert flown(EMULATED[machine]) == usual


ROOMS = [
    "geometry",
    "earth",
    "vehicle",
    "control",
    "contact",
    "dynamics",
    "network",
    "sensors",
    "tasks",
    "envs",
    "policies",
]
OTHERS = re.compile(
    r"\b(math|np|cmath)\.(exp|expm1|log|log10|log1p|log2|pow|power|float_power|sin|cos|tan|asin|"
    r"acos|atan|atan2|arcsin|arccos|arctan|arctan2|sinh|cosh|tanh|hypot)\("
)
LOOKS = {"geometry/view.py", "sensors/camera.py", "envs/renderer.py"}
"""Files of pictures, which flights do not depend on"""
EXACT_ENOUGH = {
    "geometry/convex.py",  # bounds of shapes, by the length of corners
    "tasks/spawns.py",  # how deep a start may be in the ground
}


@pytest.mark.parametrize("room", ROOMS)
def test_flights_depend_on_functions_of_our_own(room):
    for path in (PACKAGE / room).rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        if name not in LOOKS | EXACT_ENOUGH:
            assert not OTHERS.search(path.read_text()), name
