"""`bulletuav compile`: compile all functions before the first flight."""

import argparse
import os
import subprocess
import sys

import llvmlite.binding as llvm

from bulletuav.commands.progress import show_progress
from bulletuav.compiled.dispatcher import COMPILATION
from bulletuav.compiled.folders import cache_folder
from bulletuav.compiled.shipped import native_mark
from bulletuav.report.doctor import describe_code


def run(arguments: argparse.Namespace) -> None:
    """Fly the covering flights in a process whose target is the requested one."""
    mark = native_mark()
    if arguments.native:
        # Numba's target cannot be changed any more in this process
        _run_again({"NUMBA_CPU_NAME": llvm.get_host_cpu_name()})
        mark.touch()
    elif mark.is_file():
        mark.unlink()
        _run_again({})
    else:
        compile_all()


def _run_again(variables: dict[str, str]) -> None:
    """Run the command without arguments in a new process; exit if it fails."""
    command = [sys.executable, "-m", "bulletuav", "compile"]
    code = subprocess.run(command, env={**os.environ, **variables}, check=False).returncode
    if code:
        sys.exit(code)


def compile_all() -> None:
    """Fly the covering flights, and print how many functions were compiled."""
    # Imported late, as the parser of the command line does not need it
    from bulletuav.commands.covering import list_flights

    flights = list_flights()
    with show_progress("compiling", len(flights), "flights", is_compilation=True) as report:
        for k, flight in enumerate(flights):
            report.note(f"{COMPILATION.num_functions} functions, {flight.name}")
            flight.run()
            report(k + 1)
    if COMPILATION.num_functions == 0:
        print(f"nothing to compile; machine code: {describe_code()}")
        return
    number, seconds = COMPILATION.num_functions, COMPILATION.seconds
    print(f"compiled {number} functions in {seconds:.0f} s, kept in {cache_folder()}")
