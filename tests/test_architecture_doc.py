"""The page on architecture names functions that there are, in rooms that there are."""

import ast
import re
import sys
from pathlib import Path

import pytest

import bulletuav

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
TEXT = PAGE.read_text()
LINKS = sorted(set(re.findall(r"\[([^\]]+)\]\(([^)#]+)\)", TEXT)))
SECTIONS = dict(re.findall(r"^## (.*)\n\n((?:(?!^## ).*\n)*)", TEXT, re.MULTILINE))
sys.path.append(str(ROOT / "tools"))
import rooms  # noqa: E402


def named(path):
    """Functions and classes of a file, and methods as Class.method."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        for inner in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(inner, ast.FunctionDef):
                yield f"{node.name}.{inner.name}"


@pytest.mark.parametrize(("name", "target"), LINKS, ids=[name for name, _ in LINKS])
def test_what_is_named_is_there(name, target):
    path = (PAGE.parent / target).resolve()
    assert path.is_file(), target
    if path.suffix == ".py" and name != path.name:
        assert name in set(named(path)), f"{name} is not in {target}"


def test_rooms_stand_in_their_order():
    rows = re.findall(r"^\| (`.*?`) \|", SECTIONS["Packages"], re.MULTILINE)
    told = [tuple(re.findall(r"`(\w+)`", row)) for row in rows]
    there = rooms.graph()
    order = [tuple(room for room in line if room in there) for line in rooms.ROOMS]
    # The page may give rooms of one line of the rule a line each
    assert [room for line in told for room in line] == [room for line in order for room in line]


def test_a_decision_goes_through_every_room_below_the_environments():
    through = set(re.findall(r"\.\./bulletuav/(\w+)/", SECTIONS["One decision"]))
    assert {"control", "vehicle", "dynamics", "engine", "sensors", "conflict", "tasks"} < through
    assert {"envs", "policies", "analysis"} < through


def test_every_kind_of_ingredient_is_told_with_its_example_and_its_check():
    table = SECTIONS["Ingredients"]
    examples = {path.name for path in (ROOT / "examples" / "own").glob("*.*")}
    told = set(re.findall(r"\[([\w.]+)\]\((?:\.\./)+examples/own/", table))
    assert told == examples - {"heavy.py"}
    checks = {name for name in bulletuav.__all__ if name.startswith("check_")}
    assert checks <= set(re.findall(r"\[(check_\w+)\]", table))
