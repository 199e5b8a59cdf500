"""Ctrl-C ends the command line with at most one line and status 130, whenever it comes."""

import os
import signal
import subprocess
import sys

import pytest

from bulletuav import interrupts

INJECTED = """
import os, signal, sys

class At:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, At)
"""
FLY = ["fly", "crossing", "--dynamics", "point_mass", "--animation", "none"]
IN_CALLBACK = """
import ctypes, os, signal, sys, time
from bulletuav import interrupts

signal.signal(signal.SIGINT, interrupts.exit_on_interrupt)
interrupts.atexit.register(interrupts._exit_after_interrupt)

@ctypes.CFUNCTYPE(None)
def callback():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0)

try:
    with interrupts.raise_interrupts():
        callback()
        time.sleep(60)
        print("not interrupted")
except KeyboardInterrupt:
    print("caught")
    sys.exit(1)
"""


IN_CONVERSION = """
import os, signal, sys, time
from typing import NamedTuple

import numba
from numba.core import serialize

from bulletuav import interrupts


class Inner(NamedTuple):
    one: float


class Outer(NamedTuple):
    first: Inner
    other: float


@numba.njit
def make(one):
    return Outer(Inner(one), 2 * one)


find, calls = serialize._numba_unpickle, 0


def _numba_unpickle(*arguments):
    global calls
    calls += 1
    if calls == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0)
    return find(*arguments)


serialize._numba_unpickle = _numba_unpickle
signal.signal(signal.SIGINT, interrupts.exit_on_interrupt)
interrupts.atexit.register(interrupts._exit_after_interrupt)
try:
    with interrupts.raise_interrupts():
        print(make(1.0))
        time.sleep(60)
except KeyboardInterrupt:
    print("caught")
    sys.exit(1)
"""


@pytest.mark.parametrize(
    "module",
    [
        "bulletuav.envs.registration",
        "numpy",
        "numba",
        "gymnasium",
        "bulletuav.cli",
        "bulletuav.commands.fly",
    ],
)
def test_while_modules_are_imported(module, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INJECTED)
    run = subprocess.run(
        [sys.executable, "-m", "bulletuav", *FLY],
        env={**os.environ, "PYTHONPATH": str(tmp_path), "INTERRUPT_AT": module},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "interrupted\n")


def test_by_the_installed_script(tmp_path):
    """Which has the name of the command, and imports the package before it calls anything."""
    script = tmp_path / "bulletuav"
    script.write_text("from bulletuav.cli import main\nmain()\n")
    (tmp_path / "sitecustomize.py").write_text(INJECTED)
    run = subprocess.run(
        [sys.executable, script, "doctor"],
        env={**os.environ, "PYTHONPATH": str(tmp_path), "INTERRUPT_AT": "numba"},
        capture_output=True,
        text=True,
    )
    assert (run.returncode, run.stderr) == (130, "interrupted\n")


def test_programs_keep_their_own_handlers():
    program = "import signal, bulletuav\n"
    program += "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler"
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize(
    ("words", "sign"),
    [
        ([*FLY, "--horizon", "100000", "--set", "goal_radius=0.001"], "flying: 1 "),
        (
            ["evaluate", "converge", *FLY[2:4], "--workers", "2", "--episodes", "4000"],
            "flying: ",
        ),
        (["serve", "crazyflie", "--port", "0"], ""),
    ],
    ids=["flight", "workers", "serve"],
)
def test_while_a_command_runs(words, sign, tmp_path):
    """The whole group of processes is interrupted, as by a terminal."""
    running = subprocess.Popen(
        [sys.executable, "-u", "-m", "bulletuav", *words],
        cwd=tmp_path,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    # A server says on its output where it is
    stream = running.stderr if sign else running.stdout
    assert any(line.startswith(sign) for line in stream)
    os.killpg(running.pid, signal.SIGINT)
    _, err = running.communicate(timeout=120)
    said = [line for line in err.splitlines() if not line.startswith(("flying: ", "compiling"))]
    assert running.returncode == 130
    assert len(said) == 1
    assert said[0].startswith("interrupted")


def test_in_a_callback_of_c_code_it_comes_again():
    """Such as those by which LLVM hands out machine code, which can raise nothing."""
    run = subprocess.run(
        [sys.executable, "-c", IN_CALLBACK], capture_output=True, text=True, timeout=120
    )
    assert (run.returncode, run.stdout, run.stderr) == (130, "caught\n", "")


@pytest.mark.parametrize("call", [1, 2])
def test_while_a_result_is_converted_it_comes_again(call):
    """Numba's machine code does not notice an exception of the functions that it calls then."""
    run = subprocess.run(
        [sys.executable, "-c", IN_CONVERSION, str(call)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    made = "Outer(first=Inner(one=1.0), other=2.0)\n"
    assert (run.returncode, run.stdout, run.stderr) == (130, f"{made}caught\n", "")


def test_children_start_without_it():
    with interrupts.block_interrupts():
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    os.kill(child.pid, signal.SIGINT)
    child.communicate(b"\n", timeout=120)
    assert child.returncode == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
