"""The names of Numba's internals that the package uses are those that the page lists."""

import ast
import importlib
import re
from pathlib import Path

import pytest

import bulletuav

PACKAGE = Path(bulletuav.__file__).parent
PAGE = PACKAGE.parent.joinpath("docs", "explanation", "compilation.md").read_text()
NAMES = re.findall(r"^\| `(numba\.[\w.]+)` \|", PAGE, re.MULTILINE)
ATTRIBUTES = {
    "dispatcher": ("_cache", "_cache_hits", "_cache_misses", "_compiler", "_compiling_counter"),
    "library": ("_final_module", "_finalized", "_linking_libraries", "_shared_module"),
}


def imported():
    """Full names of all that files import of Numba's, but for what it promises."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("numba."):
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def resolved(name):
    """What stands under a full name."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", NAMES)
def test_numba_has_the_name(name):
    assert resolved(name) is not None


def test_the_page_lists_all_that_is_imported():
    used = {name for name in imported() if not name.startswith("numba.extending.")}
    listed = set(NAMES)
    assert used <= listed | {name.rsplit(".", 1)[0] for name in listed}
    # A name of the page is imported, or is an attribute of what is
    assert all(name in used or name.rsplit(".", 1)[0] in used for name in listed)


@pytest.mark.parametrize("name", [name for names in ATTRIBUTES.values() for name in names])
def test_the_page_lists_attributes_of_objects(name):
    assert f"`{name}`" in PAGE


def test_objects_of_numbas_have_the_attributes():
    from bulletuav.compiled.functions import moderate_exp

    def objects():
        yield "dispatcher", moderate_exp.inner
        yield "library", moderate_exp.compiled((resolved("numba.types").float64,)).library

    for kind, found in objects():
        assert [name for name in ATTRIBUTES[kind] if not hasattr(found, name)] == []
