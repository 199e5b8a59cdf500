"""The same bits on processors and C libraries that round differently, as far as they are emulated.

Not of dynamics `bullet`: Bullet's own sine and cosine are those of the C library.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import digests

CASES = [
    {"task": "crossing", "dynamics": "rigid_body", "difficulty": "extreme"},
    {"task": "converge", "dynamics": "point_mass", "difficulty": "hard"},
    {"task": "pursuit", "dynamics": "single_integrator"},
    {"task": "follow", "dynamics": "double_integrator"},
    {"task": "obstacles", "dynamics": "rigid_body", "action": "heading_speed"},
    {"task": "lidar_navigation", "dynamics": "rigid_body"},
    {"task": "mec_advanced", "difficulty": "hard"},
    {"task": "mobile_users"},
    {"task": "hover", "dynamics": "rigid_body", "controller": "pid", "effects": ("downwash",)},
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
    "compiled code for any processor": {"NUMBA_CPU_NAME": "generic"},
}


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
    return flown({})


@pytest.mark.parametrize(
    "machine",
    [
        pytest.param(name, marks=pytest.mark.slow) if "compiled" in name else name
        for name in EMULATED
    ],
)
def test_flights_are_the_same_on(machine, usual):
    assert len(usual) == 9
    assert flown(EMULATED[machine]) == usual
