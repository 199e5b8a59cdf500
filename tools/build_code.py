"""Build the machine code that wheels ship, for each level of x86-64 processors.

    python tools/build_code.py [--levels x86-64-v3 ...] [--tasks hover ...] [--out FOLDER]

The tool flies the covering flights (`bulletuav.commands.covering`), and lists the functions that
they used, with the types of arguments. It then compiles these for each level, in a process of its
own, as numba counts compiled functions in their symbols. Nothing that is compiled for a level is
run: code for AVX-512 can be built on any x86-64 computer. A wheel that is built afterwards has the
code; see `bulletuav/compiled/shipped.py`.
"""

import argparse
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = Path(__file__).parents[1] / "bulletuav"
OUT = PACKAGE / "compiled" / "shipped"
LEVELS = ("x86-64-v2", "x86-64-v3", "x86-64-v4")


class Root(NamedTuple):
    """A specialisation of a compiled function.

    Attributes:
        module: Name of the function's module.
        name: Name of the function in its module.
        is_inner: Whether compiled code or programs call it, not Python.
        arguments: Numba types of the arguments.
    """

    module: str
    name: str
    is_inner: bool
    arguments: tuple[Any, ...]


def dispatchers() -> Iterator[tuple[str, str, Any]]:
    """Yield the module, the name and the dispatcher of each compiled function that was used."""
    from bulletuav.compiled.dispatcher import Dispatcher
    from bulletuav.compiled.kernel import Elementwise
    from bulletuav.tasks.loops import LOOP_MODULE

    for module in list(sys.modules.values()):
        home = getattr(module, "__name__", "")
        if not home.startswith(("bulletuav.", LOOP_MODULE)):
            continue
        for name, found in list(vars(module).items()):
            # Functions of numbers create their dispatcher when Python first calls them
            made = vars(found).get("_of_numbers") if isinstance(found, Elementwise) else found
            if isinstance(made, Dispatcher) and made.py_func.__module__ == home:
                yield home, name, made


def find_roots() -> list[Root]:
    """List the specialisations that this process has used, in a fixed order."""
    found = set()
    for module, name, dispatcher in dispatchers():
        found |= {Root(module, name, False, kinds) for kinds in dispatcher.overloads}
        if not dispatcher.targetoptions.get("forceinline"):
            found |= {Root(module, name, True, kinds) for kinds in dispatcher.inner.overloads}
    # Functions of lanes, whose number depends on the level, are compiled with their callers
    kept = [root for root in found if "Lanes" not in str(root.arguments)]
    return sorted(kept, key=lambda root: (root[:3], str(root.arguments)))


def fly(file: Path, tasks: Sequence[str]) -> None:
    """Fly, and write the specialisations that were used, and the sources of loops, to a file.

    Args:
        file: The file.
        tasks: Names of tasks whose flights are flown; all flights if empty.
    """
    from numba.core.serialize import dumps

    from bulletuav.commands.covering import list_flights
    from bulletuav.commands.progress import show_progress
    from bulletuav.compiled.folders import cache_folder
    from bulletuav.tasks.loops import LOOP_MODULE

    flights = [one for one in list_flights() if not tasks or one.name.split(",")[0] in tasks]
    with show_progress("flying", len(flights), "flights", is_compilation=True) as report:
        for k, flight in enumerate(flights):
            report.note(flight.name)
            flight.run()
            report(k + 1)
    roots = find_roots()
    stems = {root.module.removeprefix(LOOP_MODULE) for root in roots if LOOP_MODULE in root.module}
    loops = {stem: (cache_folder() / "loops" / f"{stem}.py").read_text() for stem in sorted(stems)}
    file.write_bytes(dumps((loops, [dumps(root) for root in roots])))


def compile_roots(file: Path, level: str, out: Path) -> None:
    """Compile the specialisations of a file, and copy the machine code to a folder."""
    from numba import config

    # Python code that calls compiled functions during the import must not run code of the level
    config.DISABLE_JIT = True
    import bulletuav.compiled.dispatcher
    import bulletuav.compiled.plain

    config.DISABLE_JIT = False
    from bulletuav.commands.progress import show_progress
    from bulletuav.compiled.folders import cache_folder
    from bulletuav.compiled.kernel import Elementwise
    from bulletuav.tasks.loops import load_loop

    assert bulletuav.compiled.plain.SWITCH.is_on
    loops, roots = pickle.loads(file.read_bytes())
    folder = cache_folder()
    (folder / "loops").mkdir()
    for stem, text in loops.items():
        path = folder / "loops" / f"{stem}.py"
        path.write_text(text)
        load_loop(path)
    with show_progress(level, len(roots), "functions", is_compilation=True) as report:
        for k, packed in enumerate(roots):
            root = pickle.loads(packed)
            found = getattr(import_module(root.module), root.name)
            found = found._of_numbers if isinstance(found, Elementwise) else found
            (found.inner if root.is_inner else found).compile(root.arguments)
            report.note(root.name)
            report(k + 1)
    # Inlined functions are part of their callers
    inlined = {
        made.inner._cache._base
        for _, _, made in dispatchers()
        if made.targetoptions.get("forceinline")
    }
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    for path in sorted(folder.glob("*.nbc")):
        if path.name.split(".")[0] not in inlined:
            shutil.copyfile(path, out / path.name)
    files = list(out.iterdir())
    print(f"{out}: {len(files)} files, {sum(one.stat().st_size for one in files) / 1e6:.1f} MB")


def run_for(level: str, roots: Path, out: Path) -> None:
    """Compile for a level in a new process."""
    from bulletuav.compiled.shipped import LEVELS

    settings = {one.name: one.settings for one in LEVELS}[level]
    with tempfile.TemporaryDirectory() as cache:
        variables = {
            "NUMBA_CPU_NAME": level,
            "NUMBA_CPU_FEATURES": settings,
            "NUMBA_CACHE_DIR": cache,
            "PYTHONHASHSEED": "0",
        }
        command = [sys.executable, __file__, "--roots", roots, "--levels", level, "--out", out]
        subprocess.run(command, env={**os.environ, **variables}, check=True)


def main() -> None:
    """Fly, and compile for all levels."""
    parser = argparse.ArgumentParser(description="Build the machine code that wheels ship.")
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=LEVELS)
    parser.add_argument("--tasks", nargs="+", default=(), help="tasks to fly (default: all)")
    parser.add_argument("--out", type=Path, default=OUT, help="folder with a folder for each level")
    parser.add_argument("--roots", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.roots is not None:
        (level,) = arguments.levels
        compile_roots(arguments.roots, level, arguments.out / level)
        return
    with tempfile.TemporaryDirectory() as folder:
        roots = Path(folder, "roots")
        fly(roots, arguments.tasks)
        for level in arguments.levels:
            run_for(level, roots, arguments.out)


if __name__ == "__main__":
    main()
