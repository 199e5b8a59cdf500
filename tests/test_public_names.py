"""The list of public names in docs/reference/names.md is what documentation and examples import."""

import ast
import importlib
import re
from pathlib import Path

import pytest

import bulletuav

ROOT = Path(__file__).parents[1]


def imported(source):
    """Names that a program imports from the package, as (module, name)."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "bulletuav":
            yield from ((node.module, alias.name) for alias in node.names)


def used():
    """All names of the package that pages and examples show, and those of its top."""
    docs = ROOT / "docs"
    pages = [ROOT / "README.md", *docs.rglob("*.md")]
    programs = [
        code
        for page in pages
        for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    ]
    programs += [path.read_text() for path in (ROOT / "examples").rglob("*.py")]
    names = {pair for program in programs for pair in imported(program)}
    return names | {("bulletuav", name) for name in bulletuav.__all__}


def listed():
    """Rows of the table of the page, as (module, name)."""
    rows = re.findall(r"^\| `(bulletuav[\w.]*)` \| (.*) \|$", PAGE.read_text(), re.MULTILINE)
    return {(module, name) for module, names in rows for name in re.findall(r"`(\w+)`", names)}


PAGE = ROOT / "docs" / "reference" / "names.md"
BY_HAND = {
    "bulletuav.adapters.benchmarl",
    "bulletuav.adapters.rllib",
    "bulletuav.adapters.rllib_vector",
}
"""Modules that need BenchMARL or Ray"""


def test_the_page_lists_what_documentation_and_examples_import():
    names = {}
    for module, name in sorted(used()):
        names.setdefault(module, []).append(f"`{name}`")
    table = "\n".join(f"| `{module}` | {', '.join(own)} |" for module, own in names.items())
    assert used() <= listed(), f"the table in {PAGE.name} should have:\n{table}"


def defined(module):
    """Names that a module's source defines, for one that needs what the suite has not."""
    path = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    body = ast.parse(path.read_text()).body
    targets = [target for node in body if isinstance(node, ast.Assign) for target in node.targets]
    return {target.id for target in targets if isinstance(target, ast.Name)} | {
        node.name for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef)
    }


@pytest.mark.parametrize("module", sorted({module for module, _ in listed()}))
def test_public_names_are_there(module):
    for name in (name for home, name in listed() if home == module):
        if module in BY_HAND:
            assert name in defined(module)
        elif not hasattr(importlib.import_module(module), name):
            importlib.import_module(f"{module}.{name}")
