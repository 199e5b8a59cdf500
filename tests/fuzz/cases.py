"""Cases: damaged files that are read, one after the other; this runs in a process of its own."""

import contextlib
import faulthandler
import json
import random
import re
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

from .formats import FORMATS
from .mutations import damage

PATIENCE = 120.0
"""Seconds until a case counts as a hang"""
MOST_MEMORY = 8 * 2**30
"""Bytes of memory that a case may take"""
LONGEST = 4000
"""Characters of a message"""


def files_of(name, folder):
    """The valid files of a format, as bytes by their names."""
    FORMATS[name].make(folder)
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def lay_out(files, folder):
    shutil.rmtree(folder, ignore_errors=True)
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)


def write_damaged(name, seed, index, files, folder):
    """Write the files of a case: the first ones are no files, the others are damaged."""
    lay_out(files, folder)
    path = folder / FORMATS[name].file
    if index in (0, 1):
        path.unlink()
        if index:
            path.mkdir()
        return
    rng = random.Random(f"{name} {seed} {index}")
    content = files[Path(FORMATS[name].file)]
    path.write_bytes(damage(content, FORMATS[name].kind, rng))


def fault_of(name, folder):
    """What is wrong with how a case ended, if anything."""
    try:
        FORMATS[name].read(folder)
    except (ValueError, OSError) as error:
        text = str(error)
        if str(folder) not in text:
            return f"no name of the file: {type(error).__name__}: {text[:500]}" + where()
        if len(text) > LONGEST or "\n" in text:
            return f"a message of {len(text)} characters, more than a line: {text[:500]}"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:500]}" + where()
    return None


def where():
    """The last lines of the traceback."""
    return "\n" + "".join(traceback.format_exc().splitlines(keepends=True)[-9:-1])


def run(name, seed, first, last):
    """Read cases; each begins and ends with a line on standard output."""
    with tempfile.TemporaryDirectory() as place:
        valid, folder = Path(place, "valid"), Path(place, "damaged files")
        valid.mkdir()
        files = files_of(name, valid)
        lay_out(files, folder)
        if fault := fault_of(name, folder):
            print(json.dumps({"name": name, "index": -1, "fault": fault}), flush=True)
        for index in range(first, last):
            write_damaged(name, seed, index, files, folder)
            print(json.dumps({"name": name, "index": index, "begins": True}), flush=True)
            faulthandler.dump_traceback_later(PATIENCE, exit=True)
            fault = fault_of(name, folder)
            faulthandler.cancel_dump_traceback_later()
            print(json.dumps({"name": name, "index": index, "fault": fault}), flush=True)


def main(words):
    """Run cases `NAME SEED FIRST LAST`, one after the other."""
    warnings.simplefilter("ignore")
    with contextlib.suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    for word in words:
        name, seed, first, last = re.fullmatch(r"(.+):(\d+):(\d+):(\d+)", word).groups()
        run(name, int(seed), int(first), int(last))


if __name__ == "__main__":
    main(sys.argv[1:])
