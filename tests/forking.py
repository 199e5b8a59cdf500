"""Programs that are run in forks of a process which has imported Numba: those begin at once."""

import contextlib
import functools
import json
import subprocess
import sys

FORKING = """
import json, os, sys
import numba
import numpy
from numba.core.registry import cpu_target

if sys.argv[1] == "warm":
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
sys.dont_write_bytecode = True  # Python's own cache would not see the edits
for line in sys.stdin:
    folder, codes = json.loads(line)
    children = []
    for k, code in enumerate(codes):
        child = os.fork()
        if child == 0:
            for number, name in ((1, "out"), (2, "err")):
                file = os.open(f"{folder}/{name}{k}", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
                os.dup2(file, number)
            os.chdir(folder)
            sys.path.insert(0, folder)
            numba.config.CACHE_DIR = folder + "/cache"
            exec(code, {})
            sys.stdout.flush()
            os._exit(0)
        children.append(child)
    print(json.dumps([os.waitpid(child, 0)[1] for child in children]), flush=True)
"""
"""Runs programs, each in a process that has imported Numba and compiled nothing.

If it is warm, Numba has also listed what it knows, as it does before it first compiles.
"""


@contextlib.contextmanager
def forking():
    """Run programs in a folder, all at once, and give what each printed."""
    with contextlib.ExitStack() as stack:

        @functools.cache
        def start(kind):
            command = [sys.executable, "-c", FORKING, kind]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            server = stack.enter_context(subprocess.Popen(command, **pipes))
            stack.callback(server.stdin.close)
            return server

        def run(folder, *codes, kind="warm"):
            server = start(kind)
            server.stdin.write(json.dumps([str(folder), codes]) + "\n")
            server.stdin.flush()
            ends = json.loads(server.stdout.readline())
            assert not any(ends), [(folder / f"err{k}").read_text() for k in range(len(codes))]
            return [(folder / f"out{k}").read_text() for k in range(len(codes))]

        yield run
