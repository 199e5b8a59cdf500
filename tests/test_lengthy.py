"""The list of tests that the README's command leaves out."""

import ast
import sys
from pathlib import Path

import conftest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))
import lengthy_tests  # noqa: E402

LOG = """
12.00s call     tests/a.py::test_long
0.40s call     tests/a.py::test_of_cases[1-x]
0.10s setup    tests/a.py::test_of_cases[1-x]
0.40s call     tests/a.py::test_of_cases[2-y z]
0.60s call     tests/a.py::TestGroup::test_short
9.00s call     tests/test_golden.py::test_kept
"""


def test_cases_of_a_test_count_together():
    found = lengthy_tests.find_lengthy([LOG, "2.00s call     tests/b.py::test_slower"])
    names = ["tests/a.py::test_long", "tests/a.py::test_of_cases", "tests/b.py::test_slower"]
    assert found == sorted([*names, *lengthy_tests.WHOLE])


def test_all_listed_tests_exist():
    names = {name for name in conftest.LENGTHY if not name.startswith("#")}
    existing = {name for name in lengthy_tests.WHOLE if (ROOT / name).is_file()}
    for path in {name.partition("::")[0] for name in names}:
        for node in ast.parse((ROOT / path).read_text()).body:
            if isinstance(node, ast.ClassDef):
                existing |= {
                    f"{path}::{node.name}::{one.name}" for one in node.body if hasattr(one, "name")
                }
            elif isinstance(node, ast.FunctionDef):
                existing.add(f"{path}::{node.name}")
    assert not names - existing, "tools/lengthy_tests.py writes the list again"
    assert len(names) > 100
