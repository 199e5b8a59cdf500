"""First use of the package in a new process: from threads, forks and spawned processes."""

import subprocess
import sys
from pathlib import Path

import first_use
import pytest

import bulletuav

FORK = """
import os, sys, threading
from numba.core.compiler_lock import global_compiler_lock
import bulletuav.compiled.dispatcher

held = threading.Event()

def compile_something():
    with global_compiler_lock:
        held.set()
        threading.Event().wait(0.3)

threading.Thread(target=compile_something).start()
held.wait(60)
child = os.fork()
if child == 0:
    os._exit(0 if global_compiler_lock._lock.acquire(timeout=10) else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
"""Forks while another thread compiles; fails if the child cannot compile"""


@pytest.mark.parametrize("way", ["threads", "import", "fork", "spawn"])
def test_every_entry_point_can_be_the_first_use_of_a_process(way):
    command = [sys.executable, str(Path(first_use.__file__)), way]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * first_use.LIMIT)
    assert (done.stdout, done.returncode) == ("ok\n", 0), done.stdout + done.stderr


def test_no_public_entry_point_is_left_out():
    assert set(bulletuav.__all__) - {"__version__"} <= set(first_use.entry_points())


def test_a_fork_can_compile_though_another_thread_was_compiling():
    subprocess.run([sys.executable, "-c", FORK], check=True, timeout=first_use.LIMIT)
