"""First use of the package in a new process: from threads, forks and spawned processes."""

import subprocess
import sys
from pathlib import Path

import first_use
import pytest

import bulletuav


@pytest.mark.parametrize("way", ["threads", "import", "fork", "spawn"])
def test_every_entry_point_can_be_the_first_use_of_a_process(way):
    command = [sys.executable, str(Path(first_use.__file__)), way]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * first_use.LIMIT)
    assert (done.stdout, done.returncode) == ("ok\n", 0), done.stdout + done.stderr


def test_no_public_entry_point_is_left_out():
    assert set(bulletuav.__all__) - {"__version__"} <= set(first_use.entry_points())
