"""Follow a page in the current folder, in a process of its own: `python tutorial_driver.py STEPS`.

STEPS is a JSON file with the snippets of the page: kind, code and file. What each of them printed
and the CPU time in all, s, replace them in the file.
"""

import contextlib
import io
import json
import os
import resource
import shlex
import subprocess
import sys
from pathlib import Path


def run(kind, code, file, names):
    """Run a snippet as a reader does, and return its output."""
    if file:
        Path(file).write_text(code)
        return ""
    if kind == "python":
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(code, "<page>", "exec"), names)
        return out.getvalue()
    printed = ""
    for line in code.splitlines():
        program, *words = shlex.split(line)
        command = [Path(sys.executable).with_name(program), *words]
        printed += subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    return printed


def main():
    path = Path(sys.argv[1])
    sys.path[0] = ""  # as in an interactive session
    names = {"__name__": "__main__"}
    printed = [run(**step, names=names) for step in json.loads(path.read_text())]
    import bulletuav

    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(one.ru_utime + one.ru_stime for one in used)
    found = {"printed": printed, "seconds": seconds, "package": os.fspath(bulletuav.__file__)}
    path.write_text(json.dumps(found))


main()
