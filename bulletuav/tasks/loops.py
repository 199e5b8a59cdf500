"""Loops over all drones of all worlds, generated for a per-drone function.

The loops of the package's own ingredients are written to files in the folder of compiled kernels,
so that numba caches their machine code. Loops of user functions are compiled in each process.
"""

import functools
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

from bulletuav.compiled.folders import cache_folder
from bulletuav.compiled.kernel import uncached
from bulletuav.files import replace_file

TUPLES = (2, 3, 4)
"""Vector sizes that are passed to functions as tuples; longer vectors are passed as arrays"""
LOOP_MODULE = "_bulletuav_loop_"
"""Prefix of the module names of loops, before the name of the file"""
Form = str | int
"""How an argument is read: a key of `_EXPRESSIONS`, or the size of a vector"""

_EXPRESSIONS = {
    "drone": "{name}[w, i]",
    "world": "{name}[w]",
    "array": "{name}[w]",
    "number": "{name}",
    "index": "i",
    "out": "out[w, i]",
}


def make_loop(
    function: FunctionType, forms: Sequence[tuple[str, Form]], results: int | None
) -> Callable[..., None]:
    """Compile a loop that evaluates a function for each drone and stores the results.

    Args:
        function: Per-drone function.
        forms: Name and form of each of its arguments.
        results: 0 for one number in `out` (W, N); k for k numbers in `out` (W, N, k); None if the
            function itself writes to its argument `out`.

    Returns:
        Compiled function of the argument arrays and `out`.
    """
    return _compiled(function, tuple(forms), results)


@functools.cache
def _compiled(
    function: FunctionType, forms: tuple[tuple[str, Form], ...], results: int | None
) -> Callable[..., None]:
    source = _source(function.__name__, forms, results)
    home = function.__module__ or ""  # empty in code run by `exec`
    if home.startswith("bulletuav.") and function.__qualname__ == function.__name__:
        return _from_file(home, function.__name__, source)
    # User functions may change at any time, so they are not cached on disk
    space: dict[str, Any] = {"function": uncached(function, forceinline=True)}
    exec(compile(source, f"<loop of {function.__qualname__}>", "exec"), space)
    loop: Callable[..., None] = uncached(space["loop"])
    return loop


def _source(name: str, forms: tuple[tuple[str, Form], ...], results: int | None) -> str:
    given = [name for name, form in forms if form not in ("index", "out")]
    call = f"function({', '.join(_expression(*form) for form in forms)})"
    body = [f"def loop({', '.join([*given, 'out'])}):", f'    """Loop over drones for {name}."""']
    body += ["    for w in range(out.shape[0]):", "        for i in range(out.shape[1]):"]
    if results is None:
        body += [f"            {call}"]
    elif results == 0:
        body += [f"            out[w, i] = {call}"]
    elif results == 1:
        body += [f"            out[w, i, 0] = {call}"]
    else:
        body += [f"            result = {call}"]
        body += [f"            out[w, i, {k}] = result[{k}]" for k in range(results)]
    return "\n".join([*body, ""])


def _expression(name: str, form: Form) -> str:
    if isinstance(form, int):
        return "(" + ", ".join(f"{name}[w, i, {k}]" for k in range(form)) + ")"
    return _EXPRESSIONS[form].format(name=name)


def _from_file(module: str, name: str, source: str) -> Callable[..., None]:
    """Load the loop of one of the package's ingredients from its file, writing it if missing."""
    text = (
        f'"""Generated: the loop of `{module}.{name}`."""\n\n'
        "from bulletuav.compiled.kernel import func, kernel\n"
        f"from {module} import {name} as plain\n\n"
        "function = func(plain)\n\n\n"
        f"@kernel\n{source}"
    )
    # The name depends on the text, so no process reads a partly written file
    stamp = hashlib.sha256(text.encode()).hexdigest()[:12]
    path = Path(cache_folder(), "loops", f"{name}_{stamp}.py")
    if not path.is_file():
        path.parent.mkdir(exist_ok=True)
        replace_file(path, text)
    return load_loop(path)


def load_loop(path: Path) -> Callable[..., None]:
    """Import the file of a loop as a module of its own, and return the loop."""
    spec = importlib.util.spec_from_file_location(f"{LOOP_MODULE}{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None  # a file of Python source has both
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = loaded  # where numba looks for it when it loads machine code
    spec.loader.exec_module(loaded)
    loop: Callable[..., None] = loaded.loop
    return loop
